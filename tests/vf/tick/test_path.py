"""The way between two ticks, and what a tick does with joints and targets that are of no use."""

from __future__ import annotations

from dataclasses import fields
from math import inf, nextafter

import numpy as np
import pinocchio as pin
import pytest

import robots
import vf
from tests.support import naive
from vf.qp import problem
from vf.settings import RANGES

ARMS = ("point", "psm", "panda", "ur5")
FLOOR = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.5, 0.0]])


def floor_below(tip: np.ndarray, height: float) -> vf.Surface:
    return vf.Surface.from_arrays(FLOOR + tip - [0.0, 0.0, height], [[0, 1, 2]])


@pytest.mark.parametrize("name", ARMS)
def test_the_path_leaves_its_chord_by_no_more_than_the_bound(name: str) -> None:
    """Against positions along the way; of short steps the bound is not a useless one either."""
    arm = robots.load(name)
    rng = np.random.default_rng(5)
    tightest = 0.0
    for k in range(300):
        dq = rng.normal(size=len(arm.lower)) * arm.velocity * 10.0 ** rng.uniform(-4, 0)
        dq *= rng.uniform(size=len(dq)) < rng.choice([0.3, 1.0])
        q = rng.uniform(arm.lower, arm.upper)
        share = float(rng.choice([1.0, 0.5]))
        bound = problem.sagitta(arm.jacobian(q), dq, share, arm.revolute)
        way = np.array([arm.tip(q + t * share * dq).translation for t in np.linspace(0, 1, 65)])
        chord = way[-1] - way[0]
        t = np.clip((way - way[0]) @ chord / max(chord @ chord, 1e-300), 0.0, 1.0)
        off = np.linalg.norm(way - way[0] - t[:, None] * chord, axis=1).max()
        assert off <= bound + 1e-15, (name, k, q, dq)
        if bound > 1e-12:
            tightest = max(tightest, off / bound)
    # A gantry's tip moves straight, and its joints say so.
    assert tightest > 0.5 or (name == "point" and not arm.revolute.any())


@pytest.mark.parametrize("name", ARMS)
def test_no_end_of_a_body_goes_beyond_its_motion_sphere(name: str) -> None:
    """At full speed of all joints, which is where the sphere ends, at 10 Hz to 1 kHz."""
    arm = robots.load(name)
    rng = np.random.default_rng(6)
    farthest = 0.0
    for _ in range(200):
        reach = arm.velocity * 10.0 ** rng.uniform(-3, -1)
        q = rng.uniform(arm.lower, arm.upper)
        dq = reach * rng.choice([-1.0, 1.0], len(q))
        way = arm.axes(q + dq) - arm.axes(q)
        J = arm.axis_jacobians(q)
        for k in range(len(way)):
            for end in range(2):
                bound = problem.widest(J[k, end], reach)
                assert bound <= problem.farthest(J[k, end], reach) * (1.0 + 1e-12)
                bound += 4.0 * problem.sagitta(J[k, end], reach, 1.0, arm.revolute)
                gone = float(np.linalg.norm(way[k, end]))
                assert gone <= bound + 1e-15
                farthest = max(farthest, gone / max(bound, 1e-12))
    assert farthest > 0.9


def test_joints_of_an_arm_that_does_not_say_so_count_as_revolute() -> None:
    arm = robots.load("point")

    class Unsaid:
        lower, upper, velocity = arm.lower, arm.upper, arm.velocity
        tip, kinematics = staticmethod(arm.tip), staticmethod(arm.kinematics)

    surface = floor_below(arm.tip(arm.neutral).translation, 1e-3)
    said = vf.Controller(arm, [vf.MeshFixture(surface, radius=None)])
    unsaid = vf.Controller(Unsaid(), [vf.MeshFixture(surface, radius=None)])
    goal = arm.tip(arm.neutral)
    goal.translation -= [0.02, 0.0, 0.02]
    a = b = np.array(arm.neutral)
    for _ in range(300):
        a, b = said.step(a, goal).q, unsaid.step(b, goal).q
    assert np.linalg.norm(a - b) < 1e-6


def test_planes_say_what_a_curved_path_must_not_sink_below() -> None:
    surface = floor_below(np.zeros(3), 0.0)
    for height, standoff, tip in ((1e-3, 20e-6, 0.0), (5e-6, 20e-6, 0.0), (1e-3, 0.0, 5e-4)):
        planes = vf.certified_planes(surface, [0.0, 0.0, height], 5e-3, standoff, tip)
        assert planes.floors is not None
        assert (planes.floors <= planes.offsets).all()
        assert (planes.floors > tip).all()  # the tip at a floor is still clear of the mesh


@pytest.mark.parametrize("name", ARMS)
def test_no_joint_ends_a_tick_beyond_its_limit(name: str) -> None:
    arm = robots.load(name)
    rng = np.random.default_rng(2)
    surface = floor_below(arm.tip(arm.neutral).translation, 5.0)
    controller = vf.Controller(arm, [vf.MeshFixture(surface)], vf.Settings(dt=2e-2))
    for _ in range(40):
        q = np.where(rng.uniform(size=len(arm.lower)) < 0.5, arm.lower, arm.upper)
        q = q + rng.choice([0.0, 1e-3], size=len(q)) * (arm.lower + arm.upper - 2 * q)
        goal = arm.tip(rng.uniform(arm.lower, arm.upper))
        for _ in range(20):
            q = controller.step(q, goal).q
            assert (q >= arm.lower).all(), name
            assert (q <= arm.upper).all(), name


def test_a_joint_that_is_beyond_its_limit_goes_no_farther() -> None:
    arm = robots.load("psm")
    controller = vf.Controller(arm, [])
    q = np.array(arm.neutral)
    q[0] = nextafter(arm.upper[0], inf)
    goal = arm.tip(arm.neutral + np.array([2.0, 0, 0, 0, 0, 0]))
    assert controller.step(q, goal).q[0] <= q[0]


USELESS = (
    None, "x", 1.0, [], [0.0] * 5, np.zeros((6, 1)), [None] * 6, [np.nan] * 6, [np.inf] * 6,
    [1e308] * 6, [1e300] * 6, [1e16] * 6, [1e200, 0, 0, 0, 0, 0], {"q": 1}, [[0.0], [0.0, 1.0]],
    [10**400] * 6,
)  # fmt: skip


@pytest.mark.parametrize("q", USELESS, ids=repr)
def test_joints_of_no_use_are_refused_and_never_raise(q: object) -> None:
    arm = robots.load("psm")
    controller = vf.Controller(arm, [])
    step = controller.step(q, arm.tip(arm.neutral))  # type: ignore[arg-type]
    assert step.status is vf.Status.REFUSED
    after = controller.step(arm.neutral, arm.tip(arm.neutral))
    assert after.status is vf.Status.SOLVED


@pytest.mark.parametrize(
    "target",
    [None, 1, "x", np.eye(4), np.zeros(3), pin.SE3.Identity().homogeneous, pin.Motion.Zero(),
     pin.SE3(np.eye(3), np.full(3, np.nan)), pin.SE3(np.eye(3), np.full(3, 1e300)),
     pin.SE3(2.0 * np.eye(3), np.zeros(3))],
    ids=lambda target: type(target).__name__,
)  # fmt: skip
def test_targets_of_no_use_are_refused_and_the_arm_stays(target: object) -> None:
    arm = robots.load("psm")
    step = vf.Controller(arm, []).step(arm.neutral, target)  # type: ignore[arg-type]
    assert step.status is vf.Status.REFUSED
    assert (step.q == arm.neutral).all()


def test_every_setting_has_a_range_and_becomes_a_float() -> None:
    assert {*RANGES, "solver", "guard"} == {field.name for field in fields(vf.Settings)}
    for name, (low, high, _unit) in RANGES.items():
        assert type(getattr(vf.Settings(**{name: np.float32(max(low, 0.5))}), name)) is float
        for bad in (
            nextafter(low, -inf),
            np.nan,
            -inf,
            "x",
            *([] if name == "approach" else [None]),  # no limit
            *([] if high == inf else [2 * high]),
        ):
            with pytest.raises(ValueError, match=name):
                vf.Settings(**{name: bad})


@pytest.mark.parametrize("beyond", [1e-9, 4e-6, 15e-6])
def test_a_step_to_the_rim_of_the_ball_keeps_the_standoff_from_what_is_just_outside(beyond) -> None:
    arm, radius = robots.load("point"), 1e-3
    tip = arm.tip(arm.neutral)
    surface = floor_below(tip.translation, radius + beyond)
    controller = vf.Controller(arm, [vf.MeshFixture(surface, radius=radius)], vf.Settings(dt=2e-2))
    goal = pin.SE3(tip.rotation, tip.translation - [0.0, 0.0, 0.01])
    step = controller.step(arm.neutral, goal)
    assert naive.brute(surface).nearest(step.tip.translation) > 0.99 * vf.Settings.standoff
