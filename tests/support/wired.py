"""A station and an engine, tick by tick, with the test at the other end of every wire."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import robots
from app.control.engine import Engine, Orders
from app.control.messages import Command, LoopStats, Telemetry
from app.devices.remote import transports
from app.devices.remote.messages import Message
from app.devices.sockets.dialect import decode, encode
from app.devices.spec import Spec
from app.devices.station import Station
from app.kinds.links import Address
from app.scene import scene as scenes
from app.scene.scene import Scene
from app.settings import Options

AWAY = Options(mesh="cube", robot="psm", arm="socket://h:1", master="socket://h:2", standoff=1e-4)
AWAY_FROM_START = (0.05, -0.04, -0.01, 0.3, 0.1, -0.2)


class Wire:
    """A transport: what the test `put` is heard, what is sent is in `sent`."""

    peer = "test"

    def __init__(self, clock: Clock) -> None:
        self.refused: dict[str, int] = {}
        self.clock = clock
        self.sent: list[tuple[str, Any]] = []
        self.goals: list[np.ndarray] = []
        self.waiting: list[Message] = []

    def put(self, content: dict[str, Any]) -> None:
        self.waiting += decode(json.dumps(content).encode(), self.clock.now)

    def receive(self, now: float) -> list[Message]:
        found, self.waiting = self.waiting, []
        return found

    def send(self, message: Message, now: float) -> None:
        for name, value in json.loads(encode(message)).items():
            self.sent.append((name, value))
            if name == "servo_jp":
                self.goals.append(np.array(value["Goal"]))

    def close(self) -> None: ...

    def named(self, name: str) -> list[Any]:
        return [value for key, value in self.sent if key == name]


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


class Bench:
    """Ticks of 1 ms. The arm tells where it is in every tick, and goes to its set-point at once."""

    def __init__(self, scene: Scene, options: Options, monkeypatch: pytest.MonkeyPatch) -> None:
        self.clock = Clock()
        self.wires: dict[int, Wire] = {}

        def opened(address: Address, role: str) -> Wire:
            return self.wires.setdefault(address.port, Wire(self.clock))

        monkeypatch.setattr(transports, "open", opened)
        plant = scenes.plant(scene, options)
        self.orders = Orders(plant, Command(None, 0))
        spec = Spec.of(options)
        assert spec is not None
        self.station = Station(spec, plant.q0, self.clock)
        self.engine = Engine(self.orders, arm=self.station.arm)
        self.model = robots.load("psm")
        self.q = np.array(plant.q0) + np.array(AWAY_FROM_START)
        self.stamp = 20.0
        self.latest: Telemetry | None = None
        self.lag = 1.0  # share of the way to the set-point in a tick
        self.tells = True
        self.goals = 0

    @property
    def arm(self) -> Wire:
        return self.wires[1]

    @property
    def master(self) -> Wire:
        return self.wires[2]

    @property
    def setpoints(self) -> list[np.ndarray]:
        return self.arm.goals

    @property
    def tool(self) -> pin.SE3:
        return self.model.tip(self.q)

    def measured(self, **changes: Any) -> dict[str, Any]:
        """What the arm says of its joints, with these changes."""
        js = {"Position": self.q.tolist(), "Velocity": [], "Timestamp": self.stamp, "Valid": True}
        return {"measured_js": js | changes}

    def tick(self, content: dict[str, Any] | None = None) -> Telemetry:
        """A tick, in which the arm says this instead of where it is."""
        self.clock.now += 1e-3
        self.stamp += 1e-3
        if content is not None:
            self.arm.put(content)
        elif self.tells:
            self.arm.put(self.measured())
        orders = self.station.before(self.orders, self.latest)
        self.latest, ticked = self.engine.advance(orders, LoopStats())
        self.station.after(self.latest, ticked)
        new = self.setpoints[self.goals :]
        self.goals += len(new)
        if new:
            self.q = self.q + self.lag * (new[-1] - self.q)
        return self.latest

    def ticks(self, count: int) -> None:
        for _ in range(count):
            self.tick()

    def order(self, word: str) -> None:
        self.station.order(word)
        self.tick()

    def enabled(self) -> Bench:
        """With the arm heard of and enabled."""
        self.tick()
        self.order("enable")
        return self

    def goal(self, pose: pin.SE3, name: str = "servo_cp", **more: Any) -> None:
        """Command a goal of the tip."""
        # Poses on the wire are of the point 10.2 mm before the tip.
        cp = pose * pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.0102]))
        goal = {"Rotation": cp.rotation.tolist(), "Translation": cp.translation.tolist()}
        self.master.put({name: {"Goal": goal, **more}})

    def follow(self, pose: pin.SE3, ticks: int, **more: Any) -> None:
        """Command a goal in each of so many ticks."""
        for _ in range(ticks):
            self.goal(pose, **more)
            self.tick()


Make = Callable[..., Bench]
"""Makes benches with other options."""
