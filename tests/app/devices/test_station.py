"""An arm elsewhere, tick by tick: what moves it, holds it, brings it back."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import vf
from app.devices.crtk.state import State
from tests.support.headless import moved
from tests.support.wired import Make


def test_nothing_moves_the_arm_before_it_is_enabled(make: Make) -> None:
    bench = make()
    start = bench.q.copy()
    for _ in range(30):
        bench.goal(moved(bench.tool, dx=1e-3))
        bench.tick()
    bench.order("resume")
    bench.order("fly")
    assert bench.arm.sent == []
    np.testing.assert_array_equal(bench.q, start)
    assert bench.station.machine.state is State.DISABLED
    said = [one["Message"] for one in bench.master.named("warning")]
    assert "servo_cp is refused: the arm is DISABLED" in said
    assert "resume is not supported in state DISABLED" in said


def test_a_set_point_goes_to_an_enabled_arm_only_whoever_asks(make: Make) -> None:
    """Such as a tool that yields to a structure, which it does while it holds."""
    bench = make()
    bench.tick()
    bench.station.arm.servo(bench.q + 1e-5)
    assert bench.setpoints == []
    bench.order("enable")
    bench.station.arm.servo(bench.q + 1e-5)
    assert len(bench.setpoints) == 1
    bench.order("disable")
    bench.station.arm.servo(bench.q + 1e-5)
    assert len(bench.setpoints) == 1


def test_an_arm_that_is_not_heard_of_is_not_enabled(make: Make) -> None:
    bench = make()
    bench.tells = False
    bench.order("enable")
    assert bench.station.machine.state is State.DISABLED
    bench.tells = True
    bench.tick()
    bench.order("enable")
    assert bench.station.machine.state is State.ENABLED


def test_with_enable_the_arm_is_enabled_when_it_is_heard_of(make: Make) -> None:
    bench = make(enable=True)
    bench.tells = False
    bench.ticks(5)
    assert bench.station.machine.state is State.DISABLED
    bench.tells = True
    bench.ticks(2)
    assert bench.station.machine.state is State.ENABLED


def test_an_arm_is_joined_where_it_stands(make: Make) -> None:
    bench = make().enabled()
    there = bench.q.copy()
    assert np.abs(there - bench.orders.plant.q0).max() > 0.1
    bench.ticks(20)
    assert bench.setpoints == []  # holds, without a set-point
    assert bench.latest is not None
    assert bench.latest.step is not None
    np.testing.assert_allclose(
        bench.latest.step.tip.translation, bench.tool.translation, atol=1e-12
    )
    bench.follow(moved(bench.tool, dx=2e-3), 40)
    assert np.abs(np.diff([there, *bench.setpoints], axis=0)).max() < 0.02
    np.testing.assert_array_equal(bench.q, bench.setpoints[-1])


def test_a_goal_is_reached_from_the_measured_joints(make: Make) -> None:
    bench = make().enabled()
    bench.lag = 0.12
    goal = moved(bench.tool, dx=4e-3, dz=2e-3)
    for _ in range(200):
        before = bench.q.copy()
        bench.goal(goal)
        bench.tick()
        wanted = bench.orders.plant.controller.step(before, bench.latest.target).q
        # A point of the certified way, no faster than the arm's limits.
        way, went = wanted - before, bench.setpoints[-1] - before
        share = float(way @ went) / float(way @ way)
        assert 0.0 <= share <= 1.0 + 1e-9
        np.testing.assert_allclose(went, share * way, atol=1e-12)
    steps = np.abs(np.diff(bench.setpoints, axis=0)) / bench.model.velocity
    assert steps.max() <= 1e-3 * (1.0 + 1e-6)
    np.testing.assert_allclose(bench.tool.translation, goal.translation, atol=2e-5)


BAD = {
    "nan": lambda b: b.measured(Position=[math.nan, *b.q[1:].tolist()]),
    "null": lambda b: b.measured(Position=None),
    "denormal": lambda b: b.measured(Position=[*b.q[:5].tolist(), 4.67e-310]),
    "not valid": lambda b: b.measured(Valid=False),
    "count": lambda b: b.measured(Position=[*b.q.tolist(), 0.0]),
    "range": lambda b: b.measured(Position=[9.0, *b.q[1:].tolist()]),
    "jump": lambda b: b.measured(Position=(b.q + 0.3).tolist()),
    "time": lambda b: b.measured(Timestamp=b.stamp - 10.0),
    "frame": lambda b: b.measured(ReferenceFrame="ECM"),
}


@pytest.mark.parametrize("fault", BAD)
def test_a_bad_measurement_holds_that_tick_and_the_next_good_one_goes_on(
    make: Make, fault: str
) -> None:
    bench = make(arm="socket://h:1?frame=PSM1_base").enabled()
    goal = moved(bench.tool, dx=0.008)
    bench.follow(goal, 3)
    for _ in range(100):
        sent = len(bench.setpoints)
        bench.goal(goal)
        held = bench.tick(BAD[fault](bench))
        assert held.step is not None
        assert (held.step.status, held.target) == (vf.Status.HELD, None)
        assert len(bench.setpoints) == sent
        bench.follow(goal, 2)
        assert len(bench.setpoints) == sent + 2
    assert sum(bench.station.report.arm.refused.values()) >= 90
    assert bench.station.machine.state is State.ENABLED


def test_doubled_and_overtaken_measurements_are_ignored(make: Make) -> None:
    bench = make().enabled()
    bench.lag = 0.1
    goal = moved(bench.tool, dx=0.008)
    for k in range(100):
        bench.arm.put(bench.measured(Timestamp=bench.stamp, Position=(bench.q + 1e-3).tolist()))
        if k % 2:
            bench.arm.put(
                bench.measured(Timestamp=bench.stamp - 0.01, Position=(bench.q + 1e-3).tolist())
            )
        sent, before = len(bench.setpoints), bench.q.copy()
        bench.goal(goal)
        bench.tick()
        assert len(bench.setpoints) == sent + 1
        assert bench.latest.origin.isApprox(bench.model.tip(before), 1e-9)
    counts = bench.station.report.arm.refused
    assert counts["repeated"] > 80
    assert counts["overtaken by a newer one"] > 40


def test_a_silent_arm_is_held_and_joined_anew_when_it_comes_back(make: Make) -> None:
    bench = make().enabled()
    bench.follow(moved(bench.tool, dx=0.008), 3)
    bench.tells = False
    sent = len(bench.setpoints)
    bench.follow(moved(bench.tool, dx=0.008), 49)
    assert bench.station.holds == ""
    went = len(bench.setpoints)
    bench.follow(moved(bench.tool, dx=0.008), 152)  # longer than `age`, 50 ms
    assert len(bench.setpoints) - went <= 2
    assert went > sent
    assert bench.station.holds == "the arm is silent"
    bench.tells = True
    bench.q = bench.q + 0.02  # somebody moved it meanwhile
    bench.follow(moved(bench.tool, dx=0.03), 3)  # the old goal counts no more
    assert len(bench.setpoints) - went <= 2
    bench.follow(moved(bench.tool, dx=0.005), 3)
    assert len(bench.setpoints) >= went + 3


def test_an_arm_pushed_off_its_path_is_held_where_it_is_and_goes_on(make: Make) -> None:
    bench = make().enabled()
    bench.lag = 0.1
    goal = moved(bench.tool, dx=0.008)
    bench.follow(goal, 10)
    assert bench.station.holds == ""
    for k in range(100):
        aside = bench.q.copy()
        aside[1] += 0.025 * (-1) ** k  # 3 mm, to the side where it did not come from
        bench.q = aside
        sent = len(bench.setpoints)
        bench.clock.now += 0.02  # so fast it may be
        bench.stamp += 0.02
        bench.goal(goal)
        held = bench.tick()
        assert held.target is None
        (stay,) = bench.setpoints[sent:]
        np.testing.assert_array_equal(stay, aside)
        bench.follow(goal, 30)
        assert len(bench.setpoints) > sent + 25
    assert bench.station.machine.state is State.ENABLED


def test_an_arm_far_off_its_path_is_a_fault_until_it_is_disabled_and_enabled(make: Make) -> None:
    bench = make().enabled()
    goal = moved(bench.tool, dx=0.008)
    for _ in range(100):
        bench.follow(moved(bench.tool, dx=1e-3), 3)
        bench.q = bench.q.copy()
        bench.q[1] += -0.12 if bench.q[1] > 0 else 0.12
        bench.clock.now += 0.04
        bench.stamp += 0.04
        bench.tick()
        bench.tick()
        assert bench.station.machine.state is State.FAULT
        sent = len(bench.setpoints)
        bench.follow(goal, 3)
        bench.order("enable")
        assert bench.station.machine.state is State.FAULT
        assert len(bench.setpoints) == sent
        bench.order("disable")
        bench.order("enable")
        assert bench.station.machine.state is State.ENABLED
        bench.follow(moved(bench.tool, dx=1e-3), 2)
        assert len(bench.setpoints) == sent + 2
    assert "mm off the certified path" in bench.master.named("error")[0]["Message"]


@pytest.mark.parametrize("word", ["DISABLED", "FAULT", "PAUSED"])
def test_an_arm_that_says_it_cannot_move_is_not_moved(make: Make, word: str) -> None:
    bench = make().enabled()
    bench.follow(moved(bench.tool, dx=1e-3), 3)
    bench.arm.put({"operating_state": {"State": word, "IsHomed": True, "IsBusy": False}})
    sent = len(bench.setpoints)
    bench.follow(moved(bench.tool, dx=1e-3), 5)
    assert len(bench.setpoints) == sent
    expected = State.FAULT if word == "FAULT" else State.DISABLED
    assert bench.station.machine.state is expected
    bench.order("disable")
    bench.order("enable")
    assert bench.station.machine.state is State.DISABLED
    assert "enable" in bench.arm.named("state_command")  # it was asked to
    bench.arm.put({"operating_state": {"State": 2, "IsHomed": True, "IsBusy": False}})
    bench.order("enable")
    assert bench.station.machine.state is State.ENABLED


def test_an_arm_that_is_not_homed_is_not_moved(make: Make) -> None:
    bench = make().enabled()
    bench.arm.put({"operating_state": {"State": "ENABLED", "IsHomed": False, "IsBusy": False}})
    bench.follow(moved(bench.tool, dx=1e-3), 5)
    assert bench.setpoints == []
    assert bench.station.holds == "the arm is not homed"
    bench.arm.put({"operating_state": {"State": "ENABLED", "IsHomed": True, "IsBusy": False}})
    bench.follow(moved(bench.tool, dx=1e-3), 5)
    assert len(bench.setpoints) >= 4


def test_a_guarded_arm_stays_out_whatever_is_asked(make: Make) -> None:
    bench = make().enabled()
    bench.lag = 0.15
    start = bench.tool
    surface = bench.orders.plant.surface
    gaps = []
    for k in range(900):
        bench.goal(moved(start, dx=0.01 * math.sin(0.02 * k), dz=-1e-4 * k))
        bench.tick()
        gaps.append(surface.nearest(bench.tool.translation)[0])
        assert not surface.inside(bench.tool.translation)
    assert min(gaps) > 0.9e-4
    assert min(gaps) < 3e-4  # it did come there
    forces = np.array(bench.master.named("body/servo_cf")[-1]["Force"])
    assert np.linalg.norm(forces) > 0.5


def test_a_reset_of_the_page_does_not_move_a_real_arm(make: Make) -> None:
    bench = make().enabled()
    bench.ticks(3)
    there = bench.q.copy()
    bench.orders = replace(bench.orders, resets=1)
    bench.ticks(5)
    assert bench.setpoints == []
    np.testing.assert_array_equal(bench.q, there)
    assert bench.station.report.arm.refused == {"farther than a tick may go": 1} or (
        bench.station._remote is not None
        and bench.station._remote.border.counts["farther than a tick may go"] == 1
    )


def test_an_error_in_the_code_of_the_devices_holds_and_is_logged_once(
    make: Make, caplog: pytest.LogCaptureFixture
) -> None:
    bench = make().enabled()
    goal = moved(bench.tool, dx=0.008)
    bench.follow(goal, 2)
    good = bench.arm.receive
    bench.arm.receive = lambda now: 1 / 0  # type: ignore[method-assign, assignment]
    sent = len(bench.setpoints)
    for _ in range(5):
        held = bench.tick()
        assert held.target is None
    assert len(bench.setpoints) == sent
    assert len([r for r in caplog.records if r.exc_info]) == 1
    bench.arm.receive = good  # type: ignore[method-assign]
    bench.follow(moved(bench.tool, dx=1e-3), 2)
    assert len(bench.setpoints) == sent + 2
