"""The certified rule: planes that keep the tool off any triangle soup.

Claim. Let every plane have n·x ≥ o, let every part of the mesh within the ball be strictly behind
some plane, and let a step end at y with |y − x| ≤ radius and n·y ≥ o for all planes. Then the
segment from x to y touches no triangle.
Proof. x and y lie in the convex set C = ball ∩ {n·z ≥ o for all planes}, so the segment does. A
point of the mesh in C would be in the ball and strictly behind some plane: a contradiction. ∎

For a tip of radius ρ read "within ρ of the segment" for "touches": the ball searched has radius
r + ρ and "behind" is judged against o − ρ.

For a capsule of radius ρ with axis [a, b] the planes have n·a ≥ o and n·b ≥ o, what is searched is
all within r + ρ of the axis, and a step takes both ends to where they obey the planes, neither
farther than r. While they move straight no mesh point comes within ρ of the axis: an axis point w
is on the way a mean of a, b and their ends, so n·w ≥ o, and within r of [a, b]; a mesh point within
ρ of w would be in front of every o − ρ and within r + ρ of [a, b]: a contradiction. ∎ A tip is the
case a = b.

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

from vf import layout as at
from vf.kernels import bits_as_float, float_as_bits, njit
from vf.planes import ROUND, FloatArray, Planes, checked_ends, checked_length, planes_of
from vf.rules.behind import box_behind, less_of_bumps, rounding_of, since, triangle_behind
from vf.rules.clip import remainder
from vf.rules.margins import NO_MARGIN, Margins, margins_of
from vf.rules.queue import pop, push
from vf.rules.separate import separate
from vf.surface import Surface
from vf.tree.axis import (
    box_gap2,
    largest_coordinate,
    lowest,
    polygon_foot,
    polygon_within,
    triangle_gap2,
)
from vf.tree.pdtree import EXACT, Tree, children_of, triangles_of
from vf.tree.shapes import RIGID, place_boxes, place_corners, place_errors

BUDGET = 64  # planes that a walk may choose; masks have one bit for each
# On top of the standoff, plane number k (from 0) is moved towards x by k times this share of its
# distance. The nearest plane and planes in contact are not moved. Moved planes cover several far
# facets each: in a bowl, where every facet needs a plane of its own, this is a third of the planes
# for about a percent of the free space, and the budget lasts.
EASE = 0.004
# The same for an axis, whose body has a wide surface beside the mesh: a fifth less planes than with
# `EASE`, for a third of a percent of the free space.
AXIS_EASE = 0.016
# Parts of the mesh that stand out of the covered region by up to this share of the standoff get no
# plane of their own (a bump); the remaining share of the standoff keeps the tool off them.
BUMPY = 0.75
# This holds in full from this many standoffs away, and closer in proportion to the distance: in
# contact with a shallow bowl each of two faces would be a bump of the other, and the tool would
# alternate between their planes.
NEAR = 20.0
# A plane is at least this far below x [m], or YIELD_SHARE of the space to the mesh where that is
# less: between two opposing planes through x a tool could not slide, since no step of an arm is
# exactly straight and no solver exact. Recovery leads the tool back by it.
YIELD = 1e-8
YIELD_SHARE = 0.05
# Margins are lowered where the tool is closer to them than this share of the standoff: in contact
# it is closer than the standoff by `YIELD`.
ENOUGH = 0.9
# Space of fewer rounding errors than this counts as none: no plane separates x from the triangle.
FAINT = 64.0
# Capacity of the queue. When it is full, the walk ends and the radius shrinks to what is settled.
HEAP = 4096
SEEN = 128  # items of the queue count planes modulo this; more than BUDGET
CORNERS = BUDGET + 4  # of the polygon left of a triangle: each plane adds one corner at most


def certified_planes(
    surface: Surface,
    x: ArrayLike,
    radius: float,
    standoff: float = 0.0,
    tip_radius: float = 0.0,
    margin: ArrayLike = 0.0,
) -> Planes:
    """Separating planes for which every step that obeys them crosses no triangle.

    Args:
        surface: any triangle soup.
        x: (3,) centre of the tool tip, or (2, 3) start and end of a capsule's axis [m].
        radius: of the motion sphere: how far a step may go, each end of an axis [m].
        standoff: how far the planes are moved from the mesh towards x, at most up to x [m].
        tip_radius: of the spherical cutter around x, or of the capsule [m].
        margin: how far the tip, or the capsule, has to stay away from the surface beside the
            standoff [m]: one length, or (n,) one for each vertex; a triangle has the largest of its
            corners'. Where the tool is closer, all margins are lowered by what is missing.

    Returns:
        Planes with n·x ≥ o, for both ends of an axis. `radius` is smaller than asked for where the
        budget of 64 planes was spent, and 0 where x lies on a triangle within rounding, or an axis
        meets one; the claim then holds for that ball.

    Raises:
        ValueError: x, or a length, is not finite or not in its range (up to `planes.LARGEST`), or
            there is not a margin for each vertex.
    """
    p = checked_ends(x)
    radius = checked_length("radius", radius)
    standoff = checked_length("standoff", standoff)
    tip_radius = checked_length("tip radius", tip_radius)
    margins = margins_of(surface.tree, surface.vertices, surface.faces, margin)
    return cover(surface, p, radius, standoff, tip_radius, margins)


class Triangles(Protocol):
    """What the walk needs of a `Surface`, or of a part of one."""

    @property
    def tree(self) -> Tree: ...
    @property
    def edges(self) -> NDArray[np.int8]: ...


def cover(
    surface: Triangles,
    x: FloatArray,
    radius: float,
    standoff: float,
    tip_radius: float,
    margins: Margins = NO_MARGIN,
) -> Planes:
    """`certified_planes` for arguments that have been checked."""
    planes = np.empty((BUDGET, at.PLANE))
    tree = surface.tree
    m, reach = walk_alone(
        tree.nodes, tree.corners, tree.order, tree.errors, surface.edges, *margins, False,
        tuple(x.ravel().tolist()), radius, standoff, tip_radius,
        EASE if x.size == 3 else AXIS_EASE, planes,
    )  # fmt: skip
    return planes_of(planes[:m], reach)


@njit(cache=True, nogil=True)
def walk(  # type: ignore[no-untyped-def]
    nodes, corners, order, slivers, edges, shape, margin, highest, own, lowered, walls, ends,
    radius, standoff, thickness, ease, planes, first, queue, polygons,
):  # fmt: skip
    """Planes from row `first` on: their number, the radius they hold in, how far margins are lower.

    With a margin M the tip is searched for as if its radius were larger by M. Where the tool is
    closer to the mesh than that, M is what there is less the standoff, so that it may stay, and go
    no deeper. Margins that vary over the mesh are all lowered by the same length, to no less than
    0, and a triangle counts as so much farther away as its margin is less than the largest.

    Args:
        nodes, corners, order, slivers: a `pdtree.Tree`.
        edges: (≥ m, 3) values of `Edge`, the caller's triangles.
        shape: of a mesh that deforms, see `shapes.place_corners`: nodes, corners and slivers are
            written where the walk comes to them; else `RIGID`.
        margin, highest, own: `margins.Margins` [m]; where they vary, what `margin` is above the
            largest of them is added to all.
        lowered: by how much the margins are lowered from the outset [m].
        walls: triangles (a, b, b) stand for walls through a and b along z, and the tip's z is 0.
        ends: three numbers, the centre of the tip, or six, start and end of a capsule's axis [m].
        thickness: radius of the tip, or of the capsule [m].
        ease: `EASE`, or `AXIS_EASE` for an axis, or less.
        planes: (k, PLANE) written; at most `BUDGET` of them. PUSH is the margin, not lowered.
        queue, polygons: (HEAP, 3), (2, ≥ CORNERS, 3) to work in.
    """
    # Masks have a bit for each plane, so there are no more than BUDGET however long `planes` is.
    budget = min(planes.shape[0] - first, BUDGET)
    planes = planes[first:]
    polygon, spare = polygons[0], polygons[1]
    varied = own.shape[0] > 0
    added = margin - highest[0] if varied else 0.0  # to the margins, for this tick
    # Of the tip with the largest margin; triangles with less count as farther away by the rest.
    widest = max(margin - lowered, 0.0)
    tip_radius = thickness + widest
    near = ROUND * (largest_coordinate(ends) + radius + tip_radius)
    # A computed distance to a box, or to a triangle but a sliver, is too large by at most this.
    blur = EXACT + near
    reach = (radius + tip_radius) * (1.0 + 1e-9) + blur
    reach2 = reach * reach
    # A point z of the mesh is behind plane i when n·z is below its LIMIT, of which its BUMP is for
    # bumps and counts less and less for triangles nearer than `far`.
    far = tip_radius + NEAR * standoff
    # The queue holds squared distances, items and masks. An item is the number of a node, or −1 −
    # the number of a triangle, times SEEN, plus how many planes it has been tested against. The
    # mask has those of them that a part of it is behind: what is in it cannot be behind any other.
    m = 0
    valid = radius
    size = 0
    # The tip's centre may come this close to the mesh: its radius, or the distance if that is less.
    deepest = tip_radius
    nearest = 0.0  # space between the tip and the nearest triangle
    shift = 0.0  # where margins vary: of a triangle, or the largest of a node
    short = 0.0  # by how much it is less than the widest
    # The nearest child of the node just opened is often the next item: it is kept out of the queue.
    if shape[0] != 0:
        place_boxes(shape, 0, 1)
    next2 = box_gap2(nodes, 0, ends)
    next_item = 0
    next_mask = 0
    while True:
        d2, item, mask = next2, next_item, next_mask
        if size > 0 and queue[0, 0] < next2:
            d2, item, mask = queue[0, 0], int(queue[0, 1]), float_as_bits(queue[0, 2])
            pop(queue, size)
            size -= 1
            if next2 <= reach2:
                push(queue, size, next2, next_item, bits_as_float(next_mask))
                size += 1
        next2 = np.inf
        if d2 > reach2:
            break
        seen = item % SEEN
        item = item // SEEN
        less = less_of_bumps(d2, tip_radius, far)
        if varied:
            shift = (highest[item] if item >= 0 else own[-1 - item]) + added
            shift = max(shift - lowered, 0.0)
        if item >= 0:
            fresh = since(seen, m)
            if fresh != 0:
                hidden, cut = box_behind(nodes, item, planes, less, shift, near, fresh)
                if hidden:
                    continue
                mask |= cut
            link = nodes[item, 15]
            if link > 0.0:
                first, last = children_of(link)
                if shape[0] != 0:
                    place_boxes(shape, first, last)
            else:
                first, last = triangles_of(link)
                if shape[0] != 0:
                    place_corners(shape, first, last)
            if size + last - first >= HEAP:
                valid = max(np.sqrt(d2) * (1.0 - 1e-9) - blur - deepest, 0.0)
                break
            for entry in range(first, last):
                if link > 0.0:
                    e2 = box_gap2(nodes, entry, ends)
                    if varied:
                        shift = max(highest[entry] + added - lowered, 0.0)
                        e2 = (np.sqrt(e2) + (widest - shift)) ** 2
                    if e2 > reach2:
                        continue
                    cut = 0
                    if mask != 0:
                        hidden, cut = box_behind(
                            nodes, entry, planes, less_of_bumps(e2, tip_radius, far), shift, near,
                            mask,
                        )  # fmt: skip
                        if hidden:
                            continue
                else:
                    cut = 0
                    if varied:
                        shift = max(own[entry] + added - lowered, 0.0)
                    if mask != 0:
                        hidden, cut = triangle_behind(
                            corners, entry, planes, less, shift, near, mask
                        )
                        if hidden:
                            continue
                    if shape[0] != 0:
                        place_errors(shape, entry, entry + 1)
                    e2 = triangle_gap2(corners, entry, slivers, ends)
                    if varied:
                        e2 = (np.sqrt(e2) + (widest - shift)) ** 2
                # Rounding may put a child nearer than its parent: keys must not decrease.
                e2 = max(e2, d2)
                if e2 > reach2:
                    continue
                new = (entry if link > 0.0 else -1 - entry) * SEEN + m
                if e2 < next2:
                    e2, next2 = next2, e2
                    new, next_item = next_item, new
                    cut, next_mask = next_mask, cut
                if e2 <= reach2:
                    push(queue, size, e2, new, bits_as_float(cut))
                    size += 1
            continue

        t = -1 - item
        fresh = since(seen, m)
        if fresh != 0:
            hidden, cut = triangle_behind(corners, t, planes, less, shift, near, fresh)
            if hidden:
                continue
            mask |= cut
        rounding = rounding_of(corners, t, near)
        corners_left, swapped = remainder(
            corners, t, planes, less, shift, rounding, mask, polygon, spare
        )
        if corners_left == 0:
            continue
        rest = spare if swapped else polygon
        foot = polygon_foot(rest, corners_left, ends)
        if varied:
            short = widest - shift
        within = reach - short
        if foot[6] > within * within and not polygon_within(rest, corners_left, foot, ends, within):
            continue
        if m == 0 and widest > 0.0:
            apart = np.sqrt(foot[6]) - thickness
            gap = apart - (widest - short)
            overlaps = not apart > FAINT * rounding
            if overlaps or (short < widest and gap < ENOUGH * standoff):
                # Begin again with lower margins, without any where the tip overlaps the triangle.
                lowered = margin if overlaps else lowered + (standoff - gap)
                widest = max(margin - lowered, 0.0)
                tip_radius = thickness + widest
                reach = (radius + tip_radius) * (1.0 + 1e-9) + blur
                reach2 = reach * reach
                far = tip_radius + NEAR * standoff
                deepest = tip_radius
                size = 0
                next2 = box_gap2(nodes, 0, ends)
                next_item = 0
                next_mask = 0
                continue
        wide = tip_radius - short  # of the tip with the margin of this triangle
        if m == budget:
            valid = max(np.sqrt(d2) * (1.0 - 1e-9) - blur - deepest, 0.0)
            break
        rule, nx, ny, nz, base, px, py, pz = separate(
            corners, order, edges, walls, t, rest, corners_left, foot, rounding, wide, shift,
            ends, planes, m,
        )  # fmt: skip
        room = lowest(nx, ny, nz, ends)
        clear = room - base
        faint = FAINT * rounding
        if not clear > faint:
            # x is on the triangle within rounding: no plane separates them, so no step is safe.
            valid = 0.0
            break
        low = base + 4.0 * rounding
        space = clear - wide
        if m == 0:
            deepest = min(tip_radius, clear + short)
            nearest = space
        if space > faint:
            kept = max(standoff, faint)
            if space < kept:
                # Between two walls less than two standoffs apart the tool may come as close to
                # the farther wall as it is to the nearer one, so that it can stay in the middle.
                kept = min(space, max(nearest, faint))
            eased = ease * m * (space - kept)
            offset = min(base + wide + kept + eased, room - min(YIELD, YIELD_SHARE * space))
            limit = max(base + BUMPY * kept + eased, low)
            bump = min(BUMPY * kept, limit - low)
            floor = limit + wide
        else:
            # The tip overlaps the triangle: the planes then guarantee that its centre comes no
            # closer to any triangle than it is to the nearest one now.
            kept = max(deepest, 0.5 * faint)
            offset = room - min(YIELD, YIELD_SHARE * kept)
            limit = max(low, room - kept)
            bump = 0.0
            floor = limit
        plane = planes[m]
        plane[at.NORMAL], plane[at.NORMAL + 1], plane[at.NORMAL + 2] = nx, ny, nz
        plane[at.OFFSET] = offset
        plane[at.FLOOR] = floor
        plane[at.FOOT], plane[at.FOOT + 1], plane[at.FOOT + 2] = px, py, pz
        plane[at.TRIANGLE] = order[t]
        plane[at.RULE] = rule
        plane[at.FIXTURE] = plane[at.CAPSULE] = plane[at.POINT] = 0.0
        plane[at.PUSH] = own[t] + added if varied else margin
        # Compared with what is behind it after the margin of that has been taken off.
        plane[at.LIMIT] = limit + shift
        plane[at.BUMP] = bump
        m += 1
    return m, valid, lowered


@njit(cache=True, nogil=True)
def walk_alone(  # type: ignore[no-untyped-def]
    nodes, corners, order, slivers, edges, margin, highest, own, walls, ends, radius, standoff,
    thickness, ease, planes,
):  # fmt: skip
    """`walk` with its own working memory, for a single call from Python: planes and radius."""
    m, valid, _lowered = walk(
        nodes, corners, order, slivers, edges, RIGID, margin, highest, own, 0.0, walls, ends,
        radius, standoff, thickness, ease, planes, 0, np.empty((HEAP, 3)),
        np.empty((2, CORNERS, 3)),
    )  # fmt: skip
    return m, valid
