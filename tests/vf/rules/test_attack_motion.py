"""Attacks on what a tick really does: the curved path, the tip's speed, and freezing between walls.

The path of a tick is that of joints that move evenly from one position to the next.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest

import robots
import vf
from tests.support import exact

SHARES = np.linspace(0.0, 1.0, 17)
ARMS = ("psm", "panda", "ur5")


def turned(rng: np.random.Generator) -> np.ndarray:
    return np.asarray(pin.exp3(rng.normal(size=3) * 2.0))


def slot(gap: float, cells: int = 1, size: float = 0.03) -> np.ndarray:
    """Two parallel plates (m, 3, 3) across z, a gap apart, around the origin."""
    grid = np.linspace(-size, size, cells + 1)
    found = []
    for z in (-0.5 * gap, 0.5 * gap):
        for i in range(cells):
            for j in range(cells):
                a, b = [grid[i], grid[j], z], [grid[i + 1], grid[j], z]
                c, d = [grid[i + 1], grid[j + 1], z], [grid[i], grid[j + 1], z]
                found += [[a, b, c], [a, c, d]]
    return np.array(found)


def comb(pitch: float) -> np.ndarray:
    """Teeth (m, 3, 3) across x, the origin between two of them and below their tips."""
    teeth = [
        [[k * pitch, -0.02, -0.03], [k * pitch, 0.02, -0.03], [k * pitch, 0, 0]]
        for k in range(-12, 13)
    ]
    return np.array(teeth) - [0.5 * pitch, 0.0, -2e-3]


def soup(rng: np.random.Generator) -> np.ndarray:
    return rng.normal(size=(60, 1, 3)) * 0.015 + rng.normal(size=(60, 3, 3)) * 0.006


# The path between two ticks


def path_of(arm: robots.Arm, q: np.ndarray, q_new: np.ndarray) -> np.ndarray:
    return np.array([arm.tip(q + t * (q_new - q)).translation for t in SHARES])


def crossings_on_the_path(
    name: str, triangles: np.ndarray, period: float, seed: int, radius: float | None
) -> tuple[int, float]:
    """Drive an arm wildly between triangles around its tip: ticks that cross, and the way gone."""
    rng = np.random.default_rng(seed)
    arm = robots.load(name)
    turn = turned(rng)
    q = np.array(arm.neutral)
    T = arm.tip(q)
    x = T.translation
    triangles = triangles @ turn.T + x
    fixture = vf.MeshFixture(exact.soup(triangles), radius=radius)
    controller = vf.Controller(arm, [fixture], vf.Settings(dt=period))
    crossed, gone = 0, 0.0
    for _ in range(40):
        rotation = pin.exp3(rng.normal(size=3) * 0.3) @ T.rotation
        goal = pin.SE3(rotation, x + turn @ (rng.normal(size=3) * 0.03))
        step = controller.step(q, goal)
        path = path_of(arm, q, step.q)
        crossed += any(exact.crossed(triangles, a, b).size for a, b in pairwise(path))
        gone += float(np.linalg.norm(path[-1] - path[0]))
        q = step.q
    return crossed, gone


@pytest.mark.parametrize("period", [1e-2, 2e-2, 5e-2])
@pytest.mark.parametrize("name", ARMS)
def test_the_true_path_crosses_no_wall_of_a_slot_at_any_rate(name: str, period: float) -> None:
    for gap in (60e-6, 300e-6):
        for seed in range(3):
            crossed, gone = crossings_on_the_path(name, slot(gap), period, seed, None)
            assert crossed == 0, f"slot {gap * 1e6:.0f} µm, seed {seed}: {crossed} ticks of 40"
            assert gone > 1e-3  # by which the tool still moves


@pytest.mark.slow
@pytest.mark.parametrize("period", [1e-3, 5e-3, 2e-2, 5e-2])
@pytest.mark.parametrize("name", ARMS)
def test_the_true_path_crosses_nothing_at_any_rate(name: str, period: float) -> None:
    for seed in range(5):
        scenes = {
            "slot": slot(10.0 ** np.random.default_rng(seed).uniform(-5.0, -3.0)),
            "comb": comb(1e-3),
            "soup": soup(np.random.default_rng(seed)),
        }
        for scene, triangles in scenes.items():
            for radius in (None, 5e-3):
                crossed, _ = crossings_on_the_path(name, triangles, period, seed, radius)
                assert crossed == 0, f"{scene}, seed {seed}, radius {radius}: {crossed} ticks"


@pytest.mark.parametrize("name", ARMS)
def test_the_true_path_stays_in_a_narrow_corridor_at_a_low_rate(name: str) -> None:
    width = 100e-6
    for seed in range(3):
        rng = np.random.default_rng(seed)
        arm = robots.load(name)
        turn = turned(rng)
        q = np.array(arm.neutral)
        T = arm.tip(q)
        ends = T.translation + np.array([-0.03, 0.03])[:, None] * turn[:, 0]
        corridor = vf.CorridorFixture(ends, turn[:, 2], width=width)
        controller = vf.Controller(arm, [corridor], vf.Settings(dt=0.02))
        for _ in range(40):
            goal = T.translation + turn @ (rng.normal(size=3) * 0.03)
            step = controller.step(q, pin.SE3(T.rotation, goal))
            off = (path_of(arm, q, step.q) - T.translation) @ turn[:, 1]
            assert np.abs(off).max() <= width
            q = step.q


# The tip's speed


@pytest.mark.parametrize("period", [1e-3, 1e-2, 5e-2])
@pytest.mark.parametrize("name", ARMS)
def test_no_tick_moves_the_tip_by_more_than_its_speed_allows(name: str, period: float) -> None:
    arm = robots.load(name)
    far = exact.soup(np.array([[[9.0, 9, 9], [9, 9, 8], [9, 8, 9]]]))
    rng = np.random.default_rng(1)
    for speed in (1e-3, 1e-2, 5e-2):
        settings = vf.Settings(dt=period, tip_speed=speed)
        controller = vf.Controller(arm, [vf.MeshFixture(far)], settings)
        for _ in range(40):
            q = arm.lower + (arm.upper - arm.lower) * rng.uniform(0.05, 0.95, len(arm.lower))
            T = arm.tip(q)
            rotation = pin.exp3(rng.normal(size=3) * 2.0) @ T.rotation
            goal = pin.SE3(rotation, T.translation + rng.normal(size=3) * 0.02)
            for _ in range(2):
                step = controller.step(q, goal)
                moved = np.linalg.norm(arm.tip(step.q).translation - arm.tip(q).translation)
                assert moved <= speed * period * (1.0 + 1e-9)
                q = step.q


# Freezing


def slides(name: str, seed: int, tip_radius: float) -> list[float]:
    """How far [m] a tool is led along a slot, three ways, after a rough ride."""
    rng = np.random.default_rng(seed)
    turn = turned(rng)
    arm = robots.load(name)
    q = np.array(arm.neutral)
    T = arm.tip(q)
    gap = 10.0 ** rng.uniform(-6.0, -3.3)
    beside = [1.3e-3, 0.7e-3, rng.uniform(-0.45, 0.45) * gap]
    triangles = (slot(gap + 2.0 * tip_radius) - beside) @ turn.T + T.translation
    fixture = vf.MeshFixture(exact.soup(triangles), radius=(None, 5e-3, 5e-5)[seed % 3])
    controller = vf.Controller(arm, [fixture], vf.Settings(tip_radius=tip_radius))
    for _ in range(5):
        way = rng.normal(size=3)
        for _ in range(20):
            x = arm.tip(q).translation
            goal = pin.SE3(T.rotation, x + 4e-3 * way / np.linalg.norm(way))
            q = np.array(controller.step(q, goal).q)
    x = arm.tip(q).translation
    gone = []
    for way in (turn[:, 0], -turn[:, 0], turn[:, 1]):
        led = q
        for _ in range(60):
            led = np.array(controller.step(led, pin.SE3(T.rotation, x + 1e-3 * way)).q)
        gone.append(float((arm.tip(led).translation - x) @ way))
    return gone


def slides_everywhere(name: str, seed: int, tip_radius: float) -> None:
    gone = slides(name, seed, tip_radius)
    # In the narrowest slots a curved path has hardly any room, so the tool is slow there.
    assert min(gone) > 1e-5, f"{name}, seed {seed}, tip {tip_radius}: {gone}"


@pytest.mark.parametrize("name", ["point", *ARMS])
def test_a_tool_in_a_narrow_slot_can_always_slide(name: str) -> None:
    for seed in (0, 1, 2, 3, 30, 54):  # with the last three arms froze, each in a slot below 40 µm
        slides_everywhere(name, seed, 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("tip_radius", [0.0, 5e-4])
@pytest.mark.parametrize("name", ["point", *ARMS])
def test_a_tool_in_any_slot_can_always_slide(name: str, tip_radius: float) -> None:
    for seed in range(30):
        slides_everywhere(name, seed, tip_radius)


@pytest.mark.parametrize("walls", ["one mesh", "two meshes", "mesh and corridor", "corridor"])
@pytest.mark.parametrize("name", ["psm", "panda"])
def test_a_tool_pressed_on_a_wall_of_a_narrow_slot_does_not_creep_to_it(
    name: str, walls: str
) -> None:
    """Ticks may leave a plane by 10 nm: from the middle that would be at the wall after 500."""
    rng = np.random.default_rng(3)
    turn = turned(rng)
    arm = robots.load(name)
    q = np.array(arm.neutral)
    T = arm.tip(q)
    gap = 1e-5
    plates = slot(gap) @ turn.T + T.translation
    ends = T.translation + np.array([-0.03, 0.03])[:, None] * turn[:, 0]
    corridor = vf.CorridorFixture(ends, turn[:, 1], width=0.5 * gap)
    low, high = vf.MeshFixture(exact.soup(plates[:2])), vf.MeshFixture(exact.soup(plates[2:]))
    fixtures: dict[str, list[vf.Fixture]] = {
        "one mesh": [vf.MeshFixture(exact.soup(plates))],
        "two meshes": [low, high],
        "mesh and corridor": [low, corridor],
        "corridor": [corridor],
    }
    controller = vf.Controller(arm, fixtures[walls])
    highest = gone = 0.0
    for k in range(1200):
        if k % 200 == 0:
            way = turn @ np.array([*rng.normal(size=2) * 4e-3, -3e-3])
            rotation = pin.exp3(rng.normal(size=3) * 0.2) @ T.rotation
        step = controller.step(q, pin.SE3(rotation, T.translation + way))
        assert step.status is not vf.Status.HELD
        if k >= 1000:
            gone += float(np.linalg.norm(step.tip.translation - arm.tip(q).translation))
        q = step.q
        highest = max(highest, abs(float((step.tip.translation - T.translation) @ turn[:, 2])))
    assert highest < 0.4 * gap
    assert gone > 1e-3  # and slides as well as ever
