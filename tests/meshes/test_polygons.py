"""Polygons become triangles inside them, on all of their corners and edges."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import meshes
import vf
from meshes.polygons import strips, triangles

U = np.array([(0, 20), (0, 0), (30, 0), (30, 20), (20, 20), (20, 10), (10, 10), (10, 20)], float)


def area(p: np.ndarray) -> float:
    x, y = p.T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


def check_cut(flat: np.ndarray, faces: np.ndarray) -> None:
    """Triangles cover a simple polygon once, and fit its neighbours without a gap."""
    assert len(faces) == len(flat) - 2
    areas = [area(flat[face]) for face in faces]
    size = float(np.ptp(flat, axis=0).max()) ** 2
    assert min(areas) > -1e-12 * size
    assert sum(areas) == pytest.approx(area(flat), rel=1e-9, abs=1e-12 * size)
    sides = Counter((int(f[k]), int(f[(k + 1) % 3])) for f in faces for k in range(3))
    n = len(flat)
    for k in range(n):
        assert sides.pop((k, (k + 1) % n)) == 1
    assert all(count == 1 and sides[b, a] == 1 for (a, b), count in sides.items())


@given(
    radii=st.lists(st.floats(0.05, 1.0), min_size=4, max_size=40),
    straight=st.booleans(),
    start=st.integers(0, 39),
    seed=st.integers(0, 2**32 - 1),
)
@settings(max_examples=200, deadline=None)
def test_any_simple_polygon_in_any_plane(
    radii: list[float], straight: bool, start: int, seed: int
) -> None:
    angles = 2 * np.pi * np.arange(len(radii)) / len(radii)
    flat = np.array(radii)[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    if straight:  # corners in the middle of every side
        flat = np.stack([flat, (flat + np.roll(flat, -1, axis=0)) / 2], axis=1).reshape(-1, 2)
    flat = np.roll(flat, start, axis=0)
    rng = np.random.default_rng(seed)
    R = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    points = 100 * np.column_stack([flat, np.zeros(len(flat))]) @ R.T + rng.normal(size=3)
    faces = triangles(points, np.arange(len(flat)), np.array([len(flat)]))
    check_cut(flat, faces)


def test_the_notch_of_a_u_stays_open(tmp_path: Path) -> None:
    for start in range(8):
        flat = np.roll(U, start, axis=0)
        check_cut(flat, triangles(np.c_[flat, 0 * flat[:, 0]], np.arange(8), np.array([8])))
    points = np.vstack([np.c_[U, 0 * U[:, 0]], np.c_[U, 0 * U[:, 0] + 10]])
    caps = [list(range(8))[::-1], list(range(8, 16))]
    faces = caps + [[i, (i + 1) % 8, 8 + (i + 1) % 8, 8 + i] for i in range(8)]
    path = tmp_path / "u.obj"
    path.write_text(
        "".join("v {:g} {:g} {:g}\n".format(*p) for p in points)
        + "".join("f " + " ".join(str(i + 1) for i in face) + "\n" for face in faces)
    )
    surface = vf.Surface.from_arrays(*meshes.arrays(path, unit="mm"))
    assert surface.nearest(np.array([0.015, 0.015, 0.012]))[0] == pytest.approx(
        np.hypot(2, 5) / 1e3
    )
    assert meshes.health(surface.vertices, surface.faces).sound


def test_a_keyhole_polygon_keeps_its_hole() -> None:
    """A square with a square hole, joined by a slit without width, as exporters write it."""
    outer, inner = [(0, 0), (9, 0), (9, 9), (0, 9)], [(3, 3), (3, 6), (6, 6), (6, 3)]
    flat = np.array([*outer, outer[0], inner[0], *inner[1:], inner[0]], dtype=float)
    faces = triangles(np.c_[flat, 0 * flat[:, 0]], np.arange(10), np.array([10]))
    areas = [area(flat[face]) for face in faces]
    assert min(areas) >= 0
    assert sum(areas) == pytest.approx(72)
    for face in faces:
        assert not (flat[face].mean(axis=0) > 3).all() or not (flat[face].mean(axis=0) < 6).all()


def test_flat_quads_are_cut_at_their_inner_corner_and_nothing_stops_the_rest() -> None:
    dart = np.array([(0, 0, 0), (10, 0, 0), (3, 3, 0), (0, 10, 0)], dtype=float)
    for start in range(4):
        points = np.roll(dart, start, axis=0)
        faces = triangles(points, np.arange(4), np.array([4]))
        assert all(area(points[face][:, :2]) > 1 for face in faces)
    # Two corners, a point, a crossing, no area: as many triangles as corners less two.
    corners = np.array([0, 1, 0, 1, 3, 2, 2, 2, 2, 2])
    assert len(triangles(dart, corners, np.array([2, 0, 4, 4]))) == 4
    with pytest.raises(meshes.MeshError, match="too many to be cut"):
        triangles(np.zeros((4, 3)), np.zeros(20_000, dtype=np.int64), np.array([20_000]))


def test_strips_turn_every_other_triangle() -> None:
    found = strips(np.array([0, 1, 2, 3, 3, -1, -1, 4, 5, 6, 7]))
    assert found.tolist() == [[0, 1, 2], [2, 1, 3], [4, 5, 6], [6, 5, 7]]
