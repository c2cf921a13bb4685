"""The surface of a label: anti-aliased marching cubes, closed, no farther than half a voxel off.

Every vertex lies on the grid line between a voxel of the label and a neighbour that is none, and
stays there while it is smoothed: the surface is as flat as the label's voxels allow, each voxel's
centre stays on its side, and structures one voxel thin survive.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.sparse import coo_array, csr_array

from meshes.content import Arrays
from meshes.errors import MeshError
from meshes.volume.grid import FloatArray, planes_at_once
from meshes.volume.surfaces import MOST_TRIANGLES, grid_triangles
from vf.kernels import njit

FARTHEST = 0.45
"""[voxel] from the label's border, the face between two voxels, along the line between them."""

_PASSES = 60  # of smoothing: steps of a voxel vanish in planes up to about one in ten steep
_IN, _OUT = 0.7, -0.71  # Taubin's factors: without the second step all would shrink
_NORMALS_KEPT = 4  # passes with the same normals
_LEAST = 0.35  # cosine between a normal and the grid line, below which a step is shortened


def label_surface(inside: NDArray[np.bool_], T_world_voxel: FloatArray) -> Arrays:
    """Vertices ``(n, 3)`` [m] and faces of the voxels that are True in ``(i, j, k)``.

    The surface is closed, manifold and wound outwards, and contains the centres of exactly these
    voxels. It encloses their volume as far as `FARTHEST` allows. Where voxels of a cell's face are
    inside along one diagonal and outside along the other, the inside ones are joined.

    Raises:
        MeshError: no voxel, or more than `MOST_TRIANGLES`.
    """
    if not inside.any():
        raise MeshError("no voxel has this label")
    padded = np.pad(inside, 1)
    corners = _corners(padded)
    edges, faces = np.unique(corners, return_inverse=True)
    faces = faces.reshape(-1, 3).astype(np.int64)
    voxel, axis = np.divmod(edges, 3)
    lower = np.stack(np.unravel_index(voxel, padded.shape), axis=1)  # (n, 3)
    outwards = np.where(padded[tuple(lower.T)], 1.0, -1.0)
    share = _smoothed(lower, axis, faces)
    share = _filled(share, lower, axis, outwards, faces, float(np.count_nonzero(inside)))
    points = _points(lower, axis, share) - 1.0
    vertices = points @ T_world_voxel[:3, :3].T + T_world_voxel[:3, 3]
    if np.linalg.det(T_world_voxel[:3, :3]) < 0.0:
        faces = faces[:, ::-1]
    return vertices, np.ascontiguousarray(faces)


def _corners(padded: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Triangles ``(m, 3)`` as edges of the padded grid."""
    step = planes_at_once(padded)
    shape = (padded.shape[0], padded.shape[1], padded.shape[2])
    found, count = [], 0
    for start in range(0, shape[0] - 1, step):
        slab: NDArray[Any] = padded[start : start + step + 1]
        found.append(grid_triangles(slab, start, shape))
        count += len(found[-1])
        if count > MOST_TRIANGLES:
            raise MeshError(f"its surface has more than {MOST_TRIANGLES:,} triangles")
    return np.concatenate(found)


def _points(lower: NDArray[np.int64], axis: NDArray[np.int64], share: FloatArray) -> FloatArray:
    points = lower.astype(np.float64)
    points[np.arange(len(axis)), axis] += share
    return points


def _smoothed(
    lower: NDArray[np.int64], axis: NDArray[np.int64], faces: NDArray[np.int64]
) -> FloatArray:
    """Where each vertex lies between its two voxels, 0.5 ± `FARTHEST`, smoothed.

    A vertex goes along its grid line until it is as high above the tangential plane as the mean of
    its neighbours: what is flat stays flat, although neighbours lie unevenly about a vertex.
    """
    mean = _mean_of_neighbours(faces, len(lower))
    around = coo_array(
        (np.ones(faces.size), (faces.ravel(), np.arange(faces.size) // 3)),
        shape=(len(lower), len(faces)),
    ).tocsr()
    rows = np.arange(len(lower))
    share = np.full(len(lower), 0.5)
    points = _points(lower, axis, share)
    for _ in range(0, _PASSES, _NORMALS_KEPT):
        normals = _normals(points, faces, around, mean)
        along = normals[rows, axis]
        along = np.where(along < 0.0, -1.0, 1.0) * np.maximum(np.abs(along), _LEAST)
        _pass(points, share, axis, normals, along, mean.indptr, mean.indices, _NORMALS_KEPT)
    return share


@njit(cache=True, nogil=True)
def _pass(points, share, axis, normals, along, starts, neighbours, count):  # type: ignore[no-untyped-def]
    """``count`` passes of both factors over all vertices at once; changes points and share."""
    steps = np.empty(len(share))
    for k in range(2 * count):
        factor = _OUT if k % 2 else _IN
        for i in range(len(share)):
            x, y, z = 0.0, 0.0, 0.0
            degree = starts[i + 1] - starts[i]
            for n in range(starts[i], starts[i + 1]):
                j = neighbours[n]
                x, y, z = x + points[j, 0], y + points[j, 1], z + points[j, 2]
            height = (x / degree - points[i, 0]) * normals[i, 0]
            height += (y / degree - points[i, 1]) * normals[i, 1]
            height += (z / degree - points[i, 2]) * normals[i, 2]
            steps[i] = factor * height / along[i]
        for i in range(len(share)):
            new = min(max(share[i] + steps[i], 0.5 - FARTHEST), 0.5 + FARTHEST)
            points[i, axis[i]] += new - share[i]
            share[i] = new


def _normals(
    points: FloatArray, faces: NDArray[np.int64], around: csr_array, mean: csr_array
) -> FloatArray:
    """Unit normals ``(n, 3)`` of the vertices, averaged twice with their neighbours'."""
    a, b, c = points[faces].transpose(1, 0, 2)
    normals: FloatArray = around @ np.cross(b - a, c - a)
    for again in range(3):
        normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-12)[:, None]
        if again < 2:
            normals = normals + mean @ normals
    return normals


def _mean_of_neighbours(faces: NDArray[np.int64], count: int) -> csr_array:
    """The matrix that replaces each vertex by the mean of its neighbours."""
    ones = np.ones(3 * len(faces))
    heads, tails = faces.ravel(), np.roll(faces, -1, axis=1).ravel()  # closed: each edge both ways
    matrix = coo_array((ones, (heads, tails)), shape=(count, count)).tocsr()
    degrees = np.maximum(np.diff(matrix.indptr), 1)
    matrix.data /= np.repeat(degrees, degrees)
    return matrix


def _filled(
    share: FloatArray,
    lower: NDArray[np.int64],
    axis: NDArray[np.int64],
    outwards: FloatArray,
    faces: NDArray[np.int64],
    wanted: float,
) -> FloatArray:
    """All vertices moved outwards by one length, such that the volume is that of the voxels."""

    def moved(by: float) -> FloatArray:
        return np.clip(share + by * outwards, 0.5 - FARTHEST, 0.5 + FARTHEST)

    def volume(by: float) -> float:
        a, b, c = (_points(lower, axis, moved(by)) - lower.mean(axis=0))[faces].transpose(1, 0, 2)
        return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6.0

    low, high = -2.0 * FARTHEST, 2.0 * FARTHEST
    if not volume(low) < wanted < volume(high):
        return moved(high if volume(high) <= wanted else low)
    return moved(brentq(lambda by: volume(by) - wanted, low, high, xtol=1e-3))
