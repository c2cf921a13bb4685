"""Presets in which anatomy moves, judged by where it truly is: by the formula, by brute force."""

from __future__ import annotations

from dataclasses import replace
from math import pi, sin

import numpy as np
import pytest

import vf
from app.control.engine import Engine, Orders
from app.control.messages import Command, LoopStats, Telemetry
from app.control.watch import Watch
from app.scenarios.presets import PRESETS
from app.scenarios.staging import course
from app.scene import scene as scenes
from app.scene.scene import Scene
from tests.support.brute import Oracle


def rise(name: str, time: float) -> float:
    """How far the anatomy of a preset is above where it rests [m]; from its sentence alone."""
    if name == "knock-on-the-table":
        s = min(max((time - 2.5) / 0.06, 0.0), 1.0)
        return 0.008 * (10.0 * s**3 - 15.0 * s**4 + 6.0 * s**5)
    return 0.012 * sin(pi * time / 4.0) ** 6


class Played:
    """A preset from its start to half a second after its script.

    Attributes:
        seen: telemetry of every tick.
        tips: (n + 1, 3) the tip before and after every tick, as the true anatomy sees it [m].
        judge: of the anatomy at rest.
    """

    def __init__(self, name: str, rate: float) -> None:
        scenario = PRESETS[name]
        options = replace(scenario.options, rate=rate)
        self.scene: Scene = scenes.build(options, 1)
        way = course(scenario, self.scene)
        assert way is not None
        plant = scenes.plant(replace(self.scene, autopilot=way), options)
        orders, stats = Orders(plant, Command(None, 0), autopilot=True), LoopStats()
        engine, self.watch = Engine(orders), Watch()
        self.seen: list[Telemetry] = []
        for _ in range(round((way.duration + 0.5) * rate)):
            telemetry, ticked = engine.advance(orders, stats)
            self.watch.take(orders, telemetry, ticked)
            self.seen.append(telemetry)
        self.watch.look()
        points = [self.scene.T_base_start.translation]
        points += [t.step.tip.translation for t in self.seen if t.step is not None]
        rises = [rise(name, k / rate) for k in range(len(points))]
        self.tips = np.array(points) - np.outer(rises, [0.0, 0.0, 1.0])
        surface = self.scene.surface
        self.judge = Oracle(surface.vertices, surface.faces)

    def statuses(self) -> list[vf.Status]:
        return [t.step.status for t in self.seen if t.step is not None]

    def depth(self, k: int) -> float:
        """How deep the tip is in the true anatomy after tick k − 1 [m]; 0: outside."""
        x = self.tips[k]
        if abs(self.judge.winding(x)) < 0.5:
            return 0.0
        a, b, c = self.judge.corners.transpose(1, 0, 2)
        normals = np.cross(b - a, c - a)
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        return float(np.abs(((x - a) * normals).sum(axis=1)).min())  # a cube is convex


RATES = [250.0, pytest.param(1000.0, marks=pytest.mark.slow)]


@pytest.mark.parametrize("rate", RATES)
def test_with_the_margin_for_its_age_the_true_liver_is_never_touched(rate: float) -> None:
    run = Played("breathing-liver", rate)
    assert run.judge.crossings(run.tips) == 0
    assert abs(run.judge.winding(run.tips[-1])) < 0.5
    assert run.watch.contacts == 0
    assert run.watch.crossing is None
    assert vf.Status.OVERTAKEN not in run.statuses()
    # The hand itself wants into it, and the liver did breathe.
    goals = np.array([t.target.translation for t in run.seen if t.target is not None])
    assert run.judge.crossings(goals) > 0
    assert max(t.phase for t in run.seen) == pytest.approx(len(run.seen) / rate)


@pytest.mark.parametrize("rate", RATES)
def test_without_that_margin_the_same_hand_meets_the_true_liver(rate: float) -> None:
    run = Played("breathing-liver-no-margin", rate)
    met = run.judge.crossings(run.tips)
    assert met > 0
    assert run.watch.contacts == met
    crossing = run.watch.crossing
    assert crossing is not None
    assert crossing.centre
    assert crossing.structure == "liver"
    # Where it was met, as the liver saw it: on its surface.
    resting = crossing.point - np.array([0.0, 0.0, rise("breathing", crossing.tick / rate)])
    assert run.scene.surface.nearest(resting)[0] < 1e-4


@pytest.mark.parametrize("rate", RATES)
def test_the_knock_overtakes_the_tool_and_the_hand_leads_it_out(rate: float) -> None:
    run = Played("knock-on-the-table", rate)
    statuses = run.statuses()
    knocked = next(k for k, status in enumerate(statuses) if status is vf.Status.OVERTAKEN)
    assert 2.5 < knocked / rate < 2.56
    assert vf.Status.INSIDE in statuses[knocked:]
    # Never touched before, inside after, and outside at the end.
    assert run.judge.crossings(run.tips[: knocked + 1]) == 0
    assert run.judge.crossings(run.tips) == run.watch.contacts == 2
    for k, status in enumerate(statuses):
        if status is vf.Status.OVERTAKEN:
            step = run.seen[k].step
            assert step is not None
            assert run.depth(k + 1) <= step.violation + 1e-9
    assert abs(run.judge.winding(run.tips[-1])) < 0.5
    assert statuses[-1] is vf.Status.SOLVED
    # Inside it goes no deeper, but for what the table still does; then the way out is the hand's.
    inside = [k for k, status in enumerate(statuses) if status is vf.Status.INSIDE]
    rested = [k for k in inside if k / rate > 2.57]
    depths = [run.depth(k + 1) for k in rested[:: max(len(rested) // 40, 1)]]
    assert max(np.diff(depths)) <= 1e-6
    assert depths[0] > 5e-3
