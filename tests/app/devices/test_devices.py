"""Devices: an arm that is elsewhere than it was sent, or silent; the page's master."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import vf
from app.control.engine import Engine, Orders, Plant
from app.control.messages import Command, LoopStats
from app.devices import protocols
from app.devices.page import FARTHEST_PROXY, PageMaster, checked_pose
from app.devices.simulated import SimulatedArm
from app.scene import scene as scenes
from app.scene.scene import Scene
from app.settings import Options
from app.words import Refused
from tests.support.headless import moved

OPTIONS = Options(mesh="cube", robot="point")
STATS = LoopStats()


@pytest.fixture(scope="module")
def scene() -> Scene:
    return scenes.build(OPTIONS, 1)


@pytest.fixture
def plant(scene: Scene) -> Plant:
    return scenes.plant(scene, OPTIONS)


class Lagging:
    """An arm that goes half of the way to its set-point in a tick; `silent`: it is not heard of."""

    def __init__(self, q: np.ndarray) -> None:
        self.q = np.array(q)
        self.sent: list[np.ndarray] = []
        self.silent = False

    def measured(self) -> np.ndarray | None:
        return None if self.silent else self.q

    def servo(self, q: np.ndarray) -> None:
        self.sent.append(q)
        self.q = 0.5 * (self.q + q)


def test_each_tick_starts_from_the_measured_joints(plant: Plant, scene: Scene) -> None:
    goal = moved(scene.T_base_start, dx=0.004, dz=0.003)
    arm = Lagging(plant.q0)
    orders = Orders(plant, Command(goal, 1))
    engine = Engine(orders, arm=arm)
    for _ in range(30):
        before = arm.q
        telemetry, _ = engine.advance(orders, STATS)
        expected = plant.controller.step(before, goal)
        np.testing.assert_array_equal(arm.sent[-1], expected.q)
        np.testing.assert_array_equal(telemetry.q, expected.q)
        assert telemetry.origin.isApprox(plant.arm.tip(before), 1e-15)
        assert np.abs(arm.q - expected.q).max() > 0.0
    for _ in range(300):
        engine.advance(orders, STATS)
    np.testing.assert_allclose(plant.arm.tip(arm.q).translation, goal.translation, atol=1e-6)


def test_the_simulated_arm_is_where_it_was_sent(plant: Plant, scene: Scene) -> None:
    goal = moved(scene.T_base_start, dx=0.004)
    orders = Orders(plant, Command(goal, 1))
    arm = SimulatedArm(plant.q0)
    engine = Engine(orders, arm=arm)
    for _ in range(20):
        telemetry, _ = engine.advance(orders, STATS)
        assert arm.measured() is telemetry.q
    assert np.abs(telemetry.q - plant.q0).max() > 0.0


def test_the_tool_holds_while_the_arm_is_silent_and_goes_on_from_where_it_then_is(
    plant: Plant, scene: Scene
) -> None:
    goal = moved(scene.T_base_start, dx=0.05)
    arm = Lagging(plant.q0)
    orders = Orders(plant, Command(goal, 1))
    engine = Engine(orders, arm=arm)
    engine.advance(orders, STATS)
    sent, arm.silent = len(arm.sent), True
    for _ in range(5):
        telemetry, ticked = engine.advance(orders, STATS)
        assert ticked
        assert telemetry.step is not None
        assert telemetry.step.status is vf.Status.HELD
        np.testing.assert_array_equal(telemetry.step.force, 0.0)
    assert len(arm.sent) == sent
    arm.silent, arm.q = False, arm.q + 1e-4
    before = arm.q
    engine.advance(orders, STATS)
    np.testing.assert_array_equal(arm.sent[-1], plant.controller.step(before, goal).q)


def test_joints_of_another_arm_are_no_measurement(plant: Plant, scene: Scene) -> None:
    arm = Lagging(np.zeros(len(plant.q0) + 1))
    orders = Orders(plant, Command(scene.T_base_start, 1))
    telemetry, _ = Engine(orders, arm=arm).advance(orders, STATS)
    assert telemetry.step is not None
    assert telemetry.step.status is vf.Status.HELD
    assert arm.sent == []


def test_a_reset_sends_the_arm_to_the_start(plant: Plant, scene: Scene) -> None:
    orders = Orders(plant, Command(moved(scene.T_base_start, dx=0.05), 1))
    arm = SimulatedArm(plant.q0)
    engine = Engine(orders, arm=arm)
    for _ in range(20):
        engine.advance(orders, STATS)
    assert np.abs(arm.measured() - plant.q0).max() > 0.0
    engine.advance(replace(orders, command=Command(None, 2), resets=1), STATS)
    np.testing.assert_array_equal(arm.measured(), plant.q0)


def test_the_master_says_what_was_done_with_it() -> None:
    start = pin.SE3.Identity()
    master = PageMaster(start, scale=0.5, locked=False)
    device: protocols.Master = master
    assert (device.clutched, device.held, master.target) == (False, False, None)
    master.move(moved(start, dx=0.02), held=True)
    said = master.command(3)
    assert (said.sequence, said.held, said.clutch) == (3, True, False)
    np.testing.assert_allclose(said.target.translation, [0.01, 0.0, 0.0], atol=1e-15)
    # Pressed: the handle moves alone. Released: it stands for the tool from then on.
    tool = moved(start, dy=0.003)
    master.clutch(True, tool)
    assert not master.held
    master.move(moved(start, dx=0.04), held=True)
    np.testing.assert_allclose(master.command(4).target.translation, said.target.translation)
    assert master.command(4).clutch
    master.clutch(False, tool)
    np.testing.assert_allclose(master.target.translation, tool.translation, atol=1e-15)
    master.move(moved(start, dx=0.05), held=False)
    np.testing.assert_allclose(master.target.translation, [0.005, 0.003, 0.0], atol=1e-15)
    # Another scale does not move the proxy, but what comes after it.
    master.remap(1.0, False)
    master.move(moved(start, dx=0.06), held=False)
    np.testing.assert_allclose(master.target.translation, [0.015, 0.003, 0.0], atol=1e-15)
    device.feel(np.array([0.0, 0.0, 1.0]))
    assert master.force.tolist() == [0.0, 0.0, 1.0]
    master.hold()
    assert master.command(5).target is None


def test_what_is_refused_moves_nothing() -> None:
    start = pin.SE3.Identity()
    master = PageMaster(start, scale=2.0, locked=False)
    master.move(moved(start, dx=0.1), held=True)
    handle, target = master.handle, master.target
    mirrored = pin.SE3(np.diag([1.0, 1.0, -1.0]), np.zeros(3))
    near_but_scaled = moved(start, dx=0.6 * FARTHEST_PROXY)
    for pose in (mirrored, near_but_scaled, moved(start, dz=np.nan)):
        with pytest.raises(Refused):
            master.move(pose, held=False)
        assert (master.handle, master.target, master.held) == (handle, target, True)
    assert checked_pose(near_but_scaled).isApprox(near_but_scaled)
