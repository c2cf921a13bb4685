"""Moves that the guard makes by itself, goals it interpolates between, and all of them guarded."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import robots
from app.devices.crtk.motions import Motions
from app.devices.spec import move_time
from app.scene import scene as scenes
from app.scene.scene import Scene
from tests.support.headless import moved
from tests.support.wired import AWAY, Bench

Make = Callable[..., Bench]
PSM = robots.load("psm")


@pytest.fixture(scope="module")
def scene() -> Scene:
    return scenes.build(AWAY, 1)


@pytest.fixture
def make(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> Make:
    return lambda **changes: Bench(scene, replace(AWAY, **changes), monkeypatch)


def busy(bench: Bench) -> bool:
    return bool(bench.master.named("operating_state")[-1]["IsBusy"])


def test_a_move_goes_straight_from_rest_to_rest_in_its_time() -> None:
    motions = Motions(PSM, move_time)
    start = PSM.tip(PSM.neutral)
    end = pin.SE3(start.rotation @ pin.exp3(np.array([0.1, 0.2, 0.0])),
                  start.translation + np.array([0.02, -0.01, 0.005]))  # fmt: skip
    motions.move(start, end, 10.0)
    takes = move_time(start, end)
    assert takes == pytest.approx(15 / 8 * max(np.sqrt(5.25e-4) / 0.05, np.sqrt(0.05) / 0.5))
    times = 10.0 + np.linspace(0.0, takes, 401)
    poses = [motions.target(t) for t in times]
    way = np.array([p.translation - start.translation for p in poses])
    along = way @ (end.translation - start.translation) / np.linalg.norm(way[-1]) ** 2
    np.testing.assert_allclose(way, along[:, None] * way[-1], atol=1e-15)
    speed = np.diff(along)
    assert (speed >= 0).all()
    assert speed[0] < 0.01 * speed.max()
    assert speed[-1] < 0.01 * speed.max()
    assert poses[-1].isApprox(end, 1e-12)
    assert motions.busy(10.0 + 0.99 * takes)
    assert not motions.busy(10.0 + 1.01 * takes)
    assert motions.target(99.0).isApprox(end, 1e-12)


def test_a_move_of_joints_keeps_to_their_speeds() -> None:
    motions = Motions(PSM, move_time)
    goal = PSM.neutral + np.array([0.3, -0.2, 0.01, 1.0, 0.5, -0.5])
    motions.move_joints(goal, PSM.neutral, 0.0)
    times = np.arange(0.0, 20.0, 1e-2)
    poses = [motions.target(t) for t in times]
    assert poses[-1].isApprox(PSM.tip(goal), 1e-12)
    tips = np.array([p.translation for p in poses])
    assert np.linalg.norm(np.diff(tips, axis=0), axis=1).max() < 0.05 * 1e-2 * 15 / 8 * 2


def test_a_move_is_made_and_is_busy_until_it_is(make: Make) -> None:
    bench = make().enabled()
    bench.lag = 0.2
    end = moved(bench.tool, dx=0.01, dz=0.005)
    bench.goal(end, "move_cp")
    bench.ticks(20)
    assert busy(bench)
    bench.ticks(450)
    assert not busy(bench)
    bench.ticks(100)
    np.testing.assert_allclose(bench.tool.translation, end.translation, atol=2e-5)
    # The jump that a stream of goals may not make is none for a move.
    goal = bench.q + np.array([0.2, 0.0, 0.0, 0.5, 0.0, 0.0])
    bench.master.put({"move_jp": {"Goal": goal.tolist()}})
    bench.ticks(3000)
    np.testing.assert_allclose(bench.tool.translation, bench.model.tip(goal).translation, atol=2e-5)


def test_a_move_into_the_anatomy_ends_at_it(make: Make) -> None:
    bench = make().enabled()
    bench.lag = 0.2
    surface = bench.orders.plant.surface
    bench.goal(moved(bench.tool, dz=-0.08), "move_cp")
    for _ in range(3500):
        bench.tick()
        assert not surface.inside(bench.tool.translation)
    assert not busy(bench)
    assert 0.9e-4 < surface.nearest(bench.tool.translation)[0] < 3e-4


def test_hold_ends_a_move_and_goals_preempt_it(make: Make) -> None:
    bench = make().enabled()
    bench.lag = 0.5
    bench.goal(moved(bench.tool, dx=0.05), "move_cp")
    bench.ticks(100)
    bench.master.put({"hold": ""})
    bench.tick()
    bench.ticks(20)
    there = bench.tool
    bench.ticks(100)
    np.testing.assert_allclose(bench.tool.translation, there.translation, atol=1e-12)
    assert not busy(bench)
    bench.goal(moved(bench.tool, dx=0.05), "move_cp")
    bench.ticks(100)
    goal = moved(bench.tool, dy=1e-3)
    bench.follow(goal, 100)
    np.testing.assert_allclose(bench.tool.translation, goal.translation, atol=2e-5)


def test_a_move_is_refused_while_disabled_and_lost_when_disabled(make: Make) -> None:
    bench = make()
    bench.tick()
    bench.goal(moved(bench.tool, dx=0.01), "move_cp")
    bench.ticks(10)
    bench.order("enable")
    bench.ticks(50)
    assert bench.setpoints == []
    bench.goal(moved(bench.tool, dx=0.05), "move_cp")
    bench.ticks(50)
    bench.order("disable")
    bench.order("enable")
    sent = len(bench.setpoints)
    bench.ticks(50)
    assert len(bench.setpoints) == sent


def test_goals_at_50_Hz_are_interpolated(make: Make) -> None:
    bench = make().enabled()
    bench.lag = 0.9
    start = bench.tool
    xs = []
    for k in range(1000):
        if k % 20 == 0:
            bench.goal(moved(start, dx=2e-5 * k), "interpolate_cp")
        bench.tick()
        xs.append(bench.tool.translation[0])
    steps = np.diff(xs)[200:]
    # 20 µm a tick, without the stops and starts of goals that are 0.4 mm apart.
    assert steps.min() > 1e-5
    assert steps.max() < 3e-5
    assert start.translation[0] + 2e-5 * 1000 - xs[-1] < 1e-3
    bench.ticks(400)
    assert bench.station.holds in ("the master is silent", "no motion is commanded")


def test_an_arm_is_let_go_of_with_a_warning(make: Make) -> None:
    bench = make().enabled()
    bench.follow(moved(bench.tool, dx=0.005), 3)
    sent = len(bench.setpoints)
    bench.master.put({"free": ""})
    bench.ticks(20)
    assert bench.arm.named("free") == [""]
    assert len(bench.setpoints) == sent
    assert any("not guarded" in one["Message"] for one in bench.master.named("warning"))


@pytest.mark.parametrize("name", ["servo_cf", "body/servo_cf", "servo_jv"])
def test_what_cannot_be_guarded_is_refused(make: Make, name: str) -> None:
    bench = make().enabled()
    bench.master.put({name: {"Force": [1.0] * 6}})
    bench.ticks(2)
    assert bench.setpoints == []
    assert name in bench.master.named("warning")[0]["Message"]
