"""Polygons and strips as triangles, cut by the polygon's shape.

A polygon of n corners becomes n − 2 triangles on its own corners, and each of its edges is an edge
of exactly one of them: a closed surface stays closed, also where corners are collinear (libraries
that drop such corners open it).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from meshes.content import Arrays, check_corners, checked, cut_off
from meshes.errors import MeshError
from vf.kernels import njit

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Lists = tuple[IntArray, IntArray]
"""Corners of all polygons or strips one after the other, and the number of corners of each."""

NO_LISTS: Lists = np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
MOST_WORK = 200_000_000  # sum over non-convex polygons of the corners squared: 5 s
_FLAT = 1e-10  # sine of an angle below which a corner counts as straight


def body(vertices: FloatArray, polygons: Lists, strip_lists: Lists = NO_LISTS) -> Arrays:
    """Vertices ``(n, 3)``, and the triangles of polygons and of strips.

    Raises:
        MeshError: see `content.checked` and `triangles`.
    """
    checked(vertices, np.empty((0, 3), dtype=np.int64))  # polygons are cut by their shape
    corners, counts = strip_lists
    more = strips(np.insert(corners, np.cumsum(counts)[:-1], -1))
    return checked(vertices, np.vstack([triangles(vertices, *polygons), more]))


def triangles(vertices: FloatArray, corners: IntArray, counts: IntArray) -> IntArray:
    """Triangles ``(m, 3)`` of polygons, in their order and with their winding.

    Faces of one or two corners give none. A polygon that is not flat is cut in its mean plane; how
    one that crosses itself is cut is not defined.

    Args:
        vertices: ``(n, 3)``.
        corners, counts: the polygons, see `Lists`.

    Raises:
        MeshError: a corner that is no vertex, or so many corners that it would take minutes.
    """
    check_corners(corners, len(vertices))
    counts = counts.astype(np.int64)
    starts = np.cumsum(counts) - counts
    cut = np.maximum(counts - 2, 0)
    first = np.cumsum(cut) - cut
    out = np.empty((int(cut.sum()), 3), dtype=np.int64)
    work = 0
    for count in np.unique(counts[counts >= 3]):
        which = np.flatnonzero(counts == count)
        polygons = corners[starts[which, None] + np.arange(count)]
        fans = np.stack(
            [np.broadcast_to(polygons[:, :1], (len(which), count - 2)), polygons[:, 1:-1],
             polygons[:, 2:]], axis=2,
        )  # fmt: skip
        if count > 3:
            odd = np.flatnonzero(~_fan_is_right(vertices, polygons))
            work += len(odd) * int(count) ** 2
            if work > MOST_WORK:
                raise MeshError(f"faces of up to {count:,} corners are too many to be cut")
            places = _clipped(*_flattened(vertices[polygons[odd]]))
            fans[odd] = polygons[odd[:, None, None], places]
        out[(first[which, None] + np.arange(count - 2)).ravel()] = fans.reshape(-1, 3)
    return out


def strips(corners: IntArray) -> IntArray:
    """Triangles ``(m, 3)`` of strips of corners, one after the other with −1 between them.

    Every other triangle of a strip is reversed; those that repeat a corner are left out.
    """
    places = np.arange(len(corners))
    begins = np.maximum.accumulate(np.where(corners == -1, places + 1, 0))
    faces = np.column_stack([corners[:-2], corners[1:-1], corners[2:]])
    odd = (places[:-2] - begins[:-2]) % 2 == 1
    faces[odd] = faces[odd][:, [1, 0, 2]]
    a, b, c = faces.T
    return faces[(a != b) & (b != c) & (a != c) & (faces != -1).all(axis=1)]


def unpacked(flat: IntArray, count: int, what: str) -> tuple[IntArray, IntArray, int]:
    """``count`` lists that each begin with their length, as ``(corners, counts, numbers used)``.

    Raises:
        MeshError: fewer lists; ``what`` names them.
    """
    short = cut_off(f"{count:,} {what}")
    if count == 0:
        return flat[:0], flat[:0], 0
    if count < 0 or count > len(flat):
        raise short
    length = int(flat[0]) + 1
    if length > 0 and count * length <= len(flat):
        table = flat[: count * length].reshape(count, length)
        if (table[:, 0] == length - 1).all():
            return table[:, 1:].ravel(), table[:, 0], count * length
    counts, place = [], 0
    numbers = flat.tolist()
    for _ in range(count):
        if place >= len(numbers) or numbers[place] < 0 or place + numbers[place] >= len(numbers):
            raise short
        counts.append(numbers[place])
        place += numbers[place] + 1
    heads = np.cumsum([0] + [n + 1 for n in counts[:-1]])
    keep = np.ones(place, dtype=bool)
    keep[heads] = False
    return flat[:place][keep], np.array(counts, dtype=np.int64), place


def _fan_is_right(vertices: FloatArray, polygons: IntArray) -> NDArray[np.bool_]:
    """Whether all triangles of a fan about the first corner face the polygon's way."""
    edges = vertices[polygons[:, 1:]] - vertices[polygons[:, :1]]
    areas = np.cross(edges[:, :-1], edges[:, 1:])
    normal = areas.sum(axis=1, keepdims=True)
    along = (areas * normal).sum(axis=2)
    sizes = np.linalg.norm(edges[:, :-1], axis=2) * np.linalg.norm(edges[:, 1:], axis=2)
    return np.asarray((along > _FLAT * sizes * np.linalg.norm(normal, axis=2)).all(axis=1))


def _flattened(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Coordinates ``(m, n)`` of m polygons ``(m, n, 3)``, each in its mean plane,
    counter-clockwise."""
    points = points - points[:, :1]
    sizes = np.abs(points).max(axis=(1, 2), initial=0.0)
    points = points / np.where(sizes > 0, sizes, 1.0)[:, None, None]
    normals = np.cross(points, np.roll(points, -1, axis=1)).sum(axis=1)
    lengths = np.linalg.norm(normals, axis=1)
    normals[lengths == 0] = (0.0, 0.0, 1.0)
    normals /= np.where(lengths > 0, lengths, 1.0)[:, None]
    x = np.cross(np.eye(3)[np.abs(normals).argmin(axis=1)], normals)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    y = np.cross(normals, x)
    return (points * x[:, None]).sum(axis=2), (points * y[:, None]).sum(axis=2)


@njit(cache=True, nogil=True)
def _turn(x, y, i, j, k):  # type: ignore[no-untyped-def]
    """Sine of the turn at j from i to k, times both lengths, and the lengths' product."""
    ax, ay, bx, by = x[j] - x[i], y[j] - y[i], x[k] - x[j], y[k] - y[j]
    return ax * by - ay * bx, np.sqrt((ax * ax + ay * ay) * (bx * bx + by * by))


@njit(cache=True, nogil=True)
def _quality(x, y, i, j, k, after, convex):  # type: ignore[no-untyped-def]
    """How good an ear the corner j is: smallest of its triangle's sines; −1 where it is none."""
    smallest = 2.0
    for a, b, c in ((i, j, k), (j, k, i), (k, i, j)):
        turn, size = _turn(x, y, a, b, c)
        if not turn > _FLAT * size:
            return -1.0
        smallest = min(smallest, turn / size)
    w = after[k]
    while w != i:
        # Only corners that are not convex can be in the way.
        if not convex[w]:
            same = (
                (x[w] == x[i] and y[w] == y[i])
                or (x[w] == x[j] and y[w] == y[j])
                or (x[w] == x[k] and y[w] == y[k])
            )
            if not same:
                inside = True
                for a, b in ((i, j), (j, k), (k, i)):
                    turn, size = _turn(x, y, a, b, w)
                    if turn < -_FLAT * size:
                        inside = False
                        break
                if inside:
                    return -1.0
        w = after[w]
    return smallest


@njit(cache=True, nogil=True)
def _clipped(x, y):  # type: ignore[no-untyped-def]
    """Triangles ``(m, n - 2, 3)``, of the corners 0 … n − 1, of m polygons ``(m, n)``."""
    out = np.empty((x.shape[0], x.shape[1] - 2, 3), dtype=np.int64)
    for polygon in range(x.shape[0]):
        _clip(x[polygon], y[polygon], out[polygon])
    return out


@njit(cache=True, nogil=True)
def _clip(x, y, out):  # type: ignore[no-untyped-def]
    """Ear clipping of one polygon, the best-shaped ear first; quadratic in the corners."""
    n = x.shape[0]
    before, after = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
    for j in range(n):
        before[j], after[j] = (j - 1) % n, (j + 1) % n
    convex = np.zeros(n, dtype=np.bool_)
    for j in range(n):
        turn, size = _turn(x, y, before[j], j, after[j])
        convex[j] = turn > _FLAT * size
    quality = np.empty(n)
    for j in range(n):
        quality[j] = _quality(x, y, before[j], j, after[j], after, convex)
    left = np.ones(n, dtype=np.bool_)
    for step in range(n - 2):
        best = -1
        for j in range(n):
            if left[j] and (best < 0 or quality[j] > quality[best]):
                best = j
        if quality[best] < 0.0:
            # A polygon that crosses or touches itself: the sharpest convex corner, if any.
            sharpest = -2.0
            for j in range(n):
                if left[j]:
                    turn, size = _turn(x, y, before[j], j, after[j])
                    sine = turn / size if size > 0.0 else 0.0
                    if sine > sharpest:
                        best, sharpest = j, sine
        i, k = before[best], after[best]
        out[step, 0], out[step, 1], out[step, 2] = i, best, k
        left[best] = False
        after[i], before[k] = k, i
        for j in (i, k):
            turn, size = _turn(x, y, before[j], j, after[j])
            convex[j] = turn > _FLAT * size
        for j in (i, k):
            quality[j] = _quality(x, y, before[j], j, after[j], after, convex)
