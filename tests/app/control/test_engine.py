"""The tick-by-tick engine, without thread: holding, pausing, staleness, failures, new plants."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest

import vf
from app.control.engine import Engine, Orders, Plant
from app.control.messages import Command, LoopStats
from app.scene import scene as scenes
from app.scene.scene import Scene
from app.settings import Options
from tests.support.headless import moved

OPTIONS = Options(mesh="cube", robot="point")
STATS = LoopStats()


@pytest.fixture(scope="module")
def scene() -> Scene:
    return scenes.build(OPTIONS, 1)


@pytest.fixture
def plant(scene: Scene) -> Plant:
    return scenes.plant(scene, OPTIONS)


def test_without_a_command_the_tool_holds_and_looks(plant: Plant) -> None:
    orders = Orders(plant, Command(None, 0))
    engine = Engine(orders)
    for tick in range(1, 4):
        telemetry, ticked = engine.advance(orders, STATS)
        assert ticked
        assert telemetry.tick == tick
        assert telemetry.time == pytest.approx(tick * 1e-3)
        np.testing.assert_array_equal(telemetry.q, plant.q0)
        assert telemetry.target is None
        assert telemetry.step is not None
        np.testing.assert_array_equal(telemetry.step.force, 0.0)


def test_the_tool_follows_a_free_target_and_stays_there(plant: Plant, scene: Scene) -> None:
    goal = moved(scene.T_base_start, dx=0.004, dz=0.003)
    orders = Orders(plant, Command(goal, 1))
    engine = Engine(orders)
    for _ in range(200):
        telemetry, _ = engine.advance(orders, STATS)
    np.testing.assert_allclose(plant.arm.tip(telemetry.q).translation, goal.translation, atol=1e-6)


def test_a_clutched_tool_holds_without_force(plant: Plant, scene: Scene) -> None:
    goal = moved(scene.T_base_start, dx=0.05)
    engine = Engine(Orders(plant, Command(goal, 1)))
    moving, _ = engine.advance(Orders(plant, Command(goal, 1)), STATS)
    held, _ = engine.advance(Orders(plant, Command(goal, 2, clutch=True)), STATS)
    assert np.abs(moving.q - plant.q0).max() > 0
    assert moving.step is not None
    assert np.linalg.norm(moving.step.force) > 0
    np.testing.assert_array_equal(held.q, moving.q)
    assert held.step is not None
    np.testing.assert_array_equal(held.step.force, 0.0)


def test_a_silent_drag_goes_stale_after_its_time_and_a_new_command_wakes_it(
    plant: Plant, scene: Scene
) -> None:
    plant = replace(plant, stale_after=0.05)
    far = moved(scene.T_base_start, dz=0.2)  # 1 s of free way up at 0.2 m/s
    orders = Orders(plant, Command(far, 1, held=True))
    engine = Engine(Orders(plant, Command(None, 0)))
    seen = [engine.advance(orders, STATS)[0] for _ in range(100)]
    stale = [t.stale for t in seen]
    assert stale.index(True) == 51  # the 50 ms after the tick the command came with are over
    assert all(stale[51:])
    steps = np.array([np.abs(b.q - a.q).max() for a, b in pairwise(seen)])
    assert (steps[:50] > 0).all()
    assert (steps[50:] == 0).all()
    assert {t.step.status for t in seen[51:] if t.step} == {vf.Status.HELD}
    woken, _ = engine.advance(Orders(plant, Command(far, 2, held=True)), STATS)
    assert not woken.stale
    assert np.abs(woken.q - seen[-1].q).max() > 0


def test_a_proxy_that_was_let_go_never_goes_stale(plant: Plant, scene: Scene) -> None:
    plant = replace(plant, stale_after=0.05)
    orders = Orders(plant, Command(moved(scene.T_base_start, dz=0.2), 1, held=False))
    engine = Engine(orders)
    assert not any(engine.advance(orders, STATS)[0].stale for _ in range(200))


def test_pause_moves_nothing_and_a_single_step_is_one_tick(plant: Plant, scene: Scene) -> None:
    run = Orders(plant, Command(moved(scene.T_base_start, dx=0.1), 1))
    engine = Engine(run)
    before, _ = engine.advance(run, STATS)
    paused = replace(run, paused=True)
    for _ in range(5):
        telemetry, ticked = engine.advance(paused, STATS)
        assert not ticked
        assert telemetry.paused
        assert telemetry.tick == before.tick
        assert telemetry.q is before.q
    one = replace(paused, steps=1)
    results = [engine.advance(one, STATS) for _ in range(4)]
    assert [ticked for _, ticked in results] == [True, False, False, False]
    assert results[-1][0].tick == before.tick + 1
    assert np.abs(results[-1][0].q - before.q).max() > 0
    # Steps asked for while running are not saved up for the next pause.
    engine.advance(replace(run, steps=9), STATS)
    assert not engine.advance(replace(paused, steps=9), STATS)[1]


def test_reset_goes_back_to_the_start(plant: Plant, scene: Scene) -> None:
    run = Orders(plant, Command(moved(scene.T_base_start, dx=0.1), 1))
    engine = Engine(run)
    for _ in range(20):
        telemetry, _ = engine.advance(run, STATS)
    assert np.abs(telemetry.q - plant.q0).max() > 1e-3
    telemetry, _ = engine.advance(Orders(plant, Command(None, 2), resets=1), STATS)
    np.testing.assert_array_equal(telemetry.q, plant.q0)
    assert telemetry.tick == 21


def test_a_reset_while_paused_is_seen_at_once(plant: Plant, scene: Scene) -> None:
    run = Orders(plant, Command(moved(scene.T_base_start, dx=0.1), 1))
    engine = Engine(run)
    for _ in range(20):
        engine.advance(run, STATS)
    telemetry, ticked = engine.advance(Orders(plant, Command(None, 2), True, resets=1), STATS)
    assert not ticked
    np.testing.assert_array_equal(telemetry.q, plant.q0)
    assert telemetry.step is not None
    assert telemetry.step.tip.isApprox(scene.T_base_start, 1e-12)


class Broken:
    """A controller that must not exist: it raises."""

    def step(self, q: np.ndarray, target: pin.SE3) -> vf.Step:
        raise RuntimeError("this controller is broken")


def test_a_controller_that_raises_is_a_held_tick_logged_once(
    plant: Plant, scene: Scene, caplog: pytest.LogCaptureFixture
) -> None:
    run = Orders(plant, Command(moved(scene.T_base_start, dx=0.1), 1))
    engine = Engine(run)
    good, _ = engine.advance(run, STATS)
    broken = replace(run, plant=replace(plant, controller=Broken()))
    for k in range(5):
        held, ticked = engine.advance(broken, STATS)
        assert ticked
        assert held.tick == good.tick + 1 + k
        assert held.q is good.q
        assert held.step is not None
        assert held.step.status is vf.Status.HELD
        np.testing.assert_array_equal(held.step.force, 0.0)
    assert engine.failures == 5
    assert len([r for r in caplog.records if r.levelname == "ERROR"]) == 1
    back, _ = engine.advance(run, STATS)
    assert np.abs(back.q - good.q).max() > 0


def test_a_new_scene_keeps_the_tool_only_where_it_is_free(plant: Plant, scene: Scene) -> None:
    goal = moved(scene.T_base_start, dz=-0.01)
    run = Orders(plant, Command(goal, 1))
    engine = Engine(run)
    for _ in range(200):
        there, _ = engine.advance(run, STATS)
    np.testing.assert_allclose(plant.arm.tip(there.q).translation, goal.translation, atol=1e-6)
    vertices = np.asarray(scene.surface.vertices)
    outside = vf.Surface.from_arrays(vertices - np.array([0.0, 0.0, 0.05]), scene.surface.faces)
    around = vf.Surface.from_arrays(vertices + np.array([0.0, 0.0, 0.02]), scene.surface.faces)
    free, _ = engine.advance(
        Orders(replace(plant, surface=outside, scene=2), Command(None, 2)), STATS
    )
    assert free.scene == 2
    np.testing.assert_array_equal(free.q, there.q)
    stuck, _ = engine.advance(
        Orders(replace(plant, surface=around, scene=3), Command(None, 3)), STATS
    )
    assert stuck.scene == 3
    np.testing.assert_array_equal(stuck.q, plant.q0)


@pytest.mark.parametrize("guard", ["tip", "tool"])
def test_a_guarded_tool_with_its_shaft_in_a_new_scene_goes_to_its_start(guard: str) -> None:
    below = Options(mesh="sphere", at=(0.0, 0.0, -0.25), guard=guard)
    across = replace(below, at=(0.0, 0.0, -0.06))  # of radius 3 cm, above the tip
    first, second = scenes.build(below, 1), scenes.build(across, 2)
    orders = Orders(scenes.plant(first, below), Command(None, 0))
    engine = Engine(orders)
    engine.advance(orders, STATS)
    told, _ = engine.advance(Orders(scenes.plant(second, across), Command(None, 1)), STATS)
    assert told.step is not None
    np.testing.assert_array_equal(told.q, second.start if guard == "tool" else first.start)
    assert (second.start != first.start).any() == (guard == "tool")


def test_arrays_that_leave_the_engine_are_read_only(plant: Plant, scene: Scene) -> None:
    for target in (None, moved(scene.T_base_start, dz=-0.03)):
        orders = Orders(plant, Command(target, 1))
        engine = Engine(orders)
        for _ in range(150):
            telemetry, _ = engine.advance(orders, STATS)
        step = telemetry.step
        assert step is not None
        arrays = (telemetry.q, step.q, step.force, step.planes.normals, step.planes.offsets)
        for array in (*arrays, step.planes.points, step.multipliers):
            with pytest.raises(ValueError, match="read-only"):
                array[...] = 0.0
