"""On which side of a triangle's plane a point is, or that rounding leaves it undecided."""

from __future__ import annotations

from vf.kernels import njit

# Bound on the relative rounding error of a determinant of three differences of points, by the sum
# of its terms' magnitudes: nine roundings a term, and some to spare.
DETERMINANT = 16.0 * 1.2e-16


@njit(cache=True, nogil=True)
def side(ax, ay, az, bx, by, bz, cx, cy, cz, x, y, z):  # type: ignore[no-untyped-def]
    """Sign of (b − a) × (c − a) · (x − a), 0 where rounding leaves it undecided.

    Differences of coordinates are exact to half a unit in the last place, so the error is bounded
    by a share of the magnitudes of the terms, independent of where the origin is.
    """
    ux, uy, uz = bx - ax, by - ay, bz - az
    vx, vy, vz = cx - ax, cy - ay, cz - az
    wx, wy, wz = x - ax, y - ay, z - az
    volume = (uy * vz - uz * vy) * wx + (uz * vx - ux * vz) * wy + (ux * vy - uy * vx) * wz
    magnitude = (
        (abs(uy * vz) + abs(uz * vy)) * abs(wx)
        + (abs(uz * vx) + abs(ux * vz)) * abs(wy)
        + (abs(ux * vy) + abs(uy * vx)) * abs(wz)
    )
    error = DETERMINANT * magnitude + 1e-290  # what is lost where products underflow
    if volume > error:
        return 1
    return -1 if volume < -error else 0


@njit(cache=True, nogil=True)
def inner_side(c, x, y, z, turn):  # type: ignore[no-untyped-def]
    """Whether (x, y, z) is strictly on the inner side of a triangle with corners c (9,)."""
    return turn * side(c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8], x, y, z) < 0.0
