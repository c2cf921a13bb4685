"""The settings of a session, for the command line, files and the page.

Cheap to import, see `app.options`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from app import choices
from app.kinds import (
    SEEDS,
    Colour,
    Device,
    File,
    Frame,
    Kind,
    Length,
    Maybe,
    Number,
    OneOf,
    Place,
    Repeated,
    Share,
    Speed,
    Switch,
    Text,
    Time,
    Turn,
    Whole,
    bare,
)
from app.motion.declared import DEFORMING, KINDS, Motion, Tracker
from app.options import Checked, Record, Scope, declared, option
from app.structure import Registration, Structure, printable
from app.words import OptionError

MOST = 64  # structures beside the mesh
AHEAD = 1e-2  # a set-point of an arm that is elsewhere may be so far ahead of where it is [s]


@dataclass(frozen=True)
class Options(Checked):
    """Settings of a session. Lengths are in metres, on the command line with a unit (`5mm`).

    Raises:
        OptionError: an invalid value. Names of meshes are checked when the scene is built, since
            this needs the libraries.
    """

    mesh: str = option(
        File(metavar="NAME|FILE"), "skull-closed",
        f"A name of the catalogue: {', '.join(choices.MESHES)}; where their package is installed "
        f"{', '.join(choices.FROM_PACKAGES)}. Or the path of a mesh file.", Scope.MESH,
    )  # fmt: skip
    unit: str | None = option(
        Maybe(OneOf("unit", choices.UNITS)), None,
        "Unit of a mesh file. Needed where its size allows mm and m.", Scope.MESH,
    )  # fmt: skip
    frame: str | None = option(
        Maybe(Frame("frame", choices.FRAMES)), None,
        "Patient frame of a mesh file that does not name it. Nothing is transformed.",
        Scope.MESH, recorded=False,
    )  # fmt: skip
    at: tuple[float, float, float] | None = option(
        Maybe(Place(), "auto"), None,
        "Where the mesh's own origin goes in the arm's base frame, such as 0,-1cm,-12cm; auto: "
        "straight under the tip's neutral pose, which for the psm is under the remote centre.",
        Scope.MESH,
    )  # fmt: skip
    rotate: tuple[float, float, float] = option(
        Turn(), (0.0, 0.0, 0.0),
        "Turn of the mesh in degrees about the base frame's x, then y, then z axis.", Scope.MESH,
    )  # fmt: skip
    up: str = option(
        OneOf("axis", choices.AXES), "z",
        "The mesh's own axis that faces the tool (write --up=-y). glTF files often have y up.",
        Scope.MESH,
    )  # fmt: skip
    damage: str = option(
        OneOf("damage", choices.DAMAGES), "none",
        "Damage done to the mesh on purpose, to test a rule.", Scope.MESH,
    )  # fmt: skip
    seed: int = option(Whole(*SEEDS), 0, "Seed of the damage.", Scope.MESH)
    repair: bool = option(
        Switch(), False,
        "Weld vertices, drop degenerate and duplicate faces, correct the winding; no vertex is "
        "moved.",
        Scope.MESH,
    )  # fmt: skip
    flip: bool = option(
        Switch(),
        False,
        "Reverse the winding of open sheets: their outside is not known.",
        Scope.MESH,
    )
    path: str | None = option(
        Maybe(File()), None,
        "Text file with a planned path on the mesh: x y z in mm of the mesh's own axes, a point a "
        "line. The skulls come with one.", Scope.MESH,
    )  # fmt: skip
    corridor: float | None = option(
        Maybe(Length(1e-4, 2e-2), "off"), None,
        "How far the tool may leave the planned path sideways, or off.", Scope.FIXTURE,
    )  # fmt: skip
    structures: tuple[Structure, ...] = option(
        Repeated(Record(Structure, "a structure")), (),
        "A further structure beside the mesh, in the mesh's own frame: a mesh file, a label map "
        "(all labels, or FILE:3 or FILE:NAME), a folder of mesh files, or "
        f"{', '.join(choices.SETS)}. May be repeated. What follows it directly is of this "
        "structure: --margin, --guard, --name, --colour, --opacity, --unit, --no-guarded. "
        "Without --mesh the first structure is the mesh.",
        Scope.MESH, flag="structure",
    )  # fmt: skip
    motions: tuple[Motion, ...] = option(
        Repeated(Record(Motion, "a motion")), (),
        f"A motion of structures: {', '.join(KINDS)}. May be repeated. What follows it directly is "
        "of this motion: --move, --turn, --period, --after, --file, --stream (vertices that come "
        "while it runs: socket://HOST:PORT, where to listen), --amplitude, --of with the "
        "name of a structure, else all move.",
        Scope.MESH, flag="motion",
    )  # fmt: skip
    tracker: Tracker | None = option(
        Maybe(Record(Tracker, "a tracker"), "off"), None,
        "How often a tracker sees moving structures [Hz]; off: the guard knows where they are. "
        "What follows it directly is of the tracker: --latency, --noise, --dropouts, --bound, "
        "--predictor, --period, --stale, --seed.",
        Scope.MESH,
    )  # fmt: skip
    registration: Registration | None = option(
        Maybe(Record(Registration, "a registration"), "off"), None,
        "Fiducials of the registration, a text file with x y z in mm of the mesh's own axes in a "
        "line: every structure's margin is larger by what the registration may be off there. What "
        "follows it directly is of the registration: --fle, --factor.",
        Scope.MESH,
    )  # fmt: skip
    margin: float = option(
        Length(0.0, 0.05), 0.0,
        "Distance the tool keeps from the mesh beyond the standoff. After --structure: from that.",
        Scope.FIXTURE,
    )  # fmt: skip
    guarded: bool = option(
        Switch(), True, "Whether the mesh is guarded; it is drawn in any case.", Scope.FIXTURE
    )
    colour: str | None = option(
        Maybe(Colour(), "bone"), None, "Colour of the mesh, such as #cc8844.", Scope.VIEW
    )
    opacity: float = option(Number(0.05, 1.0), 1.0, "Opacity of the mesh.", Scope.VIEW)
    robot: str = option(
        OneOf("robot", choices.ROBOTS), "psm", "Arm that carries the tool.", Scope.ARM
    )
    rule: str = option(
        OneOf("rule", choices.RULES), "certified",
        "Which planes guard the tool: paper has its Conditions 1-3, all takes every face, nearest "
        "one plane at the nearest point, sdf one of a distance field sampled every 0.5 mm.",
        Scope.FIXTURE,
    )  # fmt: skip
    guard: str = option(
        OneOf("guard", choices.GUARDS), "tool",
        "What the certified rule keeps out of the anatomy: tool is every part of the instrument, "
        "tip its tip alone. The other rules guard the tip alone.",
        Scope.FIXTURE,
    )  # fmt: skip
    trocar: float = option(
        Length(0.0, 0.1), 0.0,
        "With guard tool: radius of the ball around the remote centre in which the shaft may pass "
        "through the mesh, as through a port; 0: nowhere. Only the psm has one.",
        Scope.FIXTURE,
    )  # fmt: skip
    radius: float | None = option(
        Maybe(Length(5e-5, 2e-2), "auto"), 5e-3,
        "Radius of the motion sphere; 5mm is the paper's preset, auto the largest step of a tick.",
        Scope.FIXTURE,
    )  # fmt: skip
    rate: float = option(
        Number(10.0, 20_000.0, "Hz"), 1000.0, "Ticks of the control loop per second.",
        Scope.SERVER, recorded=True,
    )  # fmt: skip
    host: str = option(
        Text(255), "127.0.0.1",
        "Address the page listens on. For one that other machines reach, such as 0.0.0.0, a token "
        "is printed and asked for: whoever has it can do all that the page can.", Scope.SERVER,
    )  # fmt: skip
    port: int = option(
        Whole(0, 65535), 8080, "Port of the page; 0 takes any free one.", Scope.SERVER
    )
    open: bool = option(
        Switch(), False, "Open the page in the browser once it is ready.", Scope.SERVER
    )
    standoff: float = option(
        Length(1e-6, 1e-3, "µm"), 20e-6, "Distance the tool keeps from the surface.", Scope.FIXTURE
    )
    approach: float = option(
        Number(0.0, 1000.0, "/s"), 0.0,
        "Limit of the speed of approach on top of the rule: a part of the tool that is d farther "
        "away than it must be comes nearer by at most so many times d a second, so 20 lets it "
        "come 20 mm/s from 1 mm away; 0: no limit.", Scope.FIXTURE,
    )  # fmt: skip
    tip_radius: float = option(
        Length(0.0, 5e-3), 0.0, "Radius of a spherical tool tip; 0 is a point.", Scope.FIXTURE
    )
    scale: float = option(
        Number(0.05, 2.0), 1.0,
        "Teleoperation scale: movement of the proxy per movement of the handle; the dVRK uses 0.2.",
        Scope.TELEOPERATION,
    )  # fmt: skip
    lock_orientation: bool = option(
        Switch(), False,
        "Teleoperation keeps the tool's orientation, whatever the handle's is, as in the paper.",
        Scope.TELEOPERATION,
    )  # fmt: skip
    tip_speed: float = option(
        Speed(1e-3, 2.0), 2.0,
        "Speed limit of the tool's tip, such as 100mm/s, beside those of the joints.",
        Scope.FIXTURE,
    )  # fmt: skip
    force_gain: float = option(
        Number(0.0, 1000.0, "N/m"), 150.0,
        "Stiffness of the simulated haptic force [N/m], which is capped at 4 N.", Scope.FIXTURE,
    )  # fmt: skip
    stale_after: float = option(
        Number(0.05, 10.0, "s"), 0.5,
        "The tool holds when a drag goes silent for this long [s].", Scope.SERVER, recorded=True,
    )  # fmt: skip
    upload_limit: float = option(
        Number(1.0, 500.0, "MB"), 200.0, "Largest mesh file that the page takes [MB].", Scope.SERVER
    )
    record: str | None = option(
        Maybe(File()), None,
        "Record the session from its start to its end into this new file, see vf-sandbox replay.",
        Scope.SERVER,
    )  # fmt: skip
    scenario: str | None = option(
        Maybe(File(metavar="NAME|FILE")), None,
        f"Start with a scenario: {', '.join(choices.SCENARIOS)}; or from a JSON file. Other "
        "options override it, except the mesh.", Scope.SERVER,
    )  # fmt: skip
    arm: str = option(
        Device("arm"), "sim",
        "The arm that is moved: sim, or one that is elsewhere, as socket://127.0.0.1:48051 (the "
        "dVRK's socket streamer, which sends to that port), ros:/PSM1, python:FILE:CLASS.",
        Scope.SERVER, recorded=True,
    )  # fmt: skip
    master: str = option(
        Device("master"), "page",
        "Who moves the tool: page, sim (the autopilot), or socket://HOST:PORT, a console that "
        "hears the guard as an arm there; with ?listen a hand that sends to that port; or "
        "ros:/NAMESPACE, igtl://HOST:PORT (3D Slicer), python:FILE:CLASS.",
        Scope.SERVER,
    )  # fmt: skip
    enable: bool = option(
        Switch(), False,
        "Enable an arm that is elsewhere as soon as it is heard of; without it nothing moves it "
        "until it is enabled on the page or by state_command.", Scope.SERVER,
    )  # fmt: skip
    delay: float = option(
        Time(0.0, 10.0), 0.0, "Delay between master and guard, each way, such as 80ms.",
        Scope.SERVER,
    )  # fmt: skip
    jitter: float = option(
        Time(0.0, 1.0), 0.0, "Standard deviation of what comes on top of the delay.", Scope.SERVER
    )
    loss: float = option(
        Share(0.0, 1.0), 0.0, "Share of what is lost between master and guard, such as 2%.",
        Scope.SERVER,
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.structures) > MOST:
            raise OptionError(f"structures are {len(self.structures)}: at most {MOST} are guarded")
        if len(self.motions) > MOST:
            raise OptionError(f"motions are {len(self.motions)}: there may be {MOST} at most")
        if sum(motion.stream is not None for motion in self.motions) > 1:
            raise OptionError("the vertices of one structure may come from a stream, not of more")
        deforms = any(motion.kind in DEFORMING for motion in self.motions)
        if deforms and self.tracker is not None and self.tracker.predictor != "off":
            raise OptionError(
                f"the predictor {self.tracker.predictor} is of poses: not with a structure that "
                "changes its shape"
            )

    @cached_property
    def anatomy(self) -> tuple[Structure, ...]:
        """The settings of all structures: those of the mesh first, then of the further ones."""
        mesh = Structure(
            self.mesh, colour=self.colour, opacity=self.opacity, margin=self.margin,
            guarded=self.guarded, unit=self.unit,
        )  # fmt: skip
        named = replace(mesh, name=printable(mesh.label or Path(mesh.file).name))
        return named, *self.structures

    @property
    def dt(self) -> float:
        """Length of a tick [s]."""
        return 1.0 / self.rate

    @property
    def horizon(self) -> float:
        """How far ahead of the measured joints a set-point may be [s].

        A tick for the simulated arm, which is there at once. An arm that lags would crawl, or sag:
        its set-points are certified further ahead, unless structures move meanwhile.
        """
        return self.dt if self.arm == "sim" or self.motions else max(self.dt, AHEAD)

    @property
    def guards_tool(self) -> bool:
        """Whether any structure holds all parts of the instrument, and not only its tip."""
        return self.rule == "certified" and any(
            self.guard_of(own) == "tool" for own in self.anatomy if own.guarded
        )

    def guard_of(self, own: Structure) -> str:
        """What is kept out of a structure, its own or as the session says: "tip" or "tool"."""
        return own.guard or self.guard


DECLARED = declared(Options)
MESH = tuple(name for name, entry in DECLARED.items() if entry.scope is Scope.MESH)


def kind_of(name: str) -> Kind:
    """The kind of this option, without None."""
    return bare(DECLARED[name].kind)


def number(name: str) -> Number:
    """The kind of a numeric option.

    Raises:
        KeyError: it is not numeric.
    """
    found = kind_of(name)
    if not isinstance(found, Number):
        raise KeyError(name)
    return found
