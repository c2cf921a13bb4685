"""The limit on the speed of approach."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import robots
import vf
from tests.support.ticks import UM, plate, pose, psm_over

STANDOFF = 20 * UM


def over(surface: vf.Surface, approach: float | None, **options: float) -> vf.Controller:
    settings = vf.Settings(approach=approach, **options)
    return vf.Controller(robots.load("point"), [vf.MeshFixture(surface)], settings)


@pytest.mark.parametrize("rate", [5.0, 40.0, 300.0])
@pytest.mark.parametrize("dt", [1e-3, 1e-2])
def test_the_room_shrinks_by_no_more_than_its_share_of_a_tick(rate: float, dt: float) -> None:
    surface = plate()
    controller, free = over(surface, rate, dt=dt), over(surface, None, dt=dt)
    q = np.array([0.0, 0.0, 3e-3])
    share = min(rate * dt, 1.0)
    fell = 0
    for _ in range(120):
        room = surface.nearest(q)[0] - STANDOFF
        goal = pose(q + np.array([0.1e-3, 0.0, -2e-3]))
        step = controller.step(q, goal)
        sunk = q[2] - step.q[2]
        assert sunk <= share * room + 1e-12
        # As fast as it may, but for the micrometre that rows are tight by, and the arm's speed.
        reach = float(controller.arm.velocity[2]) * dt
        if room > 50 * UM and share * room < 0.5 * reach:
            assert sunk >= share * (room - 2 * UM)
            fell += 1
        # Along the wall it is not held back.
        assert step.q[0] >= free.step(q, goal).q[0] - 1e-8
        q = step.q
    assert fell > 3 or share == 1.0
    assert surface.nearest(q)[0] >= STANDOFF - 0.1 * UM


def test_none_is_no_limit_and_a_fast_one_is_none() -> None:
    surface, q = plate(), np.array([0.0, 0.0, 1e-3])
    none, fast = over(surface, None), over(surface, 1e5)
    for _ in range(20):
        goal = pose(q - np.array([0.0, 1e-4, 3e-3]))
        a, b = none.step(q, goal), fast.step(q, goal)
        assert (a.q == b.q).all()
        q = a.q


def test_a_tool_moves_away_as_fast_as_ever_and_yields_as_ever() -> None:
    surface, q = plate(), np.array([0.0, 0.0, 100e-6])
    slow, free = over(surface, 1.0), over(surface, None)
    goal = pose(q + np.array([0.0, 0.0, 1e-3]))
    assert np.abs(slow.step(q, goal).q - free.step(q, goal).q).max() < 1e-12
    rises = vf.Motion(pin.SE3.Identity(), pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.2e-3])))
    slow, free = over(surface, 1.0), over(surface, None)
    one, other = (c.step(q, pose(q), motions=[rises]) for c in (slow, free))
    assert one.status is other.status is vf.Status.SOLVED
    # It may use up a thousandth of the room of 80 µm that the wall has not taken.
    assert one.q[2] - q[2] == pytest.approx(0.2e-3, abs=2 * UM)
    assert other.q[2] - q[2] == pytest.approx(0.12e-3, abs=2 * UM)


def test_the_tip_of_an_arm_with_turning_joints_keeps_to_it() -> None:
    """But for the linearisation of a tick's step."""
    run, surface = psm_over("sphere")
    arm, q = run.arm, run.q
    controller = vf.Controller(arm, [vf.MeshFixture(surface)], vf.Settings(approach=30.0))
    goal = arm.tip(q)
    goal = pin.SE3(goal.rotation, goal.translation - [0.0, 0.0, 0.02])
    room = surface.nearest(arm.tip(q).translation)[0] - STANDOFF
    for _ in range(150):
        step = controller.step(q, goal)
        left = surface.nearest(step.tip.translation)[0] - STANDOFF
        if room < 4e-3:  # farther away the ball of 5 mm may have no plane
            assert room - left <= 0.03 * room + 0.2 * UM
        q, room = step.q, left
    assert room < 0.5e-3


@pytest.mark.parametrize("rate", [0.0, -1.0, np.nan, np.inf, "fast"])
def test_a_rate_of_no_use_is_refused(rate: object) -> None:
    with pytest.raises(ValueError, match=r"approach must be a number from 0\.001"):
        vf.Settings(approach=rate)  # type: ignore[arg-type]
