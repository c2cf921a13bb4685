"""Principal-direction tree over triangles: a hierarchy of boxes turned along their content.

A node is a box in the frame of the principal directions of its triangles' corners. It is split at
the mean along the first direction, and each half once more along its own first direction: a node
has up to four children, so a walk opens half as many nodes as in a binary tree. A leaf holds a
handful of triangles. Everything lies in flat arrays, siblings and their triangles side by side.

Small kernels are left to LLVM to inline: numba's own inlining counts references to arrays at every
use, which made the walk of `vf.rules.certified` a quarter slower.

After the covariance trees of the paper's section III-A.
"""

from __future__ import annotations

from typing import NamedTuple

from vf.kernels import njit
from vf.planes import FloatArray, IntArray
from vf.tree.closest import closest_on_triangle, distance2_to_triangle

# Capacity of a walk's stack: three entries for each two splits, none of which is worse than 1 : 9.
STACK = 256
# A computed distance that exceeds the true one by no more than this counts as exact [m].
EXACT = 1e-12


class Tree(NamedTuple):
    """Flat arrays of a PD-tree with k nodes over m triangles.

    A node's record is 128 bytes: all that a walk needs of it comes with two cache lines.

    Attributes:
        nodes: (k, 16) centre (3), half sizes (3), rows of the rotation world → box (9), link:
            8 · first child + count, or for a leaf −(64 · first triangle + count).
        corners: (m, 9) corners of the triangles in tree order.
        order: (m,) the caller's index of each triangle in tree order.
        errors: (m,) how much the computed distance to a triangle can exceed the true one, in tree
            order, 0 where that is at most `EXACT` [m]: large for slivers only.
    """

    nodes: FloatArray
    corners: FloatArray
    order: IntArray
    errors: FloatArray


@njit(cache=True, nogil=True)
def children_of(link):  # type: ignore[no-untyped-def]
    """First child of an inner node and the one after its last, from the link of the node."""
    code = int(link)
    first = code >> 3
    return first, first + (code & 7)


@njit(cache=True, nogil=True)
def triangles_of(link):  # type: ignore[no-untyped-def]
    """First triangle of a leaf and the one after its last, from the link of its node."""
    code = int(-link)
    first = code >> 6
    return first, first + (code & 63)


@njit(cache=True, nogil=True)
def triangles_below(nodes, node):  # type: ignore[no-untyped-def]
    """First triangle of a subtree and the one after its last: its leaves lie side by side."""
    left = right = node
    while nodes[left, 15] > 0.0:
        left = children_of(nodes[left, 15])[0]
    while nodes[right, 15] > 0.0:
        right = children_of(nodes[right, 15])[1] - 1
    return triangles_of(nodes[left, 15])[0], triangles_of(nodes[right, 15])[1]


@njit(cache=True, nogil=True)
def box_distance2(nodes, node, x, y, z):  # type: ignore[no-untyped-def]
    """Squared distance of a point to the box of a node (0 inside)."""
    dx, dy, dz = x - nodes[node, 0], y - nodes[node, 1], z - nodes[node, 2]
    d2 = 0.0
    for k in range(3):
        p = nodes[node, 6 + 3 * k] * dx + nodes[node, 7 + 3 * k] * dy + nodes[node, 8 + 3 * k] * dz
        e = abs(p) - nodes[node, 3 + k]
        if e > 0.0:
            d2 += e * e
    return d2


@njit(cache=True, nogil=True)
def box_distances2(nodes, node, x, y, z):  # type: ignore[no-untyped-def]
    """Squared distance of a point to the box of a node (0 inside), and to its farthest corner."""
    dx, dy, dz = x - nodes[node, 0], y - nodes[node, 1], z - nodes[node, 2]
    near2 = far2 = 0.0
    for k in range(3):
        p = nodes[node, 6 + 3 * k] * dx + nodes[node, 7 + 3 * k] * dy + nodes[node, 8 + 3 * k] * dz
        half = nodes[node, 3 + k]
        far2 += (abs(p) + half) ** 2
        e = abs(p) - half
        if e > 0.0:
            near2 += e * e
    return near2, far2


@njit(cache=True, nogil=True)
def triangle_at(corners, t, x, y, z):  # type: ignore[no-untyped-def]
    """`closest_on_triangle` for row t of tree-ordered corners."""
    return closest_on_triangle(
        corners[t, 0],
        corners[t, 1],
        corners[t, 2],
        corners[t, 3],
        corners[t, 4],
        corners[t, 5],
        corners[t, 6],
        corners[t, 7],
        corners[t, 8],
        x,
        y,
        z,
    )


@njit(cache=True, nogil=True)
def triangle_distance2(corners, t, x, y, z):  # type: ignore[no-untyped-def]
    """`distance2_to_triangle` for row t of tree-ordered corners."""
    return distance2_to_triangle(
        corners[t, 0],
        corners[t, 1],
        corners[t, 2],
        corners[t, 3],
        corners[t, 4],
        corners[t, 5],
        corners[t, 6],
        corners[t, 7],
        corners[t, 8],
        x,
        y,
        z,
    )
