"""The controller with guard "tool": every capsule of the instrument is held, and only then.

Clearances are looked for along the joints' way, by Pinocchio's axes and distances of another kind
than the rule's.
"""

from __future__ import annotations

import itertools

import numpy as np
import pinocchio as pin
import pytest
import trimesh

import robots
import vf
from robots import point
from vf.tick.chain import place_points, point_jacobian, tip_pose

STANDOFF = vf.Settings.standoff
SHEET = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
HALVES = np.array([[0, 1, 2], [0, 2, 3]])


def ball(centre: np.ndarray, radius: float = 0.01) -> vf.Surface:
    shape = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    return vf.Surface.from_arrays(np.array(shape.vertices) + centre, np.array(shape.faces))


def gaps(arm: robots.Arm, surface: vf.Surface, q: np.ndarray) -> np.ndarray:
    """Clearance of each capsule (c,) from the corners of a mesh, which are close together."""
    found = []
    for capsule, (a, b) in zip(arm.capsules, arm.axes(q), strict=True):
        way = b - a
        share = np.clip((surface.vertices - a) @ way / max(way @ way, 1e-300), 0.0, 1.0)
        feet = a + share[:, None] * way
        found.append(np.linalg.norm(surface.vertices - feet, axis=1).min() - capsule.radius)
    return np.array(found)


def beside_the_shaft(arm: robots.Arm, q: np.ndarray, gap: float) -> vf.Surface:
    """A ball on the −x side of the middle of the shaft."""
    middle = arm.axes(q)[2].mean(axis=0)
    return ball(middle - [0.01 + arm.capsules[2].radius + gap, 0.0, 0.0])


def driven(
    controller: vf.Controller, q: np.ndarray, way: np.ndarray, ticks: int = 200
) -> list[vf.Step]:
    goal = controller.arm.tip(q)
    goal = pin.SE3(goal.rotation, goal.translation + way)
    steps = []
    for _ in range(ticks):
        steps.append(controller.step(q, goal))
        q = steps[-1].q
    return steps


def test_the_shaft_is_held_where_the_tip_alone_would_let_it_through() -> None:
    arm = robots.load("psm")
    surface = beside_the_shaft(arm, arm.neutral, 1e-3)
    ends = {}
    for guard in vf.GUARDS:
        controller = vf.Controller(arm, [vf.MeshFixture(surface)], vf.Settings(guard=guard))
        steps = driven(controller, arm.neutral, np.array([-0.02, 0.0, 0.0]))
        ends[guard] = steps[-1]
        # On the way, too.
        lowest = np.inf
        for one, other in itertools.pairwise(steps):
            for t in (0.5, 1.0):
                lowest = min(lowest, gaps(arm, surface, one.q + t * (other.q - one.q)).min())
        if guard == "tool":
            assert lowest > 0.9 * STANDOFF
        else:
            assert lowest < -2e-3
    held = ends["tool"]
    assert held.planes.capsules is not None
    assert set(held.planes.capsules) == {2}
    assert held.multipliers.max() > 1e-5
    assert np.linalg.norm(held.force) > 0.5
    assert not len(ends["tip"].planes)
    # At rest it rests.
    again = driven(controller_of(arm, surface), held.q, np.array([-0.02, 0.0, 0.0]), 2000)
    places = np.array([arm.tip(step.q).translation for step in again[-200:]])
    assert np.ptp(places, axis=0).max() < 1e-6
    assert gaps(arm, surface, again[-1].q)[2] == pytest.approx(STANDOFF, abs=3e-6)


def controller_of(arm: robots.Arm, surface: vf.Surface, **options: object) -> vf.Controller:
    settings = vf.Settings(guard="tool", **options)  # type: ignore[arg-type]
    return vf.Controller(arm, [vf.MeshFixture(surface)], settings)


@pytest.mark.parametrize(
    "dt",
    [
        pytest.param(1e-4, marks=pytest.mark.slow),
        1e-3,
        pytest.param(0.02, marks=pytest.mark.slow),
        0.1,
    ],
)
@pytest.mark.parametrize("part", [0, 1, 2, 3])
def test_every_part_keeps_clear_on_its_true_path_at_any_rate(part: int, dt: float) -> None:
    """Pushed into a small ball beside it, from random sides, in random postures."""
    arm, rng = robots.load("psm"), np.random.default_rng(part)
    met = 0
    for _ in range(3):
        q = rng.uniform(arm.lower, arm.upper) * [0.5, 0.5, 0.4, 0.5, 0.5, 0.5] + [
            0,
            0,
            0.1,
            0,
            0,
            0,
        ]
        axis = arm.axes(q)[part]
        out = np.cross(axis[1] - axis[0], rng.normal(size=3))
        out /= np.linalg.norm(out)
        spot = axis[0] + rng.uniform(0.3, 1.0) * (axis[1] - axis[0])
        surface = ball(spot - (0.004 + arm.capsules[part].radius + 5e-4) * out, 0.004)
        if gaps(arm, surface, q).min() < 1e-4:
            continue
        controller = controller_of(arm, surface, dt=dt)
        goal = arm.tip(q)
        goal.translation -= 0.02 * out
        goal.rotation = pin.exp3(rng.normal(size=3)) @ goal.rotation
        nearest = np.inf
        for _ in range(60):
            step = controller.step(q, goal)
            for t in (0.3, 0.6, 1.0):
                assert gaps(arm, surface, q + t * (step.q - q)).min() > 0.0
            q = step.q
            nearest = min(nearest, gaps(arm, surface, q)[part])
        # At low rates steps near the mesh are short: their paths would leave the chord by too much.
        met += nearest < (3.0 * STANDOFF if dt <= 1e-3 else 4e-4)
    assert met or part == 3  # the upper shaft moves little


def test_guarded_points_and_their_jacobians_are_those_of_pinocchio() -> None:
    rng = np.random.default_rng(0)
    for arm in (*map(robots.load, robots.names()), point.load((0.01, 0.0, 0.03))):
        count = 1 + 2 * len(arm.capsules)
        guards = np.zeros((count, 4))
        guards[1:] = arm.anchors.reshape(-1, 4)
        places, pose = np.zeros((count, 3)), np.empty((3, 4))
        joint_axes, J = np.empty((len(arm.chain) - 1, 6)), np.empty((3, len(arm.lower)))
        for _ in range(20):
            q = rng.uniform(arm.lower, arm.upper)
            tip_pose(arm.chain, q, pose, joint_axes)
            place_points(arm.chain, q, guards, places)
            np.testing.assert_allclose(places[1:], arm.axes(q).reshape(-1, 3), atol=1e-12)
            known = arm.axis_jacobians(q).reshape(-1, 3, len(q))
            for p in range(1, count):
                point_jacobian(arm.chain, joint_axes, int(guards[p, 0]), *places[p], J)
                np.testing.assert_allclose(J, known[p - 1], atol=1e-12)


def test_an_arm_that_is_a_tip_moves_the_same_with_either_guard() -> None:
    arm = robots.load("point")
    surface = ball(np.array([0.0, 0.0, -0.012]))
    ends = []
    for guard in vf.GUARDS:
        settings = vf.Settings(guard=guard, tip_radius=1e-3)
        controller = vf.Controller(arm, [vf.MeshFixture(surface)], settings)
        ends.append(driven(controller, arm.neutral, np.array([2e-3, 0.0, -0.02]))[-1])
    assert ends[0].q.tobytes() == ends[1].q.tobytes()
    assert ends[0].planes.offsets.tobytes() == ends[1].planes.offsets.tobytes()


def test_a_needle_is_held_along_its_length() -> None:
    arm = point.load((0.0, 0.0, 0.05))
    surface = ball(np.array([-0.01 - 0.0016 - 1e-3, 0.0, 0.03]))
    for guard, most in (("tip", -1e-3), ("tool", 1e-3)):
        controller = vf.Controller(arm, [vf.MeshFixture(surface)], vf.Settings(guard=guard))
        q = driven(controller, arm.neutral, np.array([-0.02, 0.0, 0.0]))[-1].q
        assert (gaps(arm, surface, q)[1] > 0.0) == (most > 0.0)


def test_a_shaft_through_the_mesh_holds_the_tool_and_a_trocar_zone_frees_it() -> None:
    arm = robots.load("psm")
    skin = vf.Surface.from_arrays(SHEET - [0.0, 0.0, 0.004], HALVES)
    way = np.array([0.01, 0.005, 0.0])
    stuck = driven(controller_of(arm, skin), arm.neutral, way, 5)[-1]
    assert stuck.status is vf.Status.HELD
    np.testing.assert_array_equal(stuck.q, arm.neutral)
    free = driven(controller_of(arm, skin, trocar=0.02), arm.neutral, way)[-1]
    assert free.status is vf.Status.SOLVED
    assert np.linalg.norm(free.tip.translation - arm.tip(arm.neutral).translation - way) < 1e-5
    # Below the zone the shaft is held as ever, and above it.
    for surface in (
        beside_the_shaft(arm, arm.neutral, 1e-3),
        ball(np.array([0.01 + arm.capsules[3].radius + 1e-3, 0.0, 0.08])),
    ):
        fixtures = [vf.MeshFixture(skin), vf.MeshFixture(surface)]
        controller = vf.Controller(arm, fixtures, vf.Settings(guard="tool", trocar=0.02))
        held = driven(controller, arm.neutral, np.array([-0.03, 0.0, 0.0]))[-1]
        assert 0.0 < gaps(arm, surface, held.q).min() < 3.0 * STANDOFF
        assert held.planes.fixtures is not None
        assert set(held.planes.fixtures[held.multipliers > 0.0]) == {1}


def test_a_shaft_that_is_drawn_back_into_its_port_is_not_held_there() -> None:
    """With the wrist in the zone there is no shaft outside of it."""
    arm = robots.load("psm")
    q = arm.neutral.copy()
    q[2] = 0.03
    # Upright beside the shaft, where the zone is, and too near for a shaft outside of it.
    upright = 0.02 * SHEET[:, [2, 0, 1]] - np.array([0.0062, 0.0, 0.0])
    surface = vf.Surface.from_arrays(upright, HALVES)
    controller = controller_of(arm, surface, trocar=0.03)
    steps = driven(controller, q, np.array([0.0, 0.0, 0.005]), 20)
    assert steps[-1].status is vf.Status.SOLVED


def test_other_rules_hold_the_tip_only() -> None:
    arm = robots.load("psm")
    surface = beside_the_shaft(arm, arm.neutral, 1e-3)
    fixtures = [vf.MeshFixture(surface, "paper")]
    controller = vf.Controller(arm, fixtures, vf.Settings(guard="tool"))
    q = driven(controller, arm.neutral, np.array([-0.02, 0.0, 0.0]))[-1].q
    assert gaps(arm, surface, q).min() < -2e-3
    # Beside a certified mesh, whose planes then come from Python for the tip, the tool is held.
    fixtures += [vf.MeshFixture(surface)]
    controller = vf.Controller(arm, fixtures, vf.Settings(guard="tool"))
    q = driven(controller, arm.neutral, np.array([-0.02, 0.0, 0.0]))[-1].q
    assert gaps(arm, surface, q).min() > 0.0


def test_an_overlapping_shaft_is_led_out_and_no_deeper() -> None:
    arm = robots.load("psm")
    surface = beside_the_shaft(arm, arm.neutral, -5e-4)
    before = gaps(arm, surface, arm.neutral)[2]
    q, controller = arm.neutral, controller_of(arm, surface)
    goal = arm.tip(q)
    goal.translation -= [0.02, 0.0, 0.0]
    seen = set()
    for _ in range(100):
        step = controller.step(q, goal)
        seen.add(step.status)
        assert gaps(arm, surface, step.q)[2] > before - 2e-8
        before, q = gaps(arm, surface, step.q)[2], step.q
    assert vf.Status.RECOVERING in seen
    assert before > 0.9 * STANDOFF


class Unchained:
    """An arm of one's own, without a chain."""

    def __init__(self, **more: object) -> None:
        arm = robots.load("point")
        self.lower, self.upper, self.velocity = arm.lower, arm.upper, arm.velocity
        self.tip, self.kinematics = arm.tip, arm.kinematics
        self.__dict__.update(more)


def test_of_an_arm_that_gives_no_capsules_the_tip_is_guarded() -> None:
    surface = ball(np.array([0.0, 0.0, -0.012]))
    settings = vf.Settings(guard="tool")
    own = vf.Controller(Unchained(), [vf.MeshFixture(surface)], settings)
    end = driven(own, np.zeros(3), np.array([0.0, 0.0, -0.02]))[-1]
    assert surface.nearest(end.tip.translation)[0] == pytest.approx(STANDOFF, abs=2e-6)
    capsules = robots.load("psm").capsules
    with pytest.raises(ValueError, match="guard 'tool' needs an arm with a chain"):
        vf.Controller(Unchained(capsules=capsules), [vf.MeshFixture(surface)], settings)


def test_what_is_no_guard_is_refused() -> None:
    with pytest.raises(ValueError, match="unknown guard 'arm': choose one of tip, tool"):
        vf.Settings(guard="arm")
    with pytest.raises(ValueError, match="trocar must be a number from 0 to 1 m, got -1"):
        vf.Settings(trocar=-1)
