"""The isosurface of a volume, closed for any values."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from meshes.checks.topology import topology
from meshes.content import Arrays, compact
from meshes.errors import MeshError
from meshes.volume.cubes import triangles
from meshes.volume.grid import FloatArray, Volume, extent, planes_at_once

IntArray = NDArray[np.int64]

MOST_TRIANGLES = 10_000_000
# Vertices keep this share of the spacing from the voxels, so that triangles have an area in single
# precision also where a value equals the level.
_CLEAR = 1e-3
_WIDEST = 20  # [voxel] standard deviation, which the run time grows with
_LARGEST_VALUE = 1e100  # keeps differences finite


def surface(
    volume: Volume,
    level: float,
    *,
    smooth: float = 0.0,
    largest: bool = False,
    progress: Callable[[str], None] | None = None,
) -> Arrays:
    """The surface where the values pass ``level``: vertices ``(n, 3)`` [m], world, and faces.

    Voxels above the level are inside; those at or below it, NaN, and everything around the volume
    are outside. The surface is closed, manifold and wound outwards for any values, and each face
    has an area; at the volume's border it is cut flat within a voxel. Vertices are interpolated
    linearly between two voxels, at least a thousandth of the spacing from each.

    Args:
        smooth: standard deviation [m] of a Gaussian filter applied first; 0: none.
        largest: keep only the component with the largest bounding box.

    Raises:
        MeshError: the level lies outside the volume's values, ``smooth`` is more than 20 voxels, or
            the surface would have more than `MOST_TRIANGLES`.
    """
    say = progress or (lambda _stage: None)
    if not (np.isfinite(level) and np.isfinite(smooth) and smooth >= 0.0):
        raise MeshError(f"level must be finite and smooth zero or more, not {level} and {smooth}")
    values, outside, within = _finite(volume, float(level))
    if smooth:
        say("smoothing")
        spacing = np.linalg.norm(volume.T_world_voxel[:3, :3], axis=0)  # [m/voxel]
        if smooth > _WIDEST * spacing.min():
            raise MeshError(
                f"{volume.name}: smooth must be at most {_WIDEST} voxels, "
                f"{1e3 * _WIDEST * spacing.min():.4g} mm, not {1e3 * smooth:.4g} mm"
            )
        values = gaussian_filter(
            _replaced(values, outside, within).astype(np.float32), smooth / spacing
        )
        if not values.min() < level < values.max():
            raise MeshError(f"{volume.name}: nothing of level {level:g} is left after smoothing")
    say("marching cubes")
    corners: list[IntArray] = []
    count = 0
    # Padded by one voxel of outside: indices are one more than the volume's.
    shape = (values.shape[0] + 2, values.shape[1] + 2, values.shape[2] + 2)
    for start, above in _slabs(values, np.float64(level), outside, within):
        found = grid_triangles(above, start, shape)
        count += len(found)
        if count > MOST_TRIANGLES:
            raise MeshError(
                f"{volume.name}: at level {level:g} there are more than {MOST_TRIANGLES:,} "
                "triangles: choose another level, smooth, or take a part of the volume"
            )
        corners.append(found)
    edges, faces = np.unique(np.concatenate(corners), return_inverse=True)
    points = _points(values, edges, shape, np.float64(level), outside, within)
    vertices = points @ volume.T_world_voxel[:3, :3].T + volume.T_world_voxel[:3, 3]
    faces = faces.reshape(-1, 3).astype(np.int64)
    if np.linalg.det(volume.T_world_voxel[:3, :3]) < 0.0:
        faces = faces[:, ::-1]
    if largest:
        say("largest piece")
        faces = _largest(vertices, faces)
    return compact(vertices, faces)


def _finite(volume: Volume, level: float) -> tuple[NDArray[Any], float, float]:
    """The values, the one for NaN, minus infinity and padding, and the one for infinity."""
    values, known = volume.values, extent(volume.values)
    if known.count == 0:
        raise MeshError(f"{volume.name}: no voxel has a finite value")
    low, high = known.low, known.high
    if max(abs(low), abs(high)) > _LARGEST_VALUE:
        raise MeshError(f"{volume.name}: its values run from {low:g} to {high:g}: too large")
    if not (low < level or known.below) or not (level < high or known.above):
        others = values.size - known.count
        not_finite = f", {others:,} are not finite" if others else ""
        raise MeshError(
            f"{volume.name}: no surface at level {level:g}: "
            f"its values run from {low:g} to {high:g}{not_finite}"
        )
    # Where no finite value is on a side of the level, the nearest one mirrored at the level.
    return (
        values,
        low if low < level else 2.0 * level - high,
        high if high > level else 2.0 * level - low,
    )


def _replaced(values: NDArray[Any], outside: float, within: float) -> NDArray[Any]:
    if values.dtype.kind != "f":
        return values
    return np.nan_to_num(values, copy=True, nan=outside, posinf=within, neginf=outside)


def _slabs(
    values: NDArray[Any], level: np.float64, outside: float, within: float
) -> Iterator[tuple[int, FloatArray]]:
    """Values minus the level of the padded volume, in slabs that share a plane."""
    planes, step = values.shape[0] + 2, planes_at_once(values)
    for start in range(0, planes - 1, step):
        stop = min(start + step + 1, planes)
        above = np.full((stop - start, values.shape[1] + 2, values.shape[2] + 2), outside - level)
        first, last = max(start, 1), min(stop, planes - 1)
        above[first - start : last - start, 1:-1, 1:-1] = (
            _replaced(values[first - 1 : last - 1], outside, within) - level
        )
        yield start, above


def grid_triangles(above: FloatArray, start: int, shape: tuple[int, int, int]) -> IntArray:
    """Triangles ``(n, 3)`` of a slab, as grid edges: 3 × the index of the lower voxel + the axis.

    Args:
        above: ``(planes, j, k)``, positive inside; of the padded grid.
        start: index of its first plane in the grid of size ``shape``.
    """
    inside = above > 0.0
    n, rows, columns = (size - 1 for size in above.shape)
    signs = np.zeros((n, rows, columns), dtype=np.uint8)
    for c in range(8):
        x, y, z = c & 1, c >> 1 & 1, c >> 2
        signs |= inside[x : x + n, y : y + rows, z : z + columns].astype(np.uint8) << np.uint8(c)
    cells = np.flatnonzero((signs != 0) & (signs != 255))
    if len(cells) == 0:
        return np.zeros((0, 3), dtype=np.int64)
    i, j, k = np.unravel_index(cells, signs.shape)
    kinds, kind = np.unique(signs.ravel()[cells], return_inverse=True)
    table = [triangles(int(code)) for code in kinds]
    counts = np.array([len(one) for one in table], dtype=np.int64)
    flat = np.array([triangle for one in table for triangle in one], dtype=np.int64)
    starts = np.cumsum(counts) - counts
    cell = np.repeat(np.arange(len(cells)), counts[kind])
    ends = np.cumsum(counts[kind])
    rank = np.arange(len(cell)) - np.repeat(ends - counts[kind], counts[kind])
    numbers = flat[starts[kind[cell]] + rank]  # (n, 3) of the cell's edges
    corner, axis = np.divmod(numbers, 3)
    voxel = np.ravel_multi_index(
        (
            (start + i[cell])[:, None] + (corner & 1),
            j[cell][:, None] + (corner >> 1 & 1),
            k[cell][:, None] + (corner >> 2),
        ),
        shape,
    )
    return 3 * voxel + axis


def _points(
    values: NDArray[Any],
    edges: IntArray,
    shape: tuple[int, int, int],
    level: np.float64,
    outside: float,
    within: float,
) -> FloatArray:
    """Vertices (n, 3) on grid edges, in voxel indices of the volume."""
    voxel, axis = np.divmod(edges, 3)
    lower = np.stack(np.unravel_index(voxel, shape), axis=1) - 1  # (n, 3)
    upper = lower + (axis[:, None] == np.arange(3))
    heights = []
    for index in (lower, upper):
        known = ((index >= 0) & (index < values.shape)).all(axis=1)
        height = np.full(len(index), outside - level)
        height[known] = _replaced(values[tuple(index[known].T)], outside, within) - level
        heights.append(height)
    share = np.clip(heights[0] / (heights[0] - heights[1]), _CLEAR, 1.0 - _CLEAR)
    return lower + (upper - lower) * share[:, None]


def _largest(vertices: FloatArray, faces: IntArray) -> IntArray:
    component = topology(faces, len(vertices)).components
    count = int(component.max()) + 1
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, component, vertices[faces].min(axis=1))
    np.maximum.at(high, component, vertices[faces].max(axis=1))
    return faces[component == int(np.linalg.norm(high - low, axis=1).argmax())]
