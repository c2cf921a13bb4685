"""Attack the fixtures with adversarial hands and judge every step by an independent oracle."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console

from app import choices
from app.commands import interrupted
from app.commands._verify_motion import run_moving
from app.console import Column, count, progress, run_counted, show_table
from app.console import console as new_console
from app.kinds import SEEDS, File, Maybe, Number, OneOf, Repeated, Switch, Whole
from app.motion.declared import Tracker
from app.options import Checked, like, option
from app.settings import DECLARED, Options
from app.words import OptionError, format_length

if TYPE_CHECKING:
    from app.studies.verification.campaign import Cover, Drive
    from app.studies.verification.scenes import Scene
    from meshes.builtin.shapes import Arrays

PROGRAM = "vf-sandbox verify"
PASSED, BROKEN = 0, 1
DAMAGES = ("all", *choices.DAMAGES)
MOTIONS = ("rigid", "deforming", "both", "all")
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


@dataclass(frozen=True)
class Found:
    """Results for one mesh with one kind of damage."""

    scenes: list[Scene]  # of the drives
    drives: list[Drive]
    covers: list[Cover]


@dataclass(frozen=True)
class Verify(Checked):
    """Try to get the tool through the surface, and count how often it worked.

    Adversarial hands (pokes, slides, jerks, full-speed reversals) drive the arm from start
    positions all around the mesh. After every tick an independent oracle tests the way of the true
    tip against all triangles around it. With the certified rule the surroundings change from case
    to case, but for --outside: the mesh alone, several of them, a corridor, a standoff of 1 mm, a
    ball-shaped tip, 50 ticks a second, more triangles around the tip than there may be planes. With
    --queries the planes are also searched for leaks at radius 0.3, 1 and 3 times the median edge.
    Exit code 0: nothing got through; 1: something did.
    """

    mesh: str = option(
        File(metavar="all|NAME|FILE"), "all",
        "Catalogue name, path of a mesh file, or all: every catalogue mesh up to 20,000 triangles.",
    )  # fmt: skip
    unit: str | None = like(Options, "unit")
    damage: str = option(
        OneOf("damage", DAMAGES), "all",
        "Kind of damage done to the mesh first, none, or all: none and every kind in turn.",
    )  # fmt: skip
    robot: str = option(
        OneOf("robot", (*choices.ROBOTS, "all")), "point",
        "Robot arm; all, with --guard: every arm and the point with a needle, --steps ticks with "
        "the PSM and a tenth of them with each other.",
    )  # fmt: skip
    rule: str = like(Options, "rule", about="Which planes guard the tool.")
    radius: tuple[float | None, ...] = option(
        Repeated(DECLARED["radius"].kind), (),
        "Radius of the motion sphere, may be repeated; 0.5mm and 5mm if not given, with --motion "
        "auto and 5mm.",
    )  # fmt: skip
    steps: int = option(
        Whole(0, 10**12), 20_000,
        "Controller ticks in all, shared evenly among meshes, kinds of damage and radii.",
    )  # fmt: skip
    queries: int = option(
        Whole(0, 10**12), 0,
        "Leak queries in all, shared evenly among meshes, kinds of damage and three radii.",
    )  # fmt: skip
    seed: int = option(Whole(*SEEDS), 0, "Of everything random.")
    noise: float = option(
        Number(0.0, 0.1), 5e-3,
        "Actuation error after every tick, up to this share of the radius; half the cases have "
        "none. The standoff is then four times the error.",
    )  # fmt: skip
    guard: str | None = option(
        Maybe(OneOf("guard", choices.GUARDS)), None,
        "Aim with every capsule of the instrument and judge each on its true path, at 10 Hz to "
        "10 kHz in turn; tool: all of them are guarded, tip: the tip alone. Not given: the tip is "
        "guarded, aimed and judged.",
    )  # fmt: skip
    motion: str | None = option(
        Maybe(OneOf("motion", MOTIONS)), None,
        "Let the mesh move to 0.2 m/s and 2 rad/s, deform to 0.1 m/s, both, or all three, at 50, "
        "200 and 1,000 Hz in turn, and judge by its true motion; not given: it rests.",
    )  # fmt: skip
    tracker: Tracker | None = like(
        Options, "tracker",
        about="With --motion: how often a tracker sees the mesh [Hz]; off: the guard knows "
        "where it is. What follows directly is of the tracker: --latency, --noise, --dropouts, "
        "--bound, which nothing is faster than, …",
    )  # fmt: skip
    workers: int = option(
        Whole(0, 64), 0, "Processes, with --motion; 0 computes in this one. Results are the same."
    )  # fmt: skip
    outside: bool = option(
        Switch(), False,
        "Start and ask only outside the undamaged mesh, which the paper's rule takes for granted.",
    )  # fmt: skip
    tip_radius: float = like(
        Options, "tip_radius",
        about="Radius of a spherical tool tip, at least: it crosses a triangle where the ball cuts "
        "it.",
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.steps == 0 and self.queries == 0:
            raise OptionError("nothing to do: steps and queries are both 0")
        if self.tracker is not None and self.motion is None:
            raise OptionError("a tracker is of --motion")
        if self.motion is not None and (self.queries or self.outside or self.tip_radius):
            raise OptionError(
                "motion: there are no --queries, no --outside and no --tip-radius with it"
            )
        if self.workers and self.motion is None:
            raise OptionError("workers are of --motion")
        if self.guard is not None and (self.rule != "certified" or self.outside or self.tip_radius):
            raise OptionError(
                "guard: the whole instrument is verified with rule certified, without --outside "
                "and --tip-radius"
            )
        if self.robot == "all" and self.guard is None:
            raise OptionError("robot all is of --guard tool and --guard tip")
        if self.mesh != "all":
            choices.check_mesh(self.mesh)


def run(options: Verify) -> int:
    """Run the campaign and print its table; returns the exit code."""
    console = new_console()
    import meshes
    import robots
    import vf
    from app.studies.verification import campaign
    from app.studies.verification.guarded import parts
    from app.studies.verification.scenes import SCENES
    from meshes.builtin.damage import damage, kinds

    if options.mesh == "all":
        sources = {name: meshes.arrays(name) for name in meshes.names()}
        sources = {name: mesh for name, mesh in sources.items() if len(mesh[1]) <= 20_000}
    else:
        sources = {options.mesh: meshes.arrays(options.mesh, unit=options.unit)}
    damages = kinds() if options.damage == "all" else (options.damage,)
    # What moves fast overtakes a tool at once whose motion sphere is small.
    small = 5e-4 if options.motion is None else None
    radii: tuple[float | None, ...] = options.radius or (small, 5e-3)
    if options.motion is not None:
        return run_moving(options, sources, damages, radii, console, _show_places, PROGRAM)
    if options.guard is not None:
        return _run_guarded(options, options.guard, sources, damages, radii, console)
    arm = robots.load(options.robot)

    # Other rules than certified are tested with the mesh alone, so that they are comparable.
    varied = options.rule == "certified" and not options.outside
    kinds_of_scene = SCENES if varied else SCENES[:1]
    leak_tools = LEAK_TOOLS if varied else LEAK_TOOLS[:2]
    cases = [(name, kind) for name in sources for kind in damages]
    share = -(-options.steps // (len(cases) * len(radii)))
    query_share = -(-options.queries // (len(cases) * len(LEAK_EDGES)))
    found: dict[tuple[str, str], Found] = {}
    began = perf_counter()
    bar = progress(counted=True)
    stopped = False
    try:
        with bar:
            work = len(cases) * (share * len(radii) + query_share * len(LEAK_EDGES))
            task = bar.add_task("verify", total=work)
            for number, (name, kind) in enumerate(cases):
                bar.update(task, description=f"{name}, {kind}")
                mesh = damage(kind, sources[name], options.seed)
                outside_of = vf.Surface.from_arrays(*sources[name]) if options.outside else None
                here = found.setdefault((name, kind), Found([], [], []))
                for k, radius, part, steps in parts(radii, share):
                    scene = kinds_of_scene[(number + k) % len(kinds_of_scene)]
                    here.scenes.append(scene)
                    seed = options.seed + 1000 * number + k + 10**6 * part
                    noise = options.noise if (number + k) % 2 else 0.0
                    here.drives.append(
                        campaign.drive(
                            arm, mesh, rule=options.rule, radius=radius, steps=steps,
                            seed=seed, noise=noise, tip_radius=options.tip_radius, scene=scene,
                            outside_of=outside_of, progress=lambda n: bar.advance(task, n),
                        )
                    )  # fmt: skip
                for k, edges, part, queries in parts(LEAK_EDGES, query_share):
                    standoff, tip_radius = leak_tools[(number + k) % len(leak_tools)]
                    here.covers.append(
                        campaign.query(
                            mesh, rule=options.rule, edges=edges, queries=queries,
                            seed=options.seed + 1000 * number + k + 10**6 * part,
                            standoff=standoff, tip_radius=tip_radius, outside_of=outside_of,
                            progress=lambda n: bar.advance(task, n),
                        )
                    )  # fmt: skip
    except KeyboardInterrupt:
        stopped = True
    drives = [d for f in found.values() for d in f.drives]
    covers = [c for f in found.values() for c in f.covers]
    if stopped and not drives and not covers:
        return interrupted(PROGRAM, "before anything was done")
    by_mesh = len(damages) == 1
    labels = tuple(sources) if by_mesh else damages
    rows = []
    for label in labels:
        mine = [f for case, f in found.items() if case[0 if by_mesh else 1] == label]
        rows.append((label, *_cells(mine)))
    rows.append(("all", *_cells(list(found.values()))))
    show_table(
        console,
        [Column("mesh" if by_mesh else "damage", left=True), *(Column(name) for name in COLUMNS)],
        rows,
        title=f"rule {options.rule}, arm {options.robot}, seed {options.seed}, "
        + (f"damage {damages[0]}" if by_mesh else count(len(sources), "mesh", "meshes")),
    )
    if options.steps and varied:
        _show_by_scene(list(found.values()), console)
    complaints = []
    for (name, kind), f in found.items():
        firsts = [
            (f"{scene.name}, " if varied else "") + drive.first
            for scene, drive in zip(f.scenes, f.drives, strict=False)
            if drive.first
        ]
        firsts += [cover.first for cover in f.covers if cover.first]
        complaints += [f"{name}, {kind}: {first}" for first in firsts]
    _show_places(complaints, console)
    crossings = sum(d.crossings for d in drives)
    leaks = sum(c.leaking for c in covers)
    console.print(
        f"{count(crossings, 'crossing')} at radius {', '.join(map(format_length, radii))}, "
        f"{count(leaks, 'leak')}; {perf_counter() - began:.0f} s"
    )
    if stopped:
        ticks = count(sum(d.ticks for d in drives), "tick")
        asked = count(sum(c.queries for c in covers), "query", "queries")
        return interrupted(PROGRAM, f"this is of {ticks} and {asked}")
    return BROKEN if crossings or leaks else PASSED


def _run_guarded(
    options: Verify,
    guard: str,
    sources: dict[str, Arrays],
    damages: Sequence[str],
    radii: Sequence[float | None],
    console: Console,
) -> int:
    """`run` with the whole instrument."""
    import robots
    from app.studies.verification import guarded

    if options.robot == "all":
        arms = guarded.all_arms(options.steps)
    else:
        arms = {options.robot: (robots.load(options.robot), options.steps)}
    campaign = guarded.Campaign(
        arms, sources, damages, radii, guard, options.queries, LEAK_TOOLS, options.noise,
        options.seed,
    )  # fmt: skip
    found = guarded.Findings()
    began = perf_counter()
    stopped = run_counted("verify", campaign.work, partial(guarded.run, campaign, found))
    if stopped and not found.drives and not found.covers:
        return interrupted(PROGRAM, "before anything was done")
    title = (
        f"whole instrument, guard {guard}, arm {options.robot}, seed {options.seed}, "
        f"{count(len(sources), 'mesh', 'meshes')}, damage {options.damage}, radius "
        + ", ".join(map(format_length, radii))
    )
    guarded.show(found, console, title)
    _show_places(guarded.complaints(found), console)
    console.print(
        f"{count(found.crossings, 'crossing')}, {count(found.leaks, 'leak')}; "
        f"{perf_counter() - began:.0f} s"
    )
    if stopped:
        return interrupted(PROGRAM, "this is of what was done until then")
    return BROKEN if found.crossings or found.leaks else PASSED


def _show_places(complaints: Sequence[str], console: Console) -> None:
    """Print where something got through, to repeat it."""
    for line in complaints[:10]:
        console.print(line, soft_wrap=True)
    if len(complaints) > 10:
        console.print(f"… and {count(len(complaints) - 10, 'more place')}")


def _cells(found: list[Found]) -> list[str]:
    """A row of the table: sums and shares over the cases."""
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


def _show_by_scene(found: list[Found], console: Console) -> None:
    """Print the results of the drives by kind of scene."""
    import vf
    from app.studies.verification.scenes import SCENES

    rows = []
    for scene in SCENES:
        drives = [d for f in found for s, d in zip(f.scenes, f.drives, strict=False) if s is scene]
        ticks = sum(d.ticks for d in drives)
        if not ticks:
            continue
        statuses = sum((d.statuses for d in drives), Counter[vf.Status]())
        rows.append(
            (
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
        )
    columns = [Column("around the tip", left=True), *map(Column, SCENE_COLUMNS)]
    show_table(console, columns, rows)


def _percent(part: int, whole: int) -> str:
    return f"{100.0 * part / whole:.1f} %" if whole else ""


KINDS = {"": (Verify, run)}
