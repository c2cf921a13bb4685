"""The control thread: deadlines, overruns, statistics, failures, shutdown."""

from __future__ import annotations

import gc
import sys
import threading
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import vf
from app.control import loop as loops
from app.control.engine import Orders, Plant
from app.control.loop import ControlLoop
from app.control.mailbox import Mailbox
from app.control.messages import Command
from app.scene import scene as scenes
from app.scene.scene import Scene
from app.settings import Options
from app.words import Refused
from tests.support.headless import Tape, wait_until

OPTIONS = Options(mesh="cube", robot="point")


@pytest.fixture(scope="module")
def scene() -> Scene:
    return scenes.build(OPTIONS, 1)


@pytest.fixture
def plant(scene: Scene) -> Plant:
    return scenes.plant(scene, OPTIONS)


class Slow:
    """A controller that needs longer than a tick lasts, for as long as it is told to."""

    def __init__(self, controller: vf.Controller, seconds: float) -> None:
        self.controller = controller
        self.seconds = seconds

    def step(self, q: np.ndarray, target: pin.SE3) -> vf.Step:
        time.sleep(self.seconds)
        return self.controller.step(q, target)


class Broken:
    """A controller that must not exist: it raises."""

    def step(self, q: np.ndarray, target: pin.SE3) -> vf.Step:
        raise RuntimeError("this controller is broken")


def test_every_tick_is_published_once_and_in_order(plant: Plant) -> None:
    out = Tape()
    loop = ControlLoop(Mailbox(Orders(plant, Command(None, 0))), out, plant.dt)
    loop.start()
    wait_until(lambda: out.get().tick >= 300)
    loop.close()
    assert [t.tick for t in out.items] == list(range(len(out.items)))


def test_ticks_that_take_too_long_are_counted_and_never_made_up(plant: Plant) -> None:
    slow = Slow(plant.controller, 4.0 * plant.dt)
    inbox = Mailbox(Orders(replace(plant, controller=slow), Command(None, 0)))
    out = Tape()
    loop = ControlLoop(inbox, out, plant.dt)
    loop.start()
    # Long enough for two summaries of the statistics.
    wait_until(lambda: out.get().stats.overruns >= 60)
    seen = out.get()
    # Every tick was too long; what is counted since the last summary is not told yet.
    assert seen.stats.overruns <= seen.tick
    assert seen.stats.tick_median > 4.0 * plant.dt
    assert seen.stats.tick_worst > seen.stats.tick_median
    # Quick again: had the loop kept its old grid, it would now tick without any pause to catch up.
    slow.seconds = 0.0
    began = time.perf_counter()
    first = out.get().tick
    wait_until(lambda: out.get().tick >= first + 200)
    ticks = out.get().tick - first
    elapsed = time.perf_counter() - began
    # Of ticks that end in time none is counted: of the next thousand some may be late, not most.
    second = out.get()
    wait_until(lambda: out.get().tick >= second.tick + 1000)
    loop.close()
    assert ticks * plant.dt <= elapsed + 3.0 * plant.dt
    assert out.get().stats.overruns - second.stats.overruns < 700
    assert out.get().stats.tick_median < plant.dt


def test_statuses_are_counted_and_add_up_to_the_ticks(plant: Plant, scene: Scene) -> None:
    inbox = Mailbox(Orders(plant, Command(None, 0)))
    out = Tape()
    loop = ControlLoop(inbox, out, plant.dt)
    loop.start()
    wait_until(lambda: out.get().tick >= 50)
    inbox.put(Orders(replace(plant, controller=Broken()), Command(scene.T_base_start, 1)))
    wait_until(lambda: out.get().stats.counts.get(vf.Status.HELD, 0) >= 100)
    held = out.get().q
    inbox.put(Orders(plant, Command(scene.T_base_start, 2)))
    start = out.get().tick
    wait_until(lambda: out.get().tick >= start + 400)
    loop.close()
    np.testing.assert_array_equal(held, plant.q0)
    statuses = [t.step.status for t in out.items if t.step is not None]
    summary = out.get().stats.counts
    assert set(summary) == set(vf.Status)
    assert Counter(statuses[: sum(summary.values())]) == Counter(summary)


def test_a_paused_loop_answers_but_does_not_tick(plant: Plant) -> None:
    orders = Orders(plant, Command(None, 0))
    inbox, out = Mailbox(orders), Tape()
    loop = ControlLoop(inbox, out, plant.dt)
    loop.start()
    wait_until(lambda: out.get().tick >= 20)
    inbox.put(replace(orders, paused=True))
    wait_until(lambda: out.get().paused)
    tick, count = out.get().tick, len(out.items)
    wait_until(lambda: len(out.items) >= count + 50)
    assert out.get().tick == tick
    inbox.put(replace(orders, paused=True, steps=1))
    wait_until(lambda: out.get().tick > tick)
    count = len(out.items)
    wait_until(lambda: len(out.items) >= count + 50)
    assert out.get().tick == tick + 1
    loop.close()


def test_loops_quiet_the_interpreter_until_the_last_is_closed(plant: Plant) -> None:
    """Waits for the interpreter are short and old objects are not collected, while loops run."""
    before, frozen = sys.getswitchinterval(), gc.get_freeze_count()
    known = 7e-3  # other than what any loop sets, in this test or in one before it [s]
    sys.setswitchinterval(known)

    def quiet() -> bool:
        short = sys.getswitchinterval() <= loops.LONGEST_INTERVAL * (1 + 1e-6)
        return short and gc.get_freeze_count() > frozen

    out = [Mailbox(), Mailbox()]
    first, second = (
        ControlLoop(Mailbox(Orders(plant, Command(None, 0))), mailbox, plant.dt) for mailbox in out
    )
    try:
        assert not quiet()
        first.start()
        second.start()
        wait_until(lambda: all(mailbox.get().tick > 0 for mailbox in out))
        assert quiet()
        first.close()
        first.close()
        assert quiet()
        second.close()
        assert sys.getswitchinterval() == pytest.approx(known, abs=2e-6)  # whole microseconds
        assert gc.get_freeze_count() == frozen
        assert "control" not in {thread.name for thread in threading.enumerate()}
    finally:
        first.close()
        second.close()
        sys.setswitchinterval(before)


def test_a_loop_that_never_started_closes(plant: Plant) -> None:
    out: Mailbox = Mailbox()
    loop = ControlLoop(Mailbox(Orders(plant, Command(None, 0))), out, plant.dt)
    assert out.get().tick == 0
    assert out.get().step is None
    loop.close()


def test_a_loop_needs_orders() -> None:
    with pytest.raises(ValueError, match="orders"):
        ControlLoop(Mailbox(), Mailbox(), 1e-3)


def test_who_waits_for_the_interpreter_leaves_cores_to_who_has_it() -> None:
    assert 0.0 < loops._wait_cost() < 1e-2
    for cores in (1, 2, 4):
        for price in (0.0, 1e-6, 5e-6, 3e-5, 1e-3):
            interval = loops._switch_interval(price, cores)
            assert 2e-5 <= interval <= 2e-4
            three = 3.0 * price / interval
            assert three <= 0.75 * cores + 1e-9 or interval == 2e-4


class Failing(Mailbox):
    """A mailbox that the loop cannot put anything into once it is told so."""

    __slots__ = ("fails",)

    def __init__(self) -> None:
        super().__init__()
        self.fails = False

    def put(self, value: object) -> None:
        if self.fails:
            raise RuntimeError("this mailbox is broken")
        super().put(value)


def test_a_loop_that_ended_by_an_error_says_so_and_goes_on_where_it_was(
    plant: Plant, scene: Scene, tmp_path: Path
) -> None:
    inbox, out = Mailbox(Orders(plant, Command(None, 0))), Failing()
    loop = ControlLoop(inbox, out, plant.dt)
    loop.start()
    with pytest.raises(Refused, match="runs"):
        loop.restart()
    away = pin.SE3(scene.T_base_start.rotation, scene.T_base_start.translation + 1e-3)
    inbox.put(Orders(plant, Command(away, 1)))
    wait_until(lambda: out.get().tick >= 200)
    tape = loop.record(tmp_path / "run.vfrec")
    wait_until(lambda: tape.rows > 0)
    out.fails = True
    wait_until(lambda: loop.ended)
    assert not loop.alive
    assert "ended because the control loop ended (an error of the control loop)" in tape.outcome
    q, tick = loop.engine.state.q, loop.engine.state.tick
    out.fails = False
    inbox.put(Orders(plant, Command(None, 2)))
    loop.restart()
    wait_until(lambda: out.get().tick > tick)
    assert loop.alive
    assert loop.ended == ""
    np.testing.assert_array_equal(out.get().q, q)
    # What was ordered meanwhile counts: here a reset.
    out.fails = True
    wait_until(lambda: loop.ended)
    out.fails = False
    inbox.put(Orders(plant, Command(None, 3), resets=1))
    loop.restart()
    wait_until(lambda: loop.alive and out.get().sequence == 3)
    np.testing.assert_array_equal(out.get().q, plant.q0)
    loop.close()
