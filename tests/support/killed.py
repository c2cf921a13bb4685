"""Processes that record and are not left to end: what they run."""

from __future__ import annotations

import functools
import resource
import time
from pathlib import Path

import numpy as np
import pinocchio as pin

from app.control.engine import Engine, Orders, Plant
from app.control.messages import Command, LoopStats
from app.recording.capture import Tape
from app.scene import scene as scenes
from app.scene.scene import Scene
from app.settings import Options

CUBE = Options(mesh="cube", robot="point")


@functools.cache
def prepare() -> tuple[Scene, Plant]:
    """What all of them record."""
    scene = scenes.build(CUBE, 1)
    return scene, scenes.plant(scene, CUBE)


def record(folder: str, limit: int | None = None) -> None:
    """Record for good, each tick with a new command, with no file larger than `limit` [byte].

    Says in a file beside it what the tape knows to be written, and what came of it.
    """
    scene, plant = prepare()
    engine = Engine(orders := Orders(plant, Command(None, 0)))
    start = scene.T_base_start
    if limit is not None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
    tape = Tape(Path(folder) / "run.vfrec")
    said = Path(folder) / f"said-{tape.path.stem}"
    tape.begin(engine.seen, engine.state)
    rng = np.random.default_rng(1)
    n, rows = 0, -1
    while tape.running:
        n += 1
        goal = start.translation + rng.uniform([-5e-3, -5e-3, -0.05], [5e-3, 5e-3, 0.01])
        orders = Orders(plant, Command(pin.SE3(start.rotation, goal), n))
        tape.take(orders, *engine.advance(orders, LoopStats()))
        if tape.rows != rows and limit is None:
            rows = tape.rows
            said.write_text(f"{rows}")
        time.sleep(5e-4)
    tape.finish()
    resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    (Path(folder) / "outcome").write_text(tape.outcome)
