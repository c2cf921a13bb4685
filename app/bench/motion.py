"""`bench motion`: ticks beside anatomy that moves and deforms, and how long a new shape takes.

The closed loop of `bench runtime`, with the certified rule. In each tick the mesh goes a step one
way or back: 0.2 m/s and 2 rad/s as a rigid body, up to 0.1 m/s from shape to shape. All rows are
timed in turn within a tick, so that they meet the same load.

Then the control process of a session, with the same mesh, which deforms and stands still by turns:
how punctual it is while shapes are taken over beside it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, thread_time
from typing import Any

import numpy as np
import pinocchio as pin
import trimesh
from numpy.typing import NDArray
from rich.console import Console

import meshes
import robots
import vf
from app.bench.loop import BARE, FIRST_TICK, SETTLE, Tap, share, summary, until
from app.bench.tools import bare, report
from app.bench.tools import route as routes
from app.bench.tools.machine import machine, no_collection, percentiles, stolen
from app.bench.tools.settings import Motion
from app.console import Column, show_table
from app.control.priority import raise_process_priority
from app.motion.declared import Motion as Declared
from app.motion.forms import frame_of
from app.session import Session
from app.settings import Options
from meshes.builtin import ladder

__all__ = ["run", "show"]

FloatArray = NDArray[np.float64]
Say = Callable[[str], None]

SPEED, TURN, DEFORMED = 0.2, 2.0, 0.1  # [m/s], [rad/s], [m/s]
DT = 1e-3  # of a tick [s]
FRAME = 10  # ticks from one shape to the next
SHAPES = 12  # taken over and timed
TURNS = 4  # in which the mesh of the session deforms and stands still
STILL, RIGID, DEFORMING, BOTH = "still", "rigid", "deforming", "rigid and deforming"


def run(options: Motion, say: Say, advance: Callable[[float], None]) -> dict[str, Any]:
    """Measure all rows.

    Args:
        say: called with a short text before each stage.
        advance: called with the finished share of the measurement, 0 … 1.

    Returns:
        The content of `motion.json`.

    Raises:
        ValueError: a shape that is not usable for a ladder.
    """
    about = machine()
    shape = ladder.source(options.mesh, options.unit)
    vertices, faces = ladder.rungs(shape, (options.size,), say)[options.size]
    arm = robots.load("psm")
    say("compiling kernels")
    vf.Controller(arm, []).warm_up()
    say("building the surface")
    surface = vf.Surface.from_arrays(
        vertices + meshes.placement(vertices, arm.tip(arm.neutral)), faces
    )
    frames = _shapes(surface.vertices)
    say("taking over shapes")
    taken, deforming = _take_over(surface, frames)
    route = routes.plan(surface, arm)
    controllers = {
        name: vf.Controller(
            arm, [vf.MeshFixture(one, radius=options.radius)], vf.Settings(guard=options.guard)
        )
        for name, one in ((STILL, surface), (RIGID, surface), (DEFORMING, deforming),
                          (BOTH, deforming))
    }  # fmt: skip
    motions = _motions(arm.tip(arm.neutral).translation)
    times: dict[str, list[float]] = {name: [] for name in controllers}
    planes: dict[str, list[int]] = {name: [] for name in controllers}
    spots = range(min(len(route.starts), max(options.ticks // routes.TICKS, 1)))
    order, names = np.random.default_rng(0), [*controllers]
    done = 0
    for number in range(options.passes):
        say(f"pass {number + 1} of {options.passes}")
        for spot in spots:
            q = dict.fromkeys(controllers, route.starts[spot])
            with no_collection():
                for tick, target in enumerate(route.targets(spot)):
                    order.shuffle(names)  # none is always behind another that warmed its memory
                    for name in names:
                        began = perf_counter()
                        step = controllers[name].step(q[name], target, motions[name][tick % 2])
                        times[name].append(perf_counter() - began)
                        planes[name].append(len(step.planes))
                        q[name] = step.q
            done += 1
            advance(done / (len(spots) * options.passes))
    still = float(np.median(times[STILL]))
    del controllers, deforming, surface
    say("the control loop beside shapes that are taken over")
    beside = _beside(options, vertices, faces) if options.seconds > 0.0 else []
    return {
        "what": "vf-sandbox bench motion",
        "source": shape.name,
        "machine": about,
        "options": asdict(options),
        "vertices": len(vertices),
        "taken over [ms]": dict(
            zip(("p1", "median", "p99"), percentiles(1e3 * np.array(taken)), strict=True)
        ),
        "rows": [
            {
                "what": name,
                "planes": float(np.mean(planes[name])),
                "ratio": float(np.median(times[name])) / still,
                "tick [us]": dict(
                    zip(("p1", "median", "p99"), percentiles(1e6 * np.array(times[name])),
                        strict=True)
                ),
            }
            for name in times
        ],
        "beside the loop": beside,
    }  # fmt: skip


def show(result: dict[str, Any], console: Console) -> None:
    """Print the result of `run`."""
    report.header(result, console)
    show_table(
        console,
        [Column(name, left=name == "mesh")
         for name in ("mesh", "planes", "p1", "median", "p99", "over the still one")],
        [
            (
                row["what"], f"{row['planes']:.1f}",
                *(f"{row['tick [us]'][k]:.0f}" for k in ("p1", "median", "p99")),
                f"{row['ratio']:.2f}",
            )
            for row in result["rows"]
        ],
        title="One tick of the PSM, certified rule, in µs",
    )  # fmt: skip
    taken = result["taken over [ms]"]
    console.print(
        f"a new shape of {result['vertices']:,} vertices: {taken['median']:.1f} ms of processor "
        f"time (p1 {taken['p1']:.1f}, p99 {taken['p99']:.1f})"
    )
    if result["beside the loop"]:
        show_table(
            console,
            [Column("loop", left=True), Column("shapes"), Column("ticks"), Column("< 1 ms late"),
             Column("< 0.1 ms"), Column("late p99.9 [µs]"), Column("longest stall [ms]"),
             Column("stolen")],
            [
                (row["what"], str(row["shapes"]), f"{row['ticks']:,}",
                 f"{100 * row['punctual']:.3f} %", f"{100 * row['prompt']:.3f} %",
                 f"{row['late [us]']['p99.9']:.0f}", f"{row['longest stall [ms]']:.2f}",
                 "–" if row["stolen"] is None else f"{100 * row['stolen']:.2f} %")
                for row in result["beside the loop"]
            ],
            title="The control loop, 1 kHz, and shapes taken over beside it",
        )  # fmt: skip


def _shapes(vertices: FloatArray) -> list[FloatArray]:
    """Two shapes (n, 3) that waves over the mesh make, half a frame to either side."""
    x, y, z = vertices.T
    waves = np.column_stack([np.sin(25.0 * y), np.cos(20.0 * x), np.sin(22.0 * x + 18.0 * z)])
    fastest = float(np.sqrt((waves * waves).sum(axis=1).max()))
    way = waves * (0.5 * FRAME * DEFORMED * DT / fastest)
    return [vertices - way, vertices + way]


def _take_over(
    surface: vf.Surface, frames: list[FloatArray]
) -> tuple[list[float], vf.DeformingSurface]:
    """Processor times of new shapes [s], and the surface from the first shape to the second."""
    body = surface.deforming(frames[0])  # prepares the mesh
    taken = []
    for k in range(1, 2 * (SHAPES // 2) + 2):
        began = thread_time()
        body = body.deforming(frames[k % 2])
        taken.append(thread_time() - began)
    return taken[1:], body


def _beside(
    options: Motion, vertices: FloatArray, faces: NDArray[np.int64]
) -> list[dict[str, Any]]:
    """How punctual the control loop of a session is, the mesh deforming and standing still.

    There is no page. Shapes are made as in any session, in another thread of the control process.
    """
    raise_process_priority()
    bare_time = min(options.seconds, BARE)
    before = stolen()
    nothing = summary(bare.measure(1.0 / DT, bare_time), bare_time, 1.0 / DT)
    rows = [{"what": "does nothing", "shapes": 0, **nothing,
             "stolen": share(before, stolen(), bare_time)}]  # fmt: skip
    with ExitStack() as stack:
        folder = Path(stack.enter_context(TemporaryDirectory()))
        trimesh.Trimesh(vertices, faces, process=False).export(folder / "mesh.ply")
        there = _shapes(vertices)[1]
        length = 2.0 * TURNS * options.seconds + 60.0
        # From the one shape to the other all the time: what is taken over is a little of that.
        np.savez(folder / "shapes.npz", vertices=[vertices, there], times=[0.0, length])
        session = Session(
            Options(
                mesh=str(folder / "mesh.ply"), unit="m", port=0, guard=options.guard,
                radius=options.radius, rate=1.0 / DT,
                motions=(Declared("vertices", file=str(folder / "shapes.npz")),),
            ),
            process=True,
        )  # fmt: skip
        stack.callback(session.close)
        tap = Tap(session, round((length + 60.0) / DT))
        session.move_structures(False)
        session.start()
        until(lambda: tap.count > 0, FIRST_TICK)
        session.set_autopilot(True)
        ticks: dict[bool, list[NDArray[np.float64]]] = {False: [], True: []}
        taken: dict[bool, list[float | None]] = {False: [], True: []}
        part = options.seconds / TURNS
        for turn in range(2 * TURNS):
            moves = turn % 2 == 1
            session.move_structures(moves)
            time.sleep(min(SETTLE, options.seconds))
            began, before = perf_counter(), stolen()
            time.sleep(part)
            taken[moves].append(share(before, stolen(), part))
            ticks[moves].append(tap.between(began, began + part))
    for moves, parts in ticks.items():
        each = [summary(part_ticks, part, 1.0 / DT) for part_ticks in parts]
        rows.append(
            {
                "what": "deforming" if moves else "still",
                "shapes": round(options.seconds / frame_of(len(vertices), DT)) if moves else 0,
                **summary(np.concatenate(parts), options.seconds, 1.0 / DT),
                "longest stall [ms]": max(one["longest stall [ms]"] for one in each),
                "stolen": None if None in taken[moves] else float(np.mean(taken[moves])),  # type: ignore[arg-type]
            }
        )
    return rows


def _motions(centre: FloatArray) -> dict[str, list[list[vf.Motion] | None]]:
    """What moves how in even and in odd ticks: there and back."""
    rest = pin.SE3.Identity()
    about = pin.SE3(np.eye(3), centre)
    half = 0.5 * DT * np.array([SPEED, 0.0, 0.0, 0.0, 0.0, TURN])
    before, after = (about * pin.exp6(s * half) * about.inverse() for s in (-1.0, 1.0))
    blend = (0.5 - 0.5 / FRAME, 0.5 + 0.5 / FRAME)
    back = blend[::-1]
    return {
        STILL: [None, None],
        RIGID: [[vf.Motion(before, after)], [vf.Motion(after, before)]],
        DEFORMING: [[vf.Motion(rest, rest, blend=blend)], [vf.Motion(rest, rest, blend=back)]],
        BOTH: [[vf.Motion(before, after, blend=blend)], [vf.Motion(after, before, blend=back)]],
    }
