"""The triangle nearest to a point."""

from __future__ import annotations

import numpy as np

from vf.kernels import njit
from vf.tree.pdtree import (
    STACK,
    box_distance2,
    children_of,
    triangle_at,
    triangle_distance2,
    triangles_of,
)
from vf.tree.sides import inner_side

# Nodes that `Surface.nearest` visits before it releases the interpreter lock. Few walks take as
# many (some 10 µs); to release it costs a tenth of a walk, and far more if another thread waits for
# it.
PATIENCE = 500
UNFINISHED = -3


@njit(cache=True, nogil=True)
def nearest(nodes, corners, x, y, z, limit, guess, patience, turn):  # type: ignore[no-untyped-def]
    """Nearest triangle within `limit`: squared distance and row in tree order (−1: none).

    With a `turn` of 1 or −1 only triangles count that the point is strictly on the inner side of
    (`sides.inner_side`), with 0 all do.

    `guess` is a row to test first, or −1: a tool that moves by micrometres stays near the same
    triangle, and knowing its distance halves the walk. The answer does not depend on it: of several
    triangles at the same distance the first row counts.

    The walk ends after `patience` nodes; the row is then `UNFINISHED`.
    """
    waiting = np.empty((STACK, 2))  # node and squared distance of its box
    best = limit * limit if limit < 1e150 else np.inf
    row = -1
    if 0 <= guess < corners.shape[0]:
        d2 = triangle_distance2(corners, guess, x, y, z)
        if d2 <= best:
            best = d2
            row = guess
    waiting[0, 0] = waiting[0, 1] = 0.0
    depth = 1
    while depth > 0:
        depth -= 1
        if waiting[depth, 1] > best:
            continue
        if patience == 0:
            return best, UNFINISHED
        patience -= 1
        link = nodes[int(waiting[depth, 0]), 15]
        if link > 0.0:
            first, last = children_of(link)
            bottom = depth
            for child in range(first, last):
                d2 = box_distance2(nodes, child, x, y, z)
                if d2 > best:
                    continue
                place = depth  # the nearest on top
                while place > bottom and waiting[place - 1, 1] < d2:
                    waiting[place, 0] = waiting[place - 1, 0]
                    waiting[place, 1] = waiting[place - 1, 1]
                    place -= 1
                waiting[place, 0] = child
                waiting[place, 1] = d2
                depth += 1
            continue
        first, last = triangles_of(link)
        for t in range(first, last):
            if turn == 0.0:
                d2 = triangle_distance2(corners, t, x, y, z)
            else:
                d2 = triangle_at(corners, t, x, y, z)[4]
            if (d2 < best or (d2 == best and (row < 0 or t < row))) and (
                turn == 0.0 or inner_side(corners[t], x, y, z, turn)
            ):
                best = d2
                row = t
    return best, row


@njit(cache=True)
def nearest_face(nodes, corners, p, limit, guess, patience):  # type: ignore[no-untyped-def]
    """`nearest` for one call from Python: distance and row; p (3,) becomes the closest point.

    p is unchanged where the row is −1 (nothing within `limit`), −2 (p is not finite) or
    `UNFINISHED` (patience was not enough).
    """
    x, y, z = p[0], p[1], p[2]
    if not np.isfinite(x + y + z):
        return np.inf, -2
    _d2, row = nearest(nodes, corners, x, y, z, limit, guess, patience, 0.0)
    if row < 0:
        return np.inf, row
    p[0], p[1], p[2], _feature, d2 = triangle_at(corners, row, x, y, z)
    return np.sqrt(d2), row


@njit(cache=True, nogil=True)
def nearest_face_freely(nodes, corners, p, limit, guess):  # type: ignore[no-untyped-def]
    """`nearest_face` without a limit of nodes, with the interpreter lock released."""
    return nearest_face(nodes, corners, p, limit, guess, -1)


@njit(cache=True, nogil=True)
def nearest_face_facing(nodes, corners, p, turn):  # type: ignore[no-untyped-def]
    """`nearest_face` among the triangles that p (3,) is strictly on the inner side of."""
    x, y, z = p[0], p[1], p[2]
    _d2, row = nearest(nodes, corners, x, y, z, np.inf, -1, -1, turn)
    if row < 0:
        return np.inf, row
    p[0], p[1], p[2], _feature, d2 = triangle_at(corners, row, x, y, z)
    return np.sqrt(d2), row
