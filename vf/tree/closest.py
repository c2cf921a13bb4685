"""Closest point of a triangle, and the feature of the triangle it lies on."""

from __future__ import annotations

from enum import IntEnum
from math import sqrt

import numpy as np

from vf.kernels import njit
from vf.planes import FloatArray


class Feature(IntEnum):
    """Where on a triangle (corners 0, 1, 2) a closest point lies.

    EDGE_k runs from corner k to corner k+1 (mod 3); VERTEX_k is corner k.
    """

    FACE = 0
    EDGE_0 = 1
    EDGE_1 = 2
    EDGE_2 = 3
    VERTEX_0 = 4
    VERTEX_1 = 5
    VERTEX_2 = 6


# A triangle whose height is below this share of its longest edge has no usable inside: its
# closest point is sought on its edges, which is exact for zero area and off by its height above.
SLIVER = 1e-8


@njit(cache=True, nogil=True, inline="always")
def closest_on_segment(ax, ay, az, bx, by, bz, x, y, z):  # type: ignore[no-untyped-def]
    """Parameter t in [0, 1] of the point of a→b closest to (x, y, z), and that point."""
    dx, dy, dz = bx - ax, by - ay, bz - az
    length2 = dx * dx + dy * dy + dz * dz
    if length2 == 0.0:
        return 0.0, ax, ay, az
    t = ((x - ax) * dx + (y - ay) * dy + (z - az) * dz) / length2
    if t <= 0.0:
        return 0.0, ax, ay, az
    if t >= 1.0:
        return 1.0, bx, by, bz
    return t, ax + t * dx, ay + t * dy, az + t * dz


@njit(cache=True, nogil=True)
def closest_on_triangle(ax, ay, az, bx, by, bz, cx, cy, cz, x, y, z):  # type: ignore[no-untyped-def]
    """Closest point (px, py, pz), its feature code and squared distance. Any triangle will do."""
    ux, uy, uz = bx - ax, by - ay, bz - az
    vx, vy, vz = cx - ax, cy - ay, cz - az
    wx, wy, wz = cx - bx, cy - by, cz - bz
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    area2 = nx * nx + ny * ny + nz * nz
    longest2 = max(
        ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, wx * wx + wy * wy + wz * wz
    )
    if area2 > SLIVER * SLIVER * longest2 * longest2:
        # Signed areas towards each edge say whether the projection on the plane is inside.
        rx, ry, rz = x - ax, y - ay, z - az
        sx, sy, sz = x - bx, y - by, z - bz
        e0 = nx * (uy * rz - uz * ry) + ny * (uz * rx - ux * rz) + nz * (ux * ry - uy * rx)
        e1 = nx * (wy * sz - wz * sy) + ny * (wz * sx - wx * sz) + nz * (wx * sy - wy * sx)
        e2 = nx * (vz * ry - vy * rz) + ny * (vx * rz - vz * rx) + nz * (vy * rx - vx * ry)
        if e0 > 0.0 and e1 > 0.0 and e2 > 0.0:
            h = (nx * rx + ny * ry + nz * rz) / area2
            return x - h * nx, y - h * ny, z - h * nz, 0, h * h * area2
    best = np.inf
    bpx = bpy = bpz = 0.0
    feature = 0
    for k in range(3):
        if k == 0:
            t, px, py, pz = closest_on_segment(ax, ay, az, bx, by, bz, x, y, z)
        elif k == 1:
            t, px, py, pz = closest_on_segment(bx, by, bz, cx, cy, cz, x, y, z)
        else:
            t, px, py, pz = closest_on_segment(cx, cy, cz, ax, ay, az, x, y, z)
        d2 = (x - px) ** 2 + (y - py) ** 2 + (z - pz) ** 2
        if d2 < best:
            best = d2
            bpx, bpy, bpz = px, py, pz
            if t == 0.0:
                feature = 4 + k
            elif t == 1.0:
                feature = 4 + (k + 1) % 3
            else:
                feature = 1 + k
    return bpx, bpy, bpz, feature, best


@njit(cache=True, nogil=True)
def distance_error(ax, ay, az, bx, by, bz, cx, cy, cz):  # type: ignore[no-untyped-def]
    """How much the computed distance to a triangle can exceed the true one [m].

    The rounding of a corner, ε·M for coordinates up to M, turns the plane of a triangle with
    longest edge L and height h by up to ε·M/h, and so moves it by ε·M·L/h over the triangle's
    length; 32 bounds the operations. Where only the edges are looked at, what is inside is nearer
    than they are by no more than the height. Both distance functions of this module keep to it.
    """
    ux, uy, uz = bx - ax, by - ay, bz - az
    vx, vy, vz = cx - ax, cy - ay, cz - az
    wx, wy, wz = cx - bx, cy - by, cz - bz
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    area2 = nx * nx + ny * ny + nz * nz
    longest2 = max(
        ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, wx * wx + wy * wy + wz * wz
    )
    size = max(abs(ax), abs(ay), abs(az), abs(bx), abs(by), abs(bz), max(abs(cx), abs(cy), abs(cz)))
    rounding = 32.0 * 2.3e-16 * size
    # Twice the threshold: rounding may have put the triangle on the other side of it.
    if area2 > 4.0 * SLIVER * SLIVER * longest2 * longest2:
        return rounding * longest2 / sqrt(area2)
    return rounding / SLIVER + 2.0 * SLIVER * sqrt(longest2)


@njit(cache=True, nogil=True)
def well_shaped(ax, ay, az, bx, by, bz, cx, cy, cz, error):  # type: ignore[no-untyped-def]
    """Whether `distance_error` is certainly at most `error` [m]: quicker, as most triangles are."""
    ux, uy, uz = bx - ax, by - ay, bz - az
    vx, vy, vz = cx - ax, cy - ay, cz - az
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    area2 = nx * nx + ny * ny + nz * nz
    # More than the longest edge squared, and than the largest coordinate.
    long2 = 2.0 * (ux * ux + uy * uy + uz * uz + vx * vx + vy * vy + vz * vz)
    size = abs(ax) + abs(ay) + abs(az)
    size += abs(ux) + abs(uy) + abs(uz) + abs(vx) + abs(vy) + abs(vz)
    thin = (33.0 * 2.3e-16 * size + 3.0 * SLIVER * error) * long2
    return error * error * area2 > thin * thin


# Where the sine² of the angle at corner 0 is below this, `distance2_to_triangle` would lose digits.
_SHARP = 1e-4


@njit(cache=True, nogil=True)
def distance2_to_triangle(ax, ay, az, bx, by, bz, cx, cy, cz, x, y, z):  # type: ignore[no-untyped-def]
    """Squared distance to a triangle, for walks that ask many and want the point of few.

    `closest_on_triangle` without the point and its feature, in the coordinates of edges 0 and 2.
    """
    ux, uy, uz = bx - ax, by - ay, bz - az
    vx, vy, vz = cx - ax, cy - ay, cz - az
    rx, ry, rz = x - ax, y - ay, z - az
    uu = ux * ux + uy * uy + uz * uz
    uv = ux * vx + uy * vy + uz * vz
    vv = vx * vx + vy * vy + vz * vz
    area2 = uu * vv - uv * uv
    if not area2 > _SHARP * uu * vv:
        return closest_on_triangle(ax, ay, az, bx, by, bz, cx, cy, cz, x, y, z)[4]
    ru = ux * rx + uy * ry + uz * rz
    rv = vx * rx + vy * ry + vz * rz
    s = vv * ru - uv * rv
    t = uu * rv - uv * ru
    if s > 0.0 and t > 0.0 and s + t < area2:
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        h = nx * rx + ny * ry + nz * rz
        return h * h / (nx * nx + ny * ny + nz * nz)
    on_u = min(max(ru / uu, 0.0), 1.0)
    on_v = min(max(rv / vv, 0.0), 1.0)
    across = min(max((rv - ru + uu - uv) / (uu - 2.0 * uv + vv), 0.0), 1.0)
    rest = 1.0 - across
    ex, ey, ez = rx - on_u * ux, ry - on_u * uy, rz - on_u * uz
    fx, fy, fz = rx - on_v * vx, ry - on_v * vy, rz - on_v * vz
    gx = rx - rest * ux - across * vx
    gy = ry - rest * uy - across * vy
    gz = rz - rest * uz - across * vz
    return min(
        ex * ex + ey * ey + ez * ez, fx * fx + fy * fy + fz * fz, gx * gx + gy * gy + gz * gz
    )


def closest_point(triangle: FloatArray, x: FloatArray) -> tuple[FloatArray, Feature, float]:
    """Closest point (3,) of a triangle (3, 3) to x (3,), its feature and the distance [m]."""
    a, b, c = np.asarray(triangle, dtype=np.float64).reshape(3, 3)
    px, py, pz, feature, d2 = closest_on_triangle(*a, *b, *c, *np.asarray(x, dtype=np.float64))
    return np.array([px, py, pz]), Feature(feature), sqrt(d2)
