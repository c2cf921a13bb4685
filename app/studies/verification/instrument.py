"""Randomised test of the whole instrument: does any capsule touch the mesh on its true path?"""

from __future__ import annotations

from collections import Counter
from collections.abc import Generator
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import robots
import vf
from app.judges import boxes, sweep
from app.judges.nearest import nearest
from app.studies.verification import hands
from app.studies.verification.campaign import EPISODE, Cover, Drive, Progress, random_joints
from meshes.builtin.shapes import Arrays

FloatArray = NDArray[np.float64]

PERIODS = (1e-3, 5e-3, 0.02, 1e-4, 0.1)  # of the control loop, in turn [s]
GAPS = (5e-5, 3e-3)  # from the mesh at the start, of the capsule that is nearest [m]
TRIES = 40  # poses of a mesh, each second half of them smaller by half


@dataclass
class Pushed(Drive):
    """Result of `drive`."""

    period: float = 0.0  # of the control loop [s]
    episodes: int = 0
    parts: Counter[str] = field(default_factory=Counter)  # crossings by the name of the capsule


def drive(
    arm: robots.Arm,
    mesh: Arrays,
    *,
    guard: str,
    radius: float | None,
    period: float,
    steps: int,
    seed: int,
    noise: float = 0.0,
    progress: Progress = lambda _ticks: None,
) -> Pushed:
    """Drive the arm against a mesh, aiming with every part of the instrument, for `steps` ticks.

    Every `EPISODE` ticks the arm starts at random joint positions, with the mesh turned and moved
    so that a random place of it is beside a random capsule and none is touched. `app.judges.sweep`
    judges every capsule on the way from joints to joints, actuation error included. An episode
    counts its first crossing, and ends there.

    Args:
        guard: what the controller guards, one of `vf.GUARDS`.
        period: of the control loop [s].
        noise: bound on the actuation error at any end of an axis, as a share of the motion sphere's
            radius. The standoff is at least four times it.
    """
    rng = np.random.default_rng(seed)
    result = Pushed(period=period)
    start = _Starts(mesh)
    bound = noise * (radius if radius is not None else 5e-4)
    standoff = max(vf.Settings.standoff, 4.0 * bound)
    settings = vf.Settings(dt=period, guard=guard, standoff=standoff)
    own = arm.copy()
    while result.ticks < steps:
        q, surface, judge = start.near(own, rng)
        result.episodes += 1
        fixture = vf.MeshFixture(surface, "certified", radius)
        controller = vf.Controller(arm, [fixture], settings)
        hand = goals(rng, surface, own, q)
        next(hand)
        length = min(EPISODE, steps - result.ticks)
        for _ in range(length):
            before = q
            step = controller.step(q, hand.send(q))
            q = _actuate(judge, step.q, bound, rng) if bound else step.q
            result.ticks += 1
            result.statuses[step.status] += 1
            result.solvers[step.solver] += 1
            result.planes += len(step.planes)
            result.shrunk += step.planes.radius < step.radius
            result.times.append(step.timings.total)
            touches = judge.touches(before, q)
            if touches:
                result.crossings += 1
                names = [arm.capsules[touch.capsule].name for touch in touches]
                result.parts.update(set(names))
                if not result.first:
                    result.first = (
                        f"tick {result.ticks}: {', '.join(names)} from {before.tolist()} to "
                        f"{q.tolist()}"
                    )
                break
        progress(length)
    return result


def query(
    mesh: Arrays,
    *,
    edges: float | None,
    queries: int,
    seed: int,
    standoff: float = 0.0,
    thickness: float = 0.0,
    arm: robots.Arm | None = None,
    progress: Progress = lambda _queries: None,
) -> Cover:
    """Search for leaks of the certified rule for random capsules beside a mesh.

    Axes that meet the mesh, and capsules that overlap it, are skipped.

    Args:
        edges: radius of the motion sphere in median edge lengths. None: those of the capsules of
            `arm`, which are as long and thick as they are at random joints; the radius is how far
            an end of the axis comes in a tick of 1 ms.
        standoff: [m].
        thickness: radius of the capsules [m], unless they are the arm's.
    """
    surface = vf.Surface.from_arrays(*mesh)
    rng = np.random.default_rng(seed)
    size = float(np.ptp(surface.vertices, axis=0).max())
    result = Cover()
    tried = 0
    while result.queries < queries and tried < 50 * (queries + 10):
        tried += 1
        if edges is not None:
            radius = edges * surface.median_edge
            length = size * 10.0 ** rng.uniform(-3.0, 0.3)
        else:
            assert arm is not None
            length, thickness, radius = _random_capsule(arm, standoff, rng)
        corners = surface.vertices[surface.faces[rng.integers(len(surface.faces))]]
        out, along = rng.normal(size=(2, 3))
        out *= (thickness + radius * rng.uniform(0.001, 1.0)) / np.linalg.norm(out)
        if rng.random() < 0.7:  # across the way out, so that the inside of the axis is near
            along -= (along @ out) * out / (out @ out)
        along *= length / np.linalg.norm(along)
        spot = rng.dirichlet([1.0, 1.0, 1.0]) @ corners + out
        # Some of the balls have the place beyond an end of the axis.
        share = rng.uniform(-0.2, 1.2) if edges is not None else rng.random()
        ends = np.array([spot - share * along, spot + (1.0 - share) * along])
        if not sweep.apart(surface, ends, thickness):
            continue
        # A ball is asked for as a point.
        at = ends if length > 0.0 else ends[0]
        planes = vf.certified_planes(surface, at, radius, standoff, thickness)
        result.queries += 1
        result.planes += len(planes)
        result.shrunk += planes.radius < radius
        if sweep.leaks(surface, planes, ends, planes.radius, thickness):
            result.leaking += 1
            if not result.first:
                result.first = f"query {result.queries}: ends {ends.tolist()}, radius {radius!r}"
        if result.queries % 100 == 0:
            progress(100)
    progress(queries - 100 * (result.queries // 100))
    return result


def _random_capsule(
    arm: robots.Arm, standoff: float, rng: np.random.Generator
) -> tuple[float, float, float]:
    """Length and radius of a random capsule of an arm, and how far its ends come in 1 ms [m]."""
    q = random_joints(arm, rng)
    k = int(rng.integers(len(arm.capsules)))
    start, end = arm.axes(q)[k]
    columns = np.linalg.norm(arm.axis_jacobians(q)[k], axis=1)  # (2, n)
    radius = float((columns @ arm.velocity).max()) * 1e-3
    return float(np.linalg.norm(end - start)), arm.capsules[k].radius, max(radius, 2.0 * standoff)


class _Starts:
    """Joints, and a mesh beside a capsule of the arm there, with nothing touched.

    Poses of the mesh are tried by moving the arm's axes to it: boxes are built once.
    """

    def __init__(self, mesh: Arrays) -> None:
        self.vertices, self.faces = mesh
        self.boxes = boxes.build(self.vertices, self.faces)

    def near(
        self, arm: robots.Arm, rng: np.random.Generator
    ) -> tuple[FloatArray, vf.Surface, sweep.Judge]:
        vertices, faces = self.vertices, self.faces
        while True:
            q = random_joints(arm, rng)
            k = int(rng.integers(len(arm.capsules)))
            axes = arm.axes(q)
            axis = axes[k]
            for attempt in range(TRIES):
                corners = vertices[faces[rng.integers(len(faces))]]
                normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
                size = float(np.linalg.norm(normal))
                if size == 0.0:
                    continue
                # The face's normal points to the capsule, across its axis.
                out = np.cross(axis[1] - axis[0], rng.normal(size=3))
                if not np.linalg.norm(out) > 0.0:
                    out = rng.normal(size=3)
                out /= np.linalg.norm(out)
                side = 1.0 if rng.random() < 0.7 else -1.0
                turn = turned(side * normal / size, out, rng)
                scale = 1.0 if attempt < TRIES // 2 else 0.5 ** rng.integers(1, 4)
                spot = rng.dirichlet([1.0, 1.0, 1.0]) @ corners
                gap = arm.capsules[k].radius + rng.uniform(*GAPS)
                place = axis[0] + rng.random() * (axis[1] - axis[0]) - gap * out
                if not self._clear(arm, spot + (axes - place) @ turn / scale, scale):
                    continue
                moved = place + scale * (vertices - spot) @ turn.T
                judge = sweep.Judge(arm, moved, faces)
                if not judge.clear(q, 0.99 * GAPS[0]):
                    continue
                surface = vf.Surface.from_arrays(moved, faces)
                if not surface.inside(arm.tip(q).translation):
                    return q, surface, judge

    def _clear(self, arm: robots.Arm, axes: FloatArray, scale: float) -> bool:
        """Whether the axes (c, 2, 3) of the arm, in the mesh's frame, are far enough from it."""
        for capsule, axis in zip(arm.capsules, axes, strict=True):
            reach = (capsule.radius + GAPS[0]) / scale
            if nearest(self.boxes, axis, reach)[0] < reach:
                return False
        return True


def turned(a: FloatArray, b: FloatArray, rng: np.random.Generator) -> FloatArray:
    """A random rotation (3, 3) that takes the unit vector a to b."""
    turn = pin.exp3(rng.uniform(-np.pi, np.pi) * b)
    return np.asarray(turn @ pin.Quaternion.FromTwoVectors(a, b).toRotationMatrix())


def goals(
    rng: np.random.Generator, surface: vf.Surface, arm: robots.Arm, q: FloatArray
) -> Generator[pin.SE3, FloatArray, None]:
    """Endless proxy poses for the joints (n,) sent: those of `hands`, and pushes of other parts."""
    tools = [arm.tip(q)]
    tip = arm.tip(q)
    by_tip = hands.goals(rng, surface, tip, tools)
    rotation = tip.rotation.copy()
    goal = tip
    while True:
        if rng.random() < 0.4:
            for _ in range(int(rng.integers(20, 120))):
                q = yield goal
                tools[0] = arm.tip(q)
                goal = next(by_tip)
            continue
        # A place of a capsule is taken through the mesh by moving the tip the same way.
        k, share = rng.integers(len(arm.capsules)), rng.random()
        press, stride = rng.uniform(0.0, 0.03), rng.uniform(0.0, 5e-3)
        heading = rng.normal(size=3)
        heading /= np.linalg.norm(heading)
        if rng.random() < 0.4:
            axis = rng.normal(size=3)
            axis *= rng.uniform(0.0, 1.5) / np.linalg.norm(axis)
            rotation = pin.exp3(axis) @ tip.rotation
        for _ in range(int(rng.integers(20, 120))):
            q = yield goal
            tools[0] = arm.tip(q)
            start, end = arm.axes(q)[k]
            place = start + share * (end - start)
            towards = surface.nearest(place)[2] - place
            towards /= max(float(np.linalg.norm(towards)), 1e-12)
            goal = pin.SE3(rotation, tools[0].translation + press * towards + stride * heading)


def _actuate(
    judge: sweep.Judge, q: FloatArray, bound: float, rng: np.random.Generator
) -> FloatArray:
    """Actual joint positions: no end of an axis is off by more than `bound` [m]."""
    # So small that the bound grows in proportion.
    error = 1e-9 * rng.normal(size=len(q)) * judge.arm.velocity
    error *= 0.99 * rng.random() * bound / max(judge.fastest(q, error), 1e-300)
    return judge.arm.clamp(q + error) if judge.fastest(q, error) <= bound else q
