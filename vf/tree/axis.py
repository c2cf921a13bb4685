"""Distances of a capsule's axis to boxes, triangles and polygons, as lower bounds.

An axis is a tuple `ends` of six numbers, start and end [m]. Three numbers are a point, for which
the distances are those of `vf.tree.closest` and `pdtree`. Numba compiles each function for either:
it knows the length of a tuple.

The distance of an axis is bounded by a plane: for any unit vector n the axis and a convex body are
at least min(n·a, n·b) − max n·z apart, and for n along the closest pair that is their distance. So
a pair that rounding, a sliver or an early stop of a search makes a little wrong gives a bound that
is a little low. The bound itself is off by a few units in the last place of the coordinates.
"""

from __future__ import annotations

import numpy as np

from vf.kernels import njit
from vf.tree.closest import closest_on_segment, closest_on_triangle, distance_error
from vf.tree.pdtree import box_distance2, triangle_at, triangle_distance2

# Of two segments the inner closest pair is not sought where the sine² of their angle is below this:
# the ends' pairs are as good there.
PARALLEL = 1e-14
STEPS = 4  # of the search along the axis for its point nearest to a box


@njit(cache=True, nogil=True)
def largest_coordinate(ends):  # type: ignore[no-untyped-def]
    """Largest magnitude of a coordinate [m]."""
    size = max(abs(ends[0]), abs(ends[1]), abs(ends[2]))
    if len(ends) == 6:
        size = max(size, abs(ends[-3]), abs(ends[-2]), abs(ends[-1]))
    return size


@njit(cache=True, nogil=True)
def lowest(nx, ny, nz, ends):  # type: ignore[no-untyped-def]
    """Least n·x over the axis, or n·x of the point [m]."""
    low = nx * ends[0] + ny * ends[1] + nz * ends[2]
    if len(ends) == 6:
        low = min(low, nx * ends[-3] + ny * ends[-2] + nz * ends[-1])
    return low


@njit(cache=True, nogil=True)
def out_of_reach(nodes, ends, reach):  # type: ignore[no-untyped-def]
    """Whether all of a tree is certainly farther than `reach` [m] from an axis, by two balls."""
    half2 = box2 = gap2 = 0.0
    for k in range(3):
        a, b = ends[k], ends[len(ends) - 3 + k]
        half2 += 0.25 * (b - a) * (b - a)
        gap2 += (0.5 * (a + b) - nodes[0, k]) ** 2
        box2 += nodes[0, 3 + k] * nodes[0, 3 + k]
    # Rounding is a few units in the last place of coordinates up to 10 km.
    far = np.sqrt(half2) + np.sqrt(box2) + reach + 1e-8
    return gap2 * (1.0 - 1e-9) > far * far


@njit(cache=True, nogil=True)
def box_gap2(nodes, node, ends):  # type: ignore[no-untyped-def]
    """Squared distance to the box of a node, or less (0 inside)."""
    if len(ends) == 3:
        return box_distance2(nodes, node, ends[0], ends[1], ends[2])
    return _box_gap2(
        nodes, node, ends[0], ends[1], ends[2], ends[-3], ends[-2], ends[-1]
    )  # fmt: skip


@njit(cache=True, nogil=True)
def _box_gap2(nodes, node, ax, ay, az, bx, by, bz):  # type: ignore[no-untyped-def]
    x, y, z = ax - nodes[node, 0], ay - nodes[node, 1], az - nodes[node, 2]
    wx, wy, wz = bx - ax, by - ay, bz - az
    hx, hy, hz = nodes[node, 3], nodes[node, 4], nodes[node, 5]
    # In the frame of the box: the start p of the axis, and the way d to its end.
    px = nodes[node, 6] * x + nodes[node, 7] * y + nodes[node, 8] * z
    py = nodes[node, 9] * x + nodes[node, 10] * y + nodes[node, 11] * z
    pz = nodes[node, 12] * x + nodes[node, 13] * y + nodes[node, 14] * z
    dx = nodes[node, 6] * wx + nodes[node, 7] * wy + nodes[node, 8] * wz
    dy = nodes[node, 9] * wx + nodes[node, 10] * wy + nodes[node, 11] * wz
    dz = nodes[node, 12] * wx + nodes[node, 13] * wy + nodes[node, 14] * wz
    dd = dx * dx + dy * dy + dz * dz
    t = 0.0
    if dd > 0.0:
        t = min(max(-(px * dx + py * dy + pz * dz) / dd, 0.0), 1.0)
    ex = ey = ez = 0.0
    # Newton's steps on the derivative, which is piecewise linear and grows.
    for _ in range(STEPS):
        ex, ey, ez = px + t * dx, py + t * dy, pz + t * dz
        ex -= min(max(ex, -hx), hx)
        ey -= min(max(ey, -hy), hy)
        ez -= min(max(ez, -hz), hz)
        slope = ex * dx + ey * dy + ez * dz
        curve = 0.0
        if ex != 0.0:
            curve += dx * dx
        if ey != 0.0:
            curve += dy * dy
        if ez != 0.0:
            curve += dz * dz
        if curve == 0.0:
            break
        before = t
        t = min(max(t - slope / curve, 0.0), 1.0)
        if abs(t - before) < 1e-9:
            break
    size2 = ex * ex + ey * ey + ez * ez
    if size2 == 0.0:
        return 0.0
    start = ex * px + ey * py + ez * pz
    end = start + (ex * dx + ey * dy + ez * dz)
    gap = min(start, end) - (hx * abs(ex) + hy * abs(ey) + hz * abs(ez))
    if gap <= 0.0:
        return 0.0
    return gap * gap / size2


@njit(cache=True, nogil=True)
def triangle_gap2(corners, t, slivers, ends):  # type: ignore[no-untyped-def]
    """Squared distance to row t of tree-ordered corners, or less."""
    if len(ends) == 3:
        d2 = triangle_distance2(corners, t, ends[0], ends[1], ends[2])
        if slivers[t] > 0.0:
            d2 = max(np.sqrt(d2) - slivers[t], 0.0) ** 2
        return d2
    c = corners[t]
    ax, ay, az, bx, by, bz = ends[0], ends[1], ends[2], ends[-3], ends[-2], ends[-1]
    sx, sy, sz, px, py, pz, d2 = closest_pair(
        c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8], ax, ay, az, bx, by, bz
    )
    if d2 == 0.0:
        return 0.0
    nx, ny, nz = sx - px, sy - py, sz - pz
    low = min(nx * ax + ny * ay + nz * az, nx * bx + ny * by + nz * bz)
    high = max(
        nx * c[0] + ny * c[1] + nz * c[2],
        nx * c[3] + ny * c[4] + nz * c[5],
        nx * c[6] + ny * c[7] + nz * c[8],
    )
    gap = low - high
    return gap * gap / (nx * nx + ny * ny + nz * nz) if gap > 0.0 else 0.0


@njit(cache=True, nogil=True)
def closest_pair(ux, uy, uz, vx, vy, vz, wx, wy, wz, ax, ay, az, bx, by, bz):  # type: ignore[no-untyped-def]
    """Closest points of the segment ab (s) and the triangle uvw (p), and their squared distance."""
    sx, sy, sz = ax, ay, az
    px, py, pz, _f, best = closest_on_triangle(ux, uy, uz, vx, vy, vz, wx, wy, wz, ax, ay, az)
    qx, qy, qz, _f, d2 = closest_on_triangle(ux, uy, uz, vx, vy, vz, wx, wy, wz, bx, by, bz)
    if d2 < best:
        best = d2
        sx, sy, sz, px, py, pz = bx, by, bz, qx, qy, qz
    for k in range(3):
        if k == 0:
            rx, ry, rz, qx, qy, qz, d2 = _inner_pair(ax, ay, az, bx, by, bz, ux, uy, uz, vx, vy, vz)
        elif k == 1:
            rx, ry, rz, qx, qy, qz, d2 = _inner_pair(ax, ay, az, bx, by, bz, vx, vy, vz, wx, wy, wz)
        else:
            rx, ry, rz, qx, qy, qz, d2 = _inner_pair(ax, ay, az, bx, by, bz, wx, wy, wz, ux, uy, uz)
        if d2 < best:
            best = d2
            sx, sy, sz, px, py, pz = rx, ry, rz, qx, qy, qz
    # The axis may pierce the triangle.
    ex, ey, ez = vx - ux, vy - uy, vz - uz
    fx, fy, fz = wx - ux, wy - uy, wz - uz
    nx, ny, nz = ey * fz - ez * fy, ez * fx - ex * fz, ex * fy - ey * fx
    start = nx * (ax - ux) + ny * (ay - uy) + nz * (az - uz)
    end = nx * (bx - ux) + ny * (by - uy) + nz * (bz - uz)
    if (start > 0.0) != (end > 0.0) and start != end:
        t = start / (start - end)
        rx, ry, rz = ax + t * (bx - ax), ay + t * (by - ay), az + t * (bz - az)
        qx, qy, qz, _f, d2 = closest_on_triangle(ux, uy, uz, vx, vy, vz, wx, wy, wz, rx, ry, rz)
        if d2 < best:
            best = d2
            sx, sy, sz, px, py, pz = rx, ry, rz, qx, qy, qz
    return sx, sy, sz, px, py, pz, best


@njit(cache=True, nogil=True)
def _inner_pair(ax, ay, az, bx, by, bz, cx, cy, cz, dx, dy, dz):  # type: ignore[no-untyped-def]
    """A close pair of the segments ab (s) and cd (p), and its squared distance.

    It is the closest unless one of the points is an end of ab and the triangle is near there, which
    `closest_pair` looks at besides.
    """
    ux, uy, uz = bx - ax, by - ay, bz - az
    vx, vy, vz = dx - cx, dy - cy, dz - cz
    wx, wy, wz = cx - ax, cy - ay, cz - az
    uu = ux * ux + uy * uy + uz * uz
    vv = vx * vx + vy * vy + vz * vz
    uv = ux * vx + uy * vy + uz * vz
    wu = wx * ux + wy * uy + wz * uz
    wv = wx * vx + wy * vy + wz * vz
    nn = uu * vv - uv * uv
    t = 0.0  # along cd
    if nn > PARALLEL * uu * vv:
        t = min(max((uv * wu - uu * wv) / nn, 0.0), 1.0)
    elif uu > 0.0 and vv > 0.0:
        # Parallel: the end of cd nearer to the segment ab, or what lies beside the start of ab.
        t = min(max(-wv / vv, 0.0), 1.0)
    px, py, pz = cx + t * vx, cy + t * vy, cz + t * vz
    _s, sx, sy, sz = closest_on_segment(ax, ay, az, bx, by, bz, px, py, pz)
    _t, px, py, pz = closest_on_segment(cx, cy, cz, dx, dy, dz, sx, sy, sz)
    _s, sx, sy, sz = closest_on_segment(ax, ay, az, bx, by, bz, px, py, pz)
    d2 = (sx - px) ** 2 + (sy - py) ** 2 + (sz - pz) ** 2
    return sx, sy, sz, px, py, pz, d2


@njit(cache=True, nogil=True)
def triangle_foot(corners, t, ends):  # type: ignore[no-untyped-def]
    """Point of the axis closest to triangle t, closest point of the triangle, its feature, d²."""
    if len(ends) == 3:
        x, y, z = ends[0], ends[1], ends[2]
    else:
        c = corners[t]
        x, y, z, _px, _py, _pz, _d2 = closest_pair(
            c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8],
            ends[0], ends[1], ends[2], ends[-3], ends[-2], ends[-1],
        )  # fmt: skip
    qx, qy, qz, feature, d2 = triangle_at(corners, t, x, y, z)
    return x, y, z, qx, qy, qz, feature, d2


@njit(cache=True, nogil=True)
def polygon_foot(polygon, count, ends):  # type: ignore[no-untyped-def]
    """Closest points of the axis and of a convex polygon (any corner count from 1), and d²."""
    x, y, z = ends[0], ends[1], ends[2]
    sx, sy, sz = x, y, z
    bx = by = bz = 0.0
    best = np.inf
    for i in range(1, max(count - 1, 2)):
        j = min(i, count - 1)
        k = min(i + 1, count - 1)
        if len(ends) == 3:
            px, py, pz, _f, d2 = closest_on_triangle(
                polygon[0, 0], polygon[0, 1], polygon[0, 2],
                polygon[j, 0], polygon[j, 1], polygon[j, 2],
                polygon[k, 0], polygon[k, 1], polygon[k, 2],
                x, y, z,
            )  # fmt: skip
            if d2 < best:
                best = d2
                bx, by, bz = px, py, pz
        else:
            rx, ry, rz, px, py, pz, d2 = closest_pair(
                polygon[0, 0], polygon[0, 1], polygon[0, 2],
                polygon[j, 0], polygon[j, 1], polygon[j, 2],
                polygon[k, 0], polygon[k, 1], polygon[k, 2],
                x, y, z, ends[-3], ends[-2], ends[-1],
            )  # fmt: skip
            if d2 < best:
                best = d2
                bx, by, bz = px, py, pz
                sx, sy, sz = rx, ry, rz
    return sx, sy, sz, bx, by, bz, best


@njit(cache=True, nogil=True)
def polygon_within(polygon, count, foot, ends, reach):  # type: ignore[no-untyped-def]
    """Whether a convex polygon may come within `reach`, by a lower bound on its distance.

    Args:
        foot: as `polygon_foot` gives it.
    """
    if len(ends) == 3:
        x, y, z = ends[0], ends[1], ends[2]
        for i in range(1, max(count - 1, 2)):
            a, b, c = polygon[0], polygon[min(i, count - 1)], polygon[min(i + 1, count - 1)]
            d2 = closest_on_triangle(a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2], x, y, z)[
                4
            ]
            error = distance_error(a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2])
            if np.sqrt(d2) - error <= reach:
                return True
        return False
    nx, ny, nz = foot[0] - foot[3], foot[1] - foot[4], foot[2] - foot[5]
    size = np.sqrt(nx * nx + ny * ny + nz * nz)
    high = -np.inf
    for i in range(count):
        high = max(high, nx * polygon[i, 0] + ny * polygon[i, 1] + nz * polygon[i, 2])
    return lowest(nx, ny, nz, ends) - high <= reach * size
