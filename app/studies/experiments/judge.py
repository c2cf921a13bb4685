"""Did the tip ever pass the registered surface or leave the corridor? Asked after the trial.

Shares no code with the fixtures: triangles are tested one by one with exact arithmetic where
rounding leaves it open, the corridor is the distance from a plane.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from app.studies.verification import exact
from app.studies.verification.oracles import touches
from vf.kernels import njit

FloatArray = NDArray[np.float64]

CELL = 5e-4  # [m]
ROUNDING = 1e-12  # of a distance from a plane [m]


def crossings(vertices: FloatArray, faces: NDArray[np.int64], points: FloatArray) -> int:
    """How many pairs of a step of a polyline (n, 3) and a triangle meet, touching included."""
    corners = vertices[faces]
    low, high = corners.min(axis=1), corners.max(axis=1)
    near = np.flatnonzero(((low <= points.max(axis=0)) & (high >= points.min(axis=0))).all(axis=1))
    if not len(near) or len(points) < 2:
        return 0
    axis = int(np.ptp(points, axis=0).argmax())
    start = points[:, axis].min()
    cells = int(np.ptp(points[:, axis]) / CELL) + 1
    first = np.clip((low[near, axis] - start) // CELL, 0, cells - 1).astype(np.int64)
    last = np.clip((high[near, axis] - start) // CELL, 0, cells - 1).astype(np.int64)
    offsets, members = _sorted(first, last, cells)
    doubtful = np.empty((1024, 2), dtype=np.int64)
    count, doubts = _count(
        np.ascontiguousarray(corners[near]), low[near], high[near], offsets, members,
        np.ascontiguousarray(points), axis, start, CELL, doubtful,
    )  # fmt: skip
    if doubts > len(doubtful):
        raise RuntimeError(f"{doubts} steps touch triangles within rounding")
    return int(count) + sum(
        exact.meets(points[i], points[i + 1], corners[near[t]]) for i, t in doubtful[:doubts]
    )


def outside(path: FloatArray, points: FloatArray, width: float) -> int:
    """How many of the points (n, 3) are farther than `width` from the plane of a path (k, 3).

    Those before the first point that is not do not count: the tool may start outside.
    """
    middle = path.mean(axis=0)
    normal = np.linalg.svd(path - middle)[2][2]
    off = np.abs((points - middle) @ normal) > width + ROUNDING
    return int(off[np.argmin(off) :].sum()) if not off.all() else 0


@njit(cache=True, nogil=True)
def _sorted(first, last, cells):  # type: ignore[no-untyped-def]
    """Which triangles are in which cell, as offsets (cells + 1,) into a list of members."""
    offsets = np.zeros(cells + 1, dtype=np.int64)
    for t in range(len(first)):
        for c in range(first[t], last[t] + 1):
            offsets[c + 1] += 1
    offsets = np.cumsum(offsets)
    members = np.empty(offsets[-1], dtype=np.int64)
    fill = offsets.copy()
    for t in range(len(first)):
        for c in range(first[t], last[t] + 1):
            members[fill[c]] = t
            fill[c] += 1
    return offsets, members


@njit(cache=True, nogil=True)
def _count(corners, low, high, offsets, members, points, axis, start, cell, doubtful):  # type: ignore[no-untyped-def]
    cells = len(offsets) - 1
    count = 0
    doubts = 0
    for i in range(len(points) - 1):
        a, b = points[i], points[i + 1]
        from_ = min(max(int((min(a[axis], b[axis]) - start) / cell), 0), cells - 1)
        to = min(max(int((max(a[axis], b[axis]) - start) / cell), 0), cells - 1)
        for c in range(from_, to + 1):
            for m in range(offsets[c], offsets[c + 1]):
                t = members[m]
                apart = False
                for k in range(3):
                    if max(a[k], b[k]) < low[t, k] or min(a[k], b[k]) > high[t, k]:
                        apart = True
                        break
                if apart:
                    continue
                # A triangle in several cells is counted in the first that both share.
                if c > from_ and (low[t, axis] - start) // cell < c:
                    continue
                verdict = touches(a, b, corners[t, 0], corners[t, 1], corners[t, 2])
                if verdict > 0:
                    count += 1
                elif verdict < 0:
                    if doubts < len(doubtful):
                        doubtful[doubts, 0], doubtful[doubts, 1] = i, t
                    doubts += 1
    return count, doubts
