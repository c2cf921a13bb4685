"""Queries through a PD-tree: self-intersections, wall thickness, ray crossings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vf.kernels import njit
from vf.tree.pdtree import STACK, Tree, box_distances2, children_of, triangles_of

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Cosine: the two sides of a wall are opposite within 30°, the flanks of a wedge are not.
_OPPOSITE = -0.866
# Share of the size below which a cut is rounding: solid kernels place points to about 1e-12.
_TOUCH = 1e-11
_GOLDEN = 0.5 * (5.0**0.5 - 1.0)
_PAIR = 20  # of `effort`, the cost of a pair that is found


def effort(faces: int) -> int:
    """Limit of a query's work, in boxes and triangles of the tree that are tested.

    Many times what a surface of so many faces needs. Triangles that all overlap would need the
    square of their number: minutes for a file of less than 1 MB.
    """
    return 50_000_000 + 300 * faces


class WorkLimit(Exception):
    """The query needs more work than `effort` allows."""


@njit(cache=True, nogil=True, inline="always")
def _push_children(stack, depth, link):  # type: ignore[no-untyped-def]
    """Put a node's children on the stack of a tree traversal; its new depth."""
    first, last = children_of(link)
    for child in range(first, last):
        stack[depth] = child
        depth += 1
    return depth


def well_distributed(rows: IntArray) -> IntArray:
    """The rows in a low-discrepancy order: any first part is evenly distributed over them."""
    return rows[np.argsort(np.arange(len(rows)) * _GOLDEN % 1.0, kind="stable")]


def intersections(
    vertices: FloatArray, corners: IntArray, tree: Tree, rows: IntArray
) -> tuple[IntArray, int]:
    """Pairs ``(k, 2)`` of faces, the first one from ``rows``, that cut through each other.

    An edge of one passes through the inside of the other, by more than rounding (a 1e-11th of the
    size). Touching does not count, nor do overlaps in one plane, nor what faces do along a corner
    or edge they share.

    Args:
        corners: ``(m, 3)`` vertices; those at the same place have one number.
        tree: over the same faces, in the same order.

    Returns:
        The pairs, and how many rows were examined, from the first on, within `effort`.
    """
    touch = _TOUCH * float(np.abs(vertices).max())
    pairs = np.empty((1024, 2), dtype=np.int64)
    row, found, left = 0, 0, effort(len(corners))
    while True:
        row, found, left = _intersections(
            vertices, corners, tree, rows, touch, row, left, pairs, found
        )
        if row == len(rows) or left <= 0:
            return pairs[:found].copy(), row
        more = np.empty((max(2 * len(pairs), found + len(corners)), 2), dtype=np.int64)
        more[:found] = pairs[:found]
        pairs = more


@njit(cache=True, nogil=True)
def _intersections(vertices, corners, tree, rows, touch, row, left, pairs, found):  # type: ignore[no-untyped-def]
    """Continue at a row; return the next row, the pairs found and the effort left.

    Stops before a row whose pairs do not fit into ``pairs``.
    """
    stack = np.empty(STACK, dtype=np.int32)
    while row < rows.shape[0] and left > 0:
        f = rows[row]
        begun = found
        a, b, c = vertices[corners[f, 0]], vertices[corners[f, 1]], vertices[corners[f, 2]]
        x, y, z = (a + b + c) / 3.0
        reach2 = 0.0
        for k in range(3):
            p = vertices[corners[f, k]]
            reach2 = max(reach2, (p[0] - x) ** 2 + (p[1] - y) ** 2 + (p[2] - z) ** 2)
        reach2 = reach2 * (1.0 + 1e-8) + 1e-30
        stack[0] = 0
        depth = 1
        while depth > 0:
            depth -= 1
            node = stack[depth]
            left -= 1
            if box_distances2(tree.nodes, node, x, y, z)[0] > reach2:
                continue
            link = tree.nodes[node, 15]
            if link > 0.0:
                depth = _push_children(stack, depth, link)
                continue
            first, last = triangles_of(link)
            left -= last - first
            for t in range(first, last):
                g = tree.order[t]
                if g == f:
                    continue
                if _pierces(vertices, corners, f, g, touch) or _pierces(
                    vertices, corners, g, f, touch
                ):
                    if found == pairs.shape[0]:
                        return row, begun, left
                    pairs[found, 0] = f
                    pairs[found, 1] = g
                    found += 1
                    left -= _PAIR
        row += 1
    return row, found, left


@njit(cache=True, nogil=True)
def _pierces(vertices, corners, f, g, touch):  # type: ignore[no-untyped-def]
    """Whether an edge of f, sharing no corner with g, passes through the inside of g."""
    a, b, c = vertices[corners[g, 0]], vertices[corners[g, 1]], vertices[corners[g, 2]]
    for k in range(3):
        i, j = corners[f, k], corners[f, (k + 1) % 3]
        shared = False
        for n in range(3):
            shared |= corners[g, n] == i or corners[g, n] == j
        if shared:
            continue
        p, q = vertices[i], vertices[j]
        # A point off by `touch` [m] changes a tetrahedron's volume by that times an area.
        span = max(_distance2(p, q), max(_distance2(a, b), max(_distance2(b, c), _distance2(c, a))))
        slack = touch * span
        above, below = _side(a, b, c, p), _side(a, b, c, q)
        if not ((above > slack and below < -slack) or (above < -slack and below > slack)):
            continue
        u, v, w = _side(p, q, a, b), _side(p, q, b, c), _side(p, q, c, a)
        if (u > slack and v > slack and w > slack) or (u < -slack and v < -slack and w < -slack):
            return True
    return False


@njit(cache=True, nogil=True, inline="always")
def _distance2(p, q):  # type: ignore[no-untyped-def]
    return (p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2


@njit(cache=True, nogil=True, inline="always")
def _side(a, b, c, p):  # type: ignore[no-untyped-def]
    """Six times the signed volume of a tetrahedron."""
    ux, uy, uz = a[0] - p[0], a[1] - p[1], a[2] - p[2]
    vx, vy, vz = b[0] - p[0], b[1] - p[1], b[2] - p[2]
    wx, wy, wz = c[0] - p[0], c[1] - p[1], c[2] - p[2]
    return ux * (vy * wz - vz * wy) + uy * (vz * wx - vx * wz) + uz * (vx * wy - vy * wx)


def walls(
    vertices: FloatArray, corners: IntArray, normals: FloatArray, tree: Tree, rows: IntArray
) -> tuple[FloatArray, int]:
    """Thickness [m] of the wall below each face of ``rows``, inf where there is none.

    From the face's middle inwards (against its normal) to the first face that shares no corner
    with it. If its normal is opposite within 30°, the two faces are a wall.

    Args:
        corners, tree: as for `intersections`.
        normals: ``(m, 3)`` unit, outwards; zero for faces that are no side of a wall.

    Returns:
        The thicknesses, and how many rows were examined, from the first on, within `effort`.
    """
    thickness = np.full(len(rows), np.inf)
    left = effort(len(corners))
    return thickness, int(_walls(vertices, corners, normals, tree, rows, left, thickness))


@njit(cache=True, nogil=True)
def _walls(vertices, corners, normals, tree, rows, left, thickness):  # type: ignore[no-untyped-def]
    for r in range(rows.shape[0]):
        if left <= 0:
            return r
        f = rows[r]
        n = normals[f]
        if n[0] == 0.0 and n[1] == 0.0 and n[2] == 0.0:
            continue
        a, b, c = vertices[corners[f, 0]], vertices[corners[f, 1]], vertices[corners[f, 2]]
        distance, g, work = _first_hit(tree, corners, (a + b + c) / 3.0, -n, f)
        left -= work
        if g >= 0:
            m = normals[g]
            if m[0] * n[0] + m[1] * n[1] + m[2] * n[2] < _OPPOSITE:
                thickness[r] = distance
    return rows.shape[0]


@njit(cache=True, nogil=True)
def _first_hit(tree, corners, p, d, own):  # type: ignore[no-untyped-def]
    """Distance along the unit ray p + t d to the first face apart from ``own``, that face, and
    the boxes and triangles tested."""
    stack = np.empty(STACK, dtype=np.int32)
    stack[0] = 0
    depth = 1
    best, face = np.inf, np.int64(-1)
    work = 0
    while depth > 0:
        depth -= 1
        node = stack[depth]
        work += 1
        if not _meets(tree.nodes[node], p, d, best):
            continue
        link = tree.nodes[node, 15]
        if link > 0.0:
            depth = _push_children(stack, depth, link)
            continue
        first, last = triangles_of(link)
        work += last - first
        for t in range(first, last):
            hit = _ray(tree.corners[t], p, d)
            if hit < best and not _share_a_corner(corners, own, tree.order[t]):
                best, face = hit, tree.order[t]
    return best, face, work


@njit(cache=True, nogil=True, inline="always")
def _share_a_corner(corners, f, g):  # type: ignore[no-untyped-def]
    for i in range(3):
        for j in range(3):
            if corners[f, i] == corners[g, j]:
                return True
    return False


@njit(cache=True, nogil=True, inline="always")
def _meets(box, p, d, best):  # type: ignore[no-untyped-def]
    """Whether the ray meets the oriented box, widened by rounding, nearer than ``best``."""
    enter, leave = 0.0, best
    dx, dy, dz = p[0] - box[0], p[1] - box[1], p[2] - box[2]
    for k in range(3):
        rx, ry, rz = box[6 + 3 * k], box[7 + 3 * k], box[8 + 3 * k]
        half = box[3 + k] * (1.0 + 1e-9) + 1e-15
        start = rx * dx + ry * dy + rz * dz
        rate = rx * d[0] + ry * d[1] + rz * d[2]
        if abs(rate) < 1e-300:
            if abs(start) > half:
                return False
            continue
        t0, t1 = (-half - start) / rate, (half - start) / rate
        enter, leave = max(enter, min(t0, t1)), min(leave, max(t0, t1))
    return enter <= leave


@njit(cache=True, nogil=True, inline="always")
def _ray(c, p, d):  # type: ignore[no-untyped-def]
    """Distance to a triangle (9,) along the ray, inf if missed (Möller and Trumbore, 1997)."""
    ux, uy, uz = c[3] - c[0], c[4] - c[1], c[5] - c[2]
    vx, vy, vz = c[6] - c[0], c[7] - c[1], c[8] - c[2]
    hx, hy, hz = d[1] * vz - d[2] * vy, d[2] * vx - d[0] * vz, d[0] * vy - d[1] * vx
    det = ux * hx + uy * hy + uz * hz
    if det == 0.0:
        return np.inf
    sx, sy, sz = p[0] - c[0], p[1] - c[1], p[2] - c[2]
    u = (sx * hx + sy * hy + sz * hz) / det
    if u < 0.0 or u > 1.0:
        return np.inf
    qx, qy, qz = sy * uz - sz * uy, sz * ux - sx * uz, sx * uy - sy * ux
    v = (d[0] * qx + d[1] * qy + d[2] * qz) / det
    if v < 0.0 or u + v > 1.0:
        return np.inf
    t = (vx * qx + vy * qy + vz * qz) / det
    return t if t > 0.0 else np.inf


def crossings(
    tree: Tree,
    shells: IntArray,
    starts: FloatArray,
    direction: FloatArray,
    own: IntArray,
    left: int,
) -> tuple[IntArray, int]:
    """Pairs ``(k, 2)`` of a start and a shell that its ray crosses an odd number of times, and the
    `effort` left.

    Args:
        shells: ``(m,)`` the shell that each face of the tree belongs to, from 0; −1: none.
        starts: ``(n, 3)`` [m], origins of rays along ``direction`` ``(3,)``.
        own: ``(n,)`` the shell of each start, which its ray ignores.
        left: the `effort` allowed.

    Raises:
        WorkLimit: it is not enough.
    """
    room = 4 * len(starts) + 64
    while True:
        pairs = np.empty((room, 2), dtype=np.int64)
        count, left = _crossings(
            tree, shells, int(shells.max()) + 1, starts, direction, own, left, pairs
        )
        if left <= 0:
            raise WorkLimit
        if count <= room:
            return pairs[:count].copy(), left
        room = count


@njit(cache=True, nogil=True)
def _crossings(tree, shells, count, starts, d, own, left, pairs):  # type: ignore[no-untyped-def]
    odd = np.zeros(count, dtype=np.bool_)
    met = np.empty(count, dtype=np.int64)  # every shell once
    seen = np.full(count, -1, dtype=np.int64)
    stack = np.empty(STACK, dtype=np.int32)
    found = 0
    for s in range(starts.shape[0]):
        p = starts[s]
        crossed = 0
        stack[0] = 0
        depth = 1
        while depth > 0 and left > 0:
            depth -= 1
            left -= 1
            node = stack[depth]
            if not _meets(tree.nodes[node], p, d, np.inf):
                continue
            link = tree.nodes[node, 15]
            if link > 0.0:
                depth = _push_children(stack, depth, link)
                continue
            first, last = triangles_of(link)
            left -= last - first
            for t in range(first, last):
                shell = shells[tree.order[t]]
                if shell < 0 or shell == own[s] or not _ray(tree.corners[t], p, d) < np.inf:
                    continue
                if seen[shell] != s:
                    seen[shell] = s
                    odd[shell] = False
                    met[crossed] = shell
                    crossed += 1
                odd[shell] = not odd[shell]
        for k in range(crossed):
            if odd[met[k]]:
                if found < pairs.shape[0]:
                    pairs[found, 0] = s
                    pairs[found, 1] = met[k]
                found += 1
                left -= _PAIR
        if left <= 0:
            break
    return found, left
