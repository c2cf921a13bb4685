"""Runs without thread and clock: the same commands give the same joints, bit for bit."""

from __future__ import annotations

from collections.abc import Iterable

from app import scene as scenes
from app.engine import Engine, Orders
from app.messages import Command, LoopStats, Telemetry
from app.settings import Options


def run_headless(
    options: Options,
    commands: Iterable[Command | None],
    ticks: int,
    autopilot: bool = False,
) -> list[Telemetry]:
    """Tick a fresh scene and controller `ticks` times.

    Args:
        options: as of a session (host and port are not used).
        commands: the command that is in the mailbox at each tick; None, and the end of the
            commands, mean nothing new: the last one goes on (and a held one goes stale).
        ticks: how many.
        autopilot: let the scripted hand drive; commands are then ignored.

    Returns:
        One telemetry a tick, without timing.

    Raises:
        ValueError: unknown names or an unusable mesh.
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
