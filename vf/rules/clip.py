"""What is left of a triangle that is partly behind the planes chosen so far: a convex polygon."""

from __future__ import annotations

from vf import layout as at
from vf.kernels import lowest_bit, njit


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
def remainder(corners, t, planes, less, shift, rounding, mask, polygon, spare):  # type: ignore[no-untyped-def]
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
        limit = planes[i, at.LIMIT] - less * planes[i, at.BUMP] - shift - rounding
        if swapped:
            count = _clip(spare, polygon, count, nx, ny, nz, limit)
        else:
            count = _clip(polygon, spare, count, nx, ny, nz, limit)
        swapped = not swapped
    return count, swapped
