"""Attacks on inside and outside: hollow bodies, and a second body behind the way out."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest

import robots
import vf
from tests.support import exact
from tests.support.bodies import (
    BOX_FACES,
    STRAIGHT,
    ball,
    box,
    cells,
    crossing,
    folded,
    together,
    wrong,
)


def drive(
    surface: vf.Surface, start: np.ndarray, goal: np.ndarray, ticks: int, **settings: float
) -> tuple[np.ndarray, list[vf.Status], list[int]]:
    """A free tip from start to goal (3,): where it ends, statuses, the triangles it crossed."""
    arm = robots.load("point")
    controller = vf.Controller(arm, [vf.MeshFixture(surface)], vf.Settings(**settings))
    triangles = exact.triangles_of(surface)
    q, statuses, crossed = np.asarray(start, dtype=float), [], []
    for _ in range(ticks):
        step = controller.step(q, pin.SE3(STRAIGHT, np.asarray(goal, dtype=float)))
        if (step.q != q).any():
            crossed += exact.crossed(triangles, q, step.q).tolist()
        statuses.append(step.status)
        q = step.q
    return q, statuses, crossed


# An inside that is no ground for leading anything through a wall


@pytest.mark.parametrize("turned", [False, True])
def test_the_cavity_of_a_hollow_body_is_no_inside_however_it_is_wound(turned: bool) -> None:
    surface = together(ball(0.05, outwards=not turned), ball(0.04, outwards=not turned))
    assert surface.closed
    assert not surface.inside(np.zeros(3))
    assert surface.inside(np.array([0.045, 0.0, 0.0]))  # the wall itself
    assert not surface.inside(np.array([0.06, 0.0, 0.0]))
    start = np.array([0.03, 0.0, 0.0])
    end, statuses, crossed = drive(surface, start, np.array([-0.03, 0.01, 0.0]), 350)
    assert np.linalg.norm(end - [-0.03, 0.01, 0.0]) < 1e-4  # it moves freely in there
    assert not crossed
    assert vf.Status.INSIDE not in statuses
    end, _, crossed = drive(surface, start, np.array([0.09, 0.002, 0.001]), 200)
    assert not crossed
    assert np.linalg.norm(end) < 0.04


@pytest.mark.parametrize("copies", [2, 3])
def test_walls_around_a_region_wound_several_times_let_nothing_through(copies: int) -> None:
    """Shells a hair apart, all wound alike, as voxel tools export them: not repeated faces."""
    surface = together(*(ball(0.02 + 1e-4 * k) for k in range(copies)))
    assert round(abs(surface.winding(np.zeros(3)))) == copies
    end, statuses, crossed = drive(surface, [0.015, 0.0, 0.0], [0.05, 0.0, 0.0], 200)
    assert not crossed
    assert np.linalg.norm(end) < 0.02
    assert vf.Status.INSIDE not in statuses


def test_a_body_in_the_cavity_of_another_is_still_one() -> None:
    """A bead in a hollow body: winding 1 in the wall, 0 in the cavity and 1 in the bead."""
    surface = together(ball(0.05), ball(0.04, outwards=False), ball(0.01))
    assert not surface.inside(np.array([0.025, 0.0, 0.0]))
    assert surface.inside(np.zeros(3))
    end, _, crossed = drive(surface, [0.008, 0.0, 0.0], [0.03, 0.0, 0.0], 400)
    assert 0.01 < np.linalg.norm(end) < 0.04  # led out of the bead, into the cavity and no farther
    radii = np.linalg.norm(exact.triangles_of(surface)[crossed], axis=2).max(axis=1)
    assert (radii < 0.011).all()


# What lies behind the way out


@pytest.mark.parametrize("tip", [0.0, 5e-4])
@pytest.mark.parametrize(
    ("depth", "gap", "thick"),
    [
        (5e-6, 1e-5, 5e-6), (1e-6, 2e-5, 1e-5), (5e-6, 3e-4, 2e-4), (1e-3, 1e-5, 5e-6),
        (2e-5, 2e-6, 1e-7), (3e-7, 5e-5, 1e-4), (1e-8, 1e-7, 1e-7),
        (0.0, 1e-5, 5e-6), (0.0, 2e-9, 3e-9), (0.0, 5e-10, 8e-9), (0.0, 2e-8, 3e-9),
    ],
)  # fmt: skip
def test_the_way_out_of_a_body_passes_no_second_one(
    depth: float, gap: float, thick: float, tip: float
) -> None:
    """From inside by `depth`, or from exactly on the surface, under a shell `gap` above it."""
    body = box((-0.01, -0.01, -0.01), (0.01, 0.01, 0.0))
    shell = box((-0.008, -0.008, gap), (0.008, 0.008, gap + thick))
    surface = together(body, shell)
    for period in (1e-3, 5e-3):
        for aside in (0.0, 1e-3):
            start = np.array([aside, 0.5 * aside, -depth])
            goal = np.array([aside, -aside, 5e-3])
            _, _, crossed = drive(surface, start, goal, 30, tip_radius=tip, dt=period)
            through = [t for t in crossed if t >= len(BOX_FACES)]
            assert not through, f"period {period}, {aside} m aside"


def test_the_way_out_is_still_a_way_out() -> None:
    """Alone, or with a shell far enough to stand before: out, and no deeper on the way."""
    body = box((-0.01, -0.01, -0.01), (0.01, 0.01, 0.0))
    shell = box((-0.008, -0.008, 2e-3), (0.008, 0.008, 2.2e-3))
    for surface in (together(body), together(body, shell)):
        for depth in (0.0, 1e-6, 1e-3):
            end, statuses, crossed = drive(surface, [0, 0, -depth], [0, 0, 1e-3], 400)
            assert end[2] > 20e-6 - 1e-6
            assert statuses[-1] is not vf.Status.INSIDE
            assert all(t < len(BOX_FACES) for t in crossed)


@pytest.mark.parametrize("tip", [0.0, 5e-4])
@pytest.mark.parametrize(("gap", "thick"), [(1e-6, 1e-6), (5e-6, 2e-6), (2e-6, 1e-5), (1e-7, 1e-7)])
def test_a_tick_on_the_way_out_passes_a_sheet_that_folds_back_only_once(
    gap: float, thick: float, tip: float
) -> None:
    """Below a flap of the same body, near the root where both hang together."""
    flap = {(0, 0), (1, 0), (2, 0), (1, 1), (1, 2), (2, 2)}
    xs, zs = [-5e-3, -4 * gap, 0.0, 5e-3], [-5e-3, 0.0, gap, gap + thick]
    surface = cells(flap, xs, zs, 4e-3)
    assert surface.closed
    triangles = exact.triangles_of(surface)
    arm = robots.load("point")
    controller = vf.Controller(arm, [vf.MeshFixture(surface)], vf.Settings(tip_radius=tip))
    for depth in (1e-7, 1e-6, 5e-6):
        for aside in (0.5 * gap, 3.0 * gap, 2e-6, 1e-5):
            q = np.array([aside, 1e-3, -depth])
            for _ in range(10):
                new = controller.step(q, pin.SE3(STRAIGHT, q + np.array([0.0, 0.0, 5e-3]))).q
                crossed = triangles[exact.crossed(triangles, q, new)] if (new != q).any() else []
                heights = {t[0, 2] for t in crossed if np.ptp(t[:, 2]) == 0.0}
                assert len(heights) <= 1, f"{depth} m deep, {aside} m from the root"
                q = new
            assert q[2] > -1e-8 or aside < gap  # and out it comes


# Bodies that overlap, and walls nearer to each other than a tip can tell


@pytest.mark.parametrize("tip", [0.0, 5e-4])
@pytest.mark.parametrize("period", [1e-3, 5e-3])
@pytest.mark.parametrize("away", [0.0, 1e-12, 1e-9, 1e-8, 1e-6, 5e-6, 1e-4])
def test_a_tool_in_one_body_is_not_led_through_the_wall_of_another(
    away: float, period: float, tip: float
) -> None:
    """The nearest wall leads into what both have in common."""
    surface = together(
        box((-0.01, -0.01, -0.01), (0.01, 0.01, 0.01)), box((0.0, -0.005, -0.005), (0.02,) * 3)
    )
    assert not surface.inside([0.005, 0.0, 0.0])
    for goal in ([0.005, 0.0, 0.0], [0.03, 2e-3, 1e-3], [-1e-3, 0.0, 0.0], [1e-3, 0.02, 0.0]):
        start = np.array([-away, 1e-3, 5e-4])
        end, statuses, crossed = drive(surface, start, goal, 20, tip_radius=tip, dt=period)
        assert not crossed, goal
        assert end[0] <= 0.0
        if away > 1e-11:
            assert set(statuses) == {vf.Status.INSIDE}


@pytest.mark.parametrize("goal", [(-0.03, 0.01, 0.0), (-0.004, 0.012, 0.0), (0.01, 0.03, 0.0)])
def test_beside_an_overlapping_body_there_is_a_way_out(goal: tuple[float, ...]) -> None:
    surface = together(
        box((-0.01, -0.01, -0.01), (0.01, 0.01, 0.01)), box((0.0, -0.02, -0.02), (0.02,) * 3)
    )
    end, statuses, crossed = drive(surface, [-1e-4, 9.95e-3, 0.0], goal, 400)
    assert statuses[0] is vf.Status.INSIDE
    assert statuses[-1] is not vf.Status.INSIDE
    assert exact.winding(exact.triangles_of(surface), end) == 0
    assert all(t < len(BOX_FACES) for t in crossed)


def attack(
    name: str, surface: vf.Surface, start: np.ndarray, up: np.ndarray, rng: np.random.Generator
) -> int:
    """A few ticks of an arm whose tip starts at `start` in the frame of the mesh, towards anything.

    Returns:
        How many ticks began inside.
    """
    arm = robots.load(name)
    turn = pin.exp3(rng.normal(size=3)) if rng.random() < 0.5 else STRAIGHT
    q = np.clip(
        arm.neutral + 0.06 * rng.uniform(-1, 1, len(arm.lower)) * (arm.upper - arm.lower),
        arm.lower, arm.upper,
    )  # fmt: skip
    placed = (surface.vertices - start) @ turn.T + arm.tip(q).translation
    surface = vf.Surface.from_arrays(placed, surface.faces)
    triangles = exact.triangles_of(surface)
    settings = vf.Settings(
        tip_radius=rng.choice([0.0, 5e-4, 5e-3]), dt=rng.choice([1e-3, 5e-3, 2e-2]),
        standoff=rng.choice([1e-6, 2e-5, 1e-3]),
    )  # fmt: skip
    controller = vf.Controller(arm, [vf.MeshFixture(surface)], settings)
    opponent, ahead = rng.integers(4), rng.normal(size=3)
    began = 0
    for _ in range(rng.integers(3, 10)):
        T = arm.tip(q)
        x = T.translation
        to_wall = surface.nearest(x)[2] - x
        wish = (turn @ up, ahead, rng.normal(size=3), to_wall)[opponent]
        goal = x + 5e-3 * wish / max(float(np.linalg.norm(wish)), 1e-12)
        step = controller.step(q, pin.SE3(T.rotation, goal))
        began += step.status is vf.Status.INSIDE
        if (step.q != q).any() and exact.winding(triangles, x) is not None:
            why = wrong(triangles, x, step.tip.translation)
            assert not why, (why, x.tolist(), step.tip.translation.tolist(), settings)
            places = np.linspace(0.0, 1.0, 5)[:, None]
            path = [arm.tip(p).translation for p in (1.0 - places) * q + places * step.q]
            met = [exact.passages(triangles, *ends) for ends in pairwise(path)]
            assert sum(len({place for _, place, _ in m}) for m in met) <= 1
        q = step.q
    return began


def attack_folds(arms: list[str], seed: int, cases: int) -> int:
    rng = np.random.default_rng(seed)
    began = 0
    for _ in range(cases):
        surface, zs = folded(rng, 10 ** rng.uniform(-9, -5))
        aside = 10 ** rng.uniform(-9, -4) * rng.choice([-1, 1], p=[0.25, 0.75])
        layer = int(rng.integers(1, len(zs) - 1))
        low, high = zs[layer], zs[layer + 1]
        height = -(10 ** rng.uniform(-9, -4.3)) if rng.random() < 0.7 else rng.uniform(low, high)
        start = np.array([aside, 1e-3 * rng.uniform(-1, 1), height])
        began += attack(rng.choice(arms), surface, start, np.array([0.0, 0.0, 1.0]), rng)
    return began


def attack_overlaps(arms: list[str], seed: int, cases: int) -> int:
    rng = np.random.default_rng(seed)
    began = 0
    for _ in range(cases):
        surface = crossing(rng)
        face = rng.integers(len(surface.faces))
        point = rng.dirichlet([1, 1, 1]) @ exact.triangles_of(surface)[face]
        aside = rng.choice([-1, 1]) * 10 ** rng.uniform(-9, -4)
        start = point + aside * surface.normals[face]
        began += attack(rng.choice(arms), surface, start, -surface.normals[face], rng)
    return began


@pytest.mark.parametrize("gap", [1e-9, 1e-8, 1.3e-7])
@pytest.mark.parametrize("depth", [2.2e-9, 5e-9, 9e-9])
def test_sheets_next_to_the_root_of_a_fold_are_passed_one_at_most(depth: float, gap: float) -> None:
    """The first of three walls is as far from the tip as the root that they hang together by."""
    flap = {(0, 0), (1, 0), (2, 0), (1, 1), (1, 2), (2, 2)}
    surface = cells(flap, [-5e-3, -1e-6, 0.0, 5e-3], [-5e-3, 0.0, gap, 2.0 * gap], 4e-3)
    triangles = exact.triangles_of(surface)
    for aside in (1e-9, 3.2e-9, 1e-6):
        _, _, crossed = drive(surface, [aside, 1e-3, -depth], [aside, 1e-3, 5e-3], 10)
        heights = {t[0, 2] for t in triangles[crossed] if np.ptp(t[:, 2]) == 0.0}
        assert heights <= {0.0}, aside


ARMS = ["psm", "panda", "ur5"]


def test_a_tick_passes_one_of_many_sheets_of_a_fold() -> None:
    assert attack_folds(["point"], 1, 20) > 40


def test_a_tick_passes_no_wall_that_does_not_lead_out_of_all_bodies() -> None:
    assert attack_overlaps(["point"], 0, 20) > 20


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_no_arm_passes_what_does_not_lead_out(seed: int) -> None:
    assert attack_folds(ARMS, 10 + seed, 100) > 150
    assert attack_overlaps(ARMS, 20 + seed, 100) > 80
