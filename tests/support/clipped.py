"""Distances to triangles and to their parts that no plane covers, in rational arithmetic.

By clipping of polygons, a method other than that of `tests.support.exact`.
"""

from __future__ import annotations

from fractions import Fraction

from app.judges.exact import ONE, ZERO, FloatArray, Vector, _cross, _dot, _exact, _minus


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


def _along(p: Vector, e: Vector, t: Fraction) -> Vector:
    return p[0] + t * e[0], p[1] + t * e[1], p[2] + t * e[2]
