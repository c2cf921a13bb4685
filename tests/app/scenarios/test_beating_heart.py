"""The preset of a heart that beats, judged by its true shape at every tick, by brute force."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import meshes
import vf
from app.control.engine import Engine, Orders
from app.control.messages import Command, LoopStats
from app.control.watch import Watch
from app.scenarios.presets import PRESETS
from app.scenarios.staging import course
from app.scene import scene as scenes
from tests.support import naive
from tests.support.moving import axis_gap

# By docs/motion.md: from shape to shape, and how long the vertices rest at one, in ticks.
SHORTEST, TICKS, RESTS = 0.02, 10, 2


class Played:
    """The preset from its start to half a second after its script."""

    def __init__(self, rate: float, **changes: object) -> None:
        scenario = PRESETS["beating-heart"]
        options = replace(scenario.options, rate=rate)
        self.scene = scenes.build(options, 1)
        way = course(scenario, self.scene)
        assert way is not None
        plant = scenes.plant(replace(self.scene, autopilot=way), replace(options, **changes))
        orders, stats = Orders(plant, Command(None, 0), autopilot=True), LoopStats()
        engine, self.watch = Engine(orders), Watch()
        self.seen = []
        for _ in range(round((way.duration + 0.5) * rate)):
            telemetry, ticked = engine.advance(orders, stats)
            self.watch.take(orders, telemetry, ticked)
            self.seen.append(telemetry)
            if len(self.seen) % 500 == 0:
                self.watch.look()
        self.watch.look()
        self._dt = 1.0 / rate

    def corners(self, time: float) -> np.ndarray:
        """Triangles (m, 3, 3) of the true heart [m], base frame."""
        heart, T = meshes.deforming("heart"), self.scene.T_base_mesh
        frame, rest = max(SHORTEST, TICKS * self._dt), RESTS * self._dt
        number = int(time / frame + 1e-9)
        share = np.clip((time - number * frame - rest) / (frame - rest), 0.0, 1.0)
        first, last = (heart.shape((number + k) * frame / heart.period) for k in (0, 1))
        vertices = (1.0 - share) * first + share * last
        return (vertices @ T[:3, :3].T + T[:3, 3])[heart.faces]


@pytest.mark.parametrize("rate", [250.0, pytest.param(1000.0, marks=pytest.mark.slow)])
def test_the_beating_heart_is_ridden_on_and_never_touched(rate: float) -> None:
    run = Played(rate)
    assert run.watch.contacts == 0
    statuses = [t.step.status for t in run.seen if t.step is not None]
    assert not {vf.Status.OVERTAKEN, vf.Status.INSIDE, vf.Status.HELD} & set(statuses)
    gaps, parts, walls = [], [], []
    for telemetry in run.seen[:: round(rate / 20.0)]:
        corners, tip = run.corners(telemetry.phase), run.scene.arm.tip(telemetry.q).translation
        # Edges are shorter than 5 mm.
        near = corners[np.linalg.norm(corners[:, 0] - tip, axis=1) < 0.01]
        gaps.append(float(naive.closest(near, tip)[1].min()) if len(near) else 0.005)
        below = np.linalg.norm(corners[:, :, :2].mean(axis=1) - tip[:2], axis=1) < 3e-3
        walls.append(corners[below][:, :, 2].max(initial=-np.inf))
    for telemetry in run.seen[:: round(rate / 6.0)]:
        corners = run.corners(telemetry.phase)
        axes = run.scene.arm.axes(telemetry.q)
        for capsule, (a, b) in zip(run.scene.arm.capsules, axes, strict=True):
            share = np.clip((corners[:, 0] - a) @ (b - a) / max((b - a) @ (b - a), 1e-300), 0, 1)
            away = np.linalg.norm(corners[:, 0] - a - share[:, None] * (b - a), axis=1)
            near = away < capsule.radius + 0.008
            if near.any():
                parts.append(axis_gap(corners[near], a, b) - capsule.radius)
    assert min(gaps) > 15e-6
    assert min(parts) > 0.0
    # It leans on the heart for most of the time between, and the wall below it goes far.
    between = slice(len(gaps) * 3 // 10, len(gaps) * 8 // 10)
    assert np.median(gaps[between]) < 1e-3
    assert np.ptp(walls[between]) > 4e-3


def test_without_the_guard_the_same_hand_goes_into_it() -> None:
    run = Played(250.0, rule="off")
    assert run.watch.contacts > 0
    assert run.watch.crossing is not None
    assert run.watch.crossing.structure == "heart"
