"""The judge of the whole instrument: exact distances, and contacts on the way of the joints."""

from __future__ import annotations

import dataclasses
from fractions import Fraction
from math import isqrt

import numpy as np
import pytest
import trimesh

import robots
import vf
from app.judges import boxes, exact, nearest, oracles, sweep
from robots import point
from tests.support import convex

SQUARE = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
HALVES = np.array([[0, 1, 2], [0, 2, 3]])


def root(value: Fraction) -> float:
    """Square root to more digits than a float has."""
    scale = 10**40
    return isqrt(int(value * scale * scale)) / scale


def test_exact_distances_of_cases_that_one_can_see() -> None:
    corners = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]])
    for a, b, known in (
        ([1, 1, 3], [1, 1, 5], 9),  # an end above the face
        ([1, 1, 3], [1, 1, -5], 0),  # through it
        ([0.5, 0.5, 2], [1, 1, 2], 4),  # parallel to it
        ([5, -1, 1], [5, 9, 1], 2),  # beside a corner
        ([-1, 3, -5], [-1, 3, 5], 1),  # beside an edge, skew to it
        ([2, 2, 0], [3, 3, 0], 0),  # touching an edge from outside
        ([-3, -4, 0], [-3, -4, 0], 25),  # a point
    ):
        assert exact.distance2(np.array(a, float), np.array(b, float), corners) == known
    needle = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [1.0, 0.0, 0.0]])  # no area
    assert exact.distance2(np.array([1.0, -1, 3]), np.array([1.0, 1, 3]), needle) == 9


def test_exact_distances_against_a_convex_program() -> None:
    """Within what the program says: the distance and a lower bound on it, from scratch."""
    rng = np.random.default_rng(0)
    for k in range(150):
        corners = rng.uniform(-1.0, 1.0, (3, 3))
        a, b = rng.uniform(-1.0, 1.0, (2, 3))
        if k % 5 == 0:
            corners[2] = corners[0] + (1.0 + 1e-7 * k) * (corners[1] - corners[0])
        if k % 7 == 0:
            b = a + (corners[1] - corners[0])
        gap = root(exact.distance2(a, b, corners))
        above, below = convex.distance_bounds(np.array([a, b]), corners)
        assert below - 1e-9 <= gap <= above + 1e-9
        assert above - below < 1e-6


def test_the_judges_floats_against_the_exact_distance() -> None:
    rng = np.random.default_rng(1)
    for _ in range(300):
        corners = rng.uniform(-1.0, 1.0, (3, 3)) * 10.0 ** rng.uniform(-3, 0)
        a = rng.uniform(-1.0, 1.0, 3)
        b = a + rng.normal(size=3) * 10.0 ** rng.uniform(-4, 0)
        gap2 = exact.distance2(a, b, corners)
        if gap2:
            assert oracles.distance(a, b, *corners) == pytest.approx(root(gap2), abs=1e-12)
        tree = boxes.build(corners, np.array([[0, 1, 2]]))
        assert nearest.nearest(tree, np.array([a, b]))[0] == pytest.approx(root(gap2), abs=1e-12)


def judge_of(arm: robots.Arm, at: np.ndarray, turn: np.ndarray, **options: float) -> sweep.Judge:
    """Beside a square of two metres at a place, turned."""
    return sweep.Judge(arm, SQUARE @ turn.T + at, HALVES, **options)


def test_a_needle_that_passes_a_sheet_between_two_clear_poses_is_seen() -> None:
    arm = point.load((0.0, 0.0, 0.05))
    small = 0.005 * SQUARE[:, [2, 0, 1]] + [0.0, 0.0, 0.03]  # stands upright across x, at x = 0
    judge = sweep.Judge(arm, small, HALVES)
    q, q_new = np.array([-0.01, 0.0, 0.0]), np.array([0.01, 0.0, 0.0])
    radius = point.NEEDLE_RADIUS
    assert judge.clearance(q) == pytest.approx([np.hypot(0.01, 0.025), 0.01 - radius])
    (touch,) = judge.touches(q, q_new)
    assert (touch.capsule, touch.before) == (1, False)
    assert touch.share == pytest.approx(0.5 * (0.01 - radius) / 0.01, abs=1e-6)
    # Up to there nothing is touched, nor by the tip below the sheet.
    assert not judge.touches(q, np.array([-radius - 1e-8, 0.0, 0.0]))
    (deep,) = judge.touches(np.array([-0.001, 0.0, 0.0]), q)
    assert deep.before
    assert deep.gap == pytest.approx(0.001 - radius)


def test_an_arc_that_bulges_into_a_wall_is_seen_though_its_chord_is_clear() -> None:
    arm = robots.load("psm")
    q, q_new = np.array([0.0, -0.3, 0.2, 0, 0, 0]), np.array([0.0, 0.3, 0.2, 0, 0, 0])
    low = arm.axes(np.array([0.0, 0.0, 0.2, 0, 0, 0]))[0, 1, 2] - arm.capsules[0].radius
    ends = arm.axes(q)[0, 1, 2]
    wall = 0.5 * (low + ends) - arm.capsules[0].radius
    judge = judge_of(arm, np.array([0.0, 0.0, wall]), np.eye(3))
    assert judge.clearance(q).min() > 1e-3
    assert judge.clearance(q_new).min() > 1e-3
    touches = judge.touches(q, q_new)
    assert 0 in [touch.capsule for touch in touches]
    deepest = judge_of(arm, np.array([0.0, 0.0, low - 1e-7]), np.eye(3))
    assert not deepest.touches(q, q_new)
    deepest = judge_of(arm, np.array([0.0, 0.0, low + 1e-6]), np.eye(3))
    assert deepest.touches(q, q_new)


@pytest.mark.parametrize("name", robots.names())
def test_the_jacobians_of_the_axes_are_their_derivatives(name: str) -> None:
    arm, rng = robots.load(name), np.random.default_rng(3)
    for _ in range(10):
        q = rng.uniform(arm.lower, arm.upper)
        J = arm.axis_jacobians(q)
        for j in range(len(q)):
            h = np.zeros(len(q))
            h[j] = 1e-6
            slope = (arm.axes(q + h) - arm.axes(q - h)) / 2e-6
            np.testing.assert_allclose(J[:, :, :, j], slope, atol=1e-8)


def test_contacts_against_dense_sampling() -> None:
    """Whatever the way: the judge sees what a thousand poses on it see, and nothing else."""
    arm, rng = robots.load("psm"), np.random.default_rng(4)
    shape = trimesh.creation.icosphere(subdivisions=3, radius=0.01)
    vertices, faces = np.array(shape.vertices), np.array(shape.faces)
    seen = missed = 0
    while seen < 8 or missed < 8:
        q = rng.uniform(arm.lower, arm.upper)
        k = rng.integers(len(arm.capsules))
        axis = arm.axes(q)[k]
        spot = axis[0] + rng.random() * (axis[1] - axis[0])
        out = np.cross(axis[1] - axis[0], rng.normal(size=3))
        out /= np.linalg.norm(out)
        at = vertices[(vertices @ out).argmax()]
        gap = arm.capsules[k].radius + rng.uniform(1e-5, 4e-4)
        judge = sweep.Judge(arm, vertices - at + spot - gap * out, faces)
        if judge.clearance(q).min() <= 0.0:
            continue
        q_new = arm.clamp(q + 0.003 * rng.normal(size=6))
        touched = {touch.capsule for touch in judge.touches(q, q_new)}
        ways = [q + t * (q_new - q) for t in np.linspace(0.0, 1.0, 25)]
        least = np.min([judge.clearance(way) for way in ways], axis=0)
        for i, gap in enumerate(least):
            if gap < 0.0:
                assert i in touched
                seen += 1
            elif i in touched:
                assert gap < 2e-4  # between two of the poses
            else:
                missed += gap < 1e-3


def test_the_ball_at_the_tip_is_judged_beside_the_capsules() -> None:
    arm = robots.load("psm")
    q = arm.neutral
    tip = arm.tip(q).translation
    judge = judge_of(arm, tip - [0.0, 0.0, 0.002], np.eye(3), tip_radius=0.003)
    assert judge.clearance(q)[0] == pytest.approx(-0.001)
    assert [t.capsule for t in judge.touches(q, q)] == [0]
    judge = judge_of(arm, tip - [0.0, 0.0, 0.002], np.eye(3))
    assert judge.clearance(q)[0] == pytest.approx(0.002)
    assert not judge.touches(q, q)


def test_in_the_trocar_zone_the_shaft_may_pass_the_mesh_and_nothing_else_may() -> None:
    arm = robots.load("psm")
    q = arm.neutral
    skin = np.array([0.0, 0.0, -0.003])
    assert {t.capsule for t in judge_of(arm, skin, np.eye(3)).touches(q, q)} == {2, 3}
    assert not judge_of(arm, skin, np.eye(3), trocar=0.02).touches(q, q)
    # The same mesh farther down is out of the zone, and the wrist is never exempt.
    lower = np.array([0.0, 0.0, -0.05])
    assert {t.capsule for t in judge_of(arm, lower, np.eye(3), trocar=0.02).touches(q, q)} == {2}
    wrist = arm.axes(q)[1].mean(axis=0)
    everywhere = judge_of(arm, wrist, np.eye(3), trocar=0.2)
    assert {t.capsule for t in everywhere.touches(q, q)} == {1}


def test_what_is_outside_a_ball_is_kept_and_what_is_in_it_is_not() -> None:
    rng = np.random.default_rng(5)
    triangles = SQUARE[HALVES]
    centre = np.array([0.3, -0.2, 0.1])
    kept, origin = sweep.outside_ball(triangles, centre, 0.5)
    assert (sweep._distances_to(kept, centre) >= 0.5).all()
    assert set(origin) == {0, 1}
    for p in np.column_stack([rng.uniform(-1, 1, (400, 2)), np.zeros(400)]):
        away = np.linalg.norm(p - centre)
        if away > 0.5 * (1.0 + sweep.FINE):
            assert sweep._distances_to(kept, p).min() < 1e-12


def test_leaks_along_an_axis_are_those_of_exact_distances() -> None:
    """Without planes a triangle leaks where it is near; a plane of its own takes it away."""
    rng = np.random.default_rng(6)
    seen = 0
    for _ in range(100):
        corners = rng.uniform(-1.0, 1.0, (3, 3))
        ends = rng.uniform(-1.0, 1.0, (2, 3))
        surface = vf.Surface.from_arrays(corners, np.array([[0, 1, 2]]))
        gap = root(exact.distance2(*ends, corners))
        if gap < 1e-6:
            continue
        for reach in (0.9 * gap, 1.1 * gap):
            leaking = sweep.leaks(surface, vf.Planes.none(reach), ends, reach)
            assert leaking == (gap < reach)
            seen += leaking
        assert sweep.apart(surface, ends, 0.9 * gap)
        assert not sweep.apart(surface, ends, 1.1 * gap + 1e-6)
        planes = vf.certified_planes(surface, ends, 1.5 * gap, 0.0, 0.2 * gap)
        assert not sweep.leaks(surface, planes, ends, planes.radius, 0.2 * gap)
        without = dataclasses.replace(planes, offsets=planes.offsets - gap)
        assert sweep.leaks(surface, without, ends, planes.radius, 0.2 * gap)
    assert seen > 50
