"""Orders and ticks keep every bit on their way between two processes."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pinocchio as pin
import pytest

import vf
from app.control.clock import TICKED, Timing
from app.control.engine import Engine, Orders, Plant
from app.control.messages import Command, LoopStats, Telemetry
from app.control.plant import assemble, describe
from app.control.process import surfaces, wire
from app.recording.format import ROWS
from app.recording.rows import fill
from app.scene import scene as scenes
from app.scene.scene import Scene
from app.settings import Options
from robots import load

OPTIONS = Options(mesh="cube", robot="psm")
STATS = LoopStats()


@pytest.fixture(scope="module")
def scene() -> Scene:
    return scenes.build(OPTIONS, 1)


@pytest.fixture
def plant(scene: Scene) -> Plant:
    return scenes.plant(scene, OPTIONS)


def same_pose(a: pin.SE3 | None, b: pin.SE3 | None) -> bool:
    if a is None or b is None:
        return a is b
    return bool((a.homogeneous == b.homogeneous).all())


def test_orders_come_as_they_were(plant: Plant) -> None:
    rng = np.random.default_rng(3)
    for k in range(200):
        yes = rng.random(6) < 0.5
        target = pin.SE3.Random() if yes[0] else None
        command = Command(
            target, int(rng.integers(1 << 60)), bool(yes[1]), bool(yes[2]), rng.normal()
        )
        orders = Orders(
            plant, command, bool(yes[3]), int(rng.integers(1 << 60)), int(rng.integers(99)),
            bool(yes[4]), rng.random(), bool(yes[5]),
        )  # fmt: skip
        message = wire.pack_orders(k, k + 1, orders)
        assert wire.numbers_of(message) == (k, k + 1)
        found = wire.unpack_orders(message, plant)
        assert same_pose(found.command.target, target)
        assert replace(found, command=replace(found.command, target=None)) == replace(
            orders, command=replace(command, target=None)
        )


def row(telemetry: Telemetry, ticked: bool, before: vf.Step | None) -> bytes:
    table = np.zeros(1, dtype=ROWS)
    fill(table, 0, 0, telemetry, ticked, before)
    return table.tobytes()


class Refusing:
    """A controller that answers as none does that has a record: with a step made of its fields."""

    def __init__(self, controller: vf.Controller) -> None:
        self._controller = controller

    def step(self, q: np.ndarray, target: pin.SE3) -> vf.Step:
        step = self._controller.step(q, target)
        return replace(step, status=vf.Status.REFUSED)


@pytest.mark.parametrize("refusing", [False, True])
def test_ticks_come_as_they_were_to_the_last_bit(plant: Plant, refusing: bool) -> None:
    """What a recorder writes of them and what the engine's state says, tick by tick."""
    if refusing:
        plant = replace(plant, controller=Refusing(plant.controller))
    start = plant.arm.tip(plant.q0)
    low = plant.surface.vertices[:, 2].max() - start.translation[2] - 2e-3
    pressed = pin.SE3(start.rotation, start.translation + np.array([1e-3, 2e-3, low]))
    still = Orders(plant, Command(None, 0))
    script = [
        (still, 3),
        (replace(still, command=Command(pressed, 1)), 300),
        (replace(still, command=Command(pressed, 2, held=True)), 600),
        (replace(still, command=Command(pressed, 3, clutch=True), paused=True), 3),
        (replace(still, command=Command(pressed, 3), paused=True, steps=2), 4),
        (replace(still, command=Command(pressed, 3), autopilot=True, resets=1), 20),
        (replace(still, command=Command(pin.SE3(np.eye(3), np.full(3, np.nan)), 4)), 3),
    ]
    engine = Engine(still)
    timing = Timing()
    teller, listener = wire.Teller(engine, timing), wire.Listener(plant.dt)
    before, known = None, None
    pressing = 0
    for number, (orders, ticks) in enumerate(script):
        for _ in range(ticks):
            telemetry, ticked = engine.advance(orders, STATS)
            told = listener.told(teller.message(number, telemetry, ticked), STATS, known)
            assert (told.order, told.ticked) == (number, ticked)
            assert row(told.telemetry, told.ticked, known) == row(telemetry, ticked, before)
            assert same_pose(told.telemetry.origin, telemetry.origin)
            state, truth = told.state, engine.state
            for field in fields(state):
                if field.name not in ("q", "target", "step"):
                    assert getattr(state, field.name) == getattr(truth, field.name), field.name
            assert state.q.tobytes() == truth.q.tobytes()
            for name in ("tick", "time", "scene", "sequence", "paused", "autopilot", "stale"):
                assert getattr(told.telemetry, name) == getattr(telemetry, name)
            if telemetry.step is before:
                assert told.telemetry.step is known
            before, known = telemetry.step, told.telemetry.step
            pressing += bool(known is not None and (known.multipliers > 1e-9).any())
            timing.record(vf.Status.HELD, 1.0, 2.0, 3.0, True)
    assert told.timing == (TICKED, int(vf.Status.HELD), True, 1.0, 2.0, 3.0)
    assert pressing > 100


def test_a_plant_made_from_its_description_ticks_the_same(scene: Scene) -> None:
    options = replace(OPTIONS, radius=2e-3, tip_radius=1e-3, tip_speed=0.1)
    plant = scenes.plant(scene, options)
    given = surfaces.share(scene.surface)
    there = surfaces.attach(given.memory.fd, given.pickled, given.places)
    given.memory.fd = -1  # it was handed over
    description = surfaces.unpack(surfaces.pack(describe(plant)), [there])
    other = assemble(description, load(description.robot))
    assert other.options == options
    assert other.surface is there
    for array in (there.vertices, there.faces, there.normals, *there.tree):
        assert not array.flags.writeable
    one, two = (Engine(Orders(p, Command(None, 0), autopilot=True)) for p in (plant, other))
    for _ in range(1500):
        a, _ = one.advance(one.seen, STATS)
        b, _ = two.advance(two.seen, STATS)
        assert a.q.tobytes() == b.q.tobytes()
    assert a.step is not None
    assert a.step.planes.normals.tobytes() == b.step.planes.normals.tobytes()


def test_a_shared_surface_is_there_once_and_answers_the_same(scene: Scene) -> None:
    surface = vf.Surface.from_arrays(scene.surface.vertices, scene.surface.faces)
    assert surface.closed
    points = scene.surface.vertices[::3] + 1e-3
    before = [surface.nearest(p) for p in points], [surface.winding(p) for p in points]
    given = surfaces.share(surface)
    inside = np.frombuffer(given.memory.data, np.uint8)
    for array in (surface.vertices, surface.faces, surface.edges, *surface.tree):
        assert np.shares_memory(array, inside)
    after = [surface.nearest(p) for p in points], [surface.winding(p) for p in points]
    assert [(d, k, tuple(p)) for d, k, p in before[0]] == [(d, k, tuple(p)) for d, k, p in after[0]]
    assert before[1] == after[1]
    given.memory.forget()
