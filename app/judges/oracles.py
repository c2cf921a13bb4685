"""Oracles of the certified rule that share no code with it, not even the local triangle list.

Of a `vf.Surface` they read only vertices and faces; candidates come from `app.judges.boxes`. Of
`vf` they use only the decorator that compiles.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import vf
from app.judges import boxes, exact
from vf.kernels import njit

FloatArray = NDArray[np.float64]

OVERLAP_TOLERANCE = 1e-9  # for rounding, by which a ball may overlap a triangle [m]
LEAK_TOLERANCE = 1e-11  # [m]


def crossings(surface: vf.Surface, a: FloatArray, b: FloatArray) -> int:
    """Exact number of triangles that the closed segment from a to b (3,) touches or crosses."""
    near = boxes.near(boxes.of(surface), a, b, 0.0)
    return _count_crossings(surface, near, a, b)


def _count_crossings(
    surface: vf.Surface, near: NDArray[np.int64], a: FloatArray, b: FloatArray
) -> int:
    doubtful = np.empty(len(near), dtype=np.int64)
    count, doubts = _cut(surface.vertices, surface.faces, near, a, b, doubtful)
    corners = surface.vertices[surface.faces[doubtful[:doubts]]]
    return int(count) + sum(exact.meets(a, b, triangle) for triangle in corners)


def overlaps(surface: vf.Surface, a: FloatArray, b: FloatArray, tip_radius: float) -> int:
    """Number of triangles that a ball of `tip_radius` [m] overlaps between a and b (3,).

    Overlaps of at most `OVERLAP_TOLERANCE` do not count.
    """
    near = boxes.near(boxes.of(surface), a, b, tip_radius)
    room = tip_radius - OVERLAP_TOLERANCE
    return int(_count_overlaps(surface.vertices, surface.faces, near, a, b, room))


def leaks(
    surface: vf.Surface,
    planes: vf.Planes,
    x: FloatArray,
    radius: float,
    tip_radius: float = 0.0,
) -> int:
    """Number of triangles with a point in the ball strictly on the allowed side of every plane.

    The ball is enlarged and the planes are moved back by the tip's radius. "In the ball" and
    "strictly" mean by more than `LEAK_TOLERANCE`.
    """
    p = np.asarray(x, dtype=np.float64)
    reach = radius + tip_radius
    near = boxes.near(boxes.of(surface), p, p, reach)
    return int(
        _count_leaks(
            surface.vertices, surface.faces, near, planes.normals, planes.offsets - tip_radius,
            p, reach, LEAK_TOLERANCE,
        )
    )  # fmt: skip


def distances(surface: vf.Surface, triangles: NDArray[np.int64], x: FloatArray) -> FloatArray:
    """Distance [m] of x (3,) to each of the triangles (k,)."""
    return np.asarray(_distances(surface.vertices, surface.faces, triangles, x))


def lateral_distance(path: FloatArray, direction: FloatArray, p: FloatArray) -> float:
    """Distance [m] of p (3,) from a path (k, 3), both projected along a unit direction (3,).

    The path is extended straight at both ends.
    """
    flat = path - np.outer(path @ direction, direction)
    q = p - (p @ direction) * direction
    starts, ways = flat[:-1], np.diff(flat, axis=0)
    lengths2 = (ways * ways).sum(axis=1)
    starts, ways, lengths2 = starts[lengths2 > 0.0], ways[lengths2 > 0.0], lengths2[lengths2 > 0.0]
    shares = ((q - starts) * ways).sum(axis=1) / lengths2
    low, high = np.zeros(len(ways)), np.ones(len(ways))
    low[0], high[-1] = -np.inf, np.inf
    feet = starts + np.clip(shares, low, high)[:, None] * ways
    return float(np.linalg.norm(q - feet, axis=1).min())


def blocked(
    surface: vf.Surface,
    planes: vf.Planes,
    x: FloatArray,
    radius: float,
    rng: np.random.Generator,
    samples: int = 64,
) -> tuple[int, int]:
    """Sample points that a free straight segment from x (3,) reaches: (forbidden ones, all).

    The points are uniform in the ball of `radius` [m] around x. Forbidden are points behind a plane
    or outside the ball in which the planes are valid, if it is smaller.
    """
    u = rng.normal(size=(samples, 3))
    u /= np.linalg.norm(u, axis=1)[:, None]
    ys = x + u * (radius * rng.uniform(size=(samples, 1)) ** (1.0 / 3.0))
    near = boxes.near(boxes.of(surface), x, x, radius)
    free = forbidden = 0
    for y in ys:
        if _count_crossings(surface, near, x, y):
            continue
        free += 1
        far = bool(np.linalg.norm(y - x) > planes.radius)
        forbidden += far or bool((planes.normals @ y < planes.offsets).any())
    return forbidden, free


@njit(cache=True, nogil=True)
def _orient(p, q, r, s):  # type: ignore[no-untyped-def]
    """Sign of the volume of p, q, r, s; 0 if rounding leaves it open (Shewchuk's filter)."""
    ax, ay, az = p[0] - s[0], p[1] - s[1], p[2] - s[2]
    bx, by, bz = q[0] - s[0], q[1] - s[1], q[2] - s[2]
    cx, cy, cz = r[0] - s[0], r[1] - s[1], r[2] - s[2]
    det = az * (bx * cy - by * cx) + bz * (cx * ay - cy * ax) + cz * (ax * by - ay * bx)
    size = (
        abs(az) * (abs(bx * cy) + abs(by * cx))
        + abs(bz) * (abs(cx * ay) + abs(cy * ax))
        + abs(cz) * (abs(ax * by) + abs(ay * bx))
    )
    bound = 7.8e-16 * size
    if det > bound:
        return 1
    if det < -bound:
        return -1
    return 0


@njit(cache=True, nogil=True)
def _segments_distance2(p, q, r, s):  # type: ignore[no-untyped-def]
    """Squared distance of the segments pq and rs: the least over all types of closest pairs."""
    best = np.inf
    for k in range(4):
        if k == 0:
            e, f, g = p, r, s
        elif k == 1:
            e, f, g = q, r, s
        elif k == 2:
            e, f, g = r, p, q
        else:
            e, f, g = s, p, q
        d = g - f
        dd = d @ d
        t = 0.0
        if dd > 0.0:
            t = min(max(((e - f) @ d) / dd, 0.0), 1.0)
        w = e - f - t * d
        best = min(best, w @ w)
    u, v, w0 = q - p, s - r, p - r
    n = _cross(u, v)
    nn = n @ n
    if nn > 1e-18 * (u @ u) * (v @ v):
        t1 = -(_cross(w0, v) @ n) / nn
        t2 = -(_cross(w0, u) @ n) / nn
        if 0.0 < t1 < 1.0 and 0.0 < t2 < 1.0:
            w = w0 + t1 * u - t2 * v
            best = min(best, w @ w)
    return best


@njit(cache=True, nogil=True)
def _cross(u, v):  # type: ignore[no-untyped-def]
    return np.array(
        [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
    )


@njit(cache=True, nogil=True)
def _in_prism(a, b, c, p):  # type: ignore[no-untyped-def]
    """Distance of p from the triangle's plane if p projects into the triangle, else infinity."""
    u, v, w = b - a, c - a, p - a
    n = _cross(u, v)
    nn = n @ n
    if nn == 0.0:
        return np.inf
    # By cross products: the Gram determinant of a needle suffers from cancellation.
    s = _cross(w, v) @ n / nn
    t = _cross(u, w) @ n / nn
    if s < 0.0 or t < 0.0 or s + t > 1.0:
        return np.inf
    return abs(w @ n) / np.sqrt(nn)


@njit(cache=True, nogil=True)
def distance(a, b, p, q, r):  # type: ignore[no-untyped-def]
    """Distance of the segment ab and the triangle pqr, provided that they do not cross [m]."""
    gap = min(_in_prism(p, q, r, a), _in_prism(p, q, r, b)) ** 2
    gap = min(gap, _segments_distance2(a, b, p, q))
    gap = min(gap, _segments_distance2(a, b, q, r))
    gap = min(gap, _segments_distance2(a, b, r, p))
    return np.sqrt(gap)


@njit(cache=True, nogil=True)
def _distances(vertices, faces, rows, x):  # type: ignore[no-untyped-def]
    found = np.empty(rows.shape[0])
    for k in range(rows.shape[0]):
        f = faces[rows[k]]
        found[k] = distance(x, x, vertices[f[0]], vertices[f[1]], vertices[f[2]])
    return found


@njit(cache=True, nogil=True)
def touches(a, b, p, q, r):  # type: ignore[no-untyped-def]
    """Whether the segment ab meets the triangle pqr: 1 yes, 0 no, −1 if rounding leaves it open."""
    for k in range(3):
        if max(a[k], b[k]) < min(p[k], q[k], r[k]) or min(a[k], b[k]) > max(p[k], q[k], r[k]):
            return 0
    oa, ob = _orient(p, q, r, a), _orient(p, q, r, b)
    if oa * ob > 0:
        return 0
    s0, s1, s2 = _orient(a, b, p, q), _orient(a, b, q, r), _orient(a, b, r, p)
    if s0 * s1 < 0 or s1 * s2 < 0 or s2 * s0 < 0:
        return 0
    if oa == 0 or ob == 0 or s0 == 0 or s1 == 0 or s2 == 0:
        return -1
    return 1


@njit(cache=True, nogil=True)
def _cut(vertices, faces, rows, a, b, doubtful):  # type: ignore[no-untyped-def]
    """(Triangles that the segment ab certainly meets, undecided ones); the latter are listed."""
    count = 0
    doubts = 0
    for i in rows:
        f = faces[i]
        verdict = touches(a, b, vertices[f[0]], vertices[f[1]], vertices[f[2]])
        if verdict > 0:
            count += 1
        elif verdict < 0:
            doubtful[doubts] = i
            doubts += 1
    return count, doubts


@njit(cache=True, nogil=True)
def _count_overlaps(vertices, faces, rows, a, b, room):  # type: ignore[no-untyped-def]
    count = 0
    for i in rows:
        f = faces[i]
        p, q, r = vertices[f[0]], vertices[f[1]], vertices[f[2]]
        if touches(a, b, p, q, r) > 0 or distance(a, b, p, q, r) < room:
            count += 1
    return count


@njit(cache=True, nogil=True)
def _count_leaks(vertices, faces, rows, normals, offsets, x, radius, tolerance):  # type: ignore[no-untyped-def]
    """Clip each triangle in its coordinates (s, t) by every half-space.

    On the triangle a + s u + t v the signed distance to a plane is linear in s and t, so the rest
    of the unit triangle is a convex polygon; its distance to x is the least over edges and inside.
    """
    m = offsets.shape[0]
    size = m + 8
    poly = np.empty((size, 2))
    other = np.empty((size, 2))
    count = 0
    for i in rows:
        a = vertices[faces[i, 0]]
        u = vertices[faces[i, 1]] - a
        v = vertices[faces[i, 2]] - a
        poly[0, 0], poly[0, 1] = 0.0, 0.0
        poly[1, 0], poly[1, 1] = 1.0, 0.0
        poly[2, 0], poly[2, 1] = 0.0, 1.0
        k = 3
        for j in range(m):
            h0 = normals[j] @ a - offsets[j] - tolerance
            hs, ht = normals[j] @ u, normals[j] @ v
            kept = 0
            for c in range(k):
                d = (c + 1) % k
                hc = h0 + hs * poly[c, 0] + ht * poly[c, 1]
                hd = h0 + hs * poly[d, 0] + ht * poly[d, 1]
                if hc > 0.0:
                    other[kept] = poly[c]
                    kept += 1
                if (hc > 0.0) != (hd > 0.0):
                    share = hc / (hc - hd)
                    other[kept] = poly[c] + share * (poly[d] - poly[c])
                    kept += 1
            poly, other = other, poly
            k = kept
            if k == 0:
                break
        if k == 0:
            continue
        nearest = np.inf
        inside = k >= 3
        w = x - a
        uu, uv, vv, wu, wv = u @ u, u @ v, v @ v, w @ u, w @ v
        den = uu * vv - uv * uv
        if den > 1e-20 * uu * vv:
            s = (vv * wu - uv * wv) / den
            t = (uu * wv - uv * wu) / den
        else:
            s = t = 0.0
            inside = False
        for c in range(k):
            d = (c + 1) % k
            p = a + poly[c, 0] * u + poly[c, 1] * v
            q = a + poly[d, 0] * u + poly[d, 1] * v
            e = q - p
            ee = e @ e
            share = 0.0
            if ee > 0.0:
                share = min(max(((x - p) @ e) / ee, 0.0), 1.0)
            g = x - p - share * e
            nearest = min(nearest, np.sqrt(g @ g))
            turn = (poly[d, 0] - poly[c, 0]) * (t - poly[c, 1]) - (poly[d, 1] - poly[c, 1]) * (
                s - poly[c, 0]
            )
            if turn < 0.0:
                inside = False
        if inside:
            g = w - s * u - t * v
            nearest = min(nearest, np.sqrt(g @ g))
        if nearest < radius - tolerance:
            count += 1
    return count
