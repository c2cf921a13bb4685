"""Judges in rational arithmetic, compared with a second method that shares no code with them."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

import vf
from app.judges.exact import meets
from tests.support import exact, naive
from tests.support.clipped import distance2, uncovered

FLOOR = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]])


def planes(normals: list[list[float]], offsets: list[float], radius: float) -> vf.Planes:
    n = np.array(normals, dtype=float).reshape(-1, 3)
    index = np.zeros(len(n), dtype=np.int64)
    return vf.Planes(n, np.array(offsets, dtype=float), 0.0 * n, index, index, radius)


def test_the_distance_is_that_of_another_exact_way():
    """Small integers: two of three are degenerate, flat against x or at a corner."""
    rng = np.random.default_rng(1)
    for _ in range(400):
        triangle = rng.integers(-2, 3, (3, 3)).astype(float)
        x = rng.integers(-3, 4, 3).astype(float)
        assert distance2(triangle, x) == naive.exact_closest(triangle, x)[1]


@pytest.mark.parametrize("sliver", [1e-3, 1e-9, 1e-14])
def test_the_distance_to_a_sliver_is_a_fraction(sliver):
    triangle = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, sliver, 0.0]])
    assert distance2(triangle, np.array([0.5, 0.5 * sliver, 0.25])) == Fraction(1, 16)


def test_what_no_plane_covers_is_found_to_the_last_place():
    x = np.array([1.0, 1.0, 1.0])
    up = np.array([[0.0, 0.0, 1.0]])
    one = np.spacing(0.0)
    cases = [
        (np.empty((0, 3)), [], 1.0, 0.0, 1),  # touched by the closed ball
        (np.empty((0, 3)), [], np.nextafter(1.0, 0.0), 0.0, None),
        (np.empty((0, 3)), [], 0.5, 0.5, 1),
        (np.empty((0, 3)), [], 0.5, np.nextafter(0.5, 0.0), None),
        (up, [0.0], 1.0, 0.0, 1),  # on the plane is not behind it
        (up, [one], 1.0, 0.0, None),
        (up, [0.25], 1.0, 0.25, 1),  # nor on the plane moved back by the tip's radius
        (up, [0.25], 1.0, np.nextafter(0.25, 0.0), None),
    ]
    for normals, offsets, radius, tip, truth in cases:
        found = uncovered(FLOOR, normals, np.array(offsets), x, radius, tip)
        assert found == truth, (offsets, radius, tip)


def test_planes_cover_together_what_none_covers_alone():
    x = np.array([1.0, 1.0, 1.0])
    left, right = [-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]
    # Behind the first is x > 1 − a, behind the second x < 1 + b: a gap where a + b ≤ 0.
    for a, b, covered in ((0.5, 0.5, True), (-0.5, 0.25, False), (-0.25, 0.25, False)):
        found = uncovered(FLOOR, np.array([left, right]), np.array([-1.0 + a, 1.0 + b]), x, 9.0)
        assert (found is None) == covered


def test_uncovered_parts_are_those_of_sampled_points():
    rng = np.random.default_rng(2)
    shares = np.array([[i, j, 8 - i - j] for i in range(9) for j in range(9 - i)]) / 8.0
    seen = 0
    for _ in range(300):
        triangle = rng.integers(-4, 5, (3, 3)) * 8.0
        normals = rng.integers(-2, 3, (int(rng.integers(0, 4)), 3)).astype(float)
        offsets = rng.integers(-16, 9, len(normals)).astype(float)
        x, radius = rng.integers(-8, 9, 3).astype(float), float(rng.integers(1, 40))
        points = shares @ triangle  # exact: eighths of multiples of eight
        free = (points @ normals.T >= offsets).all(axis=1)
        inside = ((points - x) ** 2).sum(axis=1) <= radius**2
        found = uncovered(triangle, normals, offsets, x, radius)
        if (free & inside).any():
            seen += 1
            assert found is not None
            assert found <= Fraction(((points[free] - x) ** 2).sum(axis=1).min())
        elif not free.any() and found is not None:
            assert found <= Fraction(radius) ** 2
    assert seen > 50


def test_segments_and_triangles_meet_as_another_exact_way_says():
    """Small integers: a third of the triangles and segments are without area or length, or flat."""
    rng = np.random.default_rng(4)
    met = 0
    for _ in range(3000):
        triangle = rng.integers(-1, 2, (3, 3)).astype(float)
        a, b = rng.integers(-1, 2, (2, 3)).astype(float)
        if rng.random() < 0.3:
            triangle[:, 2] = a[2] = b[2] = 0.0
        assert meets(a, b, triangle) == exact.meets(a, b, triangle), (a, b, triangle)
        met += exact.meets(a, b, triangle)
    assert 500 < met < 2500


def test_all_triangles_are_looked_at():
    rng = np.random.default_rng(3)
    triangles = rng.integers(-3, 4, (60, 3, 3)).astype(float)
    leaks = 0
    for _ in range(20):
        a, b = rng.integers(-3, 4, (2, 3)).astype(float)
        rows = [t for t in range(60) if meets(a, b, triangles[t])]
        np.testing.assert_array_equal(exact.crossed(triangles, a, b), rows)
        n = rng.integers(-2, 3, (2, 3)).astype(float)
        found = planes(n.tolist(), [1.0, -1.0], 2.0)
        rows = [
            t
            for t in range(60)
            if uncovered(triangles[t], n, found.offsets, a, 2.0, 0.5) is not None
        ]
        np.testing.assert_array_equal(exact.leaking(triangles, found, a, 0.5), rows)
        leaks += len(rows)
    assert leaks > 50


def test_a_plane_that_is_a_hair_too_low_leaks():
    floor = np.array([[[-1.0, -1.0, 0.1], [1.0, -1.0, 0.1], [0.0, 1.0, 0.1]]])
    x = np.array([0.0, 0.0, 0.3])
    for offset, leaks in ((0.1, [0]), (np.nextafter(0.1, 1.0), [])):
        found = planes([[0.0, 0.0, 1.0]], [offset], 0.25)
        assert exact.leaking(floor, found, x).tolist() == leaks
        assert exact.obeys(found, x, np.array([0.0, 0.0, offset]))
        assert not exact.obeys(found, x, np.array([0.0, 0.0, 0.09]))
    surface = exact.soup(floor)
    np.testing.assert_array_equal(exact.triangles_of(surface), floor)
