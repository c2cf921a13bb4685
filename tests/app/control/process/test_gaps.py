"""What is done beside the control thread does not begin shortly before a tick."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import pytest

from app.control.process import gaps
from app.control.process.gaps import MARGIN, TICK, Gaps


class World:
    """A clock that passes by itself and while one sleeps, and a loop that ticks by it."""

    dt = 1e-3

    def __init__(self) -> None:
        self.now = 0.0
        self.slept = 0

    @property
    def deadline(self) -> float:
        return (self.now // self.dt + 1.0) * self.dt

    def perf_counter(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds
        self.slept += 1


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch) -> World:
    world = World()
    clock = SimpleNamespace(perf_counter=world.perf_counter, sleep=world.sleep)
    monkeypatch.setattr(gaps, "time", clock)
    return world


def work(world: World, begun: list[float], calls: int = 400) -> None:
    def call() -> None:
        begun.append(world.now % world.dt)
        world.now += 7e-5

    for _ in range(calls):
        call()


def test_calls_begin_after_a_tick_and_well_before_the_next(world: World) -> None:
    begun: list[float] = []
    with Gaps(world):  # type: ignore[arg-type]
        work(world, begun)
    assert sys.getprofile() is None
    assert min(begun) >= TICK - 1e-9 or begun[0] == 0.0
    assert max(begun) <= world.dt - MARGIN + 1e-9
    assert world.slept > 50


def test_there_are_no_gaps_where_ticks_follow_too_closely(world: World) -> None:
    begun: list[float] = []
    world.dt = 1e-4
    with Gaps(world):  # type: ignore[arg-type]
        work(world, begun)
    with Gaps(None):
        work(world, begun)
    assert world.slept == 0
