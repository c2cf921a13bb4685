"""`bench runtime`: whole controller ticks over mesh sizes, radii and rules (paper, section IV-B).

Every row runs the same proxy over the same spots in closed loop, with the contact states of normal
use: free space, first contact, sliding on a surface, sliding in a concavity. `Controller.step` is
timed: from joint positions and proxy to the verified joint step.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

import meshes
import robots
import vf
from app.bench.tools import report
from app.bench.tools import route as routes
from app.bench.tools.machine import machine, no_collection, percentiles
from app.bench.tools.ratios import of_instrument, ratios
from app.bench.tools.report import figure as draw
from app.bench.tools.settings import Runtime
from app.console import Column, show_table
from app.words import format_length
from meshes.builtin import ladder

__all__ = ["draw", "run", "show"]

FloatArray = NDArray[np.float64]
Say = Callable[[str], None]

PUBLISHED = ((51_978, 7.73), (200_000, 1.0), (989_376, 0.18))
"""Triangles and kHz of the paper's C++ implementation (i7-8700; the second is from its text)."""

STATES = ("free", "near", "touching", "concavity")
"""No plane; planes, none active; active planes; active planes at a spot that is a pit."""

_ACTIVE = 1e-9  # a plane with a larger multiplier is active [m]
_SAMPLES = 300  # positions at which stages of the paper's rule are timed separately


@dataclass
class Cell:
    """Samples of one mesh size, rule and radius; times in seconds, one entry per tick."""

    rule: str
    radius: float | None
    triangles: int
    vertices: int
    controller: vf.Controller
    surface: vf.Surface
    spots: int = 0  # number of spots of the route in a pass; 0: not set yet
    total: list[float] = field(default_factory=list)
    parts: list[tuple[float, ...]] = field(default_factory=list)
    planes: list[int] = field(default_factory=list)
    states: list[int] = field(default_factory=list)
    statuses: Counter[str] = field(default_factory=Counter)
    radii: list[float] = field(default_factory=list)
    tips: list[FloatArray] = field(default_factory=list)

    def clear(self) -> None:
        """Remove all samples."""
        for column in (
            self.total, self.parts, self.planes, self.states, self.radii, self.tips, self.statuses,
        ):  # fmt: skip
            column.clear()

    def truncate(self) -> None:
        """Remove the incomplete samples of an interrupted tick."""
        columns: tuple[list[Any], ...] = (
            self.total, self.parts, self.planes, self.states, self.radii, self.tips,
        )  # fmt: skip
        ticks = min(map(len, columns))
        for column in columns:
            del column[ticks:]


def run(options: Runtime, say: Say, advance: Callable[[float], None]) -> dict[str, Any]:
    """Measure all rows.

    Args:
        say: called with a short text before each stage.
        advance: called with the finished share of the measurement, 0 … 1.

    Returns:
        The content of `runtime.json`.

    Raises:
        ValueError: unknown rule, or a shape that is not usable for a ladder.
    """
    for rule in options.rules:
        if rule not in vf.RULES:
            raise ValueError(f"unknown rule '{rule}': choose from {', '.join(vf.RULES)}")
    about = machine()
    shape = ladder.source(options.mesh, options.unit)
    rungs = ladder.rungs(shape, options.sizes, say)
    arm = robots.load("psm")
    # All meshes are placed like the largest one, so that one route fits them.
    shift = meshes.placement(rungs[max(rungs)][0], arm.tip(arm.neutral))
    say("compiling kernels")
    vf.Controller(arm, []).warm_up()

    surfaces, builds = [], []
    for size, (vertices, faces) in rungs.items():
        say(f"building the surface of {size:,} triangles")
        surface, build = _timed(vertices + shift, faces)
        surfaces.append(surface)
        builds.append({"triangles": size, **build})
    say("planning the route")
    route = routes.plan(surfaces[0], arm)

    cells = [
        Cell(
            rule,
            radius,
            len(surface.faces),
            len(surface.vertices),
            vf.Controller(arm, [vf.MeshFixture(surface, rule, radius)]),
            surface,
        )
        for radius in options.radii
        for rule in options.rules
        for surface in surfaces
    ]
    # With the whole instrument guarded, on the largest mesh.
    tools = [
        replace(
            cell,
            controller=vf.Controller(arm, cell.controller.fixtures, vf.Settings(guard="tool")),
            total=[], parts=[], planes=[], states=[], radii=[], tips=[], statuses=Counter(),
        )
        for cell in cells
        if cell.rule == "certified" and cell.triangles == max(len(s.faces) for s in surfaces)
    ]  # fmt: skip
    floor = _out_of_reach(arm)
    for cell in (*cells, *tools, floor):
        cell.spots = _spots_in_budget(cell, route, options)
    done = 0
    whole = True
    try:
        for number in range(options.passes):
            say(f"pass {number + 1} of {options.passes}")
            for spot in range(len(route.starts)):
                # All rows at one spot, every other time backwards: a change of load meets all.
                for cell in (floor, *cells, *tools)[:: 1 if spot % 2 == 0 else -1]:
                    if spot < cell.spots:
                        drive(cell, route, spot)
                done += 1
                advance(done / (len(route.starts) * options.passes))
    except KeyboardInterrupt:
        if done == 0:
            raise  # some rows have no samples yet
        whole = False
        for cell in (*cells, *tools, floor):
            cell.truncate()
    say("timing single stages")
    rows, whole_tools = ([summary(cell) for cell in some] for some in (cells, tools))
    low, median, high = percentiles(np.array(floor.total) * 1e6)
    return {
        "what": "vf-sandbox bench runtime",
        "source": shape.name,
        "machine": about,
        "options": asdict(options),
        "published": {
            "about": "the paper's C++ on an i7-8700, Stanford bunny: other hardware",
            "points": [{"triangles": n, "rate [kHz]": rate} for n, rate in PUBLISHED],
        },
        "settings": {
            "arm": "psm", "dt [s]": 1e-3, "standoff [m]": vf.Settings().standoff,
            "spots": len(route.starts), "passes": options.passes,
        },
        "builds": builds,
        "rows": rows,
        "whole instrument": whole_tools,
        "floor [us]": {"p1": low, "median": median, "p99": high},
        "ratios": ratios(rows) + of_instrument(rows, whole_tools),
        "interrupted": not whole,
    }  # fmt: skip


def show(result: dict[str, Any], console: Console) -> None:
    """Print the result of `run`."""
    report.header(result, console)
    for build in result["builds"]:
        stages = ", ".join(f"{name} {t:.2f}" for name, t in build["stages [s]"].items())
        console.print(
            f"surface of {build['triangles']:,}: {build['total [s]']:.2f} s ({stages}), "
            f"inside test {build['inside test [s]']:.2f} s, arrays {build['arrays [MB]']:.0f} MB"
        )
    rows = result["rows"]
    parts = [name for name in rows[0]["parts [us]"] if name != "rest"]
    names = ("rule", "r", "triangles", "in ball", "planes", "kHz", "p1", "median", "p99")
    cells = []
    for row in rows:
        tick, split = row["tick [us]"], row["parts [us]"]
        listed = f"{row['stages [us]']['list of the ball']:.0f}" if row["rule"] == "paper" else "–"
        cells.append(
            (
                row["rule"],
                format_length(row["radius [m]"]),
                f"{row['triangles']:,}",
                f"{row['in the ball']:,.0f}",
                f"{row['planes']['mean']:,.1f}",
                f"{row['rate [kHz]']:.2f}",
                *(f"{tick[key]:.0f}" for key in ("p1", "median", "p99")),
                *(f"{split[name]:.1f}" for name in parts),
                f"{split['rest']:.1f}",
                listed,
            )
        )
    show_table(
        console,
        [Column(name, left=name == "rule") for name in (*names, *parts, "rest", "list")],
        cells,
        labels=3,
        title="One tick of the PSM, medians in µs. The planes column of the certified rule is one "
        "tree walk that finds and chooses them; 'list' is the sphere query that the paper's rule "
        "starts with, timed on its own and part of its planes column.",
    )
    states = []
    for row in rows:
        shares = (
            f"{100 * state['share']:.0f} %"
            + (f" {state['tick [us]']:.0f}" if state["tick [us]"] is not None else "")
            for state in row["states"].values()
        )
        states.append(
            (row["rule"], format_length(row["radius [m]"]), f"{row['triangles']:,}", *shares)
        )
    show_table(
        console,
        [
            Column(name, left=name == "rule")
            for name in ("rule", "r", "triangles", *rows[0]["states"])
        ],
        states,
        labels=3,
        title="The same by contact state: share of the ticks, median in µs",
    )
    floor = result["floor [us]"]
    console.print(
        f"a tick that meets nothing: {floor['median']:.1f} µs "
        f"(p1 {floor['p1']:.1f}, p99 {floor['p99']:.0f})"
    )
    for ratio in result["ratios"]:
        bare = ratio.get("without inside test")
        console.print(
            f"{ratio['what']}, r = {format_length(ratio['radius [m]'])}: {ratio['ratio']:.2f}"
            + (f" ({bare:.2f} without the inside test)" if bare is not None else "")
        )


def _out_of_reach(arm: robots.Arm) -> Cell:
    """A scene whose only triangle is nowhere near: what a tick takes that meets nothing."""
    far = np.array([[9.0, 9.0, 9.0], [9.1, 9.0, 9.0], [9.0, 9.1, 9.0]])  # [m]
    surface = vf.Surface.from_arrays(far, [[0, 1, 2]])
    controller = vf.Controller(arm, [vf.MeshFixture(surface)])
    return Cell("certified", controller.fixtures[0].radius, 1, 3, controller, surface)


def _timed(vertices: FloatArray, faces: NDArray[np.int64]) -> tuple[vf.Surface, dict[str, Any]]:
    """A surface, and the time of each stage of its construction."""
    marks: list[tuple[str, float]] = []
    started = perf_counter()
    surface = vf.Surface.from_arrays(
        vertices, faces, lambda stage: marks.append((stage, perf_counter()))
    )
    ended = perf_counter()
    times = [mark for _, mark in marks] + [ended]
    arrays: list[Any] = [
        surface.vertices, surface.faces, surface.normals, surface.neighbours, surface.edges,
        *surface.tree,
    ]  # fmt: skip
    sides = perf_counter()
    closed = surface.closed
    return surface, {
        "total [s]": ended - started,
        "stages [s]": {name: times[k + 1] - times[k] for k, (name, _) in enumerate(marks)},
        "inside test [s]": perf_counter() - sides,
        "closed": closed,
        "arrays [MB]": sum(np.asarray(array).nbytes for array in arrays) / 1e6,
    }


def _spots_in_budget(cell: Cell, route: routes.Route, options: Runtime) -> int:
    """Number of spots that fit in the budget, estimated at the first two, which also warms up."""
    pilot = replace(cell, total=[], parts=[], planes=[], states=[], radii=[], tips=[])
    pilot.statuses = Counter()
    for spot in range(min(2, len(route.starts))):
        drive(pilot, route, spot)
    cost = max(float(np.mean(pilot.total)) * routes.TICKS, 1e-9)  # [s] of a spot
    wanted = max(options.ticks // routes.TICKS, 1)
    return min(wanted, len(route.starts), max(int(options.budget / cost), 1))


def drive(cell: Cell, route: routes.Route, spot: int) -> None:
    """Follow the route at one spot and add the samples to the cell."""
    step = cell.controller.step
    q = route.starts[spot]
    touching = 2 + route.pits[spot]
    targets = route.targets(spot)
    with no_collection():
        for target in targets:
            began = perf_counter()
            result = step(q, target)
            cell.total.append(perf_counter() - began)
            q = result.q
            cell.parts.append(tuple(result.timings))
            cell.planes.append(len(result.planes))
            active = bool((result.multipliers > _ACTIVE).any())
            cell.states.append((touching if active else 1) if len(result.planes) else 0)
            cell.statuses[str(result.status.name).lower()] += 1
            cell.radii.append(result.radius)
            cell.tips.append(result.tip.translation.copy())


def summary(cell: Cell) -> dict[str, Any]:
    """One row of the result; times in microseconds."""
    total = np.array(cell.total) * 1e6
    low, median, high = percentiles(total)
    names = vf.Timings._fields
    parts = dict(zip(names, np.median(np.array(cell.parts), axis=0) * 1e6, strict=True))
    parts.pop("total")
    states = np.array(cell.states)
    by_state = {
        name: {
            "share": float((states == k).mean()),
            "tick [us]": float(np.median(total[states == k])) if (states == k).any() else None,
        }
        for k, name in enumerate(STATES)
    }
    chosen = np.linspace(0, len(cell.tips) - 1, min(_SAMPLES, len(cell.tips))).astype(int)
    stages = _stages(cell, [cell.tips[k] for k in chosen], float(np.median(cell.radii)))
    return {
        "rule": cell.rule,
        "radius [m]": cell.radius,
        "sphere [m]": float(np.median(cell.radii)),
        "triangles": cell.triangles,
        "vertices": cell.vertices,
        "in the ball": stages.pop("in the ball"),
        "planes": {
            "mean": float(np.mean(cell.planes)),
            "median": float(np.median(cell.planes)),
            "max": int(np.max(cell.planes)),
        },
        "ticks": len(total),
        "rate [kHz]": 1e3 / median,
        "tick [us]": {"p1": low, "median": median, "p99": high, "mean": float(total.mean())},
        "parts [us]": {**parts, "rest": median - sum(parts.values())},
        "stages [us]": stages,
        "states": by_state,
        "statuses": dict(cell.statuses),
    }


def _stages(cell: Cell, tips: list[FloatArray], radius: float) -> dict[str, float]:
    """Medians of the times of sphere query and inside test alone, at positions of the route.

    The certified rule has no separate sphere query: one tree traversal finds and selects planes.
    """
    surface = cell.surface
    query, sides, found = [], [], []
    for x in tips:
        a = perf_counter()
        contacts = surface.within(x, radius)
        assert len(contacts.points) == len(contacts)  # the rule needs them too
        b = perf_counter()
        surface.inside(x)
        c = perf_counter()
        query.append(b - a)
        sides.append(c - b)
        found.append(len(contacts))
    return {
        "in the ball": float(np.median(found)),
        "list of the ball": float(np.median(query)) * 1e6,
        "inside test": float(np.median(sides)) * 1e6,
    }
