"""Which boxes and triangles are wholly behind one of the planes chosen so far.

`forceinline` marks the two tests of the walk that LLVM does not inline by itself: a call passes
every field of every array on the stack, which took an eighth of the walk.
"""

from __future__ import annotations

import numpy as np

from vf import layout as at
from vf.kernels import lowest_bit, njit
from vf.planes import ROUND


@njit(cache=True, nogil=True)
def less_of_bumps(d2, rim, far):  # type: ignore[no-untyped-def]
    """Share of a plane's BUMP that does not count: 1 up to the distance `rim`, 0 from `far` on.

    Args:
        d2: squared distance of what is tested to the tip's centre [m²].
        rim, far: the tip's radius, and `NEAR` standoffs more [m].
    """
    if d2 >= far * far:
        return 0.0
    if d2 <= rim * rim:
        return 1.0
    return (far - np.sqrt(d2)) / (far - rim)


@njit(cache=True, nogil=True)
def since(seen, m):  # type: ignore[no-untyped-def]
    """A mask of the planes `seen` to m − 1; m ≤ 64."""
    if seen == m:
        return 0
    return (-1 << seen) & (-1 if m == 64 else (1 << m) - 1)


@njit(cache=True, nogil=True, forceinline=True)
def box_behind(nodes, node, planes, less, shift, near, mask):  # type: ignore[no-untyped-def]
    """Whether a node's box is wholly behind one of the planes of a mask, rounding included.

    Args:
        less: share of the planes' BUMP that does not count, see `less_of_bumps`.
        shift: largest margin below the node, where margins vary over the mesh [m]; else 0.
        near: least bound on the rounding error of n·z [m].
        mask: bit k set: plane k is tested.

    Returns:
        The answer, and a mask of the planes that some part of the box is behind. The other planes
        have no triangle of the box behind them and need not be tested below this node.
    """
    cx, cy, cz = nodes[node, 0], nodes[node, 1], nodes[node, 2]
    reach = nodes[node, 3] + nodes[node, 4] + nodes[node, 5]
    left = 0
    while mask != 0:
        i = lowest_bit(mask)
        bit = mask & -mask
        mask ^= bit
        nx, ny, nz = planes[i, at.NORMAL], planes[i, at.NORMAL + 1], planes[i, at.NORMAL + 2]
        middle = nx * cx + ny * cy + nz * cz - planes[i, at.LIMIT]
        if middle >= reach:
            continue
        half = 0.0
        for k in range(3):
            half += nodes[node, 3 + k] * abs(
                nodes[node, 6 + 3 * k] * nx
                + nodes[node, 7 + 3 * k] * ny
                + nodes[node, 8 + 3 * k] * nz
            )
        if middle >= half:
            continue
        top = middle + less * planes[i, at.BUMP] + shift + half
        if top < 0.0 and top < -max(ROUND * (abs(cx) + abs(cy) + abs(cz) + reach), near):
            return True, 0
        left |= bit
    return False, left


@njit(cache=True, nogil=True)
def rounding_of(corners, t, near):  # type: ignore[no-untyped-def]
    """Bound on the rounding error of n·z at triangle t, at least `near` [m]."""
    size = 0.0
    for j in range(9):
        size = max(size, abs(corners[t, j]))
    return max(ROUND * size, near)


@njit(cache=True, nogil=True, forceinline=True)
def triangle_behind(corners, t, planes, less, shift, near, mask):  # type: ignore[no-untyped-def]
    """Whether a triangle is wholly behind one of the planes of a mask, as `box_behind` for a box.

    Returns:
        The answer, and a mask of the planes that a part of the triangle is behind.
    """
    left = 0
    while mask != 0:
        i = lowest_bit(mask)
        bit = mask & -mask
        mask ^= bit
        nx, ny, nz = planes[i, at.NORMAL], planes[i, at.NORMAL + 1], planes[i, at.NORMAL + 2]
        h0 = nx * corners[t, 0] + ny * corners[t, 1] + nz * corners[t, 2]
        h1 = nx * corners[t, 3] + ny * corners[t, 4] + nz * corners[t, 5]
        h2 = nx * corners[t, 6] + ny * corners[t, 7] + nz * corners[t, 8]
        highest = max(h0, h1, h2)
        limit = planes[i, at.LIMIT] - less * planes[i, at.BUMP] - shift
        if highest < limit and highest < limit - rounding_of(corners, t, near):
            return True, 0
        if min(h0, h1, h2) < planes[i, at.LIMIT]:
            left |= bit
    return False, left
