"""The skull cap against its recorded measures and an independent evaluation of its recipe."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

import meshes
from meshes.builtin import skull

PARTS = (  # c, A [mm], κ as in the recipe, mirrored by hand
    (0.45, 0.75, 0.5, 2.5, 14),
    (-0.45, 0.75, 0.5, 2.5, 14),
    (0.8, -0.25, 0.55, 4, 10),
    (-0.8, -0.25, 0.55, 4, 10),
    (0, -0.98, 0.1, 4, 12),
    (0.95, 0.4, -0.15, -4, 18),
    (-0.95, 0.4, -0.15, -4, 18),
    (0.40, 0.86, -0.32, -15, 60),
    (-0.40, 0.86, -0.32, -15, 60),
    (0.38, 0.92, -0.04, 3, 60),
    (-0.38, 0.92, -0.04, 3, 60),
    (0, 0.96, -0.30, 3, 60),
)


def outer_radius(d: tuple[float, float, float]) -> float:
    """Radius [mm] of the outer surface along a unit direction, written out for one direction."""
    base = sum(abs(d[i] / (52.0, 68.0, 60.0)[i]) ** 2.2 for i in range(3))
    r = base ** (-1 / 2.2)
    for cx, cy, cz, height, kappa in PARTS:
        dot = (d[0] * cx + d[1] * cy + d[2] * cz) / math.sqrt(cx * cx + cy * cy + cz * cz)
        r += height * math.exp(kappa * (dot - 1))
    x, y, z = (r * value for value in d)
    u = 1 / (1 + math.exp(-(z - 15) / 4))
    for s in (y - 24 + 0.28 * abs(x), y + 50 - 0.45 * abs(x)):
        r -= 0.5 * u * math.exp(-((s / 1.3) ** 2))
    return r


@pytest.fixture(scope="module")
def cap() -> trimesh.Trimesh:
    return trimesh.Trimesh(*meshes.arrays("skull"), process=False)


def on_outer(points: np.ndarray, tolerance: float) -> np.ndarray:
    """Which points [m] lie on the outer surface, within ``tolerance`` [mm] of radius."""
    mm = points * 1e3
    radii = np.linalg.norm(mm, axis=1)
    wanted = np.array([outer_radius(tuple(p / r)) for p, r in zip(mm, radii, strict=True)])
    return np.abs(radii - wanted) < tolerance


def test_triangle_counts_are_the_recorded_ones(cap: trimesh.Trimesh) -> None:
    # The last digits depend on how the solid kernel triangulates the cut rims.
    assert len(cap.faces) == pytest.approx(93_508, abs=100)
    assert len(meshes.arrays("skull-coarse")[1]) == pytest.approx(9_670, abs=100)


@pytest.mark.slow
def test_fine_skull_is_sound_and_has_its_count() -> None:
    fine = trimesh.Trimesh(*skull.skull(skull.FINE), process=False)
    assert len(fine.faces) == pytest.approx(936_472, abs=200)
    assert fine.is_watertight
    assert fine.is_winding_consistent
    assert fine.euler_number == 2 - 2 * 2
    assert fine.volume > 0


def test_outer_vertices_follow_the_recipe(cap: trimesh.Trimesh) -> None:
    sample = cap.vertices[:: len(cap.vertices) // 4000]
    outer = on_outer(sample, 1e-6)
    # Just under half of the vertices are outer ones; the rest is inside, or on cut rims.
    assert 0.4 < outer.mean() < 0.6
    mm = sample[~outer] * 1e3
    radii = np.linalg.norm(mm, axis=1)
    outside = radii - [outer_radius(tuple(p / r)) for p, r in zip(mm, radii, strict=True)]
    assert outside.max() < 0.1  # [mm] where rims cut a facet that spans a groove


def test_thickness_is_two_millimetres(cap: trimesh.Trimesh) -> None:
    """Distance from outer triangles to the inner surface, away from rims."""
    outer = on_outer(cap.vertices, 1e-6)
    x, y, z = (1e3 * cap.vertices).T
    rim = (np.abs(x) < 16) & (y < 42) & (y > -58)
    start = cap.vertices[outer & (z > 0) & ~rim][::7]
    assert len(start) > 1500
    # The closest inner point to each, exact within the two dozen nearest inner triangles.
    inner = cap.triangles[~outer[cap.faces].any(axis=1)]
    _, near = cKDTree(inner.mean(axis=1)).query(start, k=24)
    points = np.repeat(start, 24, axis=0)
    closest = trimesh.triangles.closest_point(inner[near].reshape(-1, 3, 3), points)
    gaps = np.linalg.norm(closest - points, axis=1).reshape(-1, 24).min(axis=1) * 1e3
    x, y, _ = (1e3 * start).T
    groove = np.minimum(np.abs(y - 24 + 0.28 * np.abs(x)), np.abs(y + 50 - 0.45 * np.abs(x)))
    assert gaps[groove > 4].min() > 1.96
    # Inside a groove's bend the facets of the inner surface cut the corner a little.
    assert 1.90 < gaps.min() < gaps.max() < 2.01


def test_it_is_mirrored_left_to_right(cap: trimesh.Trimesh) -> None:
    low, high = cap.bounds
    assert high[0] == pytest.approx(-low[0], abs=1e-6)
    assert high[1] > 0.06 > -low[1] - 0.02  # longer than wide, face towards +y
    assert np.ptp(cap.bounds, axis=0) == pytest.approx([0.106, 0.141, 0.107], abs=0.002)


def column(mesh: trimesh.Trimesh, x: float, y: float) -> np.ndarray:
    """Heights [mm] where a vertical line at (x, y) [mm] crosses the mesh: brute force."""
    a, b, c = (1e3 * mesh.triangles).transpose(1, 0, 2)

    def side(p: np.ndarray, q: np.ndarray) -> np.ndarray:
        return (q[:, 0] - p[:, 0]) * (y - p[:, 1]) - (q[:, 1] - p[:, 1]) * (x - p[:, 0])

    w = np.column_stack([side(b, c), side(c, a), side(a, b)])
    hit = (w > 0).all(axis=1) | (w < 0).all(axis=1)
    w = w[hit] / w[hit].sum(axis=1, keepdims=True)
    return np.sort((w * np.column_stack([a[hit, 2], b[hit, 2], c[hit, 2]])).sum(axis=1))


def test_openings_go_through_and_only_where_planned(cap: trimesh.Trimesh) -> None:
    x_suture = 1.2 * math.sin(2 * math.pi * (-30.3 + 22) / 9)
    fused = trimesh.Trimesh(*meshes.arrays("skull-fused"), process=False)
    precut = trimesh.Trimesh(*meshes.arrays("skull-precut"), process=False)
    assert len(column(cap, 0.013, 24.1)) == 0  # fontanelle
    assert len(column(fused, 0.013, 24.1)) == 0
    assert len(column(cap, x_suture, -30.3)) == 0  # open suture
    assert len(column(fused, x_suture, -30.3)) == 2
    assert len(column(cap, 0.013, -5.1)) == 2  # bone where the cut is planned
    assert len(column(precut, 0.013, -5.1)) == 0
    assert len(column(precut, 0.4, -5.1)) == 2  # the slot is 0.6 mm wide


def test_planned_cut_runs_back_over_the_crown(cap: trimesh.Trimesh) -> None:
    cut = meshes.planned_path("skull")
    assert cut.shape == (31, 3)
    assert np.abs(cut[:, 0]).max() == 0.0
    assert cut[0, 1] == pytest.approx(0.010, abs=1e-9)
    assert (np.diff(cut[:, 1]) < 0).all()
    steps = np.linalg.norm(np.diff(cut, axis=0), axis=1)
    np.testing.assert_allclose(steps, 1e-3, rtol=1e-4)
    assert on_outer(cut, 1e-4).all()
    # On the mesh, too: its top face under each point is at most a few microns lower.
    heights = [column(cap, 0.013, 1e3 * y)[-1] for y in cut[:, 1]]
    np.testing.assert_allclose(heights, 1e3 * cut[:, 2], atol=0.005)
