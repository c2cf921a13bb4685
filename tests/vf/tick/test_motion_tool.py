"""The whole instrument beside structures that move, judged by the true motion of both."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
import trimesh

import robots
import vf
from tests.support import moving, naive
from vf import Status

STANDOFF = vf.Settings.standoff


def campaign(seed: int, ticks: int, dt: float) -> dict[Status, int]:
    """A box that moves at random towards a part of the instrument, while hands pull at the tip."""
    rng = np.random.default_rng(seed)
    arm = robots.load("psm")
    shape = trimesh.creation.box(rng.uniform(0.004, 0.02, 3))
    surface = vf.Surface.from_arrays(shape.vertices, shape.faces)
    triangles = surface.vertices[surface.faces]
    margin = 0.3e-3 * (seed % 2)
    fixture = vf.MeshFixture(surface, radius=[None, 5e-3][seed % 2], margin=margin)
    controller = vf.Controller(arm, [fixture], vf.Settings(dt=dt, guard="tool"))
    counts = dict.fromkeys(Status, 0)
    q, T, twist, goal = arm.neutral, pin.SE3.Identity(), np.zeros(6), arm.tip(arm.neutral)
    clear = False
    contacts = 0
    for k in range(ticks):
        if k % 200 == 0:
            # Beside a random place of a random capsule.
            q = arm.neutral + rng.normal(size=6) * 0.1
            number = int(rng.integers(len(arm.capsules)))
            a, b = arm.axes(q)[number]
            u = naive.unit(rng)
            along = np.linalg.norm(b - a)
            if along > 0.0:
                u = np.cross(u, b - a)
                u /= np.linalg.norm(u)
            apart = 0.5 * np.linalg.norm(shape.extents) + arm.capsules[number].radius + 1e-3
            place = a + rng.uniform(0.35, 1.0) * (b - a) + apart * u
            T = pin.SE3(naive.rotation(rng), place)
            # It may be in another part.
            clear = moving.capsules_clearance(arm, q, q, triangles, T, T) > 0.0
        if k % 25 == 0:
            number = int(rng.integers(len(arm.capsules)))
            a, b = arm.axes(q)[number]
            towards = a + rng.uniform(0.35, 1.0) * (b - a) - T.translation
            towards = T.rotation.T @ towards / max(np.linalg.norm(towards), 1e-9)
            twist[:3] = 0.2 * rng.uniform(0.4, 1.0) * (0.8 * towards + 0.3 * naive.unit(rng))
            twist[3:] = 2.0 * rng.random() * naive.unit(rng)
            goal = arm.tip(q)
            goal = pin.SE3(goal.rotation, goal.translation + rng.normal(size=3) * 0.01)
        after = T * pin.exp6(twist * dt)
        target = goal if k % 50 < 25 else arm.tip(q)
        step = controller.step(q, target, motions=[vf.Motion(T, after)])
        counts[step.status] += 1
        case = f"seed {seed}, tick {k}, {step.status.name}"
        touched = float(np.min(step.planes.slack(step.tip.translation), initial=1.0)) < STANDOFF
        contacts += touched or bool((step.multipliers > 0.0).any())
        least = moving.capsules_clearance(arm, q, step.q, triangles, T, after)
        if not clear and step.status is not Status.INSIDE:
            # A body that overlapped when the tick began: how deep it is is said, until it is out.
            ended = moving.capsules_clearance(arm, step.q, step.q, triangles, after, after)
            if ended < 0.0 and step.status is not Status.HELD:
                assert step.status is Status.OVERTAKEN, f"{case}: {ended}"
                assert -ended <= step.violation + 1e-9, f"{case}: {ended}, {step.violation}"
        if step.status is Status.OVERTAKEN:
            if clear:
                assert -min(least, 0.0) <= step.violation, f"{case}: {least}, {step.violation}"
            clear = clear and least > 0.0
        elif clear and step.status is not Status.INSIDE:
            assert least > 0.0, f"{case}: clearance {least}"
        q, T = step.q, after
    assert contacts > ticks / 20  # or nothing was tried
    return counts


@pytest.mark.parametrize("seed", [0, 1])
def test_no_part_is_met_unless_the_tool_was_overtaken(seed: int) -> None:
    counts = campaign(seed, 200, 1e-3)
    assert counts[Status.SOLVED] + counts[Status.SHORTENED] > 60


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(0, 8, 3))
def test_no_part_is_met_in_long_campaigns_unless_the_tool_was_overtaken(seed: int) -> None:
    campaign(seed, 1500, [1e-3, 5e-3][seed // 4])
