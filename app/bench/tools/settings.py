"""Command-line options of the benchmarks."""

from __future__ import annotations

import pathlib
from dataclasses import dataclass

from app import choices
from app.kinds import File, Many, Maybe, Number, OneOf, Path, Switch, Whole
from app.options import Checked, like, option
from app.settings import Options, number

# Duplicated in `meshes.builtin.ladder`, whose import is slow.
SIZES = (51_978, 103_956, 207_912, 415_824, 989_376)
RADII: tuple[float | None, ...] = (5e-3, 2e-3, 1e-3, 5e-4, None)
PHASES = (
    "idle", "dragging", "loading", "joining", "examining", "recording", "replaying",
)  # fmt: skip
FORMATS = ("stl", "ply", "obj", "off", "glb")
PARTS = ("faults", "meshes", "latency")
_SIZE = Whole(128, 10**9)
_RADIUS = number("radius")
_SHAPE = "File or catalogue name of the shape; default: an installed bunny, else a built-in shape."
_SCALED = "Unit of the mesh file. The shape is scaled to the bunny's size in any case."
_MESH = "Catalogue name or file of the mesh; skull-fine has about a million triangles."


_SECONDS = Number(1e-3, 86_400.0, "s")
_OUT = pathlib.Path("artifacts/bench")


@dataclass(frozen=True)
class Runtime(Checked):
    """The paper's run-time experiment: whole ticks of the PSM over a ladder of mesh sizes."""

    mesh: str | None = option(Maybe(File()), None, _SHAPE)
    unit: str | None = like(Options, "unit", about=_SCALED)
    rules: tuple[str, ...] = option(
        Many(OneOf("rule", choices.RULES)), ("certified", "paper"), "Rules to measure."
    )
    radii: tuple[float | None, ...] = option(
        Many(Maybe(_RADIUS, "auto")), RADII,
        "Radii of the motion sphere: 5mm is the authors' setting, auto the largest step of a tick.",
    )  # fmt: skip
    sizes: tuple[int, ...] = option(
        Many(_SIZE), SIZES,
        "Triangles of the rungs. The largest is made first, the others are decimated from it.",
    )  # fmt: skip
    ticks: int = option(
        Whole(1, 10**7), 2400,
        "Ticks of each row and pass: 200 for each of the twelve spots of the route.",
    )  # fmt: skip
    passes: int = option(
        Whole(1, 1000), 3,
        "Repetitions of the whole ladder, so that a change of load affects all rows alike.",
    )  # fmt: skip
    budget: float = option(
        Number(1e-3, 3600.0, "s"), 5.0,
        "Longest time for a row in a pass [s]; a slower row visits fewer spots.",
    )  # fmt: skip
    out: pathlib.Path = option(Path(), _OUT, "Folder for runtime.json and runtime.png.")


@dataclass(frozen=True)
class Structures(Checked):
    """Ticks over many structures, in reach and out of reach, beside those over one large mesh."""

    mesh: str | None = option(Maybe(File()), None, _SHAPE)
    unit: str | None = like(Options, "unit", about=_SCALED)
    count: int = option(Whole(1, 65), 20, "Structures.")
    size: int = option(_SIZE, SIZES[0], "Triangles of each.")
    large: int = option(_SIZE, SIZES[-1], "Triangles of the large mesh.")
    radius: float | None = option(Maybe(_RADIUS, "auto"), 5e-3, "Radius of the motion sphere.")
    guard: str = option(OneOf("guard", choices.GUARDS), "tip", "What is kept out.")
    ticks: int = option(
        Whole(1, 10**7), 2400, "Ticks of each row and pass: 200 for each spot of the route."
    )
    passes: int = option(Whole(1, 1000), 3, "Repetitions of all rows.")
    out: pathlib.Path = option(Path(), _OUT, "Folder for structures.json.")


@dataclass(frozen=True)
class Motion(Checked):
    """Ticks beside a mesh that moves and deforms, and how long a new shape takes."""

    mesh: str | None = option(Maybe(File()), None, _SHAPE)
    unit: str | None = like(Options, "unit", about=_SCALED)
    size: int = option(_SIZE, SIZES[-1], "Triangles of the mesh.")
    radius: float | None = option(Maybe(_RADIUS, "auto"), 5e-3, "Radius of the motion sphere.")
    guard: str = option(OneOf("guard", choices.GUARDS), "tip", "What is kept out.")
    ticks: int = option(
        Whole(1, 10**7), 2400, "Ticks of each row and pass: 200 for each spot of the route."
    )
    passes: int = option(Whole(1, 1000), 3, "Repetitions of all rows.")
    seconds: float = option(
        Number(0.0, 1e5, "s"), 20.0,
        "How long the control loop is watched beside shapes, and without them; 0: not at all.",
    )  # fmt: skip
    out: pathlib.Path = option(Path(), _OUT, "Folder for motion.json.")


@dataclass(frozen=True)
class Peers(Checked):
    """The same queries and problems with other libraries; answers are compared before times."""

    mesh: str | None = option(Maybe(File()), None, _SHAPE)
    unit: str | None = like(Options, "unit", about=_SCALED)
    size: int = option(_SIZE, SIZES[-1], "Triangles of the mesh.")
    radii: tuple[float, ...] = option(
        Many(_RADIUS), (5e-3, 2e-3, 1e-3, 5e-4), "Radii of the sphere queries."
    )
    queries: int = option(
        Whole(1, 10**6), 400, "Query points, on and above the surface, from the route of the tool."
    )
    rounds: int = option(
        Whole(1, 1000), 5,
        "Rounds through all libraries, in alternating order; the median counts.",
    )  # fmt: skip
    out: pathlib.Path = option(Path(), _OUT, "Folder for peers.json.")


@dataclass(frozen=True)
class Loop(Checked):
    """The control loop's punctuality with the page open in a browser and other load.

    Phases of equal length: idle; dragging (the autopilot); loading another mesh repeatedly;
    joining: a second client that connects and disconnects; examining the mesh repeatedly;
    recording; replaying: loading a recording repeatedly.
    """

    mesh: str | None = option(
        Maybe(File()), None,
        "File or catalogue name; default: the largest rung of the ladder (989,376 triangles).",
    )  # fmt: skip
    unit: str | None = like(Options, "unit", about="Unit of the mesh file.")
    seconds: float = option(_SECONDS, 60.0, "Length of each phase.")
    phases: tuple[str, ...] = option(
        Many(OneOf("phase", PHASES)), PHASES, "Which phases, in this order."
    )
    rate: float = like(Options, "rate")
    rule: str = like(Options, "rule", about="Rule of the fixture.")
    guard: str = like(Options, "guard")
    radius: float | None = like(Options, "radius", about="Radius of the motion sphere.")
    browser: bool = option(
        Switch(), True,
        "Whether a headless Chromium shows the page (needs Playwright and a Chromium).",
    )  # fmt: skip
    out: pathlib.Path = option(Path(), _OUT, "Folder for loop.json.")


@dataclass(frozen=True)
class Rooms(Checked):
    """The control loops of several participants of a study at once, each in a trial.

    Each has a page with a headless Chromium that looks at it.
    """

    participants: int = option(Whole(1, 64), 2, "How many at once.")
    seconds: float = option(_SECONDS, 60.0, "Length of the measurement.")
    out: pathlib.Path = option(Path(), _OUT, "Folder for rooms.json.")


@dataclass(frozen=True)
class Devices(Checked):
    """The guard between an arm and a console over sockets, each in a process of its own.

    Parts: faults, each of every kind a device can have; meshes, into each of which a lagging, noisy
    arm is driven over links that lose; latency from the console to the arm, in turns with that of a
    relay that passes on what comes, at the same rate.
    """

    parts: tuple[str, ...] = option(Many(OneOf("part", PARTS)), PARTS, "Which parts.")
    faults: int = option(Whole(1, 10_000), 100, "How often each fault is made.")
    guards: int = option(Whole(1, 64), 2, "Guards that run side by side.")
    meshes: tuple[str, ...] = option(
        Many(OneOf("mesh", choices.MESHES)), choices.MESHES, "Meshes that the arm is driven into."
    )
    minutes: float = option(Number(1e-3, 1440.0, "min"), 10.0, "How long into each mesh.")
    guard: str = like(Options, "guard")
    seconds: float = option(_SECONDS, 60.0, "How long the latency is measured, guard and relay.")
    out: pathlib.Path = option(Path(), _OUT, "Folder for devices.json.")


@dataclass(frozen=True)
class View(Checked):
    """Latency from a drag to its display on the page, and the page's update rate."""

    mesh: str = option(File(), "skull-fine", _MESH)
    drags: int = option(Whole(1, 100_000), 40, "Drag events to measure.")
    seconds: float = option(
        _SECONDS, 20.0, "How long the autopilot runs, to count the page's updates [s]."
    )
    rate: float = like(Options, "rate")
    out: pathlib.Path = option(Path(), _OUT, "Folder for view.json.")


@dataclass(frozen=True)
class Meshes(Checked):
    """Time from a mesh file to a fixture, of the health report, and of the repair."""

    mesh: str = option(File(), "skull-fine", _MESH)
    unit: str | None = like(Options, "unit", about="Unit of the mesh file.")
    formats: tuple[str, ...] = option(
        Many(OneOf("format", FORMATS)), ("stl", "ply"), "Formats to read the mesh from."
    )
    passes: int = option(Whole(1, 1000), 3, "Number of repetitions; the best time counts.")
    out: pathlib.Path = option(Path(), _OUT, "Folder for meshes.json.")


@dataclass(frozen=True)
class Soak(Checked):
    """An hour of autopilot with a client that reconnects: memory and queues must not grow."""

    minutes: float = option(Number(1e-3, 10_080.0, "min"), 60.0, "How long.")
    reconnect: float = option(_SECONDS, 60.0, "Interval at which the client reconnects [s].")
    mesh: str = option(File(), "skull", "Catalogue name or file of the mesh.")
    rate: float = like(Options, "rate")
    out: pathlib.Path = option(Path(), _OUT, "Folder for soak.json.")
