"""The distance of an axis from a mesh, against every triangle by itself."""

from __future__ import annotations

from fractions import Fraction
from math import isqrt

import numpy as np
import pytest

import meshes
from app.judges import boxes, exact
from app.judges.nearest import nearest


def root(value: Fraction) -> float:
    scale = 10**40
    return isqrt(int(value * scale * scale)) / scale


def test_the_nearest_triangle_is_found_whatever_the_axis() -> None:
    rng = np.random.default_rng(0)
    vertices, faces = meshes.arrays("l-block")
    faces = faces[rng.permutation(len(faces))[:150]]
    tree = boxes.build(vertices, faces)
    met = 0
    for k in range(40):
        a = vertices[rng.integers(len(vertices))] + 10.0 ** rng.uniform(-5, -1) * rng.normal(size=3)
        b = a + (0.0, 10.0 ** rng.uniform(-4, -1))[k % 4 > 0] * rng.normal(size=3)
        gaps = np.array([root(exact.distance2(a, b, vertices[face])) for face in faces])
        gap, triangle = nearest(tree, np.array([a, b]))
        assert gap == pytest.approx(gaps.min(), abs=1e-12)
        assert gaps[triangle] == pytest.approx(gaps.min(), abs=1e-12)
        met += gap == 0.0
        if gap > 0.0:
            assert nearest(tree, np.array([a, b]), 0.999 * gap) == (np.inf, -1)
            assert nearest(tree, np.array([a, b]), 1.001 * gap) == (gap, triangle)
    assert 0 < met < 40


def test_an_axis_that_ends_in_a_face_meets_it() -> None:
    tree = boxes.build(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    axis = np.array([[0.25, 0.25, 1.0], [0.25, 0.25, 0.0]])
    assert nearest(tree, axis) == (0.0, 0)
    axis[1, 2] = 1e-9
    assert nearest(tree, axis)[0] == pytest.approx(1e-9, rel=1e-9)
