"""A crossing is seen: whatever the rule, in whichever tick, and until the tool is put elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from app.control import watch
from app.control.engine import Engine, Orders
from app.control.messages import Command, LoopStats
from app.control.watch import Crossing, Watch
from app.scenarios import presets
from app.scenarios.staging import course
from app.scene import scene as scenes
from app.scene.scene import Scene
from app.session import Session
from app.settings import Options
from app.studies.verification.hands import goals
from tests.support.brute import Oracle
from tests.support.headless import wait_until

STATS = LoopStats()


class Run:
    """An engine with a watch beside it, and the tip after every tick."""

    def __init__(self, scene: Scene, options: Options, **changes: object) -> None:
        self.scene = scene
        self.plant = replace(scenes.plant(scene, options), **changes)
        self.orders = Orders(self.plant, Command(None, 0))
        self.engine = Engine(self.orders)
        self.watch = Watch()
        self.tips = [np.array(scene.T_base_start.translation)]
        self.first = 0  # tick after which the tips begin

    def go(self, ticks: int, target: pin.SE3 | None = None, **orders: object) -> None:
        """Some ticks towards a target, or with other orders."""
        if target is not None:
            orders["command"] = Command(target, self.orders.command.sequence + 1)
        self.orders = replace(self.orders, **orders)
        for _ in range(ticks):
            telemetry, ticked = self.engine.advance(self.orders, STATS)
            self.watch.take(self.orders, telemetry, ticked)
            assert telemetry.step is not None
            self.tips.append(np.array(telemetry.step.tip.translation))

    def seen(self) -> Crossing | None:
        self.watch.look()
        return self.watch.crossing


@pytest.fixture(scope="module")
def plate() -> Scene:
    return scenes.build(Options(mesh="thin-plate", robot="point"), 1)


def below(scene: Scene, depth: float, aside: float = 0.0) -> pin.SE3:
    """The start's pose, moved down and aside [m]."""
    start = scene.T_base_start
    return pin.SE3(start.rotation, start.translation - np.array([aside, 0.0, depth]))


def first_cut(judge: object, tips: list[np.ndarray]) -> int | None:
    """The first tick, counted from 1, whose step cuts the mesh."""
    for k in range(len(tips) - 1):
        if judge.crossings(np.array(tips[k : k + 2])):
            return k + 1
    return None


@pytest.mark.parametrize(("name", "leaks"), [("paper", True), ("certified", False)])
def test_the_scenario_that_shows_the_leak_is_seen_to_leak(name: str, leaks: bool) -> None:
    scenario = presets.find(f"unclean-mesh-{name}")
    options = replace(scenario.options, rate=200.0)  # a fifth of the ticks show the same
    scene = scenes.build(options, 1)
    way = course(scenario, scene)
    assert way is not None
    run = Run(replace(scene, autopilot=way), options, autopilot=way)
    run.go(round(way.duration / run.plant.dt), autopilot=True)
    seen = run.seen()
    judge = Oracle(scene.surface.vertices, scene.surface.faces)
    cut = first_cut(judge, run.tips)
    assert (cut is not None) == leaks
    assert (None if seen is None else seen.tick) == cut
    if seen is not None:
        alone = Oracle(scene.surface.vertices, scene.surface.faces[seen.triangle][None])
        assert alone.crossings(np.array(run.tips[seen.tick - 1 : seen.tick + 1]))
        np.testing.assert_array_equal(seen.before, run.tips[seen.tick - 1])
        assert seen.rule == "paper"


@pytest.mark.parametrize("rate", [1000.0, 20.0])
def test_both_walls_of_a_plate_may_be_crossed_within_a_tick(plate: Scene, rate: float) -> None:
    options = Options(mesh="thin-plate", robot="point", rule="off", rate=rate)
    run = Run(plate, options)
    run.go(400, below(plate, 0.03))
    top = plate.surface.vertices[:, 2].max()
    over = [k for k, tip in enumerate(run.tips) if tip[2] > top]
    seen = run.seen()
    assert seen is not None
    assert seen.tick == over[-1] + 1
    assert seen.point[2] == pytest.approx(top, abs=1e-9)
    assert seen.centre
    # Another look at later ticks does not move it.
    run.go(10, below(plate, 0.0))
    assert run.seen() is seen


def test_being_put_somewhere_is_no_crossing_and_makes_a_clean_slate(plate: Scene) -> None:
    options = Options(mesh="thin-plate", robot="point", rule="off")
    run = Run(plate, options)
    run.go(400, below(plate, 0.03))
    assert run.seen() is not None
    run.go(5, command=Command(None, 9), resets=1)
    assert run.seen() is None
    run.go(400, below(plate, 0.03))
    assert run.seen() is not None
    # A mesh that comes between the tool and where it was: the tool stays where it is.
    shifted = replace(run.plant, scene=2)
    run.go(5, plant=shifted, command=Command(None, 11))
    assert run.seen() is None
    # While paused there are no ticks, but a reset counts at once.
    run.go(400, below(plate, -0.03))
    assert run.seen() is not None
    run.go(1, paused=True, command=Command(None, 13), resets=2)
    assert run.seen() is None


def test_another_rule_or_radius_keeps_the_latch(plate: Scene) -> None:
    run = Run(plate, Options(mesh="thin-plate", robot="point", rule="off"))
    run.go(400, below(plate, 0.03))
    seen = run.seen()
    options = Options(mesh="thin-plate", robot="point", rule="certified")
    run.go(50, below(plate, 0.0), plant=scenes.plant(plate, options))
    assert seen is not None
    assert run.seen() is seen
    assert seen.rule == "off"


def test_a_ball_is_seen_when_it_comes_to_overlap_and_again_when_its_centre_crosses(
    plate: Scene,
) -> None:
    radius = 2e-3
    options = Options(mesh="thin-plate", robot="point", rule="off", tip_radius=radius)
    run = Run(plate, options)
    top = plate.surface.vertices[:, 2].max()
    height = run.tips[0][2] - top
    run.go(300, below(plate, height - 0.5 * radius))
    seen = run.seen()
    assert seen is not None
    assert not seen.centre
    z = z_of(run)
    assert seen.tick == np.flatnonzero(z - top < radius - 1e-8)[0]
    run.go(300, below(plate, height + 0.5 * radius))
    seen = run.seen()
    assert seen is not None
    assert seen.centre
    assert seen.tick == np.flatnonzero(z_of(run) < top)[0]


def z_of(run: Run) -> np.ndarray:
    return np.array([tip[2] for tip in run.tips])


def test_a_ball_that_grew_into_the_mesh_did_not_move_into_it(plate: Scene) -> None:
    small = Options(mesh="thin-plate", robot="point")
    large = replace(small, tip_radius=2e-3)
    run = Run(plate, small)
    run.go(400, below(plate, 0.03))
    run.go(200, below(plate, 0.03, aside=0.01), plant=scenes.plant(plate, large))
    assert run.seen() is None


@pytest.mark.parametrize("tip_radius", [0.0, 5e-4])
@pytest.mark.parametrize("state", ["none", "jittered", "holes", "duplicated"])
def test_the_certified_rule_is_never_seen_to_cross(state: str, tip_radius: float) -> None:
    options = Options(mesh="stairs", robot="point", damage=state, tip_radius=tip_radius)
    run = Run(scenes.build(options, 1), options)
    rng = np.random.default_rng(11)
    tools = [run.scene.T_base_start]
    for target in _some(goals(rng, run.scene.surface, tools[0], tools), 1200):
        run.go(1, target)
        tools[0] = pin.SE3(tools[0].rotation, run.tips[-1])
    assert run.seen() is None
    assert np.ptp(run.tips, axis=0).max() > 5e-3, "the tool must have moved"


@pytest.mark.slow
@pytest.mark.parametrize("state", ["none", "jittered", "holes", "flipped", "slivers"])
def test_the_certified_rule_is_never_seen_to_cross_in_a_long_run(state: str) -> None:
    options = Options(mesh="skull-coarse", damage=state)
    run = Run(scenes.build(options, 1), options)
    rng = np.random.default_rng(5)
    tools = [run.scene.T_base_start]
    hand = goals(rng, run.scene.surface, tools[0], tools)
    for k in range(20_000):
        run.go(1, next(hand))
        tools[0] = pin.SE3(tools[0].rotation, run.tips[-1])
        if k % 500 == 0:
            assert run.seen() is None
    assert run.seen() is None


def _some(hand: object, count: int) -> list[pin.SE3]:
    return [next(hand) for _ in range(count)]


def test_ticks_that_wait_too_long_are_counted(
    plate: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(watch, "BEHIND", 10)
    run = Run(plate, Options(mesh="thin-plate", robot="point"))
    run.go(25, below(plate, 0.01))
    assert run.watch.missed == 15
    assert run.seen() is None
    run.go(5)
    assert run.watch.missed == 15


def test_a_session_latches_a_crossing_until_its_reset() -> None:
    with Session(Options(mesh="thin-plate", robot="point", rule="off")) as session:
        wait_until(lambda: session.latest().tick > 10)
        assert session.crossing is None
        session.drive(below(session.scene, 0.03))
        wait_until(lambda: session.crossing is not None)
        session.set(rule="certified")
        session.drive(below(session.scene, 0.0))
        tick = session.latest().tick
        wait_until(lambda: session.latest().tick > tick + 100)
        assert session.crossing is not None
        session.reset()
        wait_until(lambda: session.crossing is None)
        assert session.unwatched == 0
