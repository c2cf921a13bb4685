"""Closest points of single triangles against exact rational arithmetic."""

from __future__ import annotations

from math import sqrt

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import vf
from tests.support import naive
from vf.tree.closest import distance2_to_triangle, distance_error, well_shaped

FEATURE_OF_WEIGHTS = {
    (True, True, True): vf.Feature.FACE,
    (True, True, False): vf.Feature.EDGE_0,
    (False, True, True): vf.Feature.EDGE_1,
    (True, False, True): vf.Feature.EDGE_2,
    (True, False, False): vf.Feature.VERTEX_0,
    (False, True, False): vf.Feature.VERTEX_1,
    (False, False, True): vf.Feature.VERTEX_2,
}

small = st.integers(-4, 4)
points = st.tuples(small, small, small).map(lambda t: np.array(t, dtype=float))
triangles = st.tuples(points, points, points).map(np.array)


def _check(triangle: np.ndarray, x: np.ndarray, tolerance: float) -> None:
    """Distance and point within the tolerance of the exact ones, and the feature consistent."""
    expected, square = naive.exact_closest(triangle, x)
    point, feature, distance = vf.closest_point(triangle, x)
    case = f"triangle {triangle.tolist()}, x {x.tolist()}"
    assert distance == pytest.approx(sqrt(square), abs=tolerance), case
    assert np.abs(point - np.array([float(v) for v in expected])).max() <= tolerance, case
    k = int(feature)
    if feature >= vf.Feature.VERTEX_0:
        assert (point == triangle[k - 4]).all(), case
    elif feature >= vf.Feature.EDGE_0:
        a, b = triangle[k - 1], triangle[k % 3]
        assert np.linalg.norm(np.cross(b - a, point - a)) <= 10 * tolerance * max(
            1.0, np.linalg.norm(b - a)
        ), case


@naive.PROPERTY
@given(triangles, points)
@example(np.zeros((3, 3)), np.array([1.0, 2.0, 3.0]))  # a point
@example(np.array([[0, 0, 0], [2, 2, 2], [1, 1, 1]], dtype=float), np.array([1.0, 0.0, 0.0]))
@example(np.array([[0, 0, 0], [0, 0, 0], [3, 0, 0]], dtype=float), np.array([1.0, 1.0, 0.0]))
def test_small_integer_triangles_of_any_shape_match_exact_arithmetic(triangle, x):
    _check(triangle, x, 1e-14 * 10)


@naive.PROPERTY
@given(triangles, points)
def test_the_feature_is_the_exact_one_where_the_triangle_has_area(triangle, x):
    n = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
    expected, _ = naive.exact_closest(triangle, x)
    if not n.any():
        return
    _, feature, _ = vf.closest_point(triangle, x)
    # Integers this small leave no rounding in the sign tests, and feet on edges at t = 0 or 1
    # are exact too.
    assert {feature} == naive.exact_feature(triangle, expected), (triangle, x)


@pytest.mark.parametrize("weights", list(FEATURE_OF_WEIGHTS))
def test_each_feature_is_found_from_its_own_voronoi_region(weights):
    rng = np.random.default_rng(7)
    for _ in range(200):
        triangle = rng.normal(size=(3, 3))
        n = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
        n /= np.linalg.norm(n)
        bary = np.where(weights, rng.uniform(0.1, 1.0, 3), 0.0)
        on = (bary / bary.sum()) @ triangle
        away = np.zeros(3)
        count = sum(weights)
        centre = triangle.mean(axis=0)
        if count == 2:
            k = weights.index(False)
            a, b = triangle[(k + 1) % 3], triangle[(k + 2) % 3]
            away = np.cross(b - a, n)
            away *= -np.sign(away @ (centre - on))
        elif count == 1:
            k = weights.index(True)
            # The normal cone of a corner: minus any combination of directions into the triangle
            # that both edges see at an obtuse angle; the sum of the outward edge normals is one.
            for j in (1, 2):
                edge = np.cross(triangle[(k + j) % 3] - triangle[k], n)
                away += edge * -np.sign(edge @ (centre - triangle[k])) / np.linalg.norm(edge)
        x = on + 0.3 * rng.normal() * n + rng.uniform(0.1, 2.0) * away
        point, feature, _ = vf.closest_point(triangle, x)
        assert feature == FEATURE_OF_WEIGHTS[weights], (triangle, x)
        assert np.allclose(point, on, atol=1e-12), (triangle, x)


@pytest.mark.parametrize("height", [1e-2, 1e-4, 1e-6, 1e-8, 1e-9, 1e-10, 1e-12, 1e-16, 0.0])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_slivers(height, scale):
    """Thin triangles in general position, from all around and from very near."""
    rng = np.random.default_rng(3)
    for trial in range(60):
        R = naive.rotation(rng)
        flat = np.array([[0, 0, 0], [1, 0, 0], [rng.random(), height, 0]]) * scale
        triangle = flat @ R.T + (trial % 3) * scale * rng.normal(size=3)
        distance = scale * 10.0 ** rng.uniform(-6, 1)
        x = rng.dirichlet((1, 1, 1)) @ triangle + naive.unit(rng) * distance
        expected, square = naive.exact_closest(triangle, x)
        point, _, found = vf.closest_point(triangle, x)
        # A sliver's plane is known to rounding / height, and below 1e-9 its edges stand for it.
        tolerance = scale * 3e-7 * (1.0 + distance / scale)
        assert abs(found - sqrt(square)) <= tolerance, (triangle.tolist(), x.tolist())
        error = np.abs(point - np.array([float(v) for v in expected])).max()
        assert error <= 10 * tolerance, (triangle.tolist(), x.tolist(), error)


reals = st.floats(-1, 1, allow_subnormal=False)
vectors = st.tuples(reals, reals, reals).map(np.array)


@naive.PROPERTY
@given(st.tuples(vectors, vectors, vectors).map(np.array), vectors, st.integers(0, 2**32 - 1))
def test_no_sampled_point_of_the_triangle_is_nearer(triangle, x, seed):
    _, _, distance = vf.closest_point(triangle, x)
    weights = np.random.default_rng(seed).dirichlet((0.5, 0.5, 0.5), size=200)
    samples = np.concatenate([weights @ triangle, triangle])
    assert distance <= np.linalg.norm(samples - x, axis=1).min() + 1e-9, (triangle, x)


@naive.PROPERTY
@given(st.tuples(vectors, vectors, vectors).map(np.array), vectors)
def test_the_point_lies_on_the_triangle_at_the_distance_told(triangle, x):
    point, _, distance = vf.closest_point(triangle, x)
    assert np.linalg.norm(point - x) == pytest.approx(distance, abs=1e-9)
    _, square = naive.exact_closest(triangle, point)
    assert sqrt(square) <= 3e-7, (triangle, x, point)


def test_the_order_of_the_corners_does_not_matter():
    rng = np.random.default_rng(11)
    for _ in range(200):
        triangle, x = rng.normal(size=(3, 3)), 2 * rng.normal(size=3)
        point, _, distance = vf.closest_point(triangle, x)
        for order in ([1, 2, 0], [2, 0, 1], [1, 0, 2]):
            other, _, d = vf.closest_point(triangle[order], x)
            assert np.allclose(other, point, atol=1e-12)
            assert d == pytest.approx(distance, abs=1e-12)


# The squared distance alone, which the walks of the tree ask for.


@naive.PROPERTY
@given(triangles, points)
@example(np.zeros((3, 3)), np.array([1.0, 2.0, 3.0]))
@example(np.array([[0, 0, 0], [2, 2, 2], [1, 1, 1]], dtype=float), np.array([1.0, 0.0, 0.0]))
def test_the_squared_distance_alone_matches_exact_arithmetic(triangle, x):
    _, square = naive.exact_closest(triangle, x)
    found = distance2_to_triangle(*triangle.ravel(), *x)
    assert found == pytest.approx(float(square), rel=1e-12, abs=1e-12), (triangle, x)


@pytest.mark.parametrize("sine", [1.0, 0.1, 0.02, 0.0101, 0.0099, 1e-3, 1e-5])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_the_squared_distance_alone_of_sharp_triangles(sine, scale):
    """Sharp at each of the corners, on both sides of where the formula changes; near and far."""
    rng = np.random.default_rng(8)
    for trial in range(60):
        long, short = 1.0, rng.uniform(0.2, 1.0)
        flat = np.array([[0, 0, 0], [long, 0, 0], [short * np.sqrt(1 - sine**2), short * sine, 0]])
        triangle = np.roll(scale * flat @ naive.rotation(rng).T + scale * rng.normal(size=3), trial)
        distance = scale * 10.0 ** rng.uniform(-6, 1)
        x = rng.dirichlet((1, 1, 1)) @ triangle + naive.unit(rng) * distance
        _, square = naive.exact_closest(triangle, x)
        found = distance2_to_triangle(*triangle.ravel(), *x)
        # Coordinates are of the size of `scale`, and so is their rounding.
        tolerance = scale * 1e-14 / sine + 1e-11 * distance
        assert abs(sqrt(found) - sqrt(square)) <= tolerance, (triangle.tolist(), x.tolist())


def test_a_triangle_that_counts_as_well_shaped_has_an_exact_distance() -> None:
    rng = np.random.default_rng(4)
    well = poor = 0
    for _ in range(20_000):
        c = rng.normal(size=(3, 3)) * 10.0 ** rng.uniform(-6, 0)
        k, share, thin = rng.integers(3), rng.random(), 10.0 ** rng.uniform(-9, 0)
        c[k] += (1.0 - thin) * (share * c[k - 1] + (1.0 - share) * c[k - 2] - c[k])
        c += rng.normal(size=3) * 10.0 ** rng.uniform(-3, 1)
        error = distance_error(*c.ravel())
        if well_shaped(*c.ravel(), 1e-12):
            assert error <= 1e-12
            well += 1
        else:
            # It is not said of triangles that are far better than that.
            assert error > 5e-15
            poor += 1
    assert min(well, poor) > 1_000
