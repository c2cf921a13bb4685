"""Runs and recordings without thread and clock."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import pinocchio as pin

from app.control.engine import Engine, Orders
from app.control.messages import Command, LoopStats, Telemetry
from app.recording.write import Recorder
from app.scene import scene as scenes
from app.settings import Options

CUBE = Options(mesh="cube", robot="point")


def run_headless(
    options: Options,
    commands: Iterable[Command | None],
    ticks: int,
    autopilot: bool = False,
) -> list[Telemetry]:
    """The telemetry of the first `ticks` ticks of a new scene, without thread and clock.

    `commands`: the command in the mailbox at each tick; None, and the end of the commands, mean no
    new one. `autopilot`: it drives, and the commands are ignored.
    """
    scene = scenes.build(options, 1)
    stats = LoopStats()
    orders = Orders(scenes.plant(scene, options), Command(None, 0), autopilot=autopilot)
    engine = Engine(orders)
    incoming = iter(commands)
    seen = []
    for _ in range(ticks):
        command = next(incoming, None)
        if command is not None:
            orders = Orders(orders.plant, command, autopilot=autopilot)
        seen.append(engine.advance(orders, stats)[0])
    return seen


def a_run(path: Path, options: Options = CUBE, ticks: int = 60) -> None:
    """A recording without thread: pushed into the cube, pausing, with single steps and a reset."""
    scene = scenes.build(options, 1)
    plant = scenes.plant(scene, options)
    down = pin.SE3(
        scene.T_base_start.rotation, scene.T_base_start.translation - [0.001, 0.002, 0.05]
    )
    orders = Orders(plant, Command(None, 0))
    engine = Engine(orders)
    recorder = Recorder(path)
    recorder.begin(engine.seen, engine.state)

    def advance(orders: Orders, times: int = 1) -> None:
        for _ in range(times):
            recorder.add(orders, *engine.advance(orders, LoopStats()))
            if recorder.rows % 20 == 0:
                recorder.flush()

    advance(orders, 3)
    orders = replace(orders, command=Command(down, 1, held=True))
    advance(orders, ticks)
    orders = replace(orders, paused=True)
    advance(orders)
    orders = replace(orders, steps=2)
    advance(orders, 2)
    orders = replace(orders, paused=False, command=Command(None, 2), resets=1)
    advance(orders, 4)
    recorder.close()
