"""The certified rule: planes that keep the tool off any triangle soup.

Claim. Let every plane have n·x ≥ o, let every part of the mesh within the ball be strictly behind
some plane, and let a step end at y with |y − x| ≤ radius and n·y ≥ o for all planes. Then the
segment from x to y touches no triangle.
Proof. x and y lie in the convex set C = ball ∩ {n·z ≥ o for all planes}, so the segment does. A
point of the mesh in C would be in the ball and strictly behind some plane: a contradiction. ∎

For a tip of radius ρ read "within ρ of the segment" for "touches": the ball searched has radius
r + ρ and "behind" is judged against o − ρ.

In floating point: n·z of a point with coordinates up to M is known to within `ROUND`·M. Whatever
counts as behind a plane is behind it by more than that, a plane stands in front of what is behind
it by several times that, and the ball searched is larger by what a distance can be wrong.

The planes come from one best-first walk of the PD-tree. Planes only accumulate and distances only
grow, so what is behind a plane when it is met never needs another look.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vf.kernels import bits_as_float, float_as_bits, lowest_bit, njit
from vf.layout import (
    BUMP,
    CAPSULE,
    FIXTURE,
    FLOOR,
    FOOT,
    LIMIT,
    NORMAL,
    OFFSET,
    PLANE,
    POINT,
    PUSH,
    RULE,
    TRIANGLE,
)
from vf.planes import FloatArray, Planes, Rule, checked_length, checked_point, planes_of
from vf.surface import ROUND, Edge, Surface
from vf.tree.closest import closest_on_triangle, distance_error
from vf.tree.pdtree import (
    EXACT,
    Tree,
    box_distance2,
    children_of,
    triangle_at,
    triangle_distance2,
    triangles_of,
)

BUDGET = 64
# A face plane across a valley edge must leave x this share of the triangle's distance of room.
VALLEY_ROOM = 0.05
# On top of the standoff, plane number k (from 0) is moved towards x by this share of its distance,
# times k. The nearest plane loses nothing, the next ones next to nothing, and in contact none does;
# far facets share planes. In a bowl, where every facet would want its own, this is a third of the
# planes and keeps the budget from being spent, for about a percent of the free space.
EASE = 0.004
# Bumps up to this share of the standoff cost no plane; the rest keeps the tool off them.
BUMPY = 0.75
# In full only for what is this many standoffs away, though, and nearer in proportion: in contact
# with a shallow bowl either of two faces would be a bump of the other, and the tool would hop from
# the plane of one to that of the other.
NEAR = 20.0
# Every plane leaves the tip this much room, or a share of the room there is where that is less:
# between two opposing planes through x itself a tool could not even slide, as no step of an arm is
# straight and no solver exact [m]. Recovery wins it back.
YIELD = 1e-8
YIELD_SHARE = 0.05
# Less room than this many rounding errors is none: no plane separates x from the triangle.
FAINT = 64.0
# Nodes and triangles waiting at a time. Were it spent, the ball would shrink to what is settled.
HEAP = 4096
SEEN = 128  # more than BUDGET
CORNERS = BUDGET + 4  # of what is left of a triangle: each plane adds one at most
FACE, RIDGE, VALLEY = int(Rule.FACE), int(Rule.RIDGE), int(Rule.VALLEY)
ACROSS_VALLEY, ACROSS_FLAT = int(Edge.VALLEY), int(Edge.FLAT)


def certified_planes(
    surface: Surface,
    x: ArrayLike,
    radius: float,
    standoff: float = 0.0,
    tip_radius: float = 0.0,
) -> Planes:
    """Separating planes for which every step that obeys them crosses no triangle.

    Args:
        surface: any triangle soup.
        x: (3,) centre of the tool tip [m].
        radius: of the motion sphere: how far a step may go [m].
        standoff: how far the planes are moved from the mesh towards x, at most up to x [m].
        tip_radius: of the spherical cutter around x [m].

    Returns:
        Planes with n·x ≥ o. `radius` is smaller than asked for where the budget of 64 planes was
        spent, and 0 where x lies on a triangle within rounding; the claim then holds for that ball.

    Raises:
        ValueError: x, or a length, is not finite or not in its range (up to `planes.LARGEST`).
    """
    p = checked_point(x)
    radius = checked_length("radius", radius)
    standoff = checked_length("standoff", standoff)
    tip_radius = checked_length("tip radius", tip_radius)
    return cover(surface, p, radius, standoff, tip_radius)


class Triangles(Protocol):
    """What the walk looks at of a `Surface`, or of a part of one."""

    @property
    def tree(self) -> Tree: ...
    @property
    def edges(self) -> NDArray[np.int8]: ...


def cover(
    surface: Triangles, x: FloatArray, radius: float, standoff: float, tip_radius: float
) -> Planes:
    """`certified_planes` for arguments that are known to be sound."""
    planes = np.empty((BUDGET, PLANE))
    tree = surface.tree
    m, reach = walk_alone(
        tree.nodes, tree.corners, tree.order, tree.errors, surface.edges, False,
        x, radius, standoff, tip_radius, EASE, planes,
    )  # fmt: skip
    return planes_of(planes[:m], reach)


@njit(cache=True, nogil=True)
def _push(queue, size, key, item, mask):  # type: ignore[no-untyped-def]
    i = size
    while i > 0:
        parent = (i - 1) >> 1
        if queue[parent, 0] <= key:
            break
        queue[i, 0], queue[i, 1] = queue[parent, 0], queue[parent, 1]
        queue[i, 2] = queue[parent, 2]
        i = parent
    queue[i, 0], queue[i, 1], queue[i, 2] = key, item, mask


@njit(cache=True, nogil=True)
def _pop(queue, size):  # type: ignore[no-untyped-def]
    """Remove the root of a heap of `size` entries (read it before)."""
    size -= 1
    # The hole goes down to a leaf, and the last entry, which belongs near the leaves, goes in
    # there: that way hardly a comparison has an outcome that the processor could not foresee.
    i = 0
    child = 1
    while child < size:
        child += queue[child + 1, 0] < queue[child, 0]  # at most the last entry itself
        queue[i, 0], queue[i, 1], queue[i, 2] = queue[child, 0], queue[child, 1], queue[child, 2]
        i = child
        child = 2 * i + 1
    _push(queue, i, queue[size, 0], queue[size, 1], queue[size, 2])


@njit(cache=True, nogil=True)
def _less(d2, rim, far):  # type: ignore[no-untyped-def]
    """Share of a bump that does not count at a squared distance: 1 up to `rim`, 0 from `far` on."""
    if d2 >= far * far:
        return 0.0
    if d2 <= rim * rim:
        return 1.0
    return (far - np.sqrt(d2)) / (far - rim)


@njit(cache=True, nogil=True)
def _since(seen, m):  # type: ignore[no-untyped-def]
    """A mask of the planes seen … m − 1, of 64 at most."""
    if seen == m:
        return 0
    return (-1 << seen) & (-1 if m == 64 else (1 << m) - 1)


@njit(cache=True, nogil=True)
def _box_behind(nodes, node, planes, less, near, mask):  # type: ignore[no-untyped-def]
    """Whether a node's box is wholly behind one of the planes of a mask, rounding included.

    And a mask of those that a part of it is behind: the others hide nothing of what is in it.
    """
    cx, cy, cz = nodes[node, 0], nodes[node, 1], nodes[node, 2]
    reach = nodes[node, 3] + nodes[node, 4] + nodes[node, 5]
    left = 0
    while mask != 0:
        i = lowest_bit(mask)
        bit = mask & -mask
        mask ^= bit
        nx, ny, nz = planes[i, NORMAL], planes[i, NORMAL + 1], planes[i, NORMAL + 2]
        middle = nx * cx + ny * cy + nz * cz - planes[i, LIMIT]
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
        top = middle + less * planes[i, BUMP] + half
        if top < 0.0 and top < -max(ROUND * (abs(cx) + abs(cy) + abs(cz) + reach), near):
            return True, 0
        left |= bit
    return False, left


@njit(cache=True, nogil=True)
def _rounding(corners, t, near):  # type: ignore[no-untyped-def]
    """Bound on the rounding error of n·z at triangle t, at least `near` [m]."""
    size = 0.0
    for j in range(9):
        size = max(size, abs(corners[t, j]))
    return max(ROUND * size, near)


@njit(cache=True, nogil=True)
def _triangle_behind(corners, t, planes, less, near, mask):  # type: ignore[no-untyped-def]
    """Whether a triangle is wholly behind one of the planes of a mask: most need no clipping.

    And a mask of those that a part of it is behind.
    """
    left = 0
    if mask == 0:
        return False, left
    rounding = _rounding(corners, t, near)
    while mask != 0:
        i = lowest_bit(mask)
        bit = mask & -mask
        mask ^= bit
        nx, ny, nz = planes[i, NORMAL], planes[i, NORMAL + 1], planes[i, NORMAL + 2]
        h0 = nx * corners[t, 0] + ny * corners[t, 1] + nz * corners[t, 2]
        h1 = nx * corners[t, 3] + ny * corners[t, 4] + nz * corners[t, 5]
        h2 = nx * corners[t, 6] + ny * corners[t, 7] + nz * corners[t, 8]
        if max(h0, h1, h2) < planes[i, LIMIT] - less * planes[i, BUMP] - rounding:
            return True, 0
        if min(h0, h1, h2) < planes[i, LIMIT]:
            left |= bit
    return False, left


@njit(cache=True, nogil=True)
def _clip(polygon, spare, count, nx, ny, nz, limit):  # type: ignore[no-untyped-def]
    """Part of a convex polygon with n·z ≥ limit, left in `spare`; returns its corner count."""
    kept = 0
    jx, jy, jz = polygon[count - 1, 0], polygon[count - 1, 1], polygon[count - 1, 2]
    hj = nx * jx + ny * jy + nz * jz - limit
    for i in range(count):
        ix, iy, iz = polygon[i, 0], polygon[i, 1], polygon[i, 2]
        hi = nx * ix + ny * iy + nz * iz - limit
        if (hi >= 0.0) != (hj >= 0.0):
            t = hj / (hj - hi)
            spare[kept, 0] = jx + t * (ix - jx)
            spare[kept, 1] = jy + t * (iy - jy)
            spare[kept, 2] = jz + t * (iz - jz)
            kept += 1
        if hi >= 0.0:
            spare[kept, 0] = ix
            spare[kept, 1] = iy
            spare[kept, 2] = iz
            kept += 1
        jx, jy, jz, hj = ix, iy, iz, hi
    return kept


@njit(cache=True, nogil=True)
def _remainder(corners, t, planes, less, rounding, mask, polygon, spare):  # type: ignore[no-untyped-def]
    """Clip triangle t to what no plane of a mask covers.

    Returns its corner count, and whether it is in `spare`.
    """
    for j in range(3):
        for k in range(3):
            polygon[j, k] = corners[t, 3 * j + k]
    count = 3
    swapped = False
    while mask != 0 and count > 0:
        i = lowest_bit(mask)
        mask &= mask - 1
        nx, ny, nz = planes[i, NORMAL], planes[i, NORMAL + 1], planes[i, NORMAL + 2]
        limit = planes[i, LIMIT] - less * planes[i, BUMP] - rounding
        if swapped:
            count = _clip(spare, polygon, count, nx, ny, nz, limit)
        else:
            count = _clip(polygon, spare, count, nx, ny, nz, limit)
        swapped = not swapped
    return count, swapped


@njit(cache=True, nogil=True)
def _closest_on_polygon(polygon, count, x, y, z):  # type: ignore[no-untyped-def]
    """Closest point of a convex polygon (any corner count from 1) and its squared distance."""
    bx = by = bz = 0.0
    best = np.inf
    for i in range(1, max(count - 1, 2)):
        j = min(i, count - 1)
        k = min(i + 1, count - 1)
        px, py, pz, _f, d2 = closest_on_triangle(
            polygon[0, 0],
            polygon[0, 1],
            polygon[0, 2],
            polygon[j, 0],
            polygon[j, 1],
            polygon[j, 2],
            polygon[k, 0],
            polygon[k, 1],
            polygon[k, 2],
            x,
            y,
            z,
        )
        if d2 < best:
            best = d2
            bx, by, bz = px, py, pz
    return bx, by, bz, best


@njit(cache=True, nogil=True)
def _polygon_within(polygon, count, x, y, z, reach):  # type: ignore[no-untyped-def]
    """Whether a convex polygon may come within `reach`, by a lower bound on its distance."""
    for i in range(1, max(count - 1, 2)):
        a, b, c = polygon[0], polygon[min(i, count - 1)], polygon[min(i + 1, count - 1)]
        d2 = closest_on_triangle(a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2], x, y, z)[4]
        error = distance_error(a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2])
        if np.sqrt(d2) - error <= reach:
            return True
    return False


@njit(cache=True, nogil=True)
def walk(  # type: ignore[no-untyped-def]
    nodes, corners, order, slivers, edges, walls, p, radius, standoff, tip_radius, ease,
    planes, first, queue, polygons,
):  # fmt: skip
    """Planes for a tip at p (3,), from row `first` on: their number and the radius they hold in.

    Args:
        nodes, corners, order, slivers: a `pdtree.Tree`.
        edges: (≥ m, 3) values of `Edge`, the caller's triangles.
        walls: triangles (a, b, b) stand for walls through a and b along z, and p[2] is 0.
        ease: `EASE`, or less.
        planes: (k, PLANE) written; at most `BUDGET` of them.
        queue, polygons: (HEAP, 3), (2, ≥ CORNERS, 3) to work in.
    """
    # An entry of the queue knows only so many planes, whatever room there is for more.
    budget = min(planes.shape[0] - first, BUDGET)
    planes = planes[first:]
    polygon, spare = polygons[0], polygons[1]
    x, y, z = p[0], p[1], p[2]
    near = ROUND * (max(abs(x), abs(y), abs(z)) + radius + tip_radius)
    # By what a computed distance to a box or a triangle (but a sliver) may be too large.
    blur = EXACT + near
    reach = (radius + tip_radius) * (1.0 + 1e-9) + blur
    reach2 = reach * reach
    # A point z of the mesh is behind plane i when n·z is below its LIMIT, of which its BUMP is for
    # bumps and counts less and less for triangles nearer than `far`.
    far = tip_radius + NEAR * standoff
    # The queue holds squared distances, items and masks. A waiting node is its number, a waiting
    # triangle −1 − its number; times SEEN, plus the number of planes it has already been tested
    # against. Its mask says which of these hide a part of it: only they can hide what is in it.
    m = 0
    valid = radius
    size = 0
    # How near the tip's centre may come to anything: no nearer than it is, or the tip's radius.
    deepest = tip_radius
    nearest = 0.0  # space between the tip and what is nearest
    # The nearest of what was just opened is often the nearest of all: it need not queue.
    next2 = box_distance2(nodes, 0, x, y, z)
    next_item = 0
    next_mask = 0
    while True:
        d2, item, mask = next2, next_item, next_mask
        if size > 0 and queue[0, 0] < next2:
            d2, item, mask = queue[0, 0], int(queue[0, 1]), float_as_bits(queue[0, 2])
            _pop(queue, size)
            size -= 1
            if next2 <= reach2:
                _push(queue, size, next2, next_item, bits_as_float(next_mask))
                size += 1
        next2 = np.inf
        if d2 > reach2:
            break
        seen = item % SEEN
        item = item // SEEN
        less = _less(d2, tip_radius, far)
        if item >= 0:
            hidden, cut = _box_behind(nodes, item, planes, less, near, _since(seen, m))
            if hidden:
                continue
            mask |= cut
            link = nodes[item, 15]
            if link > 0.0:
                first, last = children_of(link)
            else:
                first, last = triangles_of(link)
            if size + last - first >= HEAP:
                valid = max(np.sqrt(d2) * (1.0 - 1e-9) - blur - deepest, 0.0)
                break
            for entry in range(first, last):
                if link > 0.0:
                    e2 = box_distance2(nodes, entry, x, y, z)
                    if e2 > reach2:
                        continue
                    hidden, cut = _box_behind(
                        nodes, entry, planes, _less(e2, tip_radius, far), near, mask
                    )
                    if hidden:
                        continue
                else:
                    hidden, cut = _triangle_behind(corners, entry, planes, less, near, mask)
                    if hidden:
                        continue
                    e2 = triangle_distance2(corners, entry, x, y, z)
                    if slivers[entry] > 0.0:
                        e2 = max(np.sqrt(e2) - slivers[entry], 0.0) ** 2
                # A box's bound may round to just above its parent's triangles: never go back.
                e2 = max(e2, d2)
                if e2 > reach2:
                    continue
                new = (entry if link > 0.0 else -1 - entry) * SEEN + m
                if e2 < next2:
                    e2, next2 = next2, e2
                    new, next_item = next_item, new
                    cut, next_mask = next_mask, cut
                if e2 <= reach2:
                    _push(queue, size, e2, new, bits_as_float(cut))
                    size += 1
            continue

        t = -1 - item
        hidden, cut = _triangle_behind(corners, t, planes, less, near, _since(seen, m))
        if hidden:
            continue
        rounding = _rounding(corners, t, near)
        corners_left, swapped = _remainder(
            corners, t, planes, less, rounding, mask | cut, polygon, spare
        )
        if corners_left == 0:
            continue
        rest = spare if swapped else polygon
        px, py, pz, rest2 = _closest_on_polygon(rest, corners_left, x, y, z)
        if rest2 > reach2 and not _polygon_within(rest, corners_left, x, y, z, reach):
            continue
        if m == budget:
            valid = max(np.sqrt(d2) * (1.0 - 1e-9) - blur - deepest, 0.0)
            break
        rule, nx, ny, nz, base, px, py, pz = _separate(
            corners, order, edges, walls, t, rest, corners_left, px, py, pz, rest2, rounding,
            tip_radius, x, y, z, planes, m,
        )  # fmt: skip
        room = nx * x + ny * y + nz * z
        clear = room - base
        faint = FAINT * rounding
        if not clear > faint:
            # x is on the triangle within rounding: no plane separates them, so no step is safe.
            valid = 0.0
            break
        low = base + 4.0 * rounding
        space = clear - tip_radius
        if m == 0:
            deepest = min(tip_radius, clear)
            nearest = space
        if space > faint:
            kept = max(standoff, faint)
            if space < kept:
                # Below the standoff a tool between two walls may go as near to the farther one as
                # it is to the nearer one: it keeps to the middle.
                kept = min(space, max(nearest, faint))
            eased = ease * m * (space - kept)
            offset = min(base + tip_radius + kept + eased, room - min(YIELD, YIELD_SHARE * space))
            limit = max(base + BUMPY * kept + eased, low)
            bump = min(BUMPY * kept, limit - low)
            floor = limit + tip_radius
        else:
            # The tip overlaps the triangle: what can be promised is about its centre, and that it
            # comes no nearer to anything than it is to the nearest.
            kept = max(deepest, 0.5 * faint)
            offset = room - min(YIELD, YIELD_SHARE * kept)
            limit = max(low, room - kept)
            bump = 0.0
            floor = limit
        plane = planes[m]
        plane[NORMAL], plane[NORMAL + 1], plane[NORMAL + 2] = nx, ny, nz
        plane[OFFSET] = offset
        plane[FLOOR] = floor
        plane[FOOT], plane[FOOT + 1], plane[FOOT + 2] = px, py, pz
        plane[TRIANGLE] = order[t]
        plane[RULE] = rule
        plane[FIXTURE] = plane[CAPSULE] = plane[POINT] = plane[PUSH] = 0.0
        plane[LIMIT] = limit
        plane[BUMP] = bump
        m += 1
    return m, valid


@njit(cache=True, nogil=True)
def walk_alone(  # type: ignore[no-untyped-def]
    nodes, corners, order, slivers, edges, walls, p, radius, standoff, tip_radius, ease, planes
):  # fmt: skip
    """`walk` with room of its own to work in, for a single call from Python."""
    return walk(
        nodes, corners, order, slivers, edges, walls, p, radius, standoff, tip_radius, ease,
        planes, 0, np.empty((HEAP, 3)), np.empty((2, CORNERS, 3)),
    )  # fmt: skip


@njit(cache=True, nogil=True)
def _separate(  # type: ignore[no-untyped-def]
    corners, order, edges, walls, t, rest, count, px, py, pz, rest2, rounding, tip_radius, x, y, z,
    planes, m,
):  # fmt: skip
    """A plane with the `rest` of triangle t behind it: rule, normal, base offset, point.

    The base is the largest n·z over the corners, so it bounds the triangle whatever was rounded.
    planes: the m so far.
    """
    c = corners[t]
    qx, qy, qz, feature, d2 = triangle_at(corners, t, x, y, z)
    d = np.sqrt(d2)
    ux, uy, uz = c[3] - c[0], c[4] - c[1], c[5] - c[2]
    vx, vy, vz = c[6] - c[0], c[7] - c[1], c[8] - c[2]
    if walls:
        vx, vy, vz = 0.0, 0.0, 1.0
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    norm = np.sqrt(nx * nx + ny * ny + nz * nz)
    if norm > 0.0:
        side = nx * (x - c[0]) + ny * (y - c[1]) + nz * (z - c[2])
        scale = (1.0 if side >= 0.0 else -1.0) / norm
        nx, ny, nz = nx * scale, ny * scale, nz * scale
        h0 = nx * c[0] + ny * c[1] + nz * c[2]
        h1 = nx * c[3] + ny * c[4] + nz * c[5]
        h2 = nx * c[6] + ny * c[7] + nz * c[8]
        base = max(h0, h1, h2)
        # A sliver's normal is noise: its corners then do not lie on the plane.
        if base - min(h0, h1, h2) <= 8.0 * rounding:
            s = nx * x + ny * y + nz * z - base
            # What is between its ends is the inside of a wall.
            if (feature == 0 or (walls and feature <= 3)) and s > 0.0:
                return FACE, nx, ny, nz, base, qx, qy, qz
            i = order[t]
            valley = False
            seam = False
            if 1 <= feature <= 3:
                valley = edges[i, feature - 1] == ACROSS_VALLEY
                seam = edges[i, feature - 1] >= ACROSS_FLAT
            elif feature >= 4:
                one, other = edges[i, feature - 4], edges[i, (feature - 2) % 3]
                valley = one == ACROSS_VALLEY or other == ACROSS_VALLEY
                seam = one >= ACROSS_FLAT or other >= ACROSS_FLAT
            if seam and not valley:
                # An edge whose neighbours the mesh does not tell, of a triangle that rises from
                # there out of what a nearer plane covers, is a valley too: were each of its faces
                # the edge's plane while the tool is nearer to the other, the tool would hop from
                # the one to the other for ever.
                for k in range(m):
                    height = planes[k, NORMAL] * qx + planes[k, NORMAL + 1] * qy
                    if height + planes[k, NORMAL + 2] * qz < planes[k, LIMIT]:
                        valley = True
                        break
            # Judged from the rim of the tip: a plane under the tip's centre by less than its radius
            # would let the rim in.
            if valley and s > tip_radius + VALLEY_ROOM * max(d - tip_radius, 0.0):
                return VALLEY, nx, ny, nz, base, qx, qy, qz
    dx, dy, dz = x - px, y - py, z - pz
    d = np.sqrt(rest2)
    if d == 0.0:
        return RIDGE, 0.0, 0.0, 0.0, 0.0, px, py, pz
    nx, ny, nz = dx / d, dy / d, dz / d
    base = -np.inf
    for i in range(count):
        base = max(base, nx * rest[i, 0] + ny * rest[i, 1] + nz * rest[i, 2])
    return RIDGE, nx, ny, nz, base, px, py, pz
