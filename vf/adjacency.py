"""Normals of faces, what lies across their edges, and whether a mesh is closed."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from vf.kernels import njit
from vf.planes import FloatArray, IntArray


class Edge(IntEnum):
    """What lies across an edge of a face, by the sign of N_a · (w_i − p_e)."""

    RIDGE = 0  # locally convex: the two half-spaces form a union
    VALLEY = 1  # locally concave: the two half-spaces intersect
    FLAT = 2  # coplanar within rounding, or the neighbour has no usable normal
    BOUNDARY = 3  # no neighbour
    NON_MANIFOLD = 4  # more than one neighbour


# Sine of the dihedral angle below which an edge is flat.
FLAT_SINE = 1e-9
RIDGE, VALLEY, FLAT = int(Edge.RIDGE), int(Edge.VALLEY), int(Edge.FLAT)
BOUNDARY, NON_MANIFOLD = int(Edge.BOUNDARY), int(Edge.NON_MANIFOLD)


def edge_keys(faces: IntArray, vertices: int) -> IntArray:
    """One integer per edge (3m,), the same for both directions, faces' edges in a row."""
    tail = faces.ravel()
    head = faces[:, [1, 2, 0]].ravel()
    return np.minimum(tail, head) * np.int64(vertices) + np.maximum(tail, head)


def adjacency(
    vertices: FloatArray, faces: IntArray, normals: FloatArray
) -> tuple[NDArray[np.int32], NDArray[np.int8], bool]:
    """Neighbours, kinds, and whether every edge has two faces that walk it in turn."""
    keys = edge_keys(faces, len(vertices))
    rank = np.argsort(keys, kind="stable")
    neighbours = np.empty((len(faces), 3), dtype=np.int32)
    kinds = np.empty((len(faces), 3), dtype=np.int8)
    manifold = _link(keys, rank, vertices, faces, normals, neighbours, kinds)
    return neighbours, kinds, bool(manifold)


@njit(cache=True, nogil=True)
def _link(keys, rank, vertices, faces, normals, neighbours, kinds):  # type: ignore[no-untyped-def]
    """Neighbour and kind of every edge from the sorted edge table; whether all are in pairs."""
    count = keys.shape[0]
    manifold = True
    i = 0
    while i < count:
        j = i + 1
        while j < count and keys[rank[j]] == keys[rank[i]]:
            j += 1
        if j - i == 2:
            e, g = rank[i], rank[i + 1]
            _pair(e, g, vertices, faces, normals, neighbours, kinds)
            _pair(g, e, vertices, faces, normals, neighbours, kinds)
        else:
            for k in range(i, j):
                e = rank[k]
                neighbours[e // 3, e % 3] = -1 if j - i == 1 else -2
                kinds[e // 3, e % 3] = BOUNDARY if j - i == 1 else NON_MANIFOLD
        excess = 0
        for k in range(i, j):
            e = rank[k]
            excess += 1 if faces[e // 3, e % 3] < faces[e // 3, (e % 3 + 1) % 3] else -1
        manifold &= excess == 0 and j - i == 2
        i = j
    return manifold


@njit(cache=True, nogil=True)
def _pair(e, g, vertices, faces, normals, neighbours, kinds):  # type: ignore[no-untyped-def]
    """Set neighbour and kind of half-edge e (face 3·i + k) from the face of half-edge g."""
    i, k = e // 3, e % 3
    a = g // 3
    neighbours[i, k] = a
    p = vertices[faces[i, k]]
    w = vertices[faces[i, (k + 2) % 3]]
    dx, dy, dz = w[0] - p[0], w[1] - p[1], w[2] - p[2]
    side = normals[a, 0] * dx + normals[a, 1] * dy + normals[a, 2] * dz
    # The sine of the angle is that height of w over the neighbour's plane per height over the edge.
    q = vertices[faces[i, (k + 1) % 3]]
    ex, ey, ez = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    along = ex * ex + ey * ey + ez * ez
    height2 = dx * dx + dy * dy + dz * dz
    if along > 0.0:
        height2 -= (dx * ex + dy * ey + dz * ez) ** 2 / along
    flat = FLAT_SINE * np.sqrt(max(height2, 0.0)) + 1e-300
    if side > flat:
        kinds[i, k] = VALLEY
    elif side < -flat:
        kinds[i, k] = RIDGE
    else:
        kinds[i, k] = FLAT


@njit(cache=True, nogil=True)
def fill_normals(vertices, faces, normals, lengths):  # type: ignore[no-untyped-def]
    """Unit normals (zero without area) and the three edge lengths of every face."""
    for i in range(faces.shape[0]):
        a, b, c = vertices[faces[i, 0]], vertices[faces[i, 1]], vertices[faces[i, 2]]
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        wx, wy, wz = c[0] - b[0], c[1] - b[1], c[2] - b[2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        norm = np.sqrt(nx * nx + ny * ny + nz * nz)
        scale = 1.0 / norm if norm > 0.0 else 0.0
        normals[i, 0], normals[i, 1], normals[i, 2] = nx * scale, ny * scale, nz * scale
        lengths[i, 0] = np.sqrt(ux * ux + uy * uy + uz * uz)
        lengths[i, 1] = np.sqrt(wx * wx + wy * wy + wz * wz)
        lengths[i, 2] = np.sqrt(vx * vx + vy * vy + vz * vz)


def closedness(
    vertices: FloatArray, faces: IntArray
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], bool]:
    """(m,) whether a face has three corners, (m,) whether it repeats another, and closedness."""
    # Adding zero turns −0.0 into 0.0, which is the same place.
    rows = np.ascontiguousarray(vertices + 0.0).view([("", np.float64)] * 3).ravel()
    _, place = np.unique(rows, return_inverse=True)
    corners = place.reshape(-1)[faces]
    ordered = np.sort(corners, axis=1)
    proper = (ordered[:, 0] != ordered[:, 1]) & (ordered[:, 1] != ordered[:, 2])
    rank = np.lexsort(ordered.T)
    ranked = ordered[rank]
    repeated = np.zeros(len(faces), dtype=bool)
    repeated[rank[1:]] = (ranked[1:] == ranked[:-1]).all(axis=1)
    first = proper & ~repeated
    if not first.any():
        return proper, repeated, False
    kept = np.ascontiguousarray(corners[first])
    keys = edge_keys(kept, len(vertices))
    forward = np.where(kept < kept[:, [1, 2, 0]], 1, -1).ravel()
    rank = np.argsort(keys)
    keys, forward = keys[rank], forward[rank]
    starts = np.flatnonzero(np.r_[True, keys[1:] != keys[:-1]])
    return proper, repeated, not np.add.reduceat(forward, starts).any()


def doubles_of(vertices: FloatArray) -> tuple[IntArray, IntArray]:
    """The vertices that are exactly where an earlier one is, and those."""
    rows = np.ascontiguousarray(vertices + 0.0).view([("", np.float64)] * 3).ravel()
    _, first, place = np.unique(rows, return_index=True, return_inverse=True)
    original = first[place.reshape(-1)]
    doubles = np.flatnonzero(original != np.arange(len(vertices)))
    return doubles, original[doubles]
