"""Randomised test beside anatomy that moves: does any part meet it, and how deep is it then?"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import robots
import vf
from app.judges import boxes, depth, passing
from app.judges.nearest import nearest
from app.motion.declared import Tracker
from app.motion.movement import Movement
from app.studies.verification import hands, swelling, wander
from app.studies.verification.campaign import EPISODE, Progress
from app.studies.verification.instrument import Pushed, goals
from app.studies.verification.starts import Scene, Starts
from meshes.content import Arrays

FloatArray = NDArray[np.float64]

MOTIONS = ("rigid", "deforming", "both")
DEPTH_TOLERANCE = 1e-9  # for rounding [m]
SHARE = 0.5  # of a tracker's bound that is left to the deformation, beside a rigid motion
KEPT = 1e-6  # by which a margin may be missed and counts as kept [m]


@dataclass
class Passed(Pushed):
    """Result of `drive`.

    Attributes:
        met: overtaken ticks in which something was met.
        late: with a tracker, ticks in which the true mesh was met and before or after which the
            tool did not have its margin from the mesh as believed: it was not led out in time.
        too_deep: those of them after which it was deeper than `Step.violation`.
        deepest: the largest violation of such a tick [m].
        first_deep: a description of the first that was too deep.
    """

    met: int = 0
    late: int = 0
    too_deep: int = 0
    deepest: float = 0.0
    first_deep: str = ""
    stale: int = 0
    margins: list[float] = field(default_factory=list)
    near: int = 0  # ticks with planes


def drive(
    arm: robots.Arm,
    mesh: Arrays,
    *,
    motion: str,
    guard: str | None,
    radius: float | None,
    period: float,
    steps: int,
    seed: int,
    rule: str = "certified",
    noise: float = 0.0,
    tracker: Tracker | None = None,
    standoff: float = vf.Settings.standoff,
    progress: Progress = lambda _ticks: None,
) -> Passed:
    """Drive the arm beside a mesh that moves by known twists, for `steps` ticks.

    Every `EPISODE` ticks the arm starts at random joint positions, with the mesh beside a part of
    it. `app.judges.passing` judges what the true motions of both come to, actuation error included.
    An episode ends where something was met.

    Args:
        motion: one of `MOTIONS`.
        guard: what the controller guards, one of `vf.GUARDS`; hands and mesh aim at every part,
            and every part is judged. None: the tip is guarded, aimed and judged alone.
        period: of the control loop [s].
        noise: bound on the actuation error, as a share of the motion sphere's radius. The standoff
            is at least four times it.
        tracker: what tells the guard where the mesh is; no point of it is then faster than the
            declared bound. None: the guard knows each tick's motion.
    """
    rng = np.random.default_rng(seed)
    result = Passed(period=period)
    bound = noise * (radius if radius is not None else 5e-4)
    standoff = max(standoff, 4.0 * bound)
    settings = vf.Settings(dt=period, guard=guard or "tip", standoff=standoff)
    own = arm.copy()
    judge = passing.Judge(own, tip_alone=guard is None)
    start = Starts(mesh)
    while result.ticks < steps:
        q, scene = start.near(own, judge, rng)
        result.episodes += 1
        if motion != "rigid":
            faces = scene.mesh.faces
            fastest = swelling.FASTEST
            if tracker is not None:
                fastest = min(fastest, SHARE * tracker.bound)
            scene.swelling = swelling.Swelling((scene.mesh.vertices, faces), period, rng, fastest)
            scene.truth.form = scene.swelling
            scene.deform(0, np.zeros(3))
        fixture = vf.MeshFixture(scene.surface, rule, radius)
        controller = vf.Controller(arm, [fixture], settings)
        length = min(EPISODE, steps - result.ticks)
        rigid = motion != "deforming"
        _episode(
            result, controller, own, judge, scene, q, length, bound, tracker, guard, rigid, rng
        )
        progress(length)
    return result


def _episode(
    result: Passed,
    controller: vf.Controller,
    own: robots.Arm,
    judge: passing.Judge,
    scene: Scene,
    q: FloatArray,
    length: int,
    error: float,
    tracker: Tracker | None,
    guard: str | None,
    rigid: bool,
    rng: np.random.Generator,
) -> None:
    """Up to `length` ticks from joints q (n,), until something is met."""
    period, truth = result.period, scene.truth
    hand = _hand(rng, _Present(scene), _Seen(own, truth), q, guard)
    aim = wander.Aim(np.zeros(3), np.zeros(3), 0.0, 0)
    moves = wander.twists(rng, aim, period)
    movement = Movement([truth], tracker) if tracker is not None else None  # type: ignore[list-item]
    bound = tracker.bound if tracker is not None else np.inf
    around = scene.radius
    if scene.swelling is not None:
        bound *= 1.0 - SHARE
        around += swelling.FIELDS * swelling.FARTHEST
    believed = scene.surface  # of a guard with a tracker
    seen: int | None = None  # number of the sighting that it has the shape of
    holds = 0
    for k in range(length):
        if k % 20 == 0:
            _aim(aim, judge, scene, q, rng)
        if scene.swelling is not None and scene.ticks == scene.swelling.ticks:
            scene.deform(aim.face, truth.now.rotation.T @ aim.towards)
            if movement is None:
                controller.replace(0, scene.surface)
        blend = scene.blend
        scene.ticks += 1
        before = truth.now
        twist = wander.body_twist(before, aim.place, *next(moves)) if rigid else np.zeros(6)
        if tracker is not None:
            twist = wander.slowed(twist, around, 0.999 * bound)
        since = truth.time
        after = truth.go(twist, period)
        goal = before * hand.send(q)
        if holds == 0 and rng.random() < 0.01:
            holds = int(rng.integers(10, 60))
        stale = False
        motion: vf.Motion | None = None
        if movement is None:
            motion = vf.Motion(before, after, **_blended(blend))
        else:
            told = movement.during(since, truth.time)
            motion, stale = told.motions[0], told.stale
            assert motion is not None
            (number,) = told.shapes
            if tracker is not None and number is not None and number != seen:
                seen = number
                assert scene.swelling is not None
                believed = believed.deforming(scene.swelling.at(max(seen, 0) / tracker.rate))
                controller.replace(0, believed)
            result.margins.append(motion.margin)
            result.stale += stale
        if holds or stale:
            goal = own.tip(q)
            holds = max(holds - 1, 0)
        step = controller.step(q, goal, motions=[motion])
        moved = _actuate(own, judge, step.q, error, rng) if error else step.q
        _count(result, step)
        frame = passing.Frame(
            before.rotation, before.translation, twist[3:] * period, twist[:3] * period
        )
        met = judge.contacts(scene.mesh, frame, q, moved, blend)
        if met:
            names = [judge.names[one.capsule] for one in met]
            where = (
                f"tick {result.ticks}, {step.status.name}: {', '.join(names)} from {q.tolist()} "
                f"to {moved.tolist()}"
            )
            kept = motion is None or movement is None
            kept = kept or _kept(judge, believed, scene, motion, q, moved)
            if step.status is not vf.Status.OVERTAKEN:
                result.crossings += kept
                result.late += not kept
                result.parts.update(set(names))
                result.first = result.first or where
            else:
                result.met += 1
                result.deepest = max(result.deepest, step.violation)
                # What is believed of a structure says nothing of how deep the true one is.
                if tracker is None and _too_deep(
                    judge, scene, after, moved, blend[1], step.violation + error
                ):
                    result.too_deep += 1
                    result.first_deep = result.first_deep or f"{where}, {step.violation!r} m"
            return
        q = moved


def _count(result: Passed, step: vf.Step) -> None:
    result.ticks += 1
    result.statuses[step.status] += 1
    result.solvers[step.solver] += 1
    result.planes += len(step.planes)
    result.near += len(step.planes) > 0
    result.shrunk += step.planes.radius < step.radius
    result.times.append(step.timings.total)


def _too_deep(
    judge: passing.Judge, scene: Scene, pose: pin.SE3, q: FloatArray, share: float, than: float
) -> bool:
    """Whether a part is deeper in the mesh than that [m], with the mesh at a pose and a shape."""
    shape = scene.mesh.boxes
    if scene.swelling is not None:
        shape = boxes.build(scene.mesh.at(share), scene.mesh.faces)
    axes = (judge.axes(q) - pose.translation) @ pose.rotation
    return any(
        depth.deeper(shape, axes[k], float(judge.radii[k]), than + DEPTH_TOLERANCE, scene.closed)
        for k in judge.chosen
    )


def _blended(blend: tuple[float, float]) -> dict[str, Any]:
    return {} if blend == (0.0, 0.0) else {"blend": blend}


class _Present:
    """The surface of a scene as it is at the time, for hands."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self.vertices = scene.surface.vertices

    def nearest(self, x: FloatArray) -> tuple[float, int, FloatArray]:
        found: tuple[float, int, FloatArray] = self._scene.surface.nearest(x)
        return found


def _kept(
    judge: passing.Judge,
    believed: Any,
    scene: Scene,
    motion: vf.Motion,
    q: FloatArray,
    moved: FloatArray,
) -> bool:
    """Whether every part had its margin from where the mesh is believed, before and after a tick.

    If it had, and the bound is true, nothing can be met. It has not where the arm cannot get away
    as fast as the margin grows: a shaft at the remote centre, joints at their limits.
    """
    shape = scene.mesh.boxes
    if scene.swelling is not None:
        shape = boxes.build(believed.vertices_after, scene.mesh.faces)
    for pose, joints, margin in (
        (motion.start, q, motion.margin - motion.growth), (motion.end, moved, motion.margin),
    ):  # fmt: skip
        axes = (judge.axes(joints) - pose.translation) @ pose.rotation
        for k in judge.chosen:
            reach = float(judge.radii[k]) + margin - KEPT
            if nearest(shape, axes[k], reach)[0] < reach:
                return False
    return True


class _Seen:
    """An arm as a structure sees it, for hands that aim at it there."""

    def __init__(self, arm: robots.Arm, truth: wander.Truth) -> None:
        self._arm, self._truth = arm, truth
        self.capsules = arm.capsules

    def tip(self, q: FloatArray) -> pin.SE3:
        return self._truth.now.inverse() * self._arm.tip(q)

    def axes(self, q: FloatArray) -> FloatArray:
        pose = self._truth.now
        return np.asarray((self._arm.axes(q) - pose.translation) @ pose.rotation)


def _hand(
    rng: np.random.Generator, surface: Any, seen: Any, q: FloatArray, guard: str | None
) -> Generator[pin.SE3, FloatArray, None]:
    """Endless proxy poses for the joints sent, frame of the structure."""
    hand = goals(rng, surface, seen, q) if guard is not None else _by_tip(rng, surface, seen, q)
    next(hand)
    return hand


def _by_tip(
    rng: np.random.Generator, surface: Any, seen: Any, q: FloatArray
) -> Generator[pin.SE3, FloatArray, None]:
    tools = [seen.tip(q)]
    for goal in hands.goals(rng, surface, tools[0], tools):
        q = yield goal
        tools[0] = seen.tip(q)


def _aim(
    aim: wander.Aim, judge: passing.Judge, scene: Scene, q: FloatArray, rng: np.random.Generator
) -> None:
    """Set the aim to a random place of a random part."""
    k = rng.choice(judge.chosen)
    a, b = judge.axes(q)[k]
    aim.place = a + rng.random() * (b - a)
    pose = scene.truth.now
    gap, aim.face, foot = scene.surface.nearest(pose.actInv(aim.place))
    way = aim.place - pose.act(foot)
    aim.towards = way / max(float(np.linalg.norm(way)), 1e-12)
    aim.distance = gap - float(judge.radii[k])


def _actuate(
    arm: robots.Arm, judge: passing.Judge, q: FloatArray, bound: float, rng: np.random.Generator
) -> FloatArray:
    """Actual joint positions: no end of an axis is off by more than `bound` [m]."""
    error = 1e-9 * rng.normal(size=len(q)) * arm.velocity
    error *= 0.99 * rng.random() * bound / max(judge.fastest(q, error), 1e-300)
    return arm.clamp(q + error) if judge.fastest(q, error) <= bound else q
