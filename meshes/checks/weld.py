"""Vertices at the same place and faces on the same corners, by hash tables.

A k-d tree would list every pair of near points, which is quadratic for clustered points; this is
linear for any points.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vf.kernels import njit

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Cells per tolerance: few cells around a point, few representatives in a cell.
_CELL = 4.0
# With no tolerance the cells only group equal points: this share of the size is fine enough.
_FINE = 1e-12


def weld(vertices: FloatArray, tolerance: float) -> tuple[IntArray, FloatArray]:
    """The representative of every vertex, and the distance to it [m].

    In their order, vertices join the nearest representative within ``tolerance`` [m] or become one:
    none moves farther than the tolerance, also in a chain of near points. Zero joins equal places
    only (−0 and 0 are equal).

    Args:
        vertices: ``(n, 3)``, finite.

    Returns:
        Representatives ``(n,)`` (a vertex that joins none is its own) and distances ``(n,)``.
    """
    if not (np.isfinite(tolerance) and tolerance >= 0.0):
        raise ValueError(f"the weld tolerance must be a length of zero or more, not {tolerance}")
    size = float(np.ptp(vertices, axis=0).max(initial=0.0)) if len(vertices) else 0.0
    cell = max(_CELL * tolerance, _FINE * size, 1e-300)
    stands_for = np.empty(len(vertices), dtype=np.int64)
    distance = np.zeros(len(vertices))
    if len(vertices):
        buckets = 1 << max(4, int(2 * len(vertices) - 1).bit_length())
        _weld(vertices, vertices.min(axis=0), cell, tolerance, buckets, stands_for, distance)
    return stands_for, distance


@njit(cache=True, nogil=True, inline="always")
def _mixed(i, j, k):  # type: ignore[no-untyped-def]
    """A hash of three integers (wraps on overflow, as intended)."""
    h = i * np.int64(73856093) ^ j * np.int64(19349663) ^ k * np.int64(83492791)
    h ^= h >> np.int64(29)
    h *= np.int64(0x1CE4E5B9BF58476D)
    return h ^ (h >> np.int64(32))


@njit(cache=True, nogil=True)
def _weld(vertices, low, cell, tolerance, buckets, stands_for, distance):  # type: ignore[no-untyped-def]
    first = np.full(buckets, -1, dtype=np.int64)  # newest representative of a bucket
    link = np.full(vertices.shape[0], -1, dtype=np.int64)  # the one before it
    mask = buckets - 1
    limit = tolerance * tolerance
    a = np.empty(3, dtype=np.int64)
    b = np.empty(3, dtype=np.int64)
    for v in range(vertices.shape[0]):
        x, y, z = vertices[v, 0], vertices[v, 1], vertices[v, 2]
        for k in range(3):
            a[k] = np.int64(np.floor((vertices[v, k] - tolerance - low[k]) / cell))
            b[k] = np.int64(np.floor((vertices[v, k] + tolerance - low[k]) / cell))
        best, found = limit, np.int64(-1)
        for i in range(a[0], b[0] + 1):
            for j in range(a[1], b[1] + 1):
                for k in range(a[2], b[2] + 1):
                    w = first[_mixed(i, j, k) & mask]
                    while w >= 0:
                        dx, dy, dz = vertices[w, 0] - x, vertices[w, 1] - y, vertices[w, 2] - z
                        d2 = dx * dx + dy * dy + dz * dz
                        if d2 < best or (d2 == best and (found < 0 or w < found)):
                            best, found = d2, w
                        w = link[w]
        if found >= 0 and (tolerance > 0.0 or _equal(vertices, v, found)):
            stands_for[v] = found
            distance[v] = np.sqrt(best)
            continue
        stands_for[v] = v
        for k in range(3):
            a[k] = np.int64(np.floor((vertices[v, k] - low[k]) / cell))
        h = _mixed(a[0], a[1], a[2]) & mask
        link[v] = first[h]
        first[h] = v


@njit(cache=True, nogil=True, inline="always")
def _equal(vertices, v, w):  # type: ignore[no-untyped-def]
    """Squares of differences can vanish where the differences do not."""
    return (
        vertices[v, 0] == vertices[w, 0]
        and vertices[v, 1] == vertices[w, 1]
        and vertices[v, 2] == vertices[w, 2]
    )


def repeats_a_corner(corners: IntArray) -> NDArray[np.bool_]:
    """``(m,)`` faces ``(m, 3)`` with the same corner twice."""
    a, b, c = corners.T
    repeats: NDArray[np.bool_] = (a == b) | (b == c) | (c == a)
    return repeats


def first_of_kind(faces: IntArray) -> IntArray:
    """For every face ``(m, 3)`` the first one with the same three corners, in any order."""
    first = np.empty(len(faces), dtype=np.int64)
    if len(faces):
        buckets = 1 << max(4, int(2 * len(faces) - 1).bit_length())
        _first_of_kind(np.sort(faces, axis=1), buckets, first)
    return first


@njit(cache=True, nogil=True)
def _first_of_kind(ordered, buckets, first):  # type: ignore[no-untyped-def]
    table = np.full(buckets, -1, dtype=np.int64)
    mask = buckets - 1
    for f in range(ordered.shape[0]):
        i, j, k = ordered[f, 0], ordered[f, 1], ordered[f, 2]
        h = _mixed(i, j, k) & mask
        while True:
            g = table[h]
            if g < 0:
                table[h] = f
                first[f] = f
                break
            if ordered[g, 0] == i and ordered[g, 1] == j and ordered[g, 2] == k:
                first[f] = g
                break
            h = (h + 1) & mask
