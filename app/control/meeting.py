"""Where a tip that moves along segments first meets a mesh. Knows no planes and no rules.

The PD-tree says which triangles are near a segment; what is tested is the segment itself against
the triangle itself, in rational arithmetic where rounding leaves the answer open.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import vf
from app.studies.verification import exact
from app.studies.verification.oracles import SCRATCH, distance, touches
from vf.kernels import njit
from vf.pdtree import STACK, children_of, triangles_of

FloatArray = NDArray[np.float64]

ROOM = 64  # triangles that one segment may meet, for a start

# Verdicts on a segment and a triangle.
_OPEN, _CROSSED, _TOUCHED = 1, 2, 3


@dataclass(frozen=True)
class Meeting:
    """The first of some segments that meets the surface.

    Attributes:
        segment: its number.
        triangle: the caller's index of the triangle met first along it.
        point: (3,) where, on the segment [m].
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

    A segment meets a triangle that it shares a point with: exactly so, ends and edges included.
    With a `tip_radius` [m] it also meets one that comes nearer than that (by more than `SCRATCH`),
    unless the ball overlapped some triangle at the segment's start already: then only the centre
    is judged. A segment without length meets nothing.
    """
    tree = surface.tree
    starts, ends = np.ascontiguousarray(starts), np.ascontiguousarray(ends)
    rows, verdicts = np.empty(ROOM, dtype=np.int64), np.empty(ROOM, dtype=np.int64)
    first = 0
    while True:
        k, count = _next(
            tree.nodes, tree.corners, starts, ends, tip_radius, tip_radius - SCRATCH, first,
            rows, verdicts,
        )  # fmt: skip
        if k < 0:
            return None
        if count > len(rows):
            rows, verdicts = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int64)
            first = k
            continue
        a, b = starts[k], ends[k]
        met = []
        for row, verdict in zip(rows[:count], verdicts[:count], strict=True):
            corners = tree.corners[row].reshape(3, 3)
            if verdict != _OPEN or exact.meets(a, b, corners):
                met.append((verdict == _TOUCHED, _share(a, b, corners), int(tree.order[row])))
        if met:
            touched, share, triangle = min(met)
            return Meeting(k, triangle, a + share * (b - a), not touched)
        first = k + 1


def warm_up() -> None:
    """Have the kernels compiled, or loaded from disk."""
    sheet = vf.Surface.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    first_meeting(sheet, np.array([[0.1, 0.1, 1.0]]), np.array([[0.1, 0.1, -1.0]]))


def sees(surface: vf.Surface, a: FloatArray, b: FloatArray) -> bool:
    """Whether the segment from a to b (3,) meets no triangle."""
    return first_meeting(surface, a[None], b[None]) is None


def _share(a: FloatArray, b: FloatArray, corners: FloatArray) -> float:
    """How far along the segment it is in the triangle's plane, or nearest to it, from 0 to 1."""
    n = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    before, after = float(n @ (a - corners[0])), float(n @ (b - corners[0]))
    if before * after < 0.0:
        return before / (before - after)
    return float(abs(after) < abs(before))


@njit(cache=True, nogil=True)
def _next(nodes, corners, starts, ends, tip_radius, room, first, rows, verdicts):  # type: ignore[no-untyped-def]
    """The next segment that may meet a triangle (−1: none), and with how many.

    Which they are (rows in tree order) and what is known of each is written as far as there is
    room.
    """
    waiting = np.empty(STACK, dtype=np.int64)
    for k in range(first, starts.shape[0]):
        a, b = starts[k], ends[k]
        if a[0] == b[0] and a[1] == b[1] and a[2] == b[2]:
            continue
        count = 0
        overlapped = False
        waiting[0] = 0
        depth = 1
        while depth > 0:
            depth -= 1
            node = waiting[depth]
            if not _near(nodes, node, a, b, tip_radius):
                continue
            link = nodes[node, 15]
            if link > 0.0:
                child, last = children_of(link)
                while child < last:
                    waiting[depth] = child
                    depth += 1
                    child += 1
                continue
            row, last = triangles_of(link)
            while row < last:
                p, q, r = corners[row, 0:3], corners[row, 3:6], corners[row, 6:9]
                verdict = 0
                sure = touches(a, b, p, q, r)
                if sure != 0:
                    verdict = 2 if sure > 0 else 1
                elif tip_radius > 0.0 and not overlapped and distance(a, b, p, q, r) < room:
                    verdict = 3
                if tip_radius > 0.0 and verdict != 0 and not overlapped:
                    overlapped = distance(a, a, p, q, r) < room
                if verdict != 0:
                    if count < rows.shape[0]:
                        rows[count], verdicts[count] = row, verdict
                    count += 1
                row += 1
        if overlapped and count <= rows.shape[0]:
            kept = 0
            for i in range(count):
                if verdicts[i] != 3:
                    rows[kept], verdicts[kept] = rows[i], verdicts[i]
                    kept += 1
            count = kept
        if count > 0:
            return k, count
    return -1, 0


@njit(cache=True, nogil=True)
def _near(nodes, node, a, b, reach):  # type: ignore[no-untyped-def]
    """Whether the segment ab may come within `reach` of the box of a node: never wrongly no."""
    low, high = 0.0, 1.0
    for k in range(3):
        start = along = size = 0.0
        for j in range(3):
            axis = nodes[node, 6 + 3 * k + j]
            start += axis * (a[j] - nodes[node, j])
            along += axis * (b[j] - a[j])
            size += abs(a[j]) + abs(b[j]) + abs(nodes[node, j])
        half = nodes[node, 3 + k] + reach
        half += 1e-14 * (size + half)
        if abs(along) < 1e-300:
            if abs(start) > half:
                return False
            continue
        u, v = (-half - start) / along, (half - start) / along
        low, high = max(low, min(u, v)), min(high, max(u, v))
        if low > high:
            return False
    return True
