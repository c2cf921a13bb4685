"""A master elsewhere, tick by tick: goals that are followed, refused, late, and what it hears."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from app.control.messages import Command
from app.devices.crtk.state import State
from tests.support.headless import moved
from tests.support.wired import Make


def test_the_first_goal_is_near_the_tool_or_refused(make: Make) -> None:
    bench = make().enabled()
    bench.follow(moved(bench.tool, dx=0.02), 5)
    turned = pin.SE3(bench.tool.rotation @ pin.exp3(np.array([0.0, 0.5, 0.0])),
                     bench.tool.translation)  # fmt: skip
    bench.follow(turned, 5)
    assert bench.setpoints == []
    assert "the first goal is 20 mm from the tool" in str(bench.master.named("warning"))
    bench.follow(moved(bench.tool, dx=0.008), 5)
    assert len(bench.setpoints) == 5


GOALS = {
    "nan": {"Goal": {"Rotation": np.eye(3).tolist(), "Translation": [math.nan, 0.0, 0.0]}},
    "null": {"Goal": None},
    "rotation": {"Goal": {"Rotation": (2 * np.eye(3)).tolist(), "Translation": [0.0] * 3}},
    "mirror": {"Goal": {"Rotation": np.diag([1.0, 1, -1]).tolist(), "Translation": [0.0] * 3}},
    "far": {"Goal": {"Rotation": np.eye(3).tolist(), "Translation": [9.0, 0.0, 0.0]}},
    "jump": {"Goal": {"Rotation": np.eye(3).tolist(), "Translation": [0.3, 0.0, 0.0]}},
}


@pytest.mark.parametrize("fault", GOALS)
def test_a_bad_goal_holds_that_tick(make: Make, fault: str) -> None:
    bench = make().enabled()
    goal = moved(bench.tool, dx=0.008)
    bench.follow(goal, 3)
    for _ in range(100):
        sent = len(bench.setpoints)
        bench.master.put({"servo_cp": GOALS[fault]})
        bench.tick()
        assert len(bench.setpoints) == sent
        bench.follow(goal, 2)
        assert len(bench.setpoints) == sent + 2


def test_goals_in_another_frame_or_from_the_past_hold(make: Make) -> None:
    bench = make(master="socket://h:2?frame=base").enabled()
    goal = moved(bench.tool, dx=0.008)
    bench.follow(goal, 3, ReferenceFrame="base", Timestamp=50.0)
    sent = len(bench.setpoints)
    bench.goal(goal, ReferenceFrame="ECM", Timestamp=51.0)
    bench.tick()
    bench.goal(goal, ReferenceFrame="base", Timestamp=40.0)
    bench.tick()
    assert len(bench.setpoints) == sent
    bench.goal(goal, ReferenceFrame="base", Timestamp=52.0)
    bench.tick()
    assert len(bench.setpoints) == sent + 1


def test_a_silent_console_holds_the_tool(make: Make) -> None:
    bench = make().enabled()
    bench.follow(moved(bench.tool, dx=0.009), 1)
    bench.ticks(49)
    assert len(bench.setpoints) >= 49
    bench.ticks(3)
    sent = len(bench.setpoints)
    bench.ticks(100)
    assert len(bench.setpoints) == sent
    assert bench.station.holds in ("the master is silent", "no motion is commanded")


def test_joint_goals_are_guarded_as_the_poses_they_give(make: Make) -> None:
    bench = make().enabled()
    goal = bench.q + np.array([0.01, 0.0, 0.0, 0.05, 0.0, 0.0])
    for _ in range(60):
        bench.master.put({"servo_jp": {"Goal": goal.tolist()}})
        bench.tick()
    np.testing.assert_allclose(bench.q, goal, atol=1e-4)


def test_a_hand_is_latched_where_the_tool_stands(make: Make) -> None:
    bench = make(scale=0.5)
    bench.orders = replace(bench.orders, scale=0.5)
    bench.enabled()
    hand = pin.SE3(pin.exp3(np.array([0.4, 0.3, -1.0])), np.array([0.5, -0.2, 0.7]))

    def hold(pose: pin.SE3, ticks: int = 1) -> None:
        for _ in range(ticks):
            bench.master.put({
                "measured_cp": {
                    "Position": {"Rotation": pose.rotation.tolist(),
                                 "Translation": pose.translation.tolist()},
                    "Valid": True, "Timestamp": bench.stamp,
                }
            })  # fmt: skip
            bench.tick()

    start = bench.tool
    hold(hand, 5)
    np.testing.assert_allclose(bench.tool.homogeneous, start.homogeneous, atol=1e-9)
    hold(moved(hand, dx=0.004), 80)
    np.testing.assert_allclose(
        bench.tool.translation, moved(start, dx=0.002).translation, atol=1e-6
    )
    # Clutched, the hand moves alone; released, it is latched again.
    bench.master.put({"clutch": {"Type": "PRESSED"}})
    there = bench.tool
    sent = len(bench.setpoints)
    away = hand
    for _ in range(100):
        away = moved(away, dx=-1e-3)
        hold(away)
    assert len(bench.setpoints) <= sent + 1
    assert bench.station.holds == "the clutch is pressed"
    assert np.allclose(bench.master.named("body/servo_cf")[-1]["Force"], 0.0)
    bench.master.put({"clutch": {"Type": "RELEASED"}})
    hold(away, 20)
    np.testing.assert_allclose(bench.tool.homogeneous, there.homogeneous, atol=1e-6)
    # Silent, and back elsewhere: latched again as well.
    bench.ticks(300)
    hold(moved(away, dy=0.4), 20)
    np.testing.assert_allclose(bench.tool.homogeneous, there.homogeneous, atol=1e-6)
    # A jump is not followed either.
    hold(moved(away, dy=0.1), 20)
    hold(moved(away, dy=0.1), 200)
    np.testing.assert_allclose(bench.tool.homogeneous, there.homogeneous, atol=1e-6)


def test_the_jaw_is_passed_on_and_its_bad_values_are_not(make: Make) -> None:
    bench = make()
    bench.tick()
    bench.master.put({"jaw/servo_jp": {"Goal": [0.3]}})
    bench.tick()
    assert bench.arm.sent == []
    bench.order("enable")
    for goal in ([0.3], [math.nan], [0.1, 0.2], [9.0], None):
        bench.master.put({"jaw/servo_jp": {"Goal": goal}})
        bench.tick()
    assert bench.arm.named("jaw/servo_jp") == [{"Goal": [0.3]}]
    bench.arm.put({"jaw/measured_js": {"Position": [0.2], "Valid": True}})
    bench.tick()
    assert bench.master.named("jaw/measured_js")[0]["Position"] == [0.2]


def test_hold_stops_and_pause_stops_until_resume(make: Make) -> None:
    bench = make().enabled()
    goal = moved(bench.tool, dx=0.009)
    bench.follow(goal, 2)
    bench.master.put({"hold": ""})
    bench.tick()
    sent = len(bench.setpoints)
    bench.ticks(10)
    assert len(bench.setpoints) == sent
    bench.master.put({"state_command": "pause"})
    bench.follow(goal, 5)
    assert bench.station.machine.state is State.PAUSED
    assert len(bench.setpoints) == sent
    bench.master.put({"state_command": {"Data": "resume"}})
    bench.follow(moved(bench.tool, dx=1e-3), 5)
    assert len(bench.setpoints) >= sent + 4


def test_the_page_as_master_moves_the_arm_only_while_it_is_enabled(make: Make) -> None:
    bench = make(master="page")
    bench.tick()

    def drag(n: int) -> None:
        for _ in range(n):
            sequence = bench.orders.command.sequence + 1
            goal = moved(bench.tool, dx=2e-3)
            bench.orders = replace(bench.orders, command=Command(goal, sequence, held=True))
            bench.tick()

    drag(5)
    assert bench.setpoints == []
    bench.order("enable")
    drag(5)
    assert len(bench.setpoints) >= 5
    bench.order("disable")
    sent = len(bench.setpoints)
    drag(5)
    assert len(bench.setpoints) == sent


def test_a_delayed_page_is_obeyed_later(make: Make) -> None:
    bench = make(arm="sim", master="page", delay=0.08)
    assert bench.station.machine.state is State.DISABLED
    goal = moved(bench.orders.plant.arm.tip(bench.orders.plant.q0), dx=0.03)
    bench.orders = replace(bench.orders, command=Command(goal, 1, held=True))
    bench.tells = False

    def quiet() -> Any:
        bench.clock.now += 1e-3
        orders = bench.station.before(bench.orders, bench.latest)
        bench.latest, _ = bench.engine.advance(orders, None)
        return bench.latest

    targets = [quiet().target is not None for _ in range(100)]
    assert targets.index(True) in (80, 81)


def test_the_console_hears_an_arm(make: Make) -> None:
    bench = make().enabled()
    bench.follow(moved(bench.tool, dx=1e-3), 1200)
    names = {name for name, _ in bench.master.sent}
    assert names >= {
        "operating_state", "measured_js", "measured_cp", "measured_cv", "setpoint_js",
        "setpoint_cp", "period_statistics", "body/servo_cf", "warning", "status",
    } - {"warning"}  # fmt: skip
    assert bench.master.named("operating_state")[-1]["State"] == "ENABLED"
    told = bench.master.named("measured_js")[-1]
    np.testing.assert_allclose(told["Position"], bench.q, atol=1e-6)
    cp = bench.master.named("measured_cp")[-1]["Position"]
    beyond = np.array(cp["Rotation"]) @ [0.0, 0.0, 0.0102]
    np.testing.assert_allclose(cp["Translation"] + beyond, bench.tool.translation, atol=1e-6)
    bench.tells = False
    bench.ticks(60)
    assert bench.master.named("measured_js")[-1]["Valid"] is False
    assert bench.master.named("measured_js")[-1]["Timestamp"] == 0.0
