"""`bench peers`: the same queries to `vf` and to other libraries, in one run on one machine."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.markup import escape

import meshes
import robots
import vf
from app.bench import queries, solvers
from app.bench.queries import Bodies, Holders, Peer
from app.bench.tools import report
from app.bench.tools import route as routes
from app.bench.tools.machine import machine, no_collection, percentiles
from app.bench.tools.reference import leak
from app.bench.tools.settings import Peers
from app.console import Column, show_table
from app.words import format_length
from meshes.builtin import ladder

FloatArray = NDArray[np.float64]
Check = Callable[[Sequence[Any], Sequence[int]], tuple[bool, str]]

CHECKED = 100  # queries per library whose answers are compared
PATIENCE = 1.0  # time of a round, by which the number of queries is limited [s]
LEAK = 1e-9  # tolerance for rounding of a sample in front of every plane [m]


def run(
    options: Peers, say: Callable[[str], None], advance: Callable[[float], None]
) -> dict[str, Any]:
    """Measure all libraries; returns the content of `peers.json`; callbacks as in `runtime.run`.

    Raises:
        ValueError: a shape that is not usable for a ladder.
    """
    about = machine()
    shape = ladder.source(options.mesh, options.unit)
    rungs = ladder.rungs(shape, sorted({options.size, min(options.size, 51_978)}), say)
    arm = robots.load("psm")
    shift = meshes.placement(rungs[max(rungs)][0], arm.tip(arm.neutral))
    say("building our surface")
    surface = vf.Surface.from_arrays(rungs[max(rungs)][0] + shift, rungs[max(rungs)][1])
    smallest = vf.Surface.from_arrays(rungs[min(rungs)][0] + shift, rungs[min(rungs)][1])
    route = routes.plan(smallest, arm)
    say("driving the route")
    points, problems = _route_samples(surface, arm, route, options.queries)
    bodies = Bodies.of(surface, points)
    held = Holders(bodies, say)

    radii = [radius for radius in options.radii if radius is not None]
    jobs: list[tuple[str, list[Peer], Check, int]] = [
        (
            f"nearest triangle, {len(surface.faces):,} triangles",
            queries.nearest(bodies, held),
            partial(queries.check_near, bodies),
            len(points),
        )
    ]
    for radius in radii:
        jobs.append(
            (
                f"triangles in the ball of {format_length(radius)}, {len(surface.faces):,}",
                queries.ball(bodies, held, radius),
                partial(queries.check_ball, bodies, radius=radius),
                len(points),
            )
        )
    for radius in radii:
        jobs.append(
            (
                f"planes for a motion sphere of {format_length(radius)} "
                "(no peer has them: beside the list of its triangles)",
                _planes(bodies, radius),
                partial(_check_planes, bodies, radius=radius),
                len(points),
            )
        )
    missing = bodies.missing
    if problems:
        jobs.append(
            (
                f"QP of a tick in contact, {np.mean([len(p.b) for p in problems]):.1f} planes "
                "on average and 6 joints with speed and position limits",
                solvers.peers(problems, missing),
                partial(solvers.check, problems),
                len(problems),
            )
        )
    tasks: list[dict[str, Any]] = []
    with suppress(KeyboardInterrupt):
        for done, (what, peers, check, count) in enumerate(jobs):
            say(what)
            tasks.append({"what": what, "entries": compare(peers, check, count, options.rounds)})
            advance((done + 1) / len(jobs))
    return {
        "what": "vf-sandbox bench peers",
        "source": shape.name,
        "machine": about,
        "options": asdict(options),
        "tasks": tasks,
        "interrupted": len(tasks) < len(jobs),
        # A wrong answer of another library is shown in its row; ours is an error.
        "complaints": [
            f"{task['what']}: {entry['name']}"
            for task in tasks
            for entry in task["entries"]
            if entry["ours"] and not entry["agrees"]
        ],
        "missing": missing,
    }


def show(result: dict[str, Any], console: Console) -> None:
    """Print the result of `run`."""
    report.header(result, console)
    for task in result["tasks"]:
        rows = []
        for entry in task["entries"]:
            good = entry["agrees"]
            rows.append(
                (
                    escape(entry["name"]),
                    *(f"{entry['us'][k]:.1f}" if good else "–" for k in ("median", "p99")),
                    f"{entry['ratio']:.2f}" if good else "–",
                    escape(entry["check"]) if good else f"[red]wrong: {escape(entry['check'])}[/]",
                    escape(entry["note"]),
                )
            )
        show_table(
            console,
            [
                Column("library", left=True),
                Column("median [µs]"),
                Column("p99 [µs]"),
                Column("× ours"),
                Column("answers", left=True),
                Column("note", left=True),
            ],
            rows,
            title=task["what"],
        )
    for name, why in result["missing"].items():
        console.print(f"not compared: {name} ({why})")


def compare(peers: Sequence[Peer], check: Check, count: int, rounds: int) -> list[dict[str, Any]]:
    """Time `count` queries of every peer in every round; entries in the peers' order, times in µs.

    Answers are compared first; a peer with a wrong answer is not timed. The order of the peers is
    reversed every other round, and ratios are taken within a round, so that a change of load
    affects all alike.
    """
    verdicts = []
    asked: list[list[int]] = []
    for peer in peers:
        every = np.linspace(0, count - 1, min(count, CHECKED)).astype(int).tolist()
        began = perf_counter()
        pilot = [peer.ask(k) for k in every[:5]]
        cost = (perf_counter() - began) / len(pilot)
        fewer = max(int(PATIENCE / max(cost, 1e-9)), 5)
        chosen = every[:: max(len(every) // fewer, 1)]
        verdicts.append(check([peer.read(peer.ask(k)) for k in chosen], chosen))
        asked.append(np.linspace(0, count - 1, min(count, fewer)).astype(int).tolist())
    samples: list[list[list[float]]] = [[] for _ in peers]
    order = [i for i, (agrees, _) in enumerate(verdicts) if agrees]
    for number in range(rounds):
        for i in order if number % 2 == 0 else order[::-1]:
            samples[i].append(_timed(peers[i], asked[i]))
    ours = next(i for i, peer in enumerate(peers) if peer.ours)
    entries = []
    for i, peer in enumerate(peers):
        pooled = np.concatenate(samples[i]) if samples[i] else np.empty(0)
        _, median, high = percentiles(pooled * 1e6)
        ratio = [
            np.median(theirs) / np.median(own)
            for theirs, own in zip(samples[i], samples[ours], strict=False)
        ]
        entries.append(
            {
                "name": peer.name,
                "ours": peer.ours,
                "agrees": verdicts[i][0],
                "check": verdicts[i][1],
                "us": {"median": median, "p99": high},
                "ratio": float(np.median(ratio)) if ratio else float("nan"),
                "calls": len(pooled),
                "note": peer.note,
            }
        )
    return entries


def _timed(peer: Peer, asked: Sequence[int]) -> list[float]:
    ask = peer.ask
    times = []
    with no_collection():
        for k in asked:
            began = perf_counter()
            ask(k)
            times.append(perf_counter() - began)
    return times


def _route_samples(
    surface: vf.Surface, arm: robots.Arm, route: routes.Route, count: int
) -> tuple[FloatArray, list[solvers.Problem]]:
    """Positions (count, 3) of the tool on the route, and the QPs in contact."""
    controller = vf.Controller(arm, [vf.MeshFixture(surface, "certified", 5e-3)])
    controller.warm_up()
    points, problems = [], []
    for spot, start in enumerate(route.starts):
        q = start
        for target in route.targets(spot):
            step = controller.step(q, target)
            points.append(arm.tip(q).translation.copy())
            if step.solver is not vf.Solver.FREE and len(step.planes):
                problems.append(solvers.problem(arm, q, target, step, controller.settings))
            q = step.q
    chosen = np.linspace(0, len(points) - 1, min(count, len(points))).astype(int)
    few = np.linspace(0, len(problems) - 1, min(count, len(problems))).astype(int)
    return np.array([points[k] for k in chosen]), [problems[k] for k in few]


def _planes(bodies: Bodies, radius: float) -> list[Peer]:
    surface, points = bodies.surface, bodies.points
    standoff = vf.Settings().standoff
    return [
        Peer(
            "vf: certified_planes",
            lambda k: vf.certified_planes(surface, points[k], radius, standoff),
            lambda planes: planes,
            "planes that keep any step off any mesh",
            ours=True,
        ),
        Peer(
            "vf: paper_planes",
            lambda k: vf.paper_planes(surface, points[k], radius),
            lambda planes: planes,
            "Conditions 1–3",
            ours=True,
        ),
        Peer(
            "vf: Surface.within, points read",
            lambda k: surface.within(points[k], radius).points,
            lambda _points: None,
            "what the paper's rule has to list first",
            ours=True,
        ),
    ]


def _check_planes(
    bodies: Bodies, answers: Sequence[Any], chosen: Sequence[int], radius: float
) -> tuple[bool, str]:
    """Whether no sampled point of the mesh in the ball is in front of every plane."""
    worst, count = -np.inf, 0
    for planes, k in zip(answers, chosen, strict=True):
        if planes is None:
            return True, "see above"
        near, _ = bodies.centroids.within(bodies.queries[k], radius * 1e3)
        corners = bodies.surface.vertices[bodies.surface.faces[near]]
        x = bodies.points[k]
        worst = max(worst, leak(corners, x, planes.radius, planes.normals, planes.offsets))
        count += len(planes)
    return worst <= LEAK, f"{count / len(chosen):,.1f} planes on average, no leak" + (
        "" if worst <= LEAK else f" but {worst * 1e6:.2g} µm"
    )
