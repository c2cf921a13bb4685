"""Tools beside structures that deform, and move, at random: judged by the true motion of both."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
import trimesh

import meshes
import robots
import vf
from tests.support import deforming, naive
from tests.support.ticks import UM, pose
from vf import Status

STANDOFF = 20 * UM
FRAME = 10  # ticks from one shape to the next


class Body:
    """A mesh that is on its way to a random shape, and to another one every `FRAME` ticks."""

    def __init__(
        self, rng: np.random.Generator, rest: np.ndarray, faces: np.ndarray, pace: float
    ) -> None:
        """`pace` [m]: no vertex moves by more in a tick."""
        self.rng, self.rest, self.faces, self.pace = rng, rest, faces, pace
        self.surface: vf.Surface = vf.Surface.from_arrays(rest, faces)
        self.before = self.after = rest

    def tick(self, k: int, controller: vf.Controller) -> tuple[float, float]:
        """The blends of tick k; a new shape is taken over where it is due."""
        if k % FRAME == 0:
            along = self.rest @ naive.unit(self.rng) / np.linalg.norm(self.rest, axis=1)
            bump = self.rng.uniform(-0.3, 0.3) * along ** self.rng.integers(0, 4)
            move = self.rest * (1.0 + bump[:, None]) - self.after
            most = np.linalg.norm(move, axis=1).max()
            move *= min(1.0, self.pace * FRAME * self.rng.random() / max(most, 1e-12))
            self.before, self.after = self.after, self.after + move
            self.surface = self.surface.deforming(self.after)
            assert isinstance(self.surface, vf.DeformingSurface)
            controller.replace(0, self.surface)
        return k % FRAME / FRAME, (k % FRAME + 1) / FRAME

    def triangles(self, blend: float) -> np.ndarray:
        return (self.before + blend * (self.after - self.before))[self.faces]


def of_tip(seed: int, ticks: int, dt: float) -> dict[Status, int]:
    """A tip, a point or a ball, beside a ball that deforms; two of three seeds move it too."""
    rng = np.random.default_rng(seed)
    shape = trimesh.creation.icosphere(subdivisions=2, radius=0.01)
    body = Body(rng, np.array(shape.vertices), np.array(shape.faces), 0.1 * dt)
    tip_radius = [0.0, 1e-3][seed // 2 % 2]
    margin = 0.3e-3 * (seed % 2)
    fixture = vf.MeshFixture(body.surface, radius=[5e-3, 1e-3][seed // 4 % 2], margin=margin)
    settings = vf.Settings(dt=dt, tip_radius=tip_radius)
    controller = vf.Controller(robots.load("point"), [fixture], settings)
    T = pin.SE3(naive.rotation(rng), rng.normal(size=3) * 0.02)
    q = T.act(np.array([0.002, 0.003, 0.0135]))
    twist, contacts = np.zeros(6), 0
    counts = dict.fromkeys(Status, 0)
    for k in range(ticks):
        blend = body.tick(k, controller)
        if k % 25 == 0 and seed % 3:
            towards = T.rotation.T @ (q - T.translation)
            towards = 0.7 * towards / np.linalg.norm(towards) + 0.5 * naive.unit(rng)
            twist[:3] = 0.2 * rng.random() * towards * rng.choice([1.0, -0.7])
            twist[3:] = 2.0 * rng.random() * naive.unit(rng)
            if np.linalg.norm(q) > 0.1:
                twist[:3] = T.rotation.T @ (-q) / np.linalg.norm(q) * 0.1
        aim = T.act(rng.normal(size=3) * 0.004) if k % 40 < 25 else q
        after = T * pin.exp6(twist * dt)
        step = controller.step(q, pose(aim), motions=[vf.Motion(T, after, blend=blend)])
        counts[step.status] += 1
        case = f"seed {seed}, tick {k}, {step.status.name}"
        first, last = body.triangles(blend[0]), body.triangles(blend[1])
        began = deforming.depth(first, T.actInv(q))
        contacts += bool((step.multipliers > 0.0).any())
        if step.status is Status.OVERTAKEN:
            # Of a tip that overlapped when the tick began the centre alone is promised.
            whole = began + tip_radius < 0.0
            deep = deforming.depth(last, after.actInv(step.q), tip_radius if whole else 0.0)
            assert deep <= step.violation, f"{case}: {deep} deeper than {step.violation}"
        elif step.status is not Status.INSIDE and began < 0.0:
            held = tip_radius if -began > tip_radius + 1e-9 else 0.0
            start, way = q.copy(), step.q - q
            least = deforming.clearance(
                first, last, lambda share, start=start, way=way: start + share * way,
                float(np.linalg.norm(way)), held, T, after,
            )  # fmt: skip
            assert least > deforming.TOUCH, f"{case}: clearance {least}"
        q, T = step.q, after
    assert contacts > ticks / 20  # or nothing was tried
    return counts


def of_tool(seed: int, ticks: int, dt: float) -> dict[Status, int]:
    """The whole instrument beside a lump that deforms, moves, and comes at a part of it."""
    rng = np.random.default_rng(seed)
    arm = robots.load("psm")
    shape = trimesh.creation.icosphere(subdivisions=1, radius=rng.uniform(0.003, 0.008))
    body = Body(rng, np.array(shape.vertices), np.array(shape.faces), 0.1 * dt)
    margin = 0.3e-3 * (seed % 2)
    fixture = vf.MeshFixture(body.surface, radius=[None, 5e-3][seed % 2], margin=margin)
    controller = vf.Controller(arm, [fixture], vf.Settings(dt=dt, guard="tool"))
    q, T, goal, twist = arm.neutral, pin.SE3.Identity(), arm.tip(arm.neutral), np.zeros(6)
    clear, contacts = False, 0
    counts = dict.fromkeys(Status, 0)
    for k in range(ticks):
        if k % 200 == 0:
            q = arm.neutral + rng.normal(size=6) * 0.1
            number = int(rng.integers(len(arm.capsules)))
            a, b = arm.axes(q)[number]
            u = naive.unit(rng)
            along = np.linalg.norm(b - a)
            if along > 0.0:
                u = np.cross(u, b - a)
                u /= np.linalg.norm(u)
            apart = 0.7 * shape.extents.max() + arm.capsules[number].radius + margin + 2e-4
            T = pin.SE3(naive.rotation(rng), a + rng.uniform(0.35, 1.0) * (b - a) + apart * u)
            here = body.triangles(1.0)
            clear = deforming.capsules_clearance(arm, q, q, here, here, T, T) > 0.0
        blend = body.tick(k, controller)
        if k % 25 == 0:
            number = int(rng.integers(len(arm.capsules)))
            a, b = arm.axes(q)[number]
            towards = a + rng.uniform(0.35, 1.0) * (b - a) - T.translation
            towards = T.rotation.T @ towards / max(np.linalg.norm(towards), 1e-9)
            moves = seed % 3 > 0
            twist[:3] = 0.2 * rng.uniform(0.4, 1.0) * (0.8 * towards + 0.3 * naive.unit(rng))
            twist[3:] = 2.0 * rng.random() * naive.unit(rng) * moves
            twist[:3] *= 1.0 if moves else 0.5
            goal = arm.tip(q)
            goal = pin.SE3(goal.rotation, goal.translation + rng.normal(size=3) * 0.01)
        after = T * pin.exp6(twist * dt)
        target = goal if k % 50 < 25 else arm.tip(q)
        step = controller.step(q, target, motions=[vf.Motion(T, after, blend=blend)])
        counts[step.status] += 1
        case = f"seed {seed}, tick {k}, {step.status.name}"
        first, last = body.triangles(blend[0]), body.triangles(blend[1])
        least = deforming.capsules_clearance(arm, q, step.q, first, last, T, after)
        contacts += least - margin < 20 * STANDOFF
        if step.status is Status.OVERTAKEN:
            if clear:
                assert -min(least, 0.0) <= step.violation, f"{case}: {least}, {step.violation}"
            clear = clear and least > 0.0
        elif clear and step.status is not Status.INSIDE:
            assert least > 0.0, f"{case}: clearance {least}"
        q, T = step.q, after
    assert contacts > ticks / 100  # or nothing was tried
    return counts


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_nothing_is_met_unless_the_tool_was_overtaken(seed: int) -> None:
    assert of_tip(seed, 120, 1e-3)[Status.SOLVED] > 90


def test_no_part_of_the_instrument_is_met_unless_it_was_overtaken() -> None:
    counts = of_tool(1, 150, 1e-3)
    assert counts[Status.SOLVED] + counts[Status.SHORTENED] > 50


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(0, 12, 4))
def test_nothing_is_met_in_long_campaigns(seed: int) -> None:
    of_tip(seed, 1500, [1e-3, 1e-2][seed // 6])


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 6])
def test_no_part_is_met_in_long_campaigns(seed: int) -> None:
    of_tool(seed, 800, [1e-3, 5e-3][seed // 4])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["heart", "liver", "vessel"])
def test_a_tip_pressed_into_anatomy_that_beats_stays_out_of_it(name: str) -> None:
    """Shapes 50 times a second, as they are: the clearance of every tick by the true motion."""
    body = meshes.deforming(name)
    rng = np.random.default_rng(3)
    surface: vf.Surface = vf.Surface.from_arrays(body.vertices, body.faces)
    controller = vf.Controller(robots.load("point"), [vf.MeshFixture(surface, radius=1e-3)])
    place = body.vertices[rng.integers(len(body.vertices))]
    outward = place - body.vertices.mean(axis=0)
    q = place + 2e-3 * outward / np.linalg.norm(outward)
    T = pin.SE3(np.eye(3), -q)  # to where the arm is
    q = np.zeros(3)
    most, touched = 0.0, 0
    before = body.vertices
    for frame in range(40):
        after = body.shape(0.02 * (frame + 1) / body.period)
        surface = surface.deforming(after)
        assert isinstance(surface, vf.DeformingSurface)
        controller.replace(0, surface)
        for k in range(20):
            blend = (k / 20, (k + 1) / 20)
            # Always into the same place: it would slide off a vessel, and be alone.
            goal = pose(2e-3 * naive.unit(rng) - 6e-3 * outward / np.linalg.norm(outward))
            step = controller.step(q, goal, motions=[vf.Motion(T, T, blend=blend)])
            first, last = (((1.0 - b) * before + b * after)[body.faces] for b in blend)
            near = np.linalg.norm(first[:, 0] - T.actInv(q), axis=1) < 0.02
            start, way = q.copy(), step.q - q
            least = deforming.clearance(
                first[near], last[near], lambda s, start=start, way=way: start + s * way,
                float(np.linalg.norm(way)), 0.0, T, T,
            )  # fmt: skip
            if step.status is Status.OVERTAKEN:
                most = max(most, step.violation)
            else:
                assert least > 0.0, (name, frame, k, step.status.name)
            touched += least < 3 * STANDOFF
            q = step.q
        before = after
    assert touched > 100
    assert most < 1e-3
