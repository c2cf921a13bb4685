"""The shaft pressed on a rim: at rest nothing moves, and the tip pivots about the rim."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from app.control.engine import Engine, Orders
from app.control.messages import Command, LoopStats, Telemetry
from app.judges import boxes
from app.judges.nearest import gaps
from app.judges.sweep import Judge
from app.scenarios.presets import PRESETS
from app.scene import scene as scenes
from app.scene.scene import Scene
from app.settings import Options

SHAFT = 2
DEPTH = np.array([0.0, 0.0, -0.055])  # from the start to inside the skull [m]


@pytest.fixture(scope="module")
def scene() -> Scene:
    return scenes.build(PRESETS["through-the-fontanelle"].applied(Options()), 1)


def driven(scene: Scene, way: list[tuple[np.ndarray, int]]) -> list[Telemetry]:
    """Ticks at 1 kHz: the proxy goes straight from one shift of the start to the next."""
    plant = scenes.plant(scene, PRESETS["through-the-fontanelle"].applied(Options()))
    orders = Orders(plant, Command(None, 0))
    engine, seen, sequence = Engine(orders), [], 0
    for (begin, _), (end, ticks) in itertools.pairwise([(np.zeros(3), 0), *way]):
        for k in range(ticks):
            shift = begin + (k + 1) / ticks * (end - begin)
            sequence += 1
            start = scene.T_base_start
            goal = pin.SE3(start.rotation, start.translation + shift)
            orders = replace(orders, command=Command(goal, sequence))
            seen.append(engine.advance(orders, LoopStats())[0])
    return seen


def tips(seen: list[Telemetry]) -> np.ndarray:
    return np.array([t.step.tip.translation for t in seen])  # type: ignore[union-attr]


@pytest.mark.parametrize("angle", [0.0, 50.0, 140.0, 270.0])
def test_at_a_resting_proxy_that_presses_the_shaft_on_the_rim_nothing_moves(
    scene: Scene, angle: float
) -> None:
    aside = DEPTH + 0.016 * np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle)), 0.0])
    seen = driven(scene, [(DEPTH, 1000), (aside, 400), (aside, 1000)])
    step = seen[-1].step
    assert step is not None
    assert step.planes.capsules is not None
    assert set(step.planes.capsules[step.multipliers > 1e-7]) == {SHAFT}
    assert gaps(boxes.of(scene.surface), scene.arm, step.q)[SHAFT] == pytest.approx(20e-6, abs=3e-6)
    resting = tips(seen[-500:])
    assert np.ptp(resting, axis=0).max() < 1e-6
    assert np.linalg.norm(np.diff(tips(seen[-500:]), axis=0), axis=1).max() < 1e-7
    ends = np.array([scene.arm.axes(t.q)[SHAFT] for t in seen[-500:]])
    assert np.ptp(ends, axis=0).max() < 1e-6


def test_a_tip_that_moves_while_the_shaft_is_pressed_pivots_about_the_rim(scene: Scene) -> None:
    """Along the rim and in depth: the contact stays, nothing crosses, nothing chatters."""
    press = np.array([0.016, 0.0, 0.0])
    seen = driven(
        scene,
        [
            (DEPTH, 1000), (DEPTH + press, 400), (DEPTH + press, 300),
            (DEPTH + press + [0.0, 0.0, -0.03], 800), (DEPTH + press + [0.0, 0.004, -0.03], 800),
            (DEPTH + press, 800),
        ],
    )  # fmt: skip
    pressed = seen[1700:]
    tree = boxes.of(scene.surface)
    gap = [gaps(tree, scene.arm, t.q)[SHAFT] for t in pressed[::10]]
    assert min(gap) > 0.0
    assert max(gap) < 40e-6
    judge = Judge(scene.arm.copy(), scene.surface.vertices, scene.surface.faces)
    for before, after in itertools.pairwise(pressed[::2]):
        assert judge.touches(before.q, after.q) == []
    path = tips(pressed)
    # Deeper inside, the tip is farther from the rim and moves out, by the lever of the shaft.
    rim = scene.arm.axes(pressed[0].q)[SHAFT, 0]  # the remote centre
    deep, shallow = path[800], path[0]
    assert deep[0] - shallow[0] > 0.5e-3
    assert deep[0] / (deep - rim)[2] == pytest.approx(shallow[0] / (shallow - rim)[2], rel=0.03)
    # A chattering contact reverses the tip's motion from tick to tick.
    change = np.linalg.norm(np.diff(path, 2, axis=0), axis=1)
    assert np.median(change) < 1e-7
    assert np.quantile(change, 0.99) < 5e-6
