"""What a controller, its settings and its fixtures refuse, and how they answer then."""

from __future__ import annotations

import numpy as np
import pytest

import robots
import vf
from tests.support.ticks import fixed, plate, pose
from vf import Status

BAD_TARGETS = [
    pose([np.nan, 0, 0]), pose([0, np.inf, 0]), pose([0, 0, 50.0]), pose([1e300, 0, 0]),
    pose([0, 0, 0], np.full((3, 3), np.nan)), pose([0, 0, 0], 2 * np.eye(3)),
    pose([0, 0, 0], np.diag([1.0, 1.0, -1.0])), pose([0, 0, 0], np.zeros((3, 3))),
]  # fmt: skip


@pytest.mark.parametrize("target", BAD_TARGETS, ids=range(len(BAD_TARGETS)))
@pytest.mark.parametrize("name", ["point", "psm"])
def test_unusable_targets_are_refused_without_motion(name, target):
    arm = robots.load(name)
    controller = vf.Controller(arm, fixed(plate(-0.5)), vf.Settings())
    step = controller.step(arm.neutral, target)
    assert step.status is Status.REFUSED
    assert (step.q == arm.neutral).all()
    assert not step.force.any()
    assert np.allclose(step.tip.translation, arm.tip(arm.neutral).translation)
    good = controller.step(arm.neutral, arm.tip(arm.neutral))
    assert good.status is Status.SOLVED


def test_refused_steps_are_read_only_too():
    arm = robots.load("point")
    step = vf.Controller(arm, []).step(arm.neutral, pose([np.nan, 0, 0]))
    for array in (step.q, step.force, step.multipliers, step.limits):
        assert not array.flags.writeable


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_unusable_joints_are_refused(bad):
    arm = robots.load("psm")
    controller = vf.Controller(arm, fixed(plate(-0.5)), vf.Settings())
    q = arm.neutral.copy()
    q[3] = bad
    step = controller.step(q, arm.tip(arm.neutral))
    assert step.status is Status.REFUSED
    assert (step.q[:3] == q[:3]).all()
    assert controller.step(q[:5], arm.tip(arm.neutral)).status is Status.REFUSED


@pytest.mark.parametrize("bad", [None, "x", [0.0] * 5, [np.nan] * 6, [1e16] * 6], ids=repr)
def test_refused_joints_are_answered_by_the_last_ones_sent(bad):
    arm = robots.load("psm")
    controller = vf.Controller(arm, fixed(plate(-0.5)), vf.Settings())
    controller.warm_up()  # its own ticks are none that anything was sent by
    goal = arm.tip(arm.neutral)
    with np.errstate(invalid="ignore"):
        first = controller.step(bad, goal)
    assert first.status is Status.REFUSED
    assert not np.array_equal(first.q, 0.5 * (arm.lower + arm.upper))
    goal.translation = goal.translation + np.array([1e-3, 0.0, 0.0])
    for target in (goal, pose([np.nan, 0, 0])):  # a step, and a target of no use
        sent = controller.step(arm.neutral, target)
        sent.tip.translation = np.ones(3)  # the caller's, who may write to it
        step = controller.step(bad, goal)
        assert step.status is Status.REFUSED
        assert (step.q == sent.q).all()
        assert np.allclose(step.tip.homogeneous, arm.tip(sent.q).homogeneous, atol=1e-15)
        assert not step.q.flags.writeable
        # And on from there.
        assert controller.step(step.q, arm.tip(arm.neutral)).status is Status.SOLVED


@pytest.mark.parametrize(
    ("name", "value"),
    [("dt", 0.0), ("dt", -1e-3), ("dt", np.nan), ("standoff", -1e-6), ("standoff", np.inf),
     ("tip_radius", -1.0), ("rotation_length", 0.0), ("damping", 0.0), ("force_gain", -150.0),
     ("force_cap", np.nan), ("tip_speed", 0.0), ("tip_speed", np.nan)],
)  # fmt: skip
def test_settings_name_the_value_they_refuse(name, value):
    with pytest.raises(ValueError, match=name) as refusal:
        vf.Settings(**{name: value})
    assert repr(value) in str(refusal.value)


@pytest.mark.parametrize("radius", [0.0, -1e-3, np.nan, np.inf])
def test_fixtures_refuse_a_bad_radius(radius):
    with pytest.raises(ValueError, match=str(radius)):
        vf.MeshFixture(plate(), "certified", radius)


def test_fixtures_name_the_rules_they_know():
    with pytest.raises(ValueError, match=r"'safe'.*certified, paper, all, off"):
        vf.MeshFixture(plate(), "safe")
