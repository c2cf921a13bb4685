"""What the measurements can be told on the command line."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from app.settings import LIMITS, RANGES, OptionError, Radii, Radius, Rule, Unit

# Repeated in `meshes.builtin.ladder`, which is slow to import where only help is asked for.
SIZES = (51_978, 103_956, 207_912, 415_824, 989_376)
RADII: tuple[float | None, ...] = (5e-3, 2e-3, 1e-3, 5e-4, None)
OUT = Path("artifacts/bench")
MOST = {
    "ticks": 1e7, "passes": 1000, "budget": 3600.0, "radius": RANGES["radius"][1], "queries": 1e6,
    "rounds": 1000, "seconds": 86_400.0, "rate": RANGES["rate"][1], "drags": 100_000,
    "minutes": 10_080.0, "reconnect": 86_400.0,
}  # fmt: skip


def _positive(**values: float) -> None:
    for name, value in values.items():
        if not 0 < value <= MOST.get(name, math.inf):
            most = f" and at most {MOST[name]:g}" if name in MOST else ""
            raise OptionError(f"{name} must be positive{most}, not {value:g}")


@dataclass(frozen=True)
class Runtime:
    """The paper's run-time experiment: whole ticks of the PSM over a ladder of mesh sizes."""

    mesh: str | None = None
    """File or catalogue name of the shape; default: an installed bunny, else a built-in shape."""
    unit: Unit = None
    """Unit of the mesh file. The shape is brought to the bunny's size in any case."""
    rules: tuple[str, ...] = ("certified", "paper")
    """Rules to measure."""
    radii: Radii = RADII
    """Radii of the motion sphere: 5mm is the authors' setting, auto the largest step of a tick."""
    sizes: tuple[int, ...] = SIZES
    """Triangles of the rungs. The largest is made first, the others are decimated from it."""
    ticks: int = 2400
    """Ticks of each row and pass, 200 for each spot of the route, which has twelve."""
    passes: int = 3
    """How often the whole ladder is gone through, so that a change of load meets every row."""
    budget: float = 5.0
    """Longest time for a row in a pass [s]; a slower row visits fewer spots."""
    out: Path = OUT
    """Folder for runtime.json and runtime.png."""

    def __post_init__(self) -> None:
        _positive(ticks=self.ticks, passes=self.passes, budget=self.budget)
        if not (self.rules and self.radii and self.sizes):
            raise OptionError("give at least one of each: --rules, --radii, --sizes")
        for radius in self.radii:
            if radius is not None:
                _positive(radius=radius)
        for rule in self.rules:
            LIMITS["rule"].check("rule", rule)
        for size in self.sizes:
            if size < 128:
                raise OptionError(f"a rung has at least 128 triangles, not {size}")


@dataclass(frozen=True)
class Peers:
    """The same queries and problems with other libraries; answers are compared before times."""

    mesh: str | None = None
    """File or catalogue name of the shape; default: an installed bunny, else a built-in shape."""
    unit: Unit = None
    """Unit of the mesh file. The shape is brought to the bunny's size in any case."""
    size: int = SIZES[-1]
    """Triangles of the mesh."""
    radii: Radii = (5e-3, 2e-3, 1e-3, 5e-4)
    """Radii of the sphere queries."""
    queries: int = 400
    """Points asked about, on and above the surface as a tool meets them."""
    rounds: int = 5
    """Rounds through all libraries, in alternating order; the median counts."""
    out: Path = OUT
    """Folder for peers.json."""

    def __post_init__(self) -> None:
        _positive(queries=self.queries, rounds=self.rounds)
        if self.size < 128:
            raise OptionError(f"the mesh has at least 128 triangles, not {self.size}")
        for radius in self.radii:
            if radius is None:
                raise OptionError("a sphere query needs a length for its radius, not auto")
            _positive(radius=radius)


@dataclass(frozen=True)
class Loop:
    """The control thread's punctuality with the page open, a browser looking on and work going on.

    Phases of equal length: idle; dragging (the autopilot); loading another mesh again and again;
    examining the mesh again and again; a second client joining.
    """

    mesh: str | None = None
    """File or catalogue name; default: the largest rung of the ladder (989,376 triangles)."""
    unit: Unit = None
    """Unit of the mesh file."""
    seconds: float = 60.0
    """Length of each phase."""
    phases: tuple[str, ...] = ("idle", "dragging", "loading", "examining", "joining")
    """Which phases, in this order."""
    rate: float = 1000.0
    """Ticks per second."""
    rule: Rule = "certified"
    """Rule of the fixture."""
    radius: Radius = 5e-3
    """Radius of the motion sphere."""
    browser: bool = True
    """Whether a headless Chromium looks on (needs Playwright and a Chromium)."""
    out: Path = OUT
    """Folder for loop.json."""

    def __post_init__(self) -> None:
        _positive(seconds=self.seconds, rate=self.rate)
        LIMITS["rule"].check("rule", self.rule)
        known = ("idle", "dragging", "loading", "examining", "joining")
        for phase in self.phases:
            if phase not in known:
                raise OptionError(f"unknown phase '{phase}': choose from {', '.join(known)}")


@dataclass(frozen=True)
class View:
    """How soon the page shows what a drag did, and how often it is brought up to date."""

    mesh: str = "skull-fine"
    """Catalogue name or file of the mesh; skull-fine has about a million triangles."""
    drags: int = 40
    """Drag events to measure."""
    seconds: float = 20.0
    """How long the autopilot runs, to count the page's updates [s]."""
    rate: float = 1000.0
    """Ticks of the control loop per second."""
    out: Path = OUT
    """Folder for view.json."""

    def __post_init__(self) -> None:
        _positive(drags=self.drags, seconds=self.seconds, rate=self.rate)


@dataclass(frozen=True)
class Meshes:
    """From a file to a guarded mesh, its health report and its repair: seconds for each."""

    mesh: str = "skull-fine"
    """Catalogue name or file of the mesh; skull-fine has about a million triangles."""
    unit: Unit = None
    """Unit of the mesh file."""
    formats: tuple[str, ...] = ("stl", "ply")
    """Formats to read the mesh from."""
    passes: int = 3
    """How often everything is done; the best counts."""
    out: Path = OUT
    """Folder for meshes.json."""

    def __post_init__(self) -> None:
        _positive(passes=self.passes)
        known = ("stl", "ply", "obj", "off", "glb")
        for kind in self.formats:
            if kind not in known:
                raise OptionError(f"unknown format '{kind}': choose from {', '.join(known)}")


@dataclass(frozen=True)
class Soak:
    """An hour of autopilot while a client comes and goes: nothing may grow."""

    minutes: float = 60.0
    """How long."""
    reconnect: float = 60.0
    """How long the client stays before it leaves and comes again [s]."""
    mesh: str = "skull"
    """Catalogue name or file of the mesh."""
    rate: float = 1000.0
    """Ticks of the control loop per second."""
    out: Path = OUT
    """Folder for soak.json."""

    def __post_init__(self) -> None:
        _positive(minutes=self.minutes, reconnect=self.reconnect, rate=self.rate)
