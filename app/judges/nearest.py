"""Distance of an axis, and of the parts of an instrument, from a mesh, over the judges' boxes."""

from __future__ import annotations

from heapq import heappop, heappush

import numpy as np
from numpy.typing import ArrayLike, NDArray

import robots
from app.judges import exact
from app.judges.boxes import FAN, Boxes
from app.judges.oracles import distance, touches
from vf.kernels import njit

FloatArray = NDArray[np.float64]


def nearest(boxes: Boxes, axis: FloatArray, within: float = np.inf) -> tuple[float, int]:
    """Distance [m] of an axis (2, 3) from the nearest triangle, and its number.

    0.0 where they meet. Where rounding leaves that open of several triangles, it is decided in
    rational arithmetic for one of them; the others are within rounding of the axis.
    Infinity and −1 where no triangle is nearer than `within` [m].
    """
    ends = np.ascontiguousarray(axis, dtype=np.float64)
    gap, triangle, doubtful = _search(*boxes, ends[0], ends[1], within)
    if doubtful >= 0 and exact.meets(ends[0], ends[1], boxes.vertices[boxes.faces[doubtful]]):
        return 0.0, int(doubtful)
    return float(gap), int(triangle)


def signed(boxes: Boxes, points: FloatArray) -> FloatArray:
    """Distance (n,) [m] of points (n, 3) from a smooth surface, negative behind its triangles.

    Behind is decided by the nearest triangle alone: right where its neighbours are nearly in its
    plane, on closed surfaces and open ones.
    """
    return np.asarray(_signed(*boxes, np.ascontiguousarray(points, dtype=np.float64)))


def gaps(boxes: Boxes, arm: robots.Arm, q: ArrayLike, trocar: float = 0.0) -> FloatArray:
    """Distance of each capsule (c,) of an arm at joints q (n,) from the mesh [m]; overlapping: < 0.

    Minus its radius where a capsule's axis meets the mesh. Infinity for a capsule that is farther
    than one before it. `trocar` is the radius of the zone around the remote centre in which the
    shaft may be in the mesh [m]: there it is not looked at.
    """
    found = np.full(len(arm.capsules), np.inf)
    least = np.inf
    for k, (capsule, axis) in enumerate(zip(arm.capsules, arm.axes(q), strict=True)):
        if capsule.port and trocar > capsule.radius:
            way = axis[1] - axis[0]
            share = np.sqrt(trocar**2 - capsule.radius**2) / max(np.linalg.norm(way), 1e-300)
            if share >= 1.0:
                continue
            axis = np.array([axis[0] + share * way, axis[1]])
        found[k] = nearest(boxes, axis, max(least, 0.0) + capsule.radius)[0] - capsule.radius
        least = min(least, found[k])
    return found


@njit(cache=True, nogil=True)
def _search(vertices, faces, order, boxes, levels, a, b, within):  # type: ignore[no-untyped-def]
    """Least distance, its triangle, and the last triangle of which it is open whether it is met.

    The boxes are taken in the order of their lower bounds, until none is below the least distance.
    """
    top = levels.shape[0] - 1
    best = within
    nearest = -1
    doubtful = -1
    size = 0.0
    whole = boxes[levels[top, 1]]
    for k in range(3):
        size = max(size, max(abs(a[k]), abs(b[k])))
        size = max(size, max(abs(whole[k]), abs(whole[3 + k])))
    slack = 1e-14 * size  # bounds the rounding error: a few dozen ulps of the largest coordinate
    waiting = [(_below(whole, a, b) - slack, top, 0)]
    box = np.empty(6)
    while len(waiting) > 0:
        bound, level, i = heappop(waiting)
        if bound >= best:
            break
        for child in range(FAN * i, min(FAN * i + FAN, levels[level - 1, 0])):
            if level > 1:
                below = _below(boxes[levels[level - 1, 1] + child], a, b) - slack
                if below < best:
                    heappush(waiting, (below, level - 1, child))
                continue
            t = order[child]
            p, q, r = vertices[faces[t, 0]], vertices[faces[t, 1]], vertices[faces[t, 2]]
            for k in range(3):
                box[k] = min(p[k], min(q[k], r[k]))
                box[3 + k] = max(p[k], max(q[k], r[k]))
            if _below(box, a, b) - slack >= best:
                continue
            verdict = touches(a, b, p, q, r)
            if verdict > 0:
                return 0.0, t, -1
            if verdict < 0:
                doubtful = t
            gap = distance(a, b, p, q, r)
            if gap < best:
                best = gap
                nearest = t
    return (best if nearest >= 0 else np.inf), nearest, doubtful


@njit(cache=True, nogil=True)
def _signed(vertices, faces, order, boxes, levels, points):  # type: ignore[no-untyped-def]
    found = np.empty(points.shape[0])
    for i in range(points.shape[0]):
        x = points[i]
        gap, t, _ = _search(vertices, faces, order, boxes, levels, x, x, np.inf)
        p, q, r = vertices[faces[t, 0]], vertices[faces[t, 1]], vertices[faces[t, 2]]
        u, v, w = q - p, r - p, x - p
        volume = (
            (u[1] * v[2] - u[2] * v[1]) * w[0]
            + (u[2] * v[0] - u[0] * v[2]) * w[1]
            + (u[0] * v[1] - u[1] * v[0]) * w[2]
        )
        found[i] = -gap if volume < 0.0 else gap
    return found


@njit(cache=True, nogil=True)
def _below(box, a, b):  # type: ignore[no-untyped-def]
    """A lower bound of the distance of the segment ab from a box (6,), negative where they meet."""
    # From the segment to the middle, less from there to a corner.
    along = length2 = half2 = 0.0
    for k in range(3):
        way = b[k] - a[k]
        along += (0.5 * (box[k] + box[3 + k]) - a[k]) * way
        length2 += way * way
        half2 += (0.5 * (box[3 + k] - box[k])) ** 2
    share = min(max(along / length2, 0.0), 1.0) if length2 > 0.0 else 0.0
    away2 = 0.0
    for k in range(3):
        away2 += (0.5 * (box[k] + box[3 + k]) - a[k] - share * (b[k] - a[k])) ** 2
    return np.sqrt(away2) - np.sqrt(half2)
