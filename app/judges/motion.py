"""Whether capsules pass triangles while joints move and triangles deform, proved piece by piece.

On a piece of the motion the ends of an axis leave the straight lines between their places at its
start and its end by no more than an eighth of the bound on their second derivative, times the
piece's length squared. The corners of a triangle go straight from one shape of the mesh to another;
of one that keeps its shape they rest. A plane that has, both at the start and at the end of the
piece, the triangle on one side and on the other, farther than that and the radius, the ends of the
axis, has them so at every time of it: on its straight way the farthest corner along the normal is
no farther than in proportion between the two, and the nearest end is no nearer. So it is proof that
the capsule does not touch the triangle on this piece. Where no such plane is found the piece is
halved, until the capsule overlaps the triangle, or nothing moves farther than `FINEST` on it: then
it is taken to touch. So what is not proved is reported; distances only say where to look for a
plane. (Within a few nanometres of the edge of a triangle rounding leaves no such plane for a body
of no radius.)
"""

from __future__ import annotations

import numpy as np

from app.judges.boxes import list_near
from app.judges.screws import fastest, place_end
from vf.kernels import njit

TOLERANCE = 1e-9  # for rounding, by which a capsule may overlap a triangle [m]
FINEST = 1e-11  # motion of a piece that is not halved any more [m]
ROUNDING = 1e-15  # of a height above a plane, for places within a few metres of the base [m]
DEEPEST = 64  # halvings; far more than lead to `FINEST`


@njit(cache=True, nogil=True)
def first_contacts(  # type: ignore[no-untyped-def]
    box_vertices, box_faces, order, levels_boxes, levels, vertices, ways, faces, first, last,
    lines, posture, ends, carried, radii, chosen, q, dq, found, shares, triangles,
):  # fmt: skip
    """For each chosen capsule the share of the tick at which it first touches a triangle.

    Args:
        box_vertices, …, levels: see `boxes.Boxes`; around all shapes of the tick.
        vertices, ways, faces: see `passing.Shapes`.
        first, last: share of the ways at the start and at the end of the tick.
        lines, …, carried: see `screws.Screws`, in the structure's frame.
        radii: (c,) of the capsules [m].
        chosen: numbers of the capsules to look at.
        q, dq: the joints go from q to q + dq in proportion.
        found: room for the triangles near one capsule's motion.
        shares, triangles: (c,) written for the chosen: inf and −1 where nothing is touched.

    Returns:
        0, or the size that `found` needs.
    """
    n = q.shape[0]
    there = np.empty(n)
    stack = np.empty((DEEPEST, 2))
    whole = np.empty((3, 2, 3))
    piece = np.empty((3, 2, 3))
    corners = np.empty((3, 3, 3))
    for k in chosen:
        shares[k], triangles[k] = np.inf, -1
        speed = 0.0
        bend = 0.0
        for e in range(2):
            way, curve = fastest(lines, posture, ends, carried, 2 * k + e, q, dq)
            speed, bend = max(speed, way), max(bend, curve)
        _place(lines, posture, ends, carried, k, q, dq, 0.0, 1.0, there, whole)
        radius = max(radii[k] - TOLERANCE, 0.0)
        reach = radius + speed + 2.0 * FINEST
        near = list_near(
            box_vertices, box_faces, order, levels_boxes, levels, whole[0, 0], whole[0, 1], reach,
            found,
        )  # fmt: skip
        if near > found.shape[0]:
            return near
        for i in range(near):
            t = found[i]
            _corners(vertices, ways, faces, t, first, last, 0.0, 1.0, corners)
            if clear(whole, corners, radius + 0.125 * bend):
                continue
            pace = speed
            for c in range(3):
                gone = 0.0
                for axis in range(3):
                    gone += (corners[2, c, axis] - corners[0, c, axis]) ** 2
                pace = max(pace, speed + np.sqrt(gone))
            # The pieces that are left, from the last to the first.
            stack[0, 0], stack[0, 1] = 0.0, 1.0
            count = 1
            while count > 0:
                count -= 1
                low, high = stack[count, 0], stack[count, 1]
                if low >= shares[k]:
                    break
                _place(lines, posture, ends, carried, k, q, dq, low, high, there, piece)
                _corners(vertices, ways, faces, t, first, last, low, high, corners)
                length = high - low
                if clear(piece, corners, radius + 0.125 * bend * length * length):
                    continue
                small = pace * length <= FINEST or count + 2 > DEEPEST
                x = corners[0]
                if small or overlaps(piece[0, 0], piece[0, 1], x[0], x[1], x[2], radius):
                    shares[k], triangles[k] = low, t
                    break
                middle = low + 0.5 * length
                stack[count, 0], stack[count, 1] = middle, high
                stack[count + 1, 0], stack[count + 1, 1] = low, middle
                count += 2
    return 0


@njit(cache=True, nogil=True)
def _place(lines, posture, ends, carried, k, q, dq, low, high, there, piece):  # type: ignore[no-untyped-def]
    """Ends of axis k at the beginning, the middle and the end of a piece, into (3, 2, 3)."""
    for m in range(3):
        share = low + 0.5 * m * (high - low)
        for j in range(q.shape[0]):
            there[j] = q[j] + share * dq[j]
        for e in range(2):
            place_end(lines, posture, ends, carried, 2 * k + e, there, piece[m, e])


@njit(cache=True, nogil=True)
def _corners(vertices, ways, faces, t, first, last, low, high, corners):  # type: ignore[no-untyped-def]
    """Those of triangle t at the beginning, the middle and the end of a piece, into (3, 3, 3)."""
    for m in range(3):
        share = first + (low + 0.5 * m * (high - low)) * (last - first)
        for c in range(3):
            v = faces[t, c]
            for axis in range(3):
                corners[m, c, axis] = vertices[v, axis] + share * ways[v, axis]


@njit(cache=True, nogil=True)
def clear(piece, corners, room):  # type: ignore[no-untyped-def]
    """Whether a plane is found that has a triangle farther than `room` from an axis all the way.

    Args:
        piece: (3, 2, 3) ends of the axis at the beginning, the middle and the end of a motion.
        corners: (3, 3, 3) of the triangle then.
    """
    p, q, r = corners[1, 0], corners[1, 1], corners[1, 2]
    nx, ny, nz, _d2 = apart(piece[1, 0], piece[1, 1], p, q, r)
    if _separates(piece, corners, nx, ny, nz, room):
        return True
    # The triangle's own plane is more accurate than a way that is hardly longer than its rounding.
    ux, uy, uz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    vx, vy, vz = r[0] - p[0], r[1] - p[1], r[2] - p[2]
    fx, fy, fz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    x = piece[1, 0]
    if fx * (x[0] - p[0]) + fy * (x[1] - p[1]) + fz * (x[2] - p[2]) < 0.0:
        fx, fy, fz = -fx, -fy, -fz
    return _separates(piece, corners, fx, fy, fz, room)


@njit(cache=True, nogil=True)
def _separates(piece, corners, nx, ny, nz, room):  # type: ignore[no-untyped-def]
    """Whether the ends are more than `room` farther along n than the triangle, first and last."""
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    # A way to nowhere is infinite.
    if not (length > 0.0 and length < np.inf):
        return False
    nx, ny, nz = nx / length, ny / length, nz / length
    for m in (0, 2):
        base = -np.inf
        for c in range(3):
            x = corners[m, c]
            base = max(base, nx * x[0] + ny * x[1] + nz * x[2])
        for e in range(2):
            x = piece[m, e]
            if not nx * x[0] + ny * x[1] + nz * x[2] - base > room + ROUNDING:
                return False
    return True


@njit(cache=True, nogil=True)
def overlaps(a, b, p, q, r, radius):  # type: ignore[no-untyped-def]
    """Whether the capsule of axis ab overlaps the triangle pqr, in floating point."""
    _x, _y, _z, d2 = apart(a, b, p, q, r)
    return d2 < radius * radius or _pierces(a, b, p, q, r)


@njit(cache=True, nogil=True)
def _pierces(a, b, p, q, r):  # type: ignore[no-untyped-def]
    """Whether the segment ab passes through the triangle pqr, in floating point."""
    ha, hb = _volume(p, q, r, a), _volume(p, q, r, b)
    if not ha * hb < 0.0:
        return False
    s, t, u = _volume(a, b, p, q), _volume(a, b, q, r), _volume(a, b, r, p)
    return (s > 0.0 and t > 0.0 and u > 0.0) or (s < 0.0 and t < 0.0 and u < 0.0)


@njit(cache=True, nogil=True)
def _volume(a, b, c, d):  # type: ignore[no-untyped-def]
    """Six times the signed volume of four points."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    return (
        (uy * vz - uz * vy) * (d[0] - a[0])
        + (uz * vx - ux * vz) * (d[1] - a[1])
        + (ux * vy - uy * vx) * (d[2] - a[2])
    )


@njit(cache=True, nogil=True)
def apart(a, b, p, q, r):  # type: ignore[no-untyped-def]
    """The shortest way from the triangle pqr to the segment ab, which does not pass through it.

    Returns:
        Its three components [m], and its squared length.
    """
    bx, by, bz, best = 0.0, 0.0, 0.0, np.inf
    for k in range(11):
        if k < 2:
            x, y, z = _above(p, q, r, a if k == 0 else b)
        elif k < 8:
            u, v = (p, q) if k % 3 == 0 else ((q, r) if k % 3 == 1 else (r, p))
            x, y, z = _from_segment(u, v, a if k < 5 else b)
        else:
            u = p if k == 8 else (q if k == 9 else r)
            x, y, z = _from_segment(a, b, u)
            x, y, z = -x, -y, -z
        d2 = x * x + y * y + z * z
        if d2 < best:
            bx, by, bz, best = x, y, z, d2
    for k in range(3):
        u, v = (p, q) if k == 0 else ((q, r) if k == 1 else (r, p))
        x, y, z = _between(u, v, a, b)
        d2 = x * x + y * y + z * z
        if d2 < best:
            bx, by, bz, best = x, y, z, d2
    return bx, by, bz, best


@njit(cache=True, nogil=True)
def _from_segment(u, v, x):  # type: ignore[no-untyped-def]
    """The way to x from the nearest point of the segment uv."""
    dx, dy, dz = v[0] - u[0], v[1] - u[1], v[2] - u[2]
    wx, wy, wz = x[0] - u[0], x[1] - u[1], x[2] - u[2]
    dd = dx * dx + dy * dy + dz * dz
    share = 0.0
    if dd > 0.0:
        share = min(max((dx * wx + dy * wy + dz * wz) / dd, 0.0), 1.0)
    return wx - share * dx, wy - share * dy, wz - share * dz


@njit(cache=True, nogil=True)
def _above(p, q, r, x):  # type: ignore[no-untyped-def]
    """The way to x from its foot on the plane of pqr; infinite if that is not in the triangle."""
    ux, uy, uz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    vx, vy, vz = r[0] - p[0], r[1] - p[1], r[2] - p[2]
    wx, wy, wz = x[0] - p[0], x[1] - p[1], x[2] - p[2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    nn = nx * nx + ny * ny + nz * nz
    if not nn > 0.0:
        return np.inf, np.inf, np.inf
    s = (nx * (wy * vz - wz * vy) + ny * (wz * vx - wx * vz) + nz * (wx * vy - wy * vx)) / nn
    t = (nx * (uy * wz - uz * wy) + ny * (uz * wx - ux * wz) + nz * (ux * wy - uy * wx)) / nn
    if s < 0.0 or t < 0.0 or s + t > 1.0:
        return np.inf, np.inf, np.inf
    h = (nx * wx + ny * wy + nz * wz) / nn
    return h * nx, h * ny, h * nz


@njit(cache=True, nogil=True)
def _between(u, v, a, b):  # type: ignore[no-untyped-def]
    """The way from the line uv to the line ab; infinite unless it is between the segments."""
    dx, dy, dz = v[0] - u[0], v[1] - u[1], v[2] - u[2]
    ex, ey, ez = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    wx, wy, wz = a[0] - u[0], a[1] - u[1], a[2] - u[2]
    nx, ny, nz = dy * ez - dz * ey, dz * ex - dx * ez, dx * ey - dy * ex
    nn = nx * nx + ny * ny + nz * nz
    if not nn > 0.0:
        return np.inf, np.inf, np.inf
    s = (nx * (wy * ez - wz * ey) + ny * (wz * ex - wx * ez) + nz * (wx * ey - wy * ex)) / nn
    t = (nx * (wy * dz - wz * dy) + ny * (wz * dx - wx * dz) + nz * (wx * dy - wy * dx)) / nn
    if s < 0.0 or s > 1.0 or t < 0.0 or t > 1.0:
        return np.inf, np.inf, np.inf
    h = (nx * wx + ny * wy + nz * wz) / nn
    return h * nx, h * ny, h * nz
