"""What the user chooses: one frozen value, the same from the command line to the panel.

Importing this module is cheap on purpose (no kernels, no robots), so that `--help` and a
mistyped option answer at once.
"""

from __future__ import annotations

import contextlib
import io
import math
import re
import sys
from dataclasses import dataclass
from typing import Annotated, TypeVar

import tyro
from tyro.constructors import PrimitiveConstructorSpec

# The settings that say which mesh, and how it is prepared and placed; they change together.
MESH = ("mesh", "unit", "frame", "at", "rotate", "up", "damage", "seed", "repair", "flip", "path")

# What a value may be; the panel clamps to these, the command line refuses what is outside.
RANGES: dict[str, tuple[float, float]] = {
    "radius": (5e-5, 2e-2),  # [m]
    "standoff": (1e-6, 1e-3),  # [m]
    "tip_radius": (0.0, 5e-3),  # [m]
    "corridor": (1e-4, 2e-2),  # [m]
    "scale": (0.05, 2.0),  # proxy metres per handle metre
    "tip_speed": (1e-3, 2.0),  # [m/s]
    "force_gain": (0.0, 1000.0),  # [N/m]
    "rate": (10.0, 20_000.0),  # [Hz]
    "stale_after": (0.05, 10.0),  # [s]
    "upload_limit": (1.0, 500.0),  # [MB]
}

LENGTHS = ("radius", "standoff", "tip_radius", "corridor")

_METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6, "in": 0.0254}
_LENGTH = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([a-zµμ]*)")


T = TypeVar("T")


class OptionError(ValueError):
    """A setting is not usable. The message names the value and what would be valid."""


def parse_length(text: str) -> float:
    """A length in metres from text such as `5mm`, `20um`, `0.2in` or `0.005` (bare: metres).

    Raises:
        OptionError: the text is no length; the message says how to write one.
    """
    match = _LENGTH.fullmatch(text.strip())
    unit = (match.group(2) or "m") if match else ""
    if match is None or unit not in _METRES:
        raise OptionError(
            f"'{text}' is not a length: write a number and a unit (m, cm, mm, um, in), "
            "such as 5mm, 0.5mm or 20um; a bare number such as 0.005 is in metres"
        )
    return float(match.group(1)) * _METRES[unit]


def parse_radius(text: str) -> float | None:
    """The motion sphere's radius [m]; None for `auto` (maximum tip speed times the tick)."""
    if text.strip().lower() == "auto":
        return None
    try:
        return parse_length(text)
    except OptionError as error:
        raise OptionError(f"{error}; or write auto") from None


def format_length(value: float | None) -> str:
    """The shortest text that `parse_radius` reads back as the same length, in mm or um."""
    if value is None:
        return "auto"
    for scale, unit in ((1e-3, "mm"), (1e-6, "um")):
        if abs(value) >= 0.01 * scale or unit == "um" or value == 0.0:
            return f"{value / scale:.6g}{unit}"
    raise AssertionError("unreachable")


def parse_point(text: str) -> tuple[float, float, float] | None:
    """Three lengths [m] with commas between them, such as `0,-1cm,-12cm`; None for `auto`."""
    if text.strip().lower() == "auto":
        return None
    words = text.split(",")
    if len(words) != 3:
        raise OptionError(
            f"'{text}' is not a place: write x,y,z as three lengths without spaces, "
            "such as 0,-1cm,-12cm; or write auto"
        )
    return parse_length(words[0]), parse_length(words[1]), parse_length(words[2])


def format_point(value: tuple[float, float, float] | None) -> str:
    """The text that `parse_point` reads back as the same place."""
    return "auto" if value is None else ",".join(map(format_length, value))


def parse_turn(text: str) -> tuple[float, float, float]:
    """Three angles [rad] with commas between them, in degrees such as `0,0,90`, or as `1.2rad`."""
    try:
        x, y, z = map(_angle, text.split(","))
    except ValueError:
        x = y = z = math.nan
    if not math.isfinite(x + y + z):
        raise OptionError(
            f"'{text}' is not a turn: write degrees about x,y,z as three numbers without spaces, "
            "such as 0,0,90"
        )
    return x, y, z


def _angle(word: str) -> float:
    radians = word.removesuffix("rad")
    return math.radians(float(word)) if radians == word else float(radians)


def format_turn(value: tuple[float, float, float]) -> str:
    """The text that `parse_turn` reads back as the same turn."""
    return ",".join(f"{math.degrees(angle):.9g}" for angle in value)


def in_range(name: str, value: float) -> float:
    """The value clamped to what the setting `name` allows (not a number: refused)."""
    low, high = RANGES[name]
    value = float(value)
    if math.isnan(value):
        raise OptionError(f"{name} must be a number between {low:g} and {high:g}, not {value}")
    return min(max(value, low), high)


Length = Annotated[
    float,
    PrimitiveConstructorSpec(
        nargs=1,
        metavar="LENGTH",
        instance_from_str=lambda words: parse_length(words[0]),
        is_instance=lambda value: isinstance(value, float | int),
        str_from_instance=lambda value: [format_length(value)],
    ),
]
Radius = Annotated[
    float | None,
    PrimitiveConstructorSpec(
        nargs=1,
        metavar="auto|LENGTH",
        instance_from_str=lambda words: parse_radius(words[0]),
        is_instance=lambda value: value is None or isinstance(value, float | int),
        str_from_instance=lambda value: [format_length(value)],
    ),
]

Corridor = Annotated[
    float | None,
    PrimitiveConstructorSpec(
        nargs=1,
        metavar="off|LENGTH",
        instance_from_str=lambda words: None if words[0] == "off" else parse_length(words[0]),
        is_instance=lambda value: value is None or isinstance(value, float | int),
        str_from_instance=lambda value: ["off" if value is None else format_length(value)],
    ),
]
Point = Annotated[
    tuple[float, float, float] | None,
    PrimitiveConstructorSpec(
        nargs=1,
        metavar="auto|X,Y,Z",
        instance_from_str=lambda words: parse_point(words[0]),
        is_instance=lambda value: value is None or isinstance(value, tuple),
        str_from_instance=lambda value: [format_point(value)],
    ),
]
Turn = Annotated[
    tuple[float, float, float],
    PrimitiveConstructorSpec(
        nargs=1,
        metavar="DEG,DEG,DEG",
        instance_from_str=lambda words: parse_turn(words[0]),
        is_instance=lambda value: isinstance(value, tuple),
        str_from_instance=lambda value: [format_turn(value)],
    ),
]


@dataclass(frozen=True)
class Options:
    """Settings of a session. Lengths in metres inside; `5mm` and the like on the command line.

    Raises:
        OptionError: a number is outside `RANGES`. Names (mesh, robot, rule) are checked by
            `check_names` and when the scene is built, since that needs the libraries.
    """

    mesh: str = "skull-closed"
    """Catalogue name (a wrong one lists them all), or path of a mesh file (STL, OBJ, PLY, …)."""
    unit: str | None = None
    """Unit of a mesh file: m, mm, cm or in; needed where its size allows mm and m."""
    frame: str | None = None
    """Patient frame of a mesh file that does not say it: RAS or LPS. It is told; nothing turns."""
    at: Point = None
    """Where the mesh's own origin goes in the arm's base frame, such as 0,-1cm,-12cm; auto:
    straight under the tip's neutral pose, which for the psm is under the remote centre."""
    rotate: Turn = (0.0, 0.0, 0.0)
    """Turn of the mesh in degrees about the base frame's x, then y, then z axis."""
    up: str = "z"
    """The mesh's own axis that faces the tool: z, -z, y, -y, x or -x (write --up=-y). glTF files
    often have y up."""
    damage: str = "none"
    """Damage done to the mesh on purpose, to see how a rule bears it (a wrong one lists them)."""
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
    robot: str = "psm"
    """Arm that carries the tool: psm, point, panda or ur5."""
    rule: str = "certified"
    """Which planes guard the tool: certified, paper (Conditions 1-3), all, or off."""
    radius: Radius = 5e-3
    """Radius of the motion sphere; 5mm is the paper's preset, auto the largest step of a tick."""
    rate: float = 1000.0
    """Ticks of the control loop per second."""
    host: str = "127.0.0.1"
    """Address the page listens on. For one that other machines reach, such as 0.0.0.0, a token is
    printed and asked for: whoever has it can do all that the page can."""
    port: int = 8080
    """Port of the page; 0 takes any free one."""
    standoff: Length = 20e-6
    """Distance the tool keeps from the surface."""
    tip_radius: Length = 0.0
    """Radius of a spherical tool tip."""
    scale: float = 1.0
    """Teleoperation scale: movement of the proxy per movement of the handle."""
    lock_orientation: bool = False
    """Teleoperation keeps the tool's orientation, whatever the handle's is, as in the paper."""
    tip_speed: float = 2.0
    """The tool's tip goes no faster than this [m/s]; the joints have speed limits of their own."""
    force_gain: float = 150.0
    """Simulated haptic stiffness [N/m]."""
    stale_after: float = 0.5
    """The tool holds when a drag goes silent for this long [s]."""
    upload_limit: float = 200.0
    """Largest mesh file that the page takes [MB]."""
    record: str | None = None
    """Record the session from its start to its end into this new file, see vf-sandbox replay."""
    scenario: str | None = None
    """Start with a scenario, by its name (a wrong one lists them all) or from a JSON file. Other
    options win over what it says, but for the mesh."""

    def __post_init__(self) -> None:
        for name, (low, high) in RANGES.items():
            value = getattr(self, name)
            if value is None:
                continue
            if not low <= value <= high:
                text = (
                    (format_length(value), format_length(low), format_length(high))
                    if name in ("radius", "standoff", "tip_radius", "corridor")
                    and math.isfinite(value)
                    else (f"{value:g}", f"{low:g}", f"{high:g}")
                )
                raise OptionError(f"{name} {text[0]} is outside {text[1]} to {text[2]}")
        if not 0 <= self.port <= 65535:
            raise OptionError(f"port {self.port} is outside 0 to 65535")

    @property
    def dt(self) -> float:
        """Length of a tick [s]."""
        return 1.0 / self.rate


def check_names(options: Options) -> None:
    """Refuse unknown robots, rules and the like before anything slow is started.

    Raises:
        OptionError: naming the valid choices.
    """
    import meshes
    import robots
    import vf
    from meshes.damage import kinds

    for kind, name, known in (
        ("frame", (options.frame or meshes.FRAMES[0]).upper(), meshes.FRAMES),
        ("robot", options.robot, tuple(robots.names())),
        ("rule", options.rule, tuple(vf.RULES)),
        ("axis", options.up, meshes.UPS),
        ("damage", options.damage, kinds()),
    ):
        if name not in known:
            raise OptionError(f"unknown {kind} '{name}': choose one of {', '.join(known)}")


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
    """A settings dataclass from command-line words, by tyro (which prints `--help` and errors).

    Args:
        default: where the words say nothing; None: the dataclass's own defaults.

    Raises:
        OptionError: a value was not usable.
        SystemExit: after `--help` (0) or a usage error (2).
    """
    # tyro draws a box around our own messages. They are single lines that say all there is to
    # say, so catch the box and hand the message on; tyro's own errors are printed as they come.
    box = io.StringIO()
    try:
        with contextlib.redirect_stderr(box):
            if default is None:
                return tyro.cli(kind, prog=program, description=description, args=arguments)
            return tyro.cli(
                kind, prog=program, description=description, args=arguments, default=default
            )
    except SystemExit as exit_:
        error = exit_.__context__
        while error is not None and not isinstance(error, OptionError):
            error = error.__cause__ or error.__context__
        if error is not None:
            raise error from None
        sys.stderr.write(box.getvalue())
        raise
