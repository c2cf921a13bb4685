"""What the user chooses: one frozen value, the same from the command line to the panel.

Importing this module is cheap on purpose (no kernels, no robots), so that `--help` and a
mistyped option answer at once.
"""

from __future__ import annotations

import contextlib
import io
import math
import sys
import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from inspect import cleandoc
from typing import Annotated, Any, TypeVar

import tyro
from tyro.constructors import PrimitiveConstructorSpec

from app import choices, limits
from app.limits import SEEDS, File, Limit, Number, OneOf, Switch, Text, Whole
from app.words import (
    OptionError,
    format_length,
    format_point,
    format_speed,
    format_turn,
    parse_corridor,
    parse_length,
    parse_point,
    parse_radius,
    parse_speed,
    parse_turn,
)

# The settings that say which mesh, and how it is prepared and placed; they change together.
MESH = ("mesh", "unit", "frame", "at", "rotate", "up", "damage", "seed", "repair", "flip", "path")

# What a value may be, on the command line and in every file; the panel clamps numbers to these.
LIMITS: dict[str, Limit] = {
    "mesh": File(),
    "unit": OneOf("unit", choices.UNITS, optional=True),
    "frame": OneOf("frame", choices.FRAMES, optional=True),
    "at": limits.Place(optional=True),
    "rotate": limits.Turn(),
    "up": OneOf("axis", choices.AXES),
    "damage": OneOf("damage", choices.DAMAGES),
    "seed": Whole(*SEEDS),
    "repair": Switch(),
    "flip": Switch(),
    "path": File(optional=True),
    "corridor": limits.Length(1e-4, 2e-2, optional=True),
    "robot": OneOf("robot", choices.ROBOTS),
    "rule": OneOf("rule", choices.RULES),
    "radius": limits.Length(5e-5, 2e-2, optional=True),
    "rate": Number(10.0, 20_000.0, unit="Hz"),
    "host": Text(255),
    "port": Whole(0, 65535),
    "open": Switch(),
    "standoff": limits.Length(1e-6, 1e-3),
    "tip_radius": limits.Length(0.0, 5e-3),
    "scale": Number(0.05, 2.0),  # proxy metres per handle metre
    "lock_orientation": Switch(),
    "tip_speed": Number(1e-3, 2.0, unit="m/s"),
    "force_gain": Number(0.0, 1000.0, unit="N/m"),
    "stale_after": Number(0.05, 10.0, unit="s"),
    "upload_limit": Number(1.0, 500.0, unit="MB"),
    "record": File(optional=True),
    "scenario": File(optional=True),
}
RANGES = {
    name: (limit.low, limit.high) for name, limit in LIMITS.items() if isinstance(limit, Number)
}

T = TypeVar("T")


def in_range(name: str, value: float) -> float:
    """The value clamped to what the setting `name` allows (not a number: refused)."""
    low, high = RANGES[name]
    value = float(value)
    if math.isnan(value):
        raise OptionError(f"{name} must be a number between {low:g} and {high:g}, not {value}")
    return min(max(value, low), high)


def _written(
    metavar: str, read: Callable[[str], Any], write: Callable[[Any], str]
) -> PrimitiveConstructorSpec[Any]:
    """How a value is written on the command line: one word, read and shown."""
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=metavar,
        instance_from_str=lambda words: read(words[0]),
        is_instance=lambda value: value is None or isinstance(value, float | int | str | tuple),
        str_from_instance=lambda value: [write(value)],
    )


def _radii(words: list[str]) -> tuple[float | None, ...]:
    return tuple(map(parse_radius, words))


def named(known: tuple[str, ...]) -> PrimitiveConstructorSpec[Any]:
    """One of some names, shown in help; limits refuse others, wherever they come from."""
    return _written("|".join(known), str, str)


def listed(known: tuple[str, ...]) -> PrimitiveConstructorSpec[Any]:
    """Some of these names, joined by commas."""
    return _written(f"{'|'.join(known)},…", str, str)


Length = Annotated[float, _written("LENGTH", parse_length, format_length)]
Radius = Annotated[float | None, _written("auto|LENGTH", parse_radius, format_length)]
Radii = Annotated[
    tuple[float | None, ...],
    PrimitiveConstructorSpec(
        nargs="*",
        metavar="auto|LENGTH …",
        instance_from_str=_radii,
        is_instance=lambda value: isinstance(value, tuple),
        str_from_instance=lambda value: [format_length(radius) for radius in value],
    ),
]
Corridor = Annotated[
    float | None,
    _written(
        "off|LENGTH", parse_corridor, lambda value: "off" if value is None else format_length(value)
    ),
]
Speed = Annotated[float, _written("SPEED", parse_speed, format_speed)]
Point = Annotated[
    tuple[float, float, float] | None, _written("auto|X,Y,Z", parse_point, format_point)
]
Turn = Annotated[tuple[float, float, float], _written("DEG,DEG,DEG", parse_turn, format_turn)]
Robot = Annotated[str, named(choices.ROBOTS)]
Rule = Annotated[str, named(choices.RULES)]
Axis = Annotated[str, named(choices.AXES)]
Damage = Annotated[str, named(choices.DAMAGES)]
Unit = Annotated[str | None, named(choices.UNITS)]
Frame = Annotated[str | None, _written("|".join(choices.FRAMES), str.upper, str)]
Mesh = Annotated[
    str,
    tyro.conf.arg(
        metavar="NAME|FILE",
        help=f"A name of the catalogue: {', '.join(choices.MESHES)}; where their package is "
        f"installed {', '.join(choices.FROM_PACKAGES)}. Or the path of a mesh file.",
    ),
]
Scenario = Annotated[
    str | None,
    tyro.conf.arg(
        metavar="NAME|FILE",
        help=f"Start with a scenario: {', '.join(choices.SCENARIOS)}; or from a JSON file. Other "
        "options win over what it says, but for the mesh.",
    ),
]


@dataclass(frozen=True)
class Options:
    """Settings of a session. Lengths in metres inside; `5mm` and the like on the command line.

    Raises:
        OptionError: a value is outside its limit in `LIMITS`. Which meshes there are is known when
            the scene is built, since that needs the libraries.
    """

    mesh: Mesh = "skull-closed"
    unit: Unit = None
    """Unit of a mesh file. Needed where its size allows mm and m."""
    frame: Frame = None
    """Patient frame of a mesh file that does not say it. It is told; nothing turns."""
    at: Point = None
    """Where the mesh's own origin goes in the arm's base frame, such as 0,-1cm,-12cm; auto:
    straight under the tip's neutral pose, which for the psm is under the remote centre."""
    rotate: Turn = (0.0, 0.0, 0.0)
    """Turn of the mesh in degrees about the base frame's x, then y, then z axis."""
    up: Axis = "z"
    """The mesh's own axis that faces the tool (write --up=-y). glTF files often have y up."""
    damage: Damage = "none"
    """Damage done to the mesh on purpose, to see how a rule bears it."""
    seed: int = 0
    """Seed of the damage."""
    repair: bool = False
    """Weld, drop what is no face, turn what is wound wrongly, before use; nothing is moved."""
    flip: bool = False
    """Turn open sheets over: they have no outside to be known by."""
    path: str | None = None
    """Text file with a planned path on the mesh: x y z in mm of the mesh's own axes, a point a
    line. The skulls come with one."""
    corridor: Corridor = None
    """How far the tool may leave the planned path sideways, or off."""
    robot: Robot = "psm"
    """Arm that carries the tool."""
    rule: Rule = "certified"
    """Which planes guard the tool: paper has its Conditions 1-3, all takes every face."""
    radius: Radius = 5e-3
    """Radius of the motion sphere; 5mm is the paper's preset, auto the largest step of a tick."""
    rate: float = 1000.0
    """Ticks of the control loop per second."""
    host: str = "127.0.0.1"
    """Address the page listens on. For one that other machines reach, such as 0.0.0.0, a token is
    printed and asked for: whoever has it can do all that the page can."""
    port: int = 8080
    """Port of the page; 0 takes any free one."""
    open: bool = False
    """Open the page in the browser once it is ready."""
    standoff: Length = 20e-6
    """Distance the tool keeps from the surface."""
    tip_radius: Length = 0.0
    """Radius of a spherical tool tip."""
    scale: float = 1.0
    """Teleoperation scale: movement of the proxy per movement of the handle."""
    lock_orientation: bool = False
    """Teleoperation keeps the tool's orientation, whatever the handle's is, as in the paper."""
    tip_speed: Speed = 2.0
    """The tool's tip goes no faster, such as 100mm/s; the joints have speed limits of their own."""
    force_gain: float = 150.0
    """Simulated haptic stiffness [N/m]."""
    stale_after: float = 0.5
    """The tool holds when a drag goes silent for this long [s]."""
    upload_limit: float = 200.0
    """Largest mesh file that the page takes [MB]."""
    record: str | None = None
    """Record the session from its start to its end into this new file, see vf-sandbox replay."""
    scenario: Scenario = None

    def __post_init__(self) -> None:
        limits.check(self, LIMITS)

    @property
    def dt(self) -> float:
        """Length of a tick [s]."""
        return 1.0 / self.rate


def parse(arguments: list[str], description: str, default: Options | None = None) -> Options:
    """Options of a session from command-line words, see `parse_as`."""
    return parse_as(Options, "vf-sandbox", arguments, description, default)


def parse_as(
    kind: type[T],
    program: str,
    arguments: list[str],
    description: str,
    default: T | None = None,
) -> T:
    """A settings dataclass from command-line words, by tyro (which prints options and errors).

    Args:
        default: where the words say nothing; None: the dataclass's own defaults.

    Raises:
        OptionError: a value was not usable.
        SystemExit: after `--help` (0) or a usage error (2).
    """
    if any(word in ("-h", "--help") for word in arguments):
        print(_wrapped(description) + "\n")  # tyro would print a paragraph as one long line
    # tyro draws a box around our own messages. They are single lines that say all there is to
    # say, so catch the box and hand the message on; tyro's own errors are printed as they come.
    box = io.StringIO()
    try:
        with contextlib.redirect_stderr(box):
            if default is None:
                return tyro.cli(kind, prog=program, description="", args=arguments)
            return tyro.cli(kind, prog=program, description="", args=arguments, default=default)
    except SystemExit as exit_:
        error = exit_.__context__
        while error is not None and not isinstance(error, OptionError):
            error = error.__cause__ or error.__context__
        if error is not None:
            raise error from None
        sys.stderr.write(box.getvalue())
        raise


def _wrapped(text: str) -> str:
    """Paragraphs in 79 columns; lines that are indented stay as they are."""
    paragraphs = cleandoc(text).split("\n\n")
    return "\n\n".join(
        part if "\n " in part or part.startswith(" ") else textwrap.fill(part, 79)
        for part in paragraphs
    )
