"""Margins of a motion: how far the tool stays from what is known to within a length."""

from __future__ import annotations

import pickle

import numpy as np
import pinocchio as pin
import pytest

import robots
import vf
from tests.support.ticks import UM, plate, pose
from vf import Status

STANDOFF = 20 * UM
HERE = pin.SE3.Identity()
MM = 1e-3


def height(step: vf.Step) -> float:
    """Above the plate, which is at z = 0 [m]."""
    return float(step.tip.translation[2])


@pytest.mark.parametrize("varied", [False, True])
def test_it_is_added_to_the_margins_of_the_fixture(varied: bool) -> None:
    surface = plate()
    own = np.full(len(surface.vertices), 0.3 * MM)
    if varied:
        own[surface.vertices[:, 0] > 0.5 * surface.vertices[:, 0].max()] = 0.8 * MM
    margin = own if varied else 0.3 * MM
    controller = vf.Controller(robots.load("point"), [vf.MeshFixture(surface, margin=margin)])
    nearest = surface.nearest(np.zeros(3))[1]
    there = float(own[surface.faces[nearest]].max())
    for added in (0.0, 0.7 * MM, 0.2 * MM):
        q = np.array([0.0, 0.0, 5 * MM])
        for _ in range(200):
            step = controller.step(q, pose([0.0, 0.0, -5 * MM]), [vf.Motion(HERE, HERE, added)])
            q = step.q
        assert height(step) == pytest.approx(STANDOFF + there + added, abs=3 * UM)
    # Without a motion, its margin is no longer there.
    for _ in range(200):
        step = controller.step(q, pose([0.0, 0.0, -5 * MM]))
        q = step.q
    assert height(step) == pytest.approx(STANDOFF + there, abs=3 * UM)


@pytest.mark.parametrize("speed", [5 * MM, 50 * MM])
def test_a_margin_that_grows_leads_the_tool_out_as_fast(speed: float) -> None:
    controller = vf.Controller(robots.load("point"), [vf.MeshFixture(plate())])
    q, margin, growth = np.array([0.0, 0.0, STANDOFF + 1 * UM]), 0.0, speed * 1e-3
    for _ in range(300):
        margin += growth
        motion = vf.Motion(HERE, HERE, margin, growth)
        step = controller.step(q, pose([0.0, 0.0, -5 * MM]), [motion])
        q = step.q
        assert height(step) >= STANDOFF + margin - 1 * UM
        assert height(step) <= STANDOFF + margin + 15 * UM
        assert step.status is not Status.OVERTAKEN


def test_a_tool_that_is_to_hold_is_led_out_too_and_along_with_the_structure() -> None:
    controller = vf.Controller(robots.load("point"), [vf.MeshFixture(plate())])
    q, T, margin = np.array([0.0, 0.0, STANDOFF]), HERE, 0.0
    for k in range(1, 200):
        after = pin.SE3(np.eye(3), np.array([0.0, 0.0, 30 * UM * k]))
        margin += 20 * UM
        motion = vf.Motion(T, after, margin, 20 * UM)
        step = controller.step(q, pose(q), [motion])
        q, T = step.q, after
        assert height(step) - after.translation[2] >= STANDOFF + margin - 1 * UM


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"margin": -1e-3}, "margin"),
        ({"margin": float("nan")}, "margin"),
        ({"margin": 1e9}, "margin"),
        ({"growth": -1e-9}, "growth"),
        ({"growth": "fast"}, "growth"),
    ],
)
def test_what_is_no_length_is_refused_by_name(options: dict[str, float], told: str) -> None:
    with pytest.raises(ValueError, match=told):
        vf.Motion(HERE, HERE, **options)


def test_two_motions_are_equal_with_equal_margins() -> None:
    one = vf.Motion(HERE, HERE, 1e-3, 1e-5)
    assert one == vf.Motion(HERE, HERE, 1e-3, 1e-5) == pickle.loads(pickle.dumps(one))
    assert one != vf.Motion(HERE, HERE, 1e-3)
    assert one != vf.Motion(HERE, HERE)
    assert hash(one) == hash(pickle.loads(pickle.dumps(one)))
