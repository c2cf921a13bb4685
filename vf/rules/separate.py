"""The plane that separates a tip, or an axis, from what is left of a triangle."""

from __future__ import annotations

import numpy as np

from vf import layout as at
from vf.adjacency import Edge
from vf.kernels import njit
from vf.planes import Rule
from vf.tree.axis import lowest, triangle_foot

# A face plane at a valley edge must be at least this share of the triangle's distance below x.
VALLEY_ROOM = 0.05
FACE, RIDGE, VALLEY = int(Rule.FACE), int(Rule.RIDGE), int(Rule.VALLEY)
ACROSS_VALLEY, ACROSS_FLAT = int(Edge.VALLEY), int(Edge.FLAT)


@njit(cache=True, nogil=True)
def separate(  # type: ignore[no-untyped-def]
    corners, order, edges, walls, t, rest, count, foot, rounding, tip_radius, shift, ends, planes, m
):  # fmt: skip
    """A plane that has the polygon `rest`, which is left of triangle t, behind it.

    Args:
        rest, count: the polygon.
        foot: `axis.polygon_foot` of it.
        ends: of the axis, or the tip, see `certified.walk`.
        walls: see `certified.walk`.
        rounding: bound on the rounding error of n·z [m].
        tip_radius: with the margin of the triangle [m].
        shift: of that what the LIMIT of planes does not have, see `certified.walk` [m].
        planes, m: those chosen so far.

    Returns:
        Rule, normal (three numbers), base offset, closest point (three numbers). The base is the
        largest n·z over the corners, so it bounds all of the polygon in spite of rounding.
    """
    c = corners[t]
    x, y, z, qx, qy, qz, feature, d2 = triangle_foot(corners, t, ends)
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
            s = lowest(nx, ny, nz, ends) - base
            # A point between the ends of a wall (features 0 to 3) is on its face.
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
                # An edge without a known neighbour counts as a valley too if it lies behind a
                # nearer plane and the triangle rises out of that plane from there. Otherwise each
                # of the two faces at the edge would give the ridge's plane while the tool is nearer
                # to the other one, and the tool would alternate between the two planes without end.
                for k in range(m):
                    height = planes[k, at.NORMAL] * qx + planes[k, at.NORMAL + 1] * qy
                    if height + planes[k, at.NORMAL + 2] * qz < planes[k, at.LIMIT] - shift:
                        valley = True
                        break
            # Judged from the tip's surface: a face plane less than its radius below the centre
            # would let the tip overlap the triangle.
            if valley and s > tip_radius + VALLEY_ROOM * max(d - tip_radius, 0.0):
                return VALLEY, nx, ny, nz, base, qx, qy, qz
    x, y, z, px, py, pz, rest2 = foot
    dx, dy, dz = x - px, y - py, z - pz
    d = np.sqrt(rest2)
    if d == 0.0:
        return RIDGE, 0.0, 0.0, 0.0, 0.0, px, py, pz
    nx, ny, nz = dx / d, dy / d, dz / d
    base = -np.inf
    for i in range(count):
        base = max(base, nx * rest[i, 0] + ny * rest[i, 1] + nz * rest[i, 2])
    return RIDGE, nx, ny, nz, base, px, py, pz
