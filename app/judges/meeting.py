"""First intersection of a tip that moves along segments with a mesh, independent of the rule.

Candidates come from `boxes`, not from the PD-tree. Segment and triangle are tested in floating
point, and in rational arithmetic where rounding leaves the answer open.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import vf
from app.judges import boxes, exact
from app.judges.boxes import ROOM, list_near
from app.judges.oracles import OVERLAP_TOLERANCE, distance, touches
from vf.kernels import njit

FloatArray = NDArray[np.float64]

# Verdicts on a segment and a triangle.
_OPEN, _CROSSED, _TOUCHED = 1, 2, 3


@dataclass(frozen=True)
class Meeting:
    """The first segment that meets the surface.

    Attributes:
        segment: its index.
        triangle: the caller's index of the triangle met first along it.
        point: (3,) on the segment [m].
        centre: whether the segment itself meets the triangle; else only the ball around its end.
    """

    segment: int
    triangle: int
    point: FloatArray
    centre: bool


def first_meeting(
    surface: vf.Surface, starts: FloatArray, ends: FloatArray, tip_radius: float = 0.0
) -> Meeting | None:
    """The first segment from starts[k] to ends[k], both (n, 3) [m], that meets a triangle.

    A segment meets a triangle if they share a point, boundaries included; this test is exact. With
    a `tip_radius` [m] it also meets a triangle nearer than that (by more than `OVERLAP_TOLERANCE`),
    unless the ball already overlapped a triangle at the segment's start: then only the centre is
    tested. A segment without length meets nothing.
    """
    around = boxes.of(surface)
    starts, ends = np.ascontiguousarray(starts), np.ascontiguousarray(ends)
    triangles, verdicts = np.empty(ROOM, dtype=np.int64), np.empty(ROOM, dtype=np.int64)
    first = 0
    while True:
        k, count, near = _next(*around, starts, ends, tip_radius, first, triangles, verdicts)
        if k < 0:
            return None
        if near > len(triangles):
            triangles, verdicts = np.empty(near, dtype=np.int64), np.empty(near, dtype=np.int64)
            first = k
            continue
        a, b = starts[k], ends[k]
        met = []
        for triangle, verdict in zip(triangles[:count], verdicts[:count], strict=True):
            corners = surface.vertices[surface.faces[triangle]]
            if verdict != _OPEN or exact.meets(a, b, corners):
                met.append((verdict == _TOUCHED, _share(a, b, corners), int(triangle)))
        if met:
            touched, share, triangle = min(met)
            return Meeting(k, triangle, a + share * (b - a), not touched)
        first = k + 1


def warm_up() -> None:
    """Compile the kernels, or load them from disk."""
    sheet = vf.Surface.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    first_meeting(sheet, np.array([[0.1, 0.1, 1.0]]), np.array([[0.1, 0.1, -1.0]]))


def sees(surface: vf.Surface, a: FloatArray, b: FloatArray) -> bool:
    """Whether the segment from a to b (3,) meets no triangle."""
    return first_meeting(surface, a[None], b[None]) is None


def _share(a: FloatArray, b: FloatArray, corners: FloatArray) -> float:
    """Parameter in [0, 1] of the segment's point on, or nearest to, the triangle's plane."""
    n = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    before, after = float(n @ (a - corners[0])), float(n @ (b - corners[0]))
    if before * after < 0.0:
        return before / (before - after)
    return float(abs(after) < abs(before))


@njit(cache=True, nogil=True)
def _next(vertices, faces, order, table, levels, starts, ends, tip_radius, first, found, verdicts):  # type: ignore[no-untyped-def]
    """The next segment that may meet a triangle (−1: none), its hits, and its candidates.

    Writes the triangles hit and their verdicts, unless `found` is too small for all candidates:
    then the segment has not been tested, and the number of hits is 0.
    """
    room = tip_radius - OVERLAP_TOLERANCE
    for k in range(first, starts.shape[0]):
        a, b = starts[k], ends[k]
        if a[0] == b[0] and a[1] == b[1] and a[2] == b[2]:
            continue
        near = list_near(vertices, faces, order, table, levels, a, b, tip_radius, found)
        if near > found.shape[0]:
            return k, 0, near
        count = 0
        overlapped = False
        for i in range(near):
            t = found[i]
            p, q, r = vertices[faces[t, 0]], vertices[faces[t, 1]], vertices[faces[t, 2]]
            verdict = 0
            sure = touches(a, b, p, q, r)
            if sure != 0:
                verdict = _CROSSED if sure > 0 else _OPEN
            elif tip_radius > 0.0 and not overlapped and distance(a, b, p, q, r) < room:
                verdict = _TOUCHED
            if tip_radius > 0.0 and verdict != 0 and not overlapped:
                overlapped = distance(a, a, p, q, r) < room
            if verdict != 0:
                found[count], verdicts[count] = t, verdict
                count += 1
        if overlapped:
            kept = 0
            for i in range(count):
                if verdicts[i] != _TOUCHED:
                    found[kept], verdicts[kept] = found[i], verdicts[i]
                    kept += 1
            count = kept
        if count > 0:
            return k, count, near
    return -1, 0, 0
