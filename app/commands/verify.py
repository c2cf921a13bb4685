"""Attack the fixtures with adversarial hands and judge every step by an independent oracle."""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import dataclass
from time import perf_counter
from typing import TYPE_CHECKING, Annotated

import numpy as np
import tyro
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from app.settings import RANGES, Length, OptionError, Radius, format_length, parse_as

if TYPE_CHECKING:
    from app.verification.campaign import Cover, Drive
    from app.verification.scenes import Scene

PASSED, BROKEN = 0, 1
LEAK_EDGES = (0.3, 1.0, 3.0)
# Standoff and tip radius of the leak queries, in turn [m].
LEAK_TOOLS = ((20e-6, 0.0), (0.0, 0.0), (1e-3, 0.0), (20e-6, 5e-4), (0.0, 1e-4))
SCENE_COLUMNS = (
    "ticks",
    "crossed",
    "held",
    "shortened",
    "recovering",
    "planes",
    "budget spent",
    "tick µs",
)
COLUMNS = (
    "ticks", "crossed", "held", "shortened", "inside", "blocked", "planes", "tick µs",
    "queries", "leaked", "blocked", "budget spent",
)  # fmt: skip

ABOUT = """Try to get the tool through the surface, and count how often it worked.

Adversarial hands (pokes, slides, jerks, full-speed reversals) drive the arm from start positions
all around the mesh. After every tick an independent oracle tests the way of the true tip against
all triangles around it. With the certified rule the surroundings change from case to case, but for
--outside: the mesh alone, several of them,
a corridor, a standoff of 1 mm, a ball-shaped tip, 50 ticks a second, more triangles around the tip
than there may be planes. With --queries the planes are also searched for leaks at radius 0.3, 1 and
3 times the median edge. Exit code 0: nothing got through; 1: something did."""


@dataclass(frozen=True)
class Found:
    """What came of one mesh with one kind of damage."""

    scenes: list[Scene]  # of the drives
    drives: list[Drive]
    covers: list[Cover]


@dataclass(frozen=True)
class Verify:
    """What to attack, how long and how hard."""

    mesh: str = "all"
    """Catalogue name, path of a mesh file, or all: every catalogue mesh up to 20,000 triangles."""
    unit: str | None = None
    """Unit of a mesh file: m, mm, cm or in; needed where its size allows mm and m."""
    damage: str = "all"
    """Kind of damage done to the mesh first, none, or all: none and every kind in turn."""
    robot: str = "point"
    """Arm that carries the tool: point, psm, panda or ur5."""
    rule: str = "certified"
    """Which planes guard the tool: certified, paper, all or off."""
    radius: Annotated[tuple[Radius, ...], tyro.conf.UseAppendAction] = ()
    """Radius of the motion sphere, may be repeated; 0.5mm and 5mm if not given."""
    steps: int = 20_000
    """Controller ticks in all, shared evenly among meshes, kinds of damage and radii."""
    queries: int = 0
    """Leak queries in all, shared evenly among meshes, kinds of damage and three radii."""
    seed: int = 0
    """Of everything random."""
    noise: float = 5e-3
    """Actuation error after every tick, up to this share of the radius; half the cases have none.
    The standoff is then four times the error."""
    outside: bool = False
    """Start and ask only outside the undamaged mesh, which the paper's rule takes for granted."""
    tip_radius: Length = 0.0
    """Radius of a spherical tool tip, at least: it crosses a triangle where the ball cuts it."""

    def __post_init__(self) -> None:
        for name in ("steps", "queries", "seed"):
            if getattr(self, name) < 0:
                raise OptionError(f"{name} must be zero or more, got {getattr(self, name)}")
        if self.steps == 0 and self.queries == 0:
            # "Nothing got through" would be true, and worth nothing.
            raise OptionError("nothing to do: steps and queries are both 0")
        if not 0.0 <= self.noise <= 0.1:
            raise OptionError(
                f"noise must be a share of the radius from 0 to 0.1, got {self.noise}"
            )
        for name, values in (("radius", self.radius), ("tip_radius", (self.tip_radius,))):
            low, high = RANGES[name]
            for value in values:
                if value is not None and not low <= value <= high:
                    text = f"{format_length(low)} to {format_length(high)}"
                    raise OptionError(f"{name} {format_length(value)} is outside {text}")


def main(arguments: list[str]) -> int:
    options = parse_as(Verify, "vf-sandbox verify", arguments, ABOUT)
    return run(options, Console(highlight=False, width=None if sys.stdout.isatty() else 140))


def run(options: Verify, console: Console) -> int:
    """Run the campaign and print its table; returns the exit code."""
    import meshes
    import robots
    import vf
    from app.verification import campaign
    from app.verification.scenes import SCENES
    from meshes.damage import damage, kinds

    if options.rule not in vf.RULES:
        raise OptionError(f"unknown rule '{options.rule}': choose one of {', '.join(vf.RULES)}")
    if options.damage != "all" and options.damage not in kinds():
        raise OptionError(
            f"unknown damage '{options.damage}': choose all or one of {', '.join(kinds())}"
        )
    try:
        arm = robots.load(options.robot)
        if options.mesh == "all":
            sources = {name: meshes.arrays(name) for name in meshes.names()}
            sources = {name: mesh for name, mesh in sources.items() if len(mesh[1]) <= 20_000}
        else:
            sources = {options.mesh: meshes.arrays(options.mesh, unit=options.unit)}
    except ValueError as error:
        raise OptionError(str(error)) from None
    damages = kinds() if options.damage == "all" else (options.damage,)
    radii: tuple[float | None, ...] = options.radius or (5e-4, 5e-3)

    # Rules are compared on the mesh alone.
    varied = options.rule == "certified" and not options.outside
    kinds_of_scene = SCENES if varied else SCENES[:1]
    leak_tools = LEAK_TOOLS if varied else LEAK_TOOLS[:2]
    cases = [(name, kind) for name in sources for kind in damages]
    share = -(-options.steps // (len(cases) * len(radii)))
    query_share = -(-options.queries // (len(cases) * len(LEAK_EDGES)))
    found: dict[tuple[str, str], Found] = {}
    began = perf_counter()
    bar = Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(),
        TimeElapsedColumn(), TimeRemainingColumn(), console=Console(stderr=True), transient=True,
    )  # fmt: skip
    with bar:
        work = len(cases) * (share * len(radii) + query_share * len(LEAK_EDGES))
        task = bar.add_task("verify", total=work)
        for number, (name, kind) in enumerate(cases):
            bar.update(task, description=f"{name}, {kind}")
            mesh = damage(kind, sources[name], options.seed)
            outside_of = vf.Surface.from_arrays(*sources[name]) if options.outside else None
            around = [kinds_of_scene[(number + k) % len(kinds_of_scene)] for k in range(len(radii))]
            drives = [
                campaign.drive(
                    arm, mesh, rule=options.rule, radius=radius, steps=share,
                    seed=options.seed + 1000 * number + k,
                    noise=options.noise if (number + k) % 2 else 0.0,
                    tip_radius=options.tip_radius, scene=around[k], outside_of=outside_of,
                    progress=lambda n: bar.advance(task, n),
                )
                for k, radius in enumerate(radii)
                if share
            ]  # fmt: skip
            tools = [leak_tools[(number + k) % len(leak_tools)] for k in range(len(LEAK_EDGES))]
            covers = [
                campaign.query(
                    mesh, rule=options.rule, edges=edges, queries=query_share,
                    seed=options.seed + 1000 * number + k,
                    standoff=tools[k][0], tip_radius=tools[k][1], outside_of=outside_of,
                    progress=lambda n: bar.advance(task, n),
                )
                for k, edges in enumerate(LEAK_EDGES)
                if query_share
            ]  # fmt: skip
            found[name, kind] = Found(around, drives, covers)
    by_mesh = len(damages) == 1
    table = Table(
        title=f"rule {options.rule}, arm {options.robot}, seed {options.seed}, "
        + (f"damage {damages[0]}" if by_mesh else f"{len(sources)} meshes")
    )
    labels = tuple(sources) if by_mesh else damages
    table.add_column("mesh" if by_mesh else "damage", min_width=max(map(len, labels)))
    for name in COLUMNS:
        table.add_column(name, justify="right")
    for label in labels:
        mine = [f for case, f in found.items() if case[0 if by_mesh else 1] == label]
        table.add_row(label, *_cells(mine))
    table.add_row("all", *_cells(list(found.values())), style="bold")
    console.print(table)
    if options.steps and varied:
        console.print(_by_scene(list(found.values())))
    complaints = []
    for (name, kind), f in found.items():
        firsts = [
            (f"{scene.name}, " if varied else "") + drive.first
            for scene, drive in zip(f.scenes, f.drives, strict=False)
            if drive.first
        ]
        firsts += [cover.first for cover in f.covers if cover.first]
        complaints += [f"{name}, {kind}: {first}" for first in firsts]
    for line in complaints[:10]:
        console.print(line, soft_wrap=True)
    if len(complaints) > 10:
        console.print(f"… and {len(complaints) - 10} more places")
    crossings = sum(d.crossings for f in found.values() for d in f.drives)
    leaks = sum(c.leaking for f in found.values() for c in f.covers)
    console.print(
        f"{crossings:,} crossings at radius {', '.join(format_length(r) for r in radii)}, "
        f"{leaks:,} leaks; {perf_counter() - began:.0f} s"
    )
    return BROKEN if crossings or leaks else PASSED


def _cells(found: list[Found]) -> list[str]:
    """One row of the table: sums and shares over some cases."""
    import vf

    drives = [d for f in found for d in f.drives]
    covers = [c for f in found for c in f.covers]
    statuses: Counter[vf.Status] = Counter()
    for d in drives:
        statuses.update(d.statuses)
    times = [t for d in drives for t in d.times]
    ticks = sum(d.ticks for d in drives)
    return [
        f"{ticks:,}",
        f"{sum(d.crossings for d in drives):,}",
        f"{statuses[vf.Status.HELD]:,}",
        f"{statuses[vf.Status.SHORTENED]:,}",
        f"{statuses[vf.Status.INSIDE]:,}",
        _percent(sum(d.forbidden for d in drives), sum(d.free for d in drives)),
        f"{sum(d.planes for d in drives) / ticks:.1f}" if ticks else "",
        f"{1e6 * float(np.median(times)):.0f}" if times else "",
        f"{sum(c.queries for c in covers):,}",
        f"{sum(c.leaking for c in covers):,}",
        _percent(sum(c.forbidden for c in covers), sum(c.free for c in covers)),
        f"{sum(c.shrunk for c in covers):,}",
    ]


def _by_scene(found: list[Found]) -> Table:
    """The same drives by what stood around the tip."""
    import vf
    from app.verification.scenes import SCENES

    table = Table()
    table.add_column("around the tip", min_width=max(len(scene.name) for scene in SCENES))
    for name in SCENE_COLUMNS:
        table.add_column(name, justify="right")
    for scene in SCENES:
        drives = [d for f in found for s, d in zip(f.scenes, f.drives, strict=False) if s is scene]
        ticks = sum(d.ticks for d in drives)
        if not ticks:
            continue
        statuses = sum((d.statuses for d in drives), Counter[vf.Status]())
        table.add_row(
            scene.name,
            f"{ticks:,}",
            f"{sum(d.crossings for d in drives):,}",
            f"{statuses[vf.Status.HELD]:,}",
            f"{statuses[vf.Status.SHORTENED]:,}",
            f"{statuses[vf.Status.RECOVERING]:,}",
            f"{sum(d.planes for d in drives) / ticks:.1f}",
            f"{sum(d.shrunk for d in drives):,}",
            f"{1e6 * float(np.median([t for d in drives for t in d.times])):.0f}",
        )
    return table


def _percent(part: int, whole: int) -> str:
    return f"{100.0 * part / whole:.1f} %" if whole else ""
