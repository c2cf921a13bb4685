"""Attacks by what the caller brings: an arm, a fixture, arrays and poses of their own."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest

import robots
import vf
from tests.support import exact
from tests.support.bodies import box, together

BODY = together(box((-0.01,) * 3, (0.01,) * 3))
START = np.array([0.05, 0.0, 0.0])
GOAL = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.05]))
NO_NUMBER = pin.SE3(np.eye(3), np.array([np.nan, 0.0, 0.0]))


class Slides:
    """Three slides; its tip and how it moves are multiplied by what the test wants."""

    lower, upper = np.full(3, -0.2), np.full(3, 0.2)
    velocity = np.full(3, 0.1)
    place = column = 1.0

    def tip(self, q):
        with np.errstate(invalid="ignore"):
            return pin.SE3(np.eye(3), self.place * np.array(q, dtype=float))

    def kinematics(self, q):
        J = np.vstack([np.eye(3), np.zeros((3, 3))])
        J[0, 0] = self.column
        return self.tip(q), J


class Wrapped:
    """A mesh that is asked by way of a fixture of the user's own."""

    certified = True

    def __init__(self, fixture: vf.MeshFixture) -> None:
        self.radius = fixture.radius
        self.planes, self.inside, self.leads_out = (
            fixture.planes, fixture.inside, fixture.leads_out
        )  # fmt: skip


# Arrays and poses


@pytest.mark.parametrize("target", [None, NO_NUMBER])
def test_a_refused_tick_leaves_the_callers_joints_alone(target: object) -> None:
    controller = vf.Controller(robots.load("point"), [vf.MeshFixture(BODY)])
    memory = np.zeros(6)
    q = memory[:3]
    q[:] = START
    step = controller.step(q, target)  # type: ignore[arg-type]
    assert step.status is vf.Status.REFUSED
    assert q.flags.writeable
    q[:] = 9.0
    np.testing.assert_array_equal(step.q, START)
    assert not step.q.flags.writeable
    np.testing.assert_array_equal(controller.step(np.full(3, np.nan), GOAL).q, START)


def test_joints_of_no_use_before_the_first_tick_stay_the_callers() -> None:
    controller = vf.Controller(robots.load("point"), [vf.MeshFixture(BODY)])
    q = np.full(3, np.nan)
    step = controller.step(q, GOAL)
    assert q.flags.writeable
    q[:] = 0.0
    assert np.isnan(step.q).all()


def test_a_pose_that_cannot_be_read_is_refused() -> None:
    class Mine(pin.SE3):
        @property
        def homogeneous(self):
            raise ValueError

    controller = vf.Controller(robots.load("point"), [vf.MeshFixture(BODY)])
    for target in (Mine(GOAL), pin.SE3.__new__(pin.SE3)):
        step = controller.step(START, target)
        assert step.status is vf.Status.REFUSED
        np.testing.assert_array_equal(step.q, START)
        np.testing.assert_array_equal(step.tip.translation, START)


# Arms


@pytest.mark.parametrize("speed", [0.0, -1.0, np.nan, np.inf, 1e150])
def test_speeds_that_a_joint_cannot_have_are_refused_at_the_border(speed: float) -> None:
    arm = Slides()
    arm.velocity = np.array([0.1, 0.1, speed])
    with pytest.raises(ValueError, match="speed limits"):
        vf.Controller(arm, [vf.MeshFixture(BODY)])


@pytest.mark.parametrize("limit", [np.nan, np.inf, -0.3])
def test_position_limits_that_are_none_are_refused_at_the_border(limit: float) -> None:
    arm = Slides()
    arm.upper = np.array([0.2, 0.2, limit])
    with pytest.raises(ValueError, match="position limits"):
        vf.Controller(arm, [vf.MeshFixture(BODY)])


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e9, 1e200])
@pytest.mark.parametrize("part", ["place", "column"])
def test_an_arm_that_does_not_know_where_it_is_holds(part: str, bad: float) -> None:
    arm = Slides()
    controller = vf.Controller(arm, [vf.MeshFixture(BODY)])
    before = controller.step(START, GOAL)
    setattr(arm, part, bad)
    step = controller.step(START, GOAL)
    assert step.status is vf.Status.REFUSED
    np.testing.assert_array_equal(step.q, before.q)


@pytest.mark.parametrize("solver", vf.SOLVERS)
def test_the_least_damping_of_a_redundant_arm_leaves_numbers(solver: str) -> None:
    if solver != "osqp":
        pytest.importorskip(solver)
    arm = robots.load("panda")  # seven joints for six coordinates
    settings = vf.Settings(damping=1e-15, rotation_length=1e3, solver=solver)
    controller = vf.Controller(arm, [vf.MeshFixture(BODY)], settings)
    rng = np.random.default_rng(0)
    q, T = np.array(arm.neutral), arm.tip(arm.neutral)
    for _ in range(20):
        goal = pin.SE3(T.rotation, T.translation + rng.normal(size=3) * 0.02)
        step = controller.step(q, goal)
        assert step.status is not vf.Status.HELD
        assert np.isfinite(step.multipliers).all()
        q = step.q
    assert np.linalg.norm(q - arm.neutral) > 1e-4


# Fixtures


@pytest.mark.parametrize("name", ["psm", "panda", "ur5"])
def test_what_an_own_fixture_says_of_paths_holds_on_the_path(name: str) -> None:
    """Planes with floors, between the plates of a slot, at a low rate."""
    arm = robots.load(name)
    T = arm.tip(arm.neutral)
    for seed in range(2):
        rng = np.random.default_rng(seed)
        turn = pin.exp3(rng.normal(size=3) * 2.0)
        plate = np.array([[-0.1, -0.1, 3e-5], [0.2, -0.1, 3e-5], [-0.1, 0.2, 3e-5]])
        plates = np.array([plate, plate * [1.0, 1.0, -1.0]])
        triangles = plates @ turn.T + T.translation
        fixture = vf.MeshFixture(exact.soup(triangles), radius=None)
        controller = vf.Controller(arm, [Wrapped(fixture)], vf.Settings(dt=0.05))
        q = np.array(arm.neutral)
        gone = 0.0
        for _ in range(25):
            rotation = pin.exp3(rng.normal(size=3) * 0.3) @ T.rotation
            goal = pin.SE3(rotation, T.translation + turn @ (rng.normal(size=3) * 0.03))
            new = controller.step(q, goal).q
            path = [arm.tip(q + t * (new - q)).translation for t in np.linspace(0.0, 1.0, 17)]
            assert not any(exact.crossed(triangles, a, b).size for a, b in pairwise(path))
            gone += float(np.linalg.norm(path[-1] - path[0]))
            q = new
        assert gone > 1e-3
