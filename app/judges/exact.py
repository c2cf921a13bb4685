"""Judges in rational arithmetic: floats are fractions, so every answer is exact.

Slow, for where floats leave it open. None of it knows the library that it judges.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Vector = tuple[Fraction, Fraction, Fraction]

ZERO, ONE = Fraction(0), Fraction(1)


def meets(a: FloatArray, b: FloatArray, triangle: FloatArray) -> bool:
    """Whether the closed segment ab (3,) and the closed triangle (3, 3) share a point.

    Triangles without area and segments without length will do as well.
    """
    p, q = _exact(a), _exact(b)
    corners = [_exact(c) for c in triangle]
    edges = [(corners[k], _minus(corners[(k + 1) % 3], corners[k])) for k in range(3)]
    n = _cross(edges[0][1], edges[1][1])
    if not any(n):
        # Without area the triangle is its longest edge.
        r, v = max(edges, key=lambda edge: _dot(edge[1], edge[1]))
        return _segments_meet(p, _minus(q, p), r, v)
    hp, hq = _dot(n, _minus(p, corners[0])), _dot(n, _minus(q, corners[0]))
    if hp * hq > 0:
        return False
    # The segment's part in the triangle's plane: all of it, or a point.
    low, high = (ZERO, ONE) if hp == hq else (hp / (hp - hq),) * 2
    d = _minus(q, p)
    for r, e in edges:
        inwards = _cross(n, e)
        start, slope = _dot(inwards, _minus(p, r)), _dot(inwards, d)
        if slope > 0:
            low = max(low, -start / slope)
        elif slope < 0:
            high = min(high, -start / slope)
        elif start < 0:
            return False
    return low <= high


def distance2(triangle: FloatArray, x: FloatArray) -> Fraction:
    """Squared distance of x (3,) and the closed triangle (3, 3), any triangle."""
    return _distance2([_exact(c) for c in triangle], _exact(x))


def uncovered(
    triangle: FloatArray,
    normals: FloatArray,
    offsets: FloatArray,
    x: FloatArray,
    radius: float,
    tip_radius: float = 0.0,
) -> Fraction | None:
    """Squared distance to x (3,) of what no plane covers of a triangle (3, 3); None: all covered.

    Covered is a point z outside the closed ball of radius + tip radius around x, or with
    n·z < o − tip radius for one of the planes (m, 3), (m,).
    """
    part = [_exact(c) for c in triangle]
    rho = Fraction(float(tip_radius))
    for normal, offset in zip(normals, offsets, strict=True):
        part = _clip(part, _exact(normal), Fraction(float(offset)) - rho)
        if not part:
            return None
    found = _distance2(part, _exact(x))
    return found if found <= (Fraction(float(radius)) + rho) ** 2 else None


def _clip(part: list[Vector], n: Vector, limit: Fraction) -> list[Vector]:
    """Corners of the part of a convex flat polygon with n·z ≥ limit."""
    heights = [_dot(n, p) - limit for p in part]
    kept = []
    for i, (p, h) in enumerate(zip(part, heights, strict=True)):
        if h >= 0:
            kept.append(p)
        q, g = part[(i + 1) % len(part)], heights[(i + 1) % len(part)]
        if h * g < 0:
            kept.append(_along(p, _minus(q, p), h / (h - g)))
    return kept


def _distance2(part: list[Vector], x: Vector) -> Fraction:
    """Squared distance of x to a convex flat polygon of one corner or more."""
    count = len(part)
    edges = [(part[i], _minus(part[(i + 1) % count], part[i])) for i in range(count)]
    best = min(_to_segment2(p, e, x) for p, e in edges)
    for k in range(1, count - 1):
        n = _cross(_minus(part[k], part[0]), _minus(part[k + 1], part[0]))
        if any(n):
            if all(_dot(_cross(n, e), _minus(x, p)) >= 0 for p, e in edges):
                best = min(best, _dot(n, _minus(x, part[0])) ** 2 / _dot(n, n))
            break
    return best


def _to_segment2(p: Vector, e: Vector, x: Vector) -> Fraction:
    """Squared distance of x to the segment from p to p + e."""
    w = _minus(x, p)
    ee = _dot(e, e)
    t = min(max(_dot(w, e) / ee, ZERO), ONE) if ee else ZERO
    off = _minus(w, (t * e[0], t * e[1], t * e[2]))
    return _dot(off, off)


def _segments_meet(p: Vector, u: Vector, r: Vector, v: Vector) -> bool:
    """Whether p + s u and r + t v share a point with s and t from 0 to 1."""
    w = _minus(r, p)
    n = _cross(u, v)
    nn = _dot(n, n)
    if nn != 0:
        s, t = _dot(_cross(w, v), n) / nn, _dot(_cross(w, u), n) / nn
        return _dot(w, n) == 0 and 0 <= s <= 1 and 0 <= t <= 1
    along = u if any(u) else v
    if any(_cross(w, along)):
        return False
    if not any(along):
        return not any(w)
    # On one line: intervals along it, from p.
    ends_u = sorted((ZERO, _dot(u, along)))
    start = _dot(w, along)
    ends_v = sorted((start, start + _dot(v, along)))
    return ends_u[0] <= ends_v[1] and ends_v[0] <= ends_u[1]


def _exact(p: FloatArray) -> Vector:
    return Fraction(float(p[0])), Fraction(float(p[1])), Fraction(float(p[2]))


def _along(p: Vector, e: Vector, t: Fraction) -> Vector:
    return p[0] + t * e[0], p[1] + t * e[1], p[2] + t * e[2]


def _minus(p: Vector, q: Vector) -> Vector:
    return p[0] - q[0], p[1] - q[1], p[2] - q[2]


def _dot(p: Vector, q: Vector) -> Fraction:
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]


def _cross(p: Vector, q: Vector) -> Vector:
    return (
        p[1] * q[2] - p[2] * q[1],
        p[2] * q[0] - p[0] * q[2],
        p[0] * q[1] - p[1] * q[0],
    )
