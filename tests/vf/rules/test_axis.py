"""The certified rule for the axis of a capsule: leaks, steps of both ends, and what is special."""

from __future__ import annotations

from fractions import Fraction
from math import isqrt

import numpy as np
import pytest

import vf
from tests.support import convex, exact
from vf.tree import axis
from vf.tree.build import build

STANDOFF = 20e-6


def root(value: Fraction) -> float:
    """Square root, rounded down in its fortieth digit."""
    return isqrt(int(value * 10**80)) / 10**40


def some_triangles(rng: np.random.Generator, count: int, size: float) -> np.ndarray:
    """(m, 3, 3): of all sizes, every fifth a sliver, every seventh without area."""
    triangles = rng.normal(size=(count, 1, 3)) + rng.normal(
        size=(count, 3, 3)
    ) * 10.0 ** rng.uniform(-2, 0.3, (count, 1, 1))
    for k in range(0, count, 5):
        share = rng.uniform(-0.5, 1.5)
        thin = 10.0 ** rng.uniform(-12, -4) * rng.normal(size=3)
        triangles[k, 2] = triangles[k, 0] + share * (triangles[k, 1] - triangles[k, 0]) + thin
    for k in range(0, count, 7):
        triangles[k, 2] = triangles[k, 0]
    return size * triangles


def some_axis(rng: np.random.Generator, size: float) -> np.ndarray:
    """(2, 3), from a point to many times as long as the triangles."""
    start = size * rng.normal(size=3)
    length = rng.choice([0.0, 1e-9, 0.1, 1.0, 10.0])
    return np.array([start, start + length * size * rng.normal(size=3)])


def axis_beside(rng: np.random.Generator, triangles: np.ndarray) -> np.ndarray:
    """(2, 3), past one of the triangles, at a distance of 10 µm to 10 mm."""
    spot = rng.dirichlet([1.0, 1.0, 1.0]) @ triangles[rng.integers(len(triangles))]
    out, along = rng.normal(size=(2, 3))
    out *= 10.0 ** rng.uniform(-5, -2) / np.linalg.norm(out)
    along *= 0.03 * rng.choice([0.0, 0.1, 1.0])
    along -= (along @ out) * out / (out @ out) * rng.choice([0.0, 1.0])
    share = rng.uniform(-0.2, 1.2)
    return np.array([spot + out - share * along, spot + out + (1.0 - share) * along])


@pytest.mark.parametrize("away", [0.0, pytest.param(100.0, marks=pytest.mark.slow)])
def test_bounds_on_the_distance_to_a_triangle_are_never_too_large(away: float) -> None:
    rng = np.random.default_rng(0)
    close = 0
    for _ in range(25):
        triangles = some_triangles(rng, 7, 0.01) + away
        tree = build(triangles.reshape(-1, 3), np.arange(21).reshape(-1, 3))
        ends = some_axis(rng, 0.01) + away
        slack = 1e-14 * (away + 1.0)
        for t in range(7):
            gap = np.sqrt(axis.triangle_gap2(tree.corners, t, tree.errors, tuple(ends.ravel())))
            true = root(exact.axis_distance2(*ends, tree.corners[t].reshape(3, 3)))
            assert gap <= true + slack
            close += gap > true - 1e-9 * (1.0 + away)
    assert close > 0.99 * 25 * 7  # and hardly ever less than the distance


def test_bounds_on_the_distance_to_a_box_are_never_too_large() -> None:
    rng = np.random.default_rng(1)
    off = 0
    for _ in range(150):
        R, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        node = np.zeros((1, 16))
        node[0, :3] = rng.normal(size=3)
        node[0, 3:6] = 10.0 ** rng.uniform(-6, 0.5, 3)
        node[0, 6:15] = R.ravel()
        ends = some_axis(rng, 1.0) + rng.normal(size=3)
        signs = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).T.reshape(-1, 3)
        corners = node[0, :3] + (signs * node[0, 3:6]) @ R
        above, below = convex.distance_bounds(ends, corners)
        gap = np.sqrt(axis.box_gap2(node, 0, tuple(ends.ravel())))
        assert gap <= above + 1e-12
        off += gap < below - 1e-6
    assert off < 5  # a step short of the nearest point, hardly ever


@pytest.mark.parametrize("away", [0.0, 1e4])
def test_a_tree_out_of_reach_of_an_axis_has_no_corner_within_it(away: float) -> None:
    rng = np.random.default_rng(3)
    rejected = 0
    for _ in range(100):
        corners = some_triangles(rng, 9, 0.01).reshape(-1, 3) + away
        tree = build(corners, np.arange(27).reshape(-1, 3))
        ends = some_axis(rng, 0.05) + away
        along = ends[0] + np.linspace(0.0, 1.0, 101)[:, None] * (ends[1] - ends[0])
        gap = float(np.linalg.norm(along[:, None] - corners, axis=2).min())
        assert not axis.out_of_reach(tree.nodes, tuple(ends.ravel()), gap + 1e-9 * away)
        rejected += axis.out_of_reach(tree.nodes, tuple(ends.ravel()), 0.3 * gap)
    assert rejected > 30


def clear_of(triangles: np.ndarray, ends: np.ndarray) -> float:
    return root(min(exact.axis_distance2(*ends, triangle) for triangle in triangles))


@pytest.mark.parametrize("away", [0.0, pytest.param(30.0, marks=pytest.mark.slow)])
@pytest.mark.parametrize(("standoff", "rho"), [(0.0, 0.0), (STANDOFF, 0.0), (STANDOFF, 2e-3)])
def test_no_query_leaks_and_standing_still_is_allowed(
    away: float, standoff: float, rho: float
) -> None:
    rng = np.random.default_rng(2)
    planes = held = 0
    for _ in range(30):
        triangles = some_triangles(rng, 6, 0.01) + away
        ends = axis_beside(rng, triangles)
        radius = 10.0 ** rng.uniform(-4, -2)
        found = vf.certified_planes(exact.soup(triangles), ends, radius, standoff, rho)
        assert found.radius <= radius
        assert (found.normals @ ends.T >= found.offsets[:, None]).all()
        np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1.0, atol=1e-12)
        gap = clear_of(triangles, ends)
        if gap == 0.0:
            assert found.radius == 0.0
        if found.radius == 0.0:
            assert gap < 1e-9 * (1.0 + away)
            held += 1
            continue
        if gap > rho + 1e-9:
            assert exact.leaking(triangles, found, ends, rho).size == 0
        planes += len(found)
    assert planes > 12
    assert held < 30


def test_steps_of_both_ends_that_obey_keep_the_capsule_clear() -> None:
    rng = np.random.default_rng(3)
    steps = nearest = 0
    for _ in range(16):
        triangles = some_triangles(rng, 4, 0.01)
        ends = axis_beside(rng, triangles)
        rho = float(rng.choice([0.0, 1e-3]))
        found = vf.certified_planes(exact.soup(triangles), ends, 5e-3, 0.0, rho)
        if clear_of(triangles, ends) <= rho or not found.radius:
            continue
        for _ in range(8):
            way = rng.normal(size=(2, 3))
            way *= found.radius * rng.uniform(0.2, 1.0) / np.linalg.norm(way, axis=1).max()
            new = ends + way
            if len(found):
                # As far as the planes allow, where they forbid it.
                room = (found.normals @ ends.T - found.offsets[:, None]).ravel()
                down = -(found.normals @ way.T).ravel()
                limits = room[down > 0.0] / down[down > 0.0]
                new = ends + min(1.0, limits.min(initial=1.0) * (1.0 - 1e-9)) * way
                if not (found.normals @ new.T >= found.offsets[:, None]).all():
                    continue
            steps += 1
            for t in (0.6, 1.0):
                gap = clear_of(triangles, ends + t * (new - ends))
                assert gap > rho
                nearest += gap < rho + 1e-4
    assert steps > 40
    assert nearest > 5


def test_an_axis_of_no_length_is_a_tip() -> None:
    rng = np.random.default_rng(4)
    for _ in range(60):
        surface = exact.soup(some_triangles(rng, 12, 0.01)[1:5])
        x = 0.02 * rng.normal(size=3)
        rho = float(rng.choice([0.0, 1e-3]))
        tip = vf.certified_planes(surface, x, 5e-3, STANDOFF, rho)
        ball = vf.certified_planes(surface, [x, x], 5e-3, STANDOFF, rho)
        assert tip.triangles.tolist() == ball.triangles.tolist()
        np.testing.assert_allclose(tip.normals, ball.normals, atol=1e-9)
        np.testing.assert_allclose(tip.offsets, ball.offsets, atol=1e-11)
        assert tip.radius == pytest.approx(ball.radius, rel=1e-6)


FLOOR = np.array([[[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.5, 0.0]]])


def test_above_a_floor_the_plane_is_the_floors_moved_by_radius_and_standoff() -> None:
    for ends in (
        [[-0.05, 0, 0.004], [0.05, 0, 0.006]],
        [[0, 0, 0.004], [0, 0, 0.2]],
        [[0, 0, 0.2], [0, 0, 0.004]],
        [[0.05, 0, 0.006], [-0.05, 0, 0.004]],
        [[-0.05, 0, 0.004], [0.05, 0, 0.004]],
    ):
        found = vf.certified_planes(exact.soup(FLOOR), ends, 5e-3, STANDOFF, 2e-3)
        np.testing.assert_allclose(found.normals, [[0, 0, 1]], atol=1e-12)
        np.testing.assert_allclose(found.offsets, [2e-3 + STANDOFF], atol=1e-12)
        # Below the standoff it is as low as it is, less the little that lets it slide.
        low = np.array(ends) - [0.0, 0.0, 0.004 - 0.002 - 5e-6]
        found = vf.certified_planes(exact.soup(FLOOR), low, 5e-3, STANDOFF, 2e-3)
        assert low[:, 2].min() - 1.1e-8 <= found.offsets[0] <= low[:, 2].min()


def test_an_axis_that_meets_the_mesh_may_not_move() -> None:
    for ends in (
        [[0, 0, -0.1], [0, 0, 0.1]],
        [[0, 0, 0], [0, 0, 0.1]],
        [[-0.1, 0, 0], [0.1, 0, 0]],
    ):
        assert vf.certified_planes(exact.soup(FLOOR), ends, 5e-3, STANDOFF, 2e-3).radius == 0.0


def test_a_capsule_that_overlaps_gets_no_deeper() -> None:
    ends = np.array([[-0.05, 0, 0.001], [0.05, 0, 0.001]])
    found = vf.certified_planes(exact.soup(FLOOR), ends, 5e-3, STANDOFF, 2e-3)
    np.testing.assert_allclose(found.normals, [[0, 0, 1]], atol=1e-12)
    assert 0.001 - 1.1e-8 <= found.offsets[0] <= 0.001
    assert found.radius == 5e-3


def test_more_rims_than_the_budget_shrink_the_radius_and_still_do_not_leak() -> None:
    """Points on a helix around the axis: none is behind the plane of another."""
    k = np.arange(400)
    angle, rim = 2.4 * k, 2.0005e-3 * (1.0 + 1e-8 * (k % 97))
    points = np.column_stack([rim * np.cos(angle), rim * np.sin(angle), 2.5e-4 * k])
    surface = vf.Surface.from_arrays(points, k[:, None].repeat(3, axis=1))
    ends = np.array([[0.0, 0.0, -0.01], [0.0, 0.0, 0.11]])
    found = vf.certified_planes(surface, ends, 3e-3, 0.0, 2e-3)
    assert len(found) == 64
    assert 0.0 < found.radius < 3e-3
    assert exact.leaking(points[:, None].repeat(3, axis=1), found, ends, 2e-3).size == 0


def test_what_is_no_axis_is_refused() -> None:
    surface = exact.soup(FLOOR)
    with pytest.raises(ValueError, match="three finite numbers"):
        vf.certified_planes(surface, [[0, 0, 1], [0, 0, np.nan]], 1e-3)
    with pytest.raises(ValueError, match="three finite numbers"):
        vf.certified_planes(surface, [[0, 0, 1]], 1e-3)
    with pytest.raises(ValueError, match="within"):
        vf.certified_planes(surface, [[0, 0, 1], [0, 0, 1e9]], 1e-3)
