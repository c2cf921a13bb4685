"""Two shapes of one mesh in one PD-tree, and every shape on the way from the one to the other.

Vertices move straight from where they are `before` to where they are `after`: at a blend τ a vertex
is at (1 − τ)·before + τ·after. Nodes keep their axes and their children; centre and half sizes are
fitted to each shape, from the leaves up, and go straight from those of the one to those of the
other. A walk computes the boxes and triangles that it comes to, and no others. Vertices are kept in
the order in which the leaves use them, so that those of a leaf lie side by side.
"""

from __future__ import annotations

import numba
import numpy as np

from vf.kernels import floats_at, njit, rows_at
from vf.planes import ROUND
from vf.tree.axis import box_gap2, largest_coordinate
from vf.tree.closest import distance_error, well_shaped
from vf.tree.pdtree import EXACT, STACK, children_of

# A node whose triangles move alike to within this is not opened to see how far they move [m].
ALIKE = 5e-7
# Nor is one of less than this share of the ball that is looked at.
SMALL = 0.5
# A box is fitted to vertices where it has no more of them than this, and else to the boxes so many
# generations below it: see `refit`.
FEW = 64
GENERATIONS = 2


# What a walk needs to know of a mesh that does not deform, see `place_corners`.
RIGID = (0, 0, 0, 0, 0, 0, 0, 0, 0.0)


@njit(cache=True, nogil=True)
def _offspring(nodes, node, found):  # type: ignore[no-untyped-def]
    """Write the nodes `GENERATIONS` below a node, and leaves that are nearer, to `found`.

    Returns:
        The first of its rows that has one of them, and the one after the last.
    """
    found[0] = node
    begin, end = 0, 1
    for _ in range(GENERATIONS):
        count = end
        for k in range(begin, end):
            link = nodes[found[k], 15]
            if link > 0.0:
                first, last = children_of(link)
                for child in range(first, last):
                    found[count] = child
                    count += 1
            else:
                found[count] = found[k]
                count += 1
        begin, end = end, count
    return begin, end


# Fused multiplications and additions, a sixth of the time: rounding is allowed for in any order.
# What moves by a difference of two numbers is not affected.
@njit(cache=True, nogil=True, fastmath={"contract"})
def refit(nodes, starts, ends, fans, before, after, boxes, shifts):  # type: ignore[no-untyped-def]
    """Fit the boxes of all nodes to a shape, and find how far what they hold moved to get there.

    A box that is fitted to boxes is larger than what it holds, the more the larger these are: a box
    is fitted to its vertices where they are `FEW`, and else to those `GENERATIONS` below it.

    Args:
        nodes: (k, 16) of a `pdtree.Tree`, of which axes and links are read.
        starts, ends, fans: of the `forms.Skeleton`.
        before, after: (n, 3) vertices of the shape before and of this one, in the order of the
            skeleton [m].
        boxes: (k, 6) written: centre and half sizes of each node [m].
        shifts: (k, 6) written: the least and the greatest of after − before below a node, for each
            coordinate [m].
    """
    found = np.empty(2 * 4**GENERATIONS, dtype=np.int64)
    for node in range(nodes.shape[0] - 1, -1, -1):
        link = nodes[node, 15]
        a0, a1, a2 = nodes[node, 6], nodes[node, 7], nodes[node, 8]
        b0, b1, b2 = nodes[node, 9], nodes[node, 10], nodes[node, 11]
        c0, c1, c2 = nodes[node, 12], nodes[node, 13], nodes[node, 14]
        lx = ly = lz = np.inf
        hx = hy = hz = -np.inf
        # Of the displacements.
        kx = ky = kz = np.inf
        gx = gy = gz = -np.inf
        begin, end = starts[node], ends[node]
        i = fans[begin]
        ox, oy, oz = after[i, 0], after[i, 1], after[i, 2]
        if link > 0.0:
            first, last = children_of(link)
            for child in range(first, last):
                kx, gx = min(kx, shifts[child, 0]), max(gx, shifts[child, 3])
                ky, gy = min(ky, shifts[child, 1]), max(gy, shifts[child, 4])
                kz, gz = min(kz, shifts[child, 2]), max(gz, shifts[child, 5])
        if begin == end:
            first, last = _offspring(nodes, node, found)
            for k in range(first, last):
                child = found[k]
                x, y, z = boxes[child, 0] - ox, boxes[child, 1] - oy, boxes[child, 2] - oz
                u, v, w = boxes[child, 3], boxes[child, 4], boxes[child, 5]
                d0, d1, d2 = nodes[child, 6], nodes[child, 7], nodes[child, 8]
                e0, e1, e2 = nodes[child, 9], nodes[child, 10], nodes[child, 11]
                f0, f1, f2 = nodes[child, 12], nodes[child, 13], nodes[child, 14]
                p = a0 * x + a1 * y + a2 * z
                r = (
                    u * abs(a0 * d0 + a1 * d1 + a2 * d2)
                    + v * abs(a0 * e0 + a1 * e1 + a2 * e2)
                    + w * abs(a0 * f0 + a1 * f1 + a2 * f2)
                )
                lx, hx = min(lx, p - r), max(hx, p + r)
                p = b0 * x + b1 * y + b2 * z
                r = (
                    u * abs(b0 * d0 + b1 * d1 + b2 * d2)
                    + v * abs(b0 * e0 + b1 * e1 + b2 * e2)
                    + w * abs(b0 * f0 + b1 * f1 + b2 * f2)
                )
                ly, hy = min(ly, p - r), max(hy, p + r)
                p = c0 * x + c1 * y + c2 * z
                r = (
                    u * abs(c0 * d0 + c1 * d1 + c2 * d2)
                    + v * abs(c0 * e0 + c1 * e1 + c2 * e2)
                    + w * abs(c0 * f0 + c1 * f1 + c2 * f2)
                )
                lz, hz = min(lz, p - r), max(hz, p + r)
        else:
            # Unsigned: no index is looked at for whether it counts from the end.
            for k in range(np.uint64(begin), np.uint64(end)):
                i = np.uint64(fans[k])
                u, v, w = after[i, 0], after[i, 1], after[i, 2]
                if link <= 0.0:
                    x, y, z = u - before[i, 0], v - before[i, 1], w - before[i, 2]
                    kx, gx = min(kx, x), max(gx, x)
                    ky, gy = min(ky, y), max(gy, y)
                    kz, gz = min(kz, z), max(gz, z)
                x, y, z = u - ox, v - oy, w - oz
                p = a0 * x + a1 * y + a2 * z
                lx, hx = min(lx, p), max(hx, p)
                p = b0 * x + b1 * y + b2 * z
                ly, hy = min(ly, p), max(hy, p)
                p = c0 * x + c1 * y + c2 * z
                lz, hz = min(lz, p), max(hz, p)
        shifts[node, 0], shifts[node, 1], shifts[node, 2] = kx, ky, kz
        shifts[node, 3], shifts[node, 4], shifts[node, 5] = gx, gy, gz
        x, y, z = 0.5 * (lx + hx), 0.5 * (ly + hy), 0.5 * (lz + hz)
        boxes[node, 0] = ox + (x * a0 + y * b0 + z * c0)
        boxes[node, 1] = oy + (x * a1 + y * b1 + z * c1)
        boxes[node, 2] = oz + (x * a2 + y * b2 + z * c2)
        # Rounding of the centre and the axes must not leave a corner outside its box.
        size = 1e-15 * (1.0 + abs(ox) + abs(oy) + abs(oz) + abs(x) + abs(y) + abs(z))
        boxes[node, 3] = 0.5 * (hx - lx) * (1.0 + 1e-12) + size
        boxes[node, 4] = 0.5 * (hy - ly) * (1.0 + 1e-12) + size
        boxes[node, 5] = 0.5 * (hz - lz) * (1.0 + 1e-12) + size


@njit(cache=True, nogil=True)
def place_boxes(shape, first, last):  # type: ignore[no-untyped-def]
    """Compute the boxes of some nodes at a blend.

    Each bound of a box goes straight from the one shape to the other: what any part of the mesh
    does along an axis is between what its vertices do.

    Args:
        shape: see `place_corners`.
    """
    before = numba.carray(floats_at(shape[5]), (last, 6))
    after = numba.carray(floats_at(shape[6]), (last, 6))
    nodes = numba.carray(floats_at(shape[7]), (last, 16))
    late = shape[8]
    early = 1.0 - late
    for node in range(first, last):
        # All is read before anything is written, so that several numbers are computed at once.
        a0, a1, a2 = before[node, 0], before[node, 1], before[node, 2]
        a3, a4, a5 = before[node, 3], before[node, 4], before[node, 5]
        b0, b1, b2 = after[node, 0], after[node, 1], after[node, 2]
        b3, b4, b5 = after[node, 3], after[node, 4], after[node, 5]
        nodes[node, 0] = early * a0 + late * b0
        nodes[node, 1] = early * a1 + late * b1
        nodes[node, 2] = early * a2 + late * b2
        nodes[node, 3] = early * a3 + late * b3
        nodes[node, 4] = early * a4 + late * b4
        nodes[node, 5] = early * a5 + late * b5


@njit(cache=True, nogil=True)
def fill_boxes(before, after, blend, nodes):  # type: ignore[no-untyped-def]
    """`place_boxes` of all nodes, in arrays."""
    early = 1.0 - blend
    for node in range(nodes.shape[0]):
        for k in range(6):
            nodes[node, k] = early * before[node, k] + blend * after[node, k]


@njit(cache=True, nogil=True)
def place_corners(shape, first, last):  # type: ignore[no-untyped-def]
    """Compute the corners of some triangles in tree order at a blend, not their errors.

    Args:
        shape: addresses of the faces of the skeleton, of the vertices before and after, of the
            corners and errors of a `pdtree.Tree` to be written, of the boxes before and after, and
            of the nodes of that tree, where axes and links stand; then the blend.
    """
    rows = numba.carray(rows_at(shape[0]), (last, 3))
    corners = numba.carray(floats_at(shape[3]), (last, 9))
    late = shape[8]
    early = 1.0 - late
    for t in range(first, last):
        for j in range(3):
            row = rows[t, j]
            before = numba.carray(floats_at(shape[1]), (row + 1, 3))
            after = numba.carray(floats_at(shape[2]), (row + 1, 3))
            for k in range(3):
                corners[t, 3 * j + k] = early * before[row, k] + late * after[row, k]


@njit(cache=True, nogil=True)
def place_errors(shape, first, last):  # type: ignore[no-untyped-def]
    """Compute the errors of triangles whose corners are placed: see `pdtree.Tree`.

    Apart from `place_corners`, as a walk measures the distance of one triangle in three that it
    comes to.

    Args:
        shape: see `place_corners`.
    """
    corners = numba.carray(floats_at(shape[3]), (last, 9))
    errors = numba.carray(floats_at(shape[4]), (last,))
    for t in range(first, last):
        errors[t] = _error(corners, t)


@njit(cache=True, nogil=True)
def _error(corners, t):  # type: ignore[no-untyped-def]
    """`distance_error` of triangle t, or 0 where that is at most `EXACT` [m]."""
    ax, ay, az = corners[t, 0], corners[t, 1], corners[t, 2]
    bx, by, bz = corners[t, 3], corners[t, 4], corners[t, 5]
    cx, cy, cz = corners[t, 6], corners[t, 7], corners[t, 8]
    # Most triangles are told by their shape, without the root and the division of the error.
    if well_shaped(ax, ay, az, bx, by, bz, cx, cy, cz, EXACT):
        return 0.0
    error = distance_error(ax, ay, az, bx, by, bz, cx, cy, cz)
    return error if error > EXACT else 0.0


@njit(cache=True, nogil=True)
def fill_corners(rows, before, after, blend, corners, errors):  # type: ignore[no-untyped-def]
    """`place_corners` of all triangles, in arrays."""
    early = 1.0 - blend
    for t in range(rows.shape[0]):
        c = corners[t]
        for j in range(3):
            for k in range(3):
                c[3 * j + k] = early * before[rows[t, j], k] + blend * after[rows[t, j], k]
        errors[t] = _error(corners, t)


@njit(cache=True, nogil=True)
def farthest_shift(shifts, node, share):  # type: ignore[no-untyped-def]
    """How far anything below a node moves, at most, in a share of the way between shapes [m]."""
    far = 0.0
    for k in range(3):
        far += max(abs(shifts[node, k]), abs(shifts[node, 3 + k])) ** 2
    return abs(share) * np.sqrt(far)


@njit(cache=True, nogil=True)
def _between(shifts, node, lx, ly, lz, hx, hy, hz):  # type: ignore[no-untyped-def]
    """Whether all that a node holds moves by what is between two bounds for each coordinate."""
    return (
        shifts[node, 0] >= lx
        and shifts[node, 1] >= ly
        and shifts[node, 2] >= lz
        and shifts[node, 3] <= hx
        and shifts[node, 4] <= hy
        and shifts[node, 5] <= hz
    )


@njit(cache=True, nogil=True)
def shift_near(nodes, shifts, shape, ends, radius, share):  # type: ignore[no-untyped-def]
    """How the mesh near an axis, or a point, moves during a share of the way between two shapes.

    Near is what comes within `radius` of it, as it stands at the start, on the way: all of the
    mesh that is now within that radius and the first number that is returned.

    Args:
        nodes, shape: see `place_corners`, at the start.
        ends: see `certified.walk`.
        share: of the way from the one shape to the other, negative: back.

    Returns:
        How far any of it moves at most [m]; the middle of its displacements, three numbers, and by
        how much they differ from it at most, three numbers, rounding included [m].
    """
    if share == 0.0:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    reach = (radius + farthest_shift(shifts, 0, share)) * (1.0 + 1e-9)
    rounding = ROUND * (largest_coordinate(ends) + reach)
    reach += EXACT + rounding
    lx = ly = lz = np.inf
    hx = hy = hz = -np.inf
    waiting = np.empty(STACK, dtype=np.int32)
    depth = 0
    first, last = 0, 1
    while first < last:
        for node in range(first, last):
            if _between(shifts, node, lx, ly, lz, hx, hy, hz):
                continue
            place_boxes(shape, node, node + 1)
            if box_gap2(nodes, node, ends) > reach * reach:
                continue
            spread = 0.0
            size = 0.0
            for k in range(3):
                spread = max(spread, shifts[node, 3 + k] - shifts[node, k])
                size = max(size, nodes[node, 3 + k])
            if nodes[node, 15] > 0.0 and spread * abs(share) > ALIKE and size > SMALL * reach:
                waiting[depth] = node
                depth += 1
                continue
            lx, hx = min(lx, shifts[node, 0]), max(hx, shifts[node, 3])
            ly, hy = min(ly, shifts[node, 1]), max(hy, shifts[node, 4])
            lz, hz = min(lz, shifts[node, 2]), max(hz, shifts[node, 5])
        last = first
        while depth > 0 and first == last:
            depth -= 1
            node = waiting[depth]
            if not _between(shifts, node, lx, ly, lz, hx, hy, hz):
                first, last = children_of(nodes[node, 15])
    if not lx <= hx:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    x, y, z = max(abs(lx), abs(hx)), max(abs(ly), abs(hy)), max(abs(lz), abs(hz))
    part = 0.5 * abs(share)
    return (
        abs(share) * np.sqrt(x * x + y * y + z * z) + rounding,
        0.5 * share * (lx + hx),
        0.5 * share * (ly + hy),
        0.5 * share * (lz + hz),
        part * (hx - lx) + rounding,
        part * (hy - ly) + rounding,
        part * (hz - lz) + rounding,
    )
