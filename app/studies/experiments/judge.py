"""Tests after a trial whether the tip crossed a surface or left the corridor, and how far.

Shares no code with the fixtures: candidates come from `app.judges.boxes` and are tested one by one,
in rational arithmetic where rounding leaves the answer open; the corridor is tested by the distance
from a plane.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from app.judges import boxes, exact, nearest
from app.judges.boxes import list_near
from app.judges.oracles import touches
from vf.kernels import njit

FloatArray = NDArray[np.float64]

ROOM = 1024  # initial capacity for triangles near a segment, and for undecided pairs
ROUNDING = 1e-12  # tolerance of a distance from a plane [m]


def crossings(vertices: FloatArray, faces: NDArray[np.int64], points: FloatArray) -> int:
    """Number of pairs of a segment of a polyline (n, 3) and a triangle that meet or touch."""
    around, points = boxes.build(vertices, faces), np.ascontiguousarray(points)
    room, most = 0, ROOM
    while most > room:
        room = most
        near, doubtful = np.empty(room, dtype=np.int64), np.empty((room, 2), dtype=np.int64)
        count, doubts, most = _count(*around, points, near, doubtful)
    return int(count) + sum(
        exact.meets(points[i], points[i + 1], vertices[faces[t]]) for i, t in doubtful[:doubts]
    )


def heights(vertices: FloatArray, faces: NDArray[np.int64], points: FloatArray) -> FloatArray:
    """Distance (n,) [m] of points (n, 3) from a smooth surface; negative: beyond it."""
    return nearest.signed(boxes.build(vertices, faces), points)


def outside(path: FloatArray, points: FloatArray, width: float) -> int:
    """Number of points (n, 3) farther than `width` from the plane of a path (k, 3).

    Points before the first one inside do not count: the tool may start outside.
    """
    middle = path.mean(axis=0)
    normal = np.linalg.svd(path - middle)[2][2]
    off = np.abs((points - middle) @ normal) > width + ROUNDING
    return int(off[np.argmin(off) :].sum()) if not off.all() else 0


@njit(cache=True, nogil=True)
def _count(vertices, faces, order, table, levels, points, near, doubtful):  # type: ignore[no-untyped-def]
    """(Pairs that certainly meet, undecided ones, required capacity); undecided ones are listed."""
    count = doubts = most = 0
    for i in range(points.shape[0] - 1):
        a, b = points[i], points[i + 1]
        found = list_near(vertices, faces, order, table, levels, a, b, 0.0, near)
        most = max(most, found)
        for t in near[: min(found, near.shape[0])]:
            p, q, r = vertices[faces[t, 0]], vertices[faces[t, 1]], vertices[faces[t, 2]]
            verdict = touches(a, b, p, q, r)
            if verdict > 0:
                count += 1
            elif verdict < 0:
                if doubts < doubtful.shape[0]:
                    doubtful[doubts, 0], doubtful[doubts, 1] = i, t
                doubts += 1
    return count, doubts, max(most, doubts)
