"""What is left of a triangle that is partly behind the planes chosen so far: a convex polygon."""

from __future__ import annotations

import numpy as np

from vf import layout as at
from vf.kernels import lowest_bit, njit
from vf.tree.closest import closest_on_triangle, distance_error


@njit(cache=True, nogil=True)
def _clip(polygon, spare, count, nx, ny, nz, limit):  # type: ignore[no-untyped-def]
    """Write the part of a convex polygon with n·z ≥ limit to `spare`; returns its corner count."""
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
def remainder(corners, t, planes, less, rounding, mask, polygon, spare):  # type: ignore[no-untyped-def]
    """Clip from triangle t what is behind the planes of a mask.

    Returns:
        Corner count of the polygon that is left, and whether it is in `spare` (or in `polygon`).
    """
    for j in range(3):
        for k in range(3):
            polygon[j, k] = corners[t, 3 * j + k]
    count = 3
    swapped = False
    while mask != 0 and count > 0:
        i = lowest_bit(mask)
        mask &= mask - 1
        nx, ny, nz = planes[i, at.NORMAL], planes[i, at.NORMAL + 1], planes[i, at.NORMAL + 2]
        limit = planes[i, at.LIMIT] - less * planes[i, at.BUMP] - rounding
        if swapped:
            count = _clip(spare, polygon, count, nx, ny, nz, limit)
        else:
            count = _clip(polygon, spare, count, nx, ny, nz, limit)
        swapped = not swapped
    return count, swapped


@njit(cache=True, nogil=True)
def closest_on_polygon(polygon, count, x, y, z):  # type: ignore[no-untyped-def]
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
def polygon_within(polygon, count, x, y, z, reach):  # type: ignore[no-untyped-def]
    """Whether a convex polygon may come within `reach`, by a lower bound on its distance."""
    for i in range(1, max(count - 1, 2)):
        a, b, c = polygon[0], polygon[min(i, count - 1)], polygon[min(i + 1, count - 1)]
        d2 = closest_on_triangle(a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2], x, y, z)[4]
        error = distance_error(a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2])
        if np.sqrt(d2) - error <= reach:
            return True
    return False
