"""What the judges take their candidates from, against every triangle by itself."""

from __future__ import annotations

import numpy as np
import pytest

import meshes
import vf
from app.judges import boxes
from meshes.builtin.damage import damage


def soup(rng: np.random.Generator, count: int, size: float, far: float) -> tuple:
    """Triangles of any size in no order, some of them points, around a point `far` off [m]."""
    centres = rng.normal(size=(count, 1, 3)) + far * rng.normal(size=3)
    corners = centres + size * 10.0 ** rng.uniform(-6, 0, (count, 1, 1)) * rng.normal(
        size=(count, 3, 3)
    )
    corners[::7] = corners[::7, :1]
    return corners.reshape(-1, 3), rng.permutation(3 * count).reshape(-1, 3) if count > 1 else [
        [0, 1, 2]
    ]


def reached(
    vertices: np.ndarray, faces: np.ndarray, a: np.ndarray, b: np.ndarray, reach: float
) -> np.ndarray:
    """How far each triangle's box is from the segment ab, less `reach`, by the largest axis.

    Over samples of the segment: an upper bound, exact where a = b.
    """
    corners = vertices[faces]
    low, high = corners.min(axis=1) - reach, corners.max(axis=1) + reach
    beyond = [
        np.maximum(low - p, p - high).max(axis=1)
        for p in a + np.linspace(0.0, 1.0, 1 if (a == b).all() else 64)[:, None] * (b - a)
    ]
    return np.min(beyond, axis=0)


def check(vertices: np.ndarray, faces: np.ndarray, rng: np.random.Generator, queries: int) -> int:
    vertices, faces = np.asarray(vertices), np.asarray(faces)
    found = boxes.build(vertices, faces)
    rounding = 1e-13 * np.abs(vertices).max()
    seen = 0
    for k in range(queries):
        a = vertices[rng.integers(len(vertices))] + 10.0 ** rng.uniform(-6, 0) * rng.normal(size=3)
        length = (0.0, 10.0 ** rng.uniform(-6, 0.5))[k % 2]
        b = a + length * rng.normal(size=3)
        reach = (0.0, 10.0 ** rng.uniform(-5, -1))[k // 2 % 2]
        near = boxes.near(found, a, b, reach)
        assert len(set(near)) == len(near)
        beyond = reached(vertices, faces, a, b, reach)
        missing = np.setdiff1d(np.flatnonzero(beyond <= 0.0), near)
        assert not len(missing), (a.tolist(), b.tolist(), reach, missing.tolist())
        # Nor more than those whose box comes as near as a sample can tell.
        step = np.abs(b - a).max() / 63
        assert (beyond[near] <= step + rounding).all()
        seen += len(near)
    return seen


@pytest.mark.parametrize("name", ["gear", "skull-coarse"])
@pytest.mark.parametrize("state", ["none", "jittered", "slivers"])
def test_no_triangle_near_a_segment_is_missed_and_few_others_are_named(
    name: str, state: str
) -> None:
    rng = np.random.default_rng(1)
    assert check(*damage(state, meshes.arrays(name), seed=1), rng, 60) > 60


@pytest.mark.parametrize("far", [0.0, 1e3, 1e7])
@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 16, 17, 65, 400])
def test_any_number_of_triangles_of_any_size_anywhere(count: int, far: float) -> None:
    rng = np.random.default_rng(count)
    for size in (1e-3, 1.0):
        assert check(*soup(rng, count, size, far), rng, 100) > 0


def test_triangles_all_in_one_place() -> None:
    rng = np.random.default_rng(2)
    corner = np.array([[0.1, 0.2, 0.3]])
    found = boxes.build(corner, np.zeros((300, 3), dtype=np.int64))
    for reach, count in ((0.0, 300), (1e-3, 300)):
        assert len(boxes.near(found, corner[0], corner[0], reach)) == count
    beside = corner[0] + [1e-9, 0.0, 0.0]
    assert len(boxes.near(found, beside, beside, 0.0)) == 0
    assert len(boxes.near(found, beside, beside, 1e-9)) == 300
    way = rng.normal(size=3)
    assert len(boxes.near(found, corner[0] - way, corner[0] + way, 1e-9)) == 300


def test_what_only_touches_a_box_is_near_it() -> None:
    found = boxes.build(np.eye(3), np.array([[0, 1, 2]]))
    for a, b in (
        ([1.0, 1.0, 1.0], [2.0, 1.0, 1.0]),  # ends at a corner
        ([1.0, 0.0, -1.0], [1.0, 0.0, 2.0]),  # along an edge
        ([2.0, 0.5, 0.0], [0.0, 2.5, 0.0]),  # past it, but for
    ):
        reach = 0.25 if b[1] == 2.5 else 0.0
        assert list(boxes.near(found, np.array(a), np.array(b), reach)) == [0], (a, b)
    assert not len(boxes.near(found, np.array([2.0, 0.5, 0.0]), np.array([0.0, 2.5, 0.0]), 0.2))


def test_a_surface_keeps_its_boxes_as_long_as_it_is() -> None:
    surface = vf.Surface.from_arrays(*meshes.arrays("cube"))
    kept = len(boxes._known)
    assert boxes.of(surface) is boxes.of(surface)
    assert len(boxes._known) == kept + 1
    del surface
    assert len(boxes._known) == kept
