"""Surfaces of volumes are closed and look outwards on any values, and lie where the level is."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import trimesh

import meshes
from meshes import volume
from meshes.volume import grid, surfaces
from tests.support import volume_files as files

UNIT = np.diag([1e-3, 1e-3, 1e-3, 1.0])  # voxels of 1 mm


def of(values: np.ndarray, level: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices in voxels, and faces."""
    vertices, faces = volume.surface(volume.Volume(values, UNIT, "v"), level)
    return vertices * 1e3, faces


def assert_closed(vertices: np.ndarray, faces: np.ndarray) -> None:
    """Every edge of two faces, walked once each way; no face without area; nothing left over."""
    half = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    key = half[:, 0] * len(vertices) + half[:, 1]
    assert len(np.unique(key)) == len(key)
    assert np.isin(half[:, 1] * len(vertices) + half[:, 0], key).all()
    a, b, c = vertices[faces].transpose(1, 0, 2)
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).min() > 1e-7  # [voxel²]
    assert len(np.unique(faces)) == len(vertices)


def windings(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Winding numbers by the solid angles of the triangles (Van Oosterom and Strackee)."""
    a, b, c = (vertices[faces][None, :, n] - points[:, None] for n in range(3))
    la, lb, lc = (np.linalg.norm(x, axis=2) for x in (a, b, c))
    volumes = np.einsum("pfi,pfi->pf", a, np.cross(b, c))
    rest = (
        la * lb * lc
        + np.einsum("pfi,pfi->pf", a, b) * lc
        + np.einsum("pfi,pfi->pf", b, c) * la
        + np.einsum("pfi,pfi->pf", c, a) * lb
    )
    return np.arctan2(volumes, rest).sum(axis=1) / (2 * np.pi)


def blocks(shape: tuple[int, int, int]) -> np.ndarray:
    """Every binary volume of this shape, side by side in one, an empty voxel between."""
    count = 2 ** int(np.prod(shape))
    side = int(np.sqrt(count))
    bits = (np.arange(count)[:, None] >> np.arange(np.prod(shape))) & 1
    whole = np.zeros((side, count // side, *(n + 1 for n in shape)), dtype=np.uint8)
    whole[:, :, :-1, :-1, :-1] = bits.reshape(side, count // side, *shape)
    return whole.transpose(0, 2, 1, 3, 4).reshape(side * (shape[0] + 1), -1, shape[2] + 1)


@pytest.mark.parametrize("shape", [(2, 2, 2), (2, 2, 3)])
def test_every_small_label_map_is_closed_at_half_a_level(shape: tuple[int, int, int]) -> None:
    assert_closed(*of(blocks(shape), 0.5))


@pytest.mark.slow
@pytest.mark.parametrize("shape", [(2, 3, 2), (3, 2, 2)])
def test_small_label_maps_lying_otherwise_are_closed(shape: tuple[int, int, int]) -> None:
    assert_closed(*of(blocks(shape), 0.5))


@pytest.mark.parametrize("seed", range(3))
def test_label_maps_of_27_voxels_are_closed(seed: int) -> None:
    """A thousand of them side by side, an empty voxel between."""
    rng = np.random.default_rng(seed)
    bits = (rng.random((10, 10, 10, 3, 3, 3)) < rng.uniform(0.2, 0.8)).astype(np.uint8)
    whole = np.zeros((10, 10, 10, 4, 4, 4), dtype=np.uint8)
    whole[..., :3, :3, :3] = bits
    assert_closed(*of(whole.transpose(0, 3, 1, 4, 2, 5).reshape(40, 40, 40), 0.5))


def test_voxels_are_inside_exactly_where_they_are_above() -> None:
    for bits in itertools.product((0, 1), repeat=8):
        values = np.array(bits, dtype=np.uint8).reshape(2, 2, 2)
        if 0 < values.sum() < 8:
            points = np.argwhere(values >= 0).astype(float)
            found = windings(*of(values, 0.5), points)
            np.testing.assert_allclose(found, values.ravel(), atol=1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_values_at_the_level_and_ties_are_closed(seed: int) -> None:
    """Whole numbers have the level exactly, on voxels and at the saddles of faces."""
    rng = np.random.default_rng(seed)
    values = rng.integers(0, 4, (14, 13, 12))
    for scale in (1.0, 1e-9, 1e9):
        for level in (0.5, 1.0, 1.5, 2.0):
            vertices, faces = of(
                (values * scale).astype(np.float32), float(np.float32(level * scale))
            )
            assert_closed(vertices, faces)
    points = rng.permutation(np.argwhere(values >= 0))[:100]
    vertices, faces = of(values, 2.0)
    np.testing.assert_allclose(
        windings(vertices, faces, points.astype(float)), values[tuple(points.T)] > 2, atol=1e-9
    )
    # What was single precision once stays closed, as in an STL file.
    assert_closed(vertices.astype(np.float32).astype(np.float64), faces)


def test_thin_oblique_walls_have_no_slits() -> None:
    """A wall of one voxel along the diagonal of a plane parts the volume in two for a walker."""
    values = np.zeros((12, 12, 6), dtype=np.uint8)
    for i in range(12):
        values[i, 11 - i] = 1
    mesh = trimesh.Trimesh(*of(values, 0.5), process=False)
    assert mesh.body_count == 1
    assert mesh.euler_number == 2


def test_what_is_no_number_is_outside_and_infinities_are_what_they_say() -> None:
    p = np.stack(np.indices((24, 24, 24)), axis=-1)
    ball = (100 - 8 * np.linalg.norm(p - 11.5, axis=-1)).astype(np.float32)
    cut = ball.copy()
    cut[:9] = np.nan
    lower = ball.copy()
    lower[:9] = -np.inf
    for values in (cut, lower):
        vertices, faces = of(values, 20.01)
        assert_closed(vertices, faces)
        assert 8.0 < vertices[:, 0].min() < 9.0
    upper = ball.copy()
    upper[ball > 50] = np.inf
    vertices, faces = of(upper, 20.01)
    assert_closed(vertices, faces)
    assert abs(np.linalg.norm(vertices - 11.5, axis=1) - 79.99 / 8).max() < 0.1
    mask = np.full((6, 6, 6), np.nan)
    mask[2:4, 2:4, 2:4] = 1.0
    vertices, faces = of(mask, 0.5)
    assert (vertices.min(), vertices.max()) == (1.5, 3.5)
    assert_closed(vertices, faces)
    with pytest.raises(meshes.MeshError, match="no voxel has a finite value"):
        of(np.full((3, 3, 3), np.nan), 0.5)
    with pytest.raises(meshes.MeshError, match="no surface at level 5"):
        of(mask, 5.0)
    vertices, faces = volume.surface(volume.Volume(cut, UNIT, "v"), 20.01, smooth=5e-4)
    assert_closed(vertices * 1e3, faces)


def test_large_whole_numbers_are_told_apart() -> None:
    """Labels of brain atlases go beyond what single precision holds."""
    values = np.zeros((5, 5, 5), dtype=np.uint32)
    values[1:3], values[3:] = 614454276, 614454277
    one = volume.one_label(volume.Volume(values, UNIT, "atlas"), 614454277)
    vertices, _faces = volume.surface(one, volume.MIDDLE)
    assert vertices[:, 0].min() == pytest.approx(2.5e-3)


def test_a_body_across_the_border_is_closed_and_slabs_join(monkeypatch: pytest.MonkeyPatch) -> None:
    shape = (30, 30, 30)
    T = files.affine(np.eye(3), shape)
    field = files.sphere(files.world_points(T, shape), 18.0).astype(np.float32)
    whole = of(field, 100.0)
    assert_closed(*whole)
    monkeypatch.setattr(grid, "SLAB", 1)
    for mine, one in zip(of(field, 100.0), whole, strict=True):
        np.testing.assert_array_equal(mine, one)
    # Levels that voxels have exactly.
    report = meshes.health(*of(np.round(field), 100.0), examine=0)
    assert report.watertight
    assert report.count("degenerate faces") == 0


def test_a_surface_of_noise_is_refused_before_it_fills_the_memory(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(surfaces, "MOST_TRIANGLES", 10_000)
    noise = np.random.default_rng(0).normal(size=(40, 40, 40)).astype(np.float32)
    with pytest.raises(meshes.MeshError, match="more than 10,000 triangles: choose another level"):
        of(noise, 0.0)


def test_smoothing_and_the_largest_piece() -> None:
    shape = (60, 60, 60)
    T = files.affine(np.eye(3), shape)
    p = files.world_points(T, shape)
    both = np.maximum(files.sphere(p, 15.0), files.sphere(p - [22.0, 22.0, 22.0], 3.0))
    metres = np.diag([1e-3, 1e-3, 1e-3, 1.0]) @ T
    two = volume.Volume(both, metres, "two")
    assert meshes.health(*volume.surface(two, 100.0), examine=0).components == 2
    vertices, faces = volume.surface(two, 100.0, largest=True)
    report = meshes.health(vertices, faces, examine=0)
    assert (report.components, report.count("unused vertices")) == (1, 0)
    assert report.volume == pytest.approx(4 / 3 * np.pi * 0.015**3, rel=0.01)
    rng = np.random.default_rng(3)
    noisy = volume.Volume(both + rng.normal(size=both.shape), metres, "noisy")
    rough = volume.surface(noisy, 100.0, largest=True)
    fine = volume.surface(noisy, 100.0, smooth=1.5e-3, largest=True)
    off = [
        np.abs(np.linalg.norm(v - files.CENTRE * 1e-3, axis=1) - 0.015).mean()
        for v, _ in (rough, fine)
    ]
    assert off[1] < 0.4 * off[0]
    with pytest.raises(meshes.MeshError, match="at most 20 voxels, 20 mm, not 21 mm"):
        volume.surface(two, 100.0, smooth=0.021)
