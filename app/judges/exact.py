"""Intersection of segments and triangles in rational arithmetic: every float is a fraction.

Exact but slow, for the cases that floating point leaves undecided.
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

    Degenerate triangles and segments are allowed.
    """
    p, q = _exact(a), _exact(b)
    corners = [_exact(c) for c in triangle]
    edges = [(corners[k], _minus(corners[(k + 1) % 3], corners[k])) for k in range(3)]
    n = _cross(edges[0][1], edges[1][1])
    if not any(n):
        # A triangle without area is its longest edge.
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


def distance2(a: FloatArray, b: FloatArray, triangle: FloatArray) -> Fraction:
    """Squared distance [m²] of the closed segment ab (3,) and the closed triangle (3, 3).

    Degenerate triangles and segments are allowed.
    """
    if meets(a, b, triangle):
        return ZERO
    p, q = _exact(a), _exact(b)
    corners = [_exact(c) for c in triangle]
    found = [_segments_distance2(p, q, corners[k], corners[(k + 1) % 3]) for k in range(3)]
    n = _cross(_minus(corners[1], corners[0]), _minus(corners[2], corners[0]))
    if any(n):
        # An end of the segment above the triangle's inside.
        for end in (p, q):
            inside = all(
                _dot(
                    _cross(n, _minus(corners[(k + 1) % 3], corners[k])), _minus(end, corners[k])
                ) >= 0
                for k in range(3)
            )  # fmt: skip
            if inside:
                found.append(_dot(n, _minus(end, corners[0])) ** 2 / _dot(n, n))
    return min(found)


def _segments_distance2(p: Vector, q: Vector, r: Vector, s: Vector) -> Fraction:
    """Squared distance of the segments pq and rs."""
    found = [
        _point_distance2(p, r, s), _point_distance2(q, r, s),
        _point_distance2(r, p, q), _point_distance2(s, p, q),
    ]  # fmt: skip
    u, v, w = _minus(q, p), _minus(s, r), _minus(r, p)
    n = _cross(u, v)
    nn = _dot(n, n)
    if nn != 0:
        along_u, along_v = _dot(_cross(w, v), n) / nn, _dot(_cross(w, u), n) / nn
        if 0 <= along_u <= 1 and 0 <= along_v <= 1:
            found.append(_dot(w, n) ** 2 / nn)
    return min(found)


def _point_distance2(p: Vector, r: Vector, s: Vector) -> Fraction:
    """Squared distance of p from the segment rs."""
    way, w = _minus(s, r), _minus(p, r)
    length2 = _dot(way, way)
    share = min(max(_dot(w, way) / length2, ZERO), ONE) if length2 else ZERO
    gap = w[0] - share * way[0], w[1] - share * way[1], w[2] - share * way[2]
    return _dot(gap, gap)
