"""`bench structures`: a tick over many structures, in reach and out of it, beside one large mesh.

The same closed loop as `bench runtime`, with the certified rule. The structures are copies of one
surface, each below the one before: by so little that all are within the motion sphere where one is,
or by a millimetre, so that some are. Those out of reach are the same a metre away.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import numpy as np
from rich.console import Console

import meshes
import robots
import vf
from app.bench import runtime
from app.bench.tools import report
from app.bench.tools import route as routes
from app.bench.tools.machine import machine, percentiles
from app.bench.tools.settings import Structures
from app.console import Column, show_table
from meshes.builtin import ladder

__all__ = ["run", "show"]

Say = Callable[[str], None]

APART = 50e-6  # of two structures that are all in reach [m]
SPREAD = 1e-3  # of two of which some are [m]
AWAY = 1.0  # of those out of reach [m]
LARGE, ONE, BEYOND = "one large mesh", "one structure", "one in reach"
SOME, REACHED = "1 mm apart, some in reach", "50 µm apart, all in reach"


def run(options: Structures, say: Say, advance: Callable[[float], None]) -> dict[str, Any]:
    """Measure all rows, in turn at every spot of the route.

    Args:
        say: called with a short text before each stage.
        advance: called with the finished share of the measurement, 0 … 1.

    Returns:
        The content of `structures.json`.

    Raises:
        ValueError: a shape that is not usable for a ladder.
    """
    about = machine()
    shape = ladder.source(options.mesh, options.unit)
    rungs = ladder.rungs(shape, (options.size, options.large), say)
    arm = robots.load("psm")
    shift = meshes.placement(rungs[options.large][0], arm.tip(arm.neutral))
    say("compiling kernels")
    vf.Controller(arm, []).warm_up()
    say("building the surfaces")
    small, faces = rungs[options.size]
    large = vf.Surface.from_arrays(rungs[options.large][0] + shift, rungs[options.large][1])
    first = vf.Surface.from_arrays(small + shift, faces)

    def further(x: float, apart: float) -> list[vf.Surface]:
        return [
            vf.Surface.from_arrays(small + shift + [x, 0.0, -apart * k], faces)
            for k in range(1, options.count)
        ]

    route = routes.plan(first, arm)
    scenes = {
        LARGE: [large],
        ONE: [first],
        BEYOND: [first, *further(AWAY, APART)],
        SOME: [first, *further(0.0, SPREAD)],
        REACHED: [first, *further(0.0, APART)],
    }
    cells = {}
    for name, surfaces in scenes.items():
        fixtures = [vf.MeshFixture(one, "certified", options.radius) for one in surfaces]
        cells[name] = runtime.Cell(
            "certified", options.radius, sum(len(one.faces) for one in surfaces),
            sum(len(one.vertices) for one in surfaces),
            vf.Controller(arm, fixtures, vf.Settings(guard=options.guard)), surfaces[0],
        )  # fmt: skip
    for cell in cells.values():  # warms up too
        runtime.drive(cell, route, 0)
        cell.clear()
    spots = range(min(len(route.starts), max(options.ticks // routes.TICKS, 1)))
    done = 0
    for number in range(options.passes):
        say(f"pass {number + 1} of {options.passes}")
        for spot in spots:
            for cell in [*cells.values()][:: 1 if spot % 2 == 0 else -1]:
                runtime.drive(cell, route, spot)
            done += 1
            advance(done / (len(spots) * options.passes))
    rows = [
        {
            "what": name,
            "structures": len(scenes[name]),
            "triangles": cell.triangles,
            "planes": float(np.mean(cell.planes)),
            "tick [us]": dict(
                zip(("p1", "median", "p99"), percentiles(np.array(cell.total) * 1e6), strict=True)
            ),
        }
        for name, cell in cells.items()
    ]
    medians = {name: float(np.median(cell.total)) for name, cell in cells.items()}
    return {
        "what": "vf-sandbox bench structures",
        "source": shape.name,
        "machine": about,
        "options": asdict(options),
        "rows": rows,
        "ratio to the large mesh": {
            name: medians[name] / medians[LARGE] for name in (ONE, BEYOND, SOME, REACHED)
        },
        "of each out of reach [us]": 1e6 * (medians[BEYOND] - medians[ONE])
        / max(options.count - 1, 1),
    }  # fmt: skip


def show(result: dict[str, Any], console: Console) -> None:
    """Print the result of `run`."""
    report.header(result, console)
    show_table(
        console,
        [
            Column(name, left=name == "scene")
            for name in ("scene", "structures", "triangles", "planes", "p1", "median", "p99")
        ],
        [
            (
                row["what"], str(row["structures"]), f"{row['triangles']:,}",
                f"{row['planes']:.1f}", *(f"{row['tick [us]'][k]:.0f}" for k in
                                          ("p1", "median", "p99")),
            )
            for row in result["rows"]
        ],
        title="One tick of the PSM, certified rule, "
        + ("tip alone" if result["options"]["guard"] == "tip" else "whole instrument")
        + ", in µs",
    )  # fmt: skip
    for name, ratio in result["ratio to the large mesh"].items():
        console.print(f"{name}: {ratio:.2f} times the large mesh")
    console.print(f"each out of reach: {result['of each out of reach [us]']:.2f} µs")
