"""What the attacks share: any triangles as a surface, and its judges in rational arithmetic.

Every triangle is looked at; floats only pass over those that are out of question by far more than
they can be wrong.
"""

from __future__ import annotations

from fractions import Fraction
from itertools import combinations, pairwise

import numpy as np

import vf
from tests.support.naive import exact_closest, fraction

Point = list[Fraction]


def soup(triangles: np.ndarray) -> vf.Surface:
    """Surface of triangles (m, 3, 3) that share no corners."""
    corners = np.asarray(triangles, dtype=np.float64).reshape(-1, 3)
    return vf.Surface.from_arrays(corners, np.arange(len(corners)).reshape(-1, 3))


def triangles_of(surface: vf.Surface) -> np.ndarray:
    """The triangles (m, 3, 3) of a surface."""
    return surface.vertices[surface.faces]


def crossed(triangles: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Which of the triangles (m, 3, 3) the closed segment ab touches or crosses: exact."""
    low, high = np.minimum(a, b), np.maximum(a, b)
    near = ((triangles.min(axis=1) <= high) & (triangles.max(axis=1) >= low)).all(axis=1)
    rows = [t for t in np.flatnonzero(near) if meets(a, b, triangles[t])]
    return np.array(rows, dtype=np.int64)


def leaking(
    triangles: np.ndarray, planes: vf.Planes, x: np.ndarray, tip_radius: float = 0.0
) -> np.ndarray:
    """Which of the triangles (m, 3, 3) break point 2 of the statement in docs/certified.md: exact.

    They have a point within planes.radius + tip radius of x (3,), or of an axis x (2, 3), that is
    strictly behind no plane moved back by the tip's radius.
    """
    x = np.asarray(x, dtype=np.float64)
    size = float(max(np.abs(triangles).max(), np.abs(x).max()))
    reach = planes.radius + tip_radius
    # A box farther away than the ball, or three corners well behind one plane.
    low, high = np.atleast_2d(x).min(axis=0), np.atleast_2d(x).max(axis=0)
    off = np.maximum(np.maximum(triangles.min(axis=1) - high, low - triangles.max(axis=1)), 0.0)
    open_ = np.linalg.norm(off, axis=1) <= reach * (1.0 + 1e-9) + 1e-12 * size
    rows = np.flatnonzero(open_)
    if len(planes):
        heights = triangles[rows] @ planes.normals.T - (planes.offsets - tip_radius)
        rows = rows[~(heights.max(axis=1) < -1e-12 * size).any(axis=1)]
    return np.array(
        [t for t in rows if uncovered(triangles[t], planes, x, tip_radius)],
        dtype=np.int64,
    )


def obeys(planes: vf.Planes, x: np.ndarray, y: np.ndarray) -> bool:
    """Whether the claim speaks of the step from x to y, computed as a caller would."""
    return bool(np.linalg.norm(y - x) <= planes.radius and (planes.slack(y) >= 0.0).all())


# In rational arithmetic


def meets(a: np.ndarray, b: np.ndarray, triangle: np.ndarray) -> bool:
    """Whether the closed segment ab (3,) and the closed triangle (3, 3) share a point, any kind.

    By signs of volumes; where the segment lies in the triangle's plane, by signs of areas.
    """
    p, q = _exact(a), _exact(b)
    corners = [_exact(corner) for corner in triangle]
    n = _cross(_minus(corners[1], corners[0]), _minus(corners[2], corners[0]))
    if not any(n):
        # The three edges together are the triangle.
        return any(_segments_meet(p, q, r, s) for r, s in combinations(corners, 2))
    above, below = (_dot(n, _minus(end, corners[0])) for end in (p, q))
    if above * below > 0:
        return False
    edges = [(corners[k], corners[(k + 1) % 3]) for k in range(3)]
    if above != below:
        d = _minus(q, p)
        sides = [_dot(d, _cross(_minus(r, p), _minus(s, p))) for r, s in edges]
        return min(sides) >= 0 or max(sides) <= 0
    if any(_segments_meet(p, q, r, s) for r, s in edges):
        return True
    # Apart from the outline, the segment is in the triangle's inside with both ends or not at all.
    turns = [_dot(n, _cross(_minus(s, r), _minus(p, r))) for r, s in edges]
    return min(turns) >= 0


def uncovered(
    triangle: np.ndarray, planes: vf.Planes, x: np.ndarray, tip_radius: float = 0.0
) -> bool:
    """Whether a point of a triangle (3, 3) breaks point 2 of the statement: see `leaking`."""
    rho = fraction(tip_radius)
    part = [_exact(corner) for corner in triangle]
    for normal, offset in zip(planes.normals, planes.offsets, strict=True):
        n, limit = _exact(normal), fraction(offset) - rho
        heights = [_dot(n, p) - limit for p in part]
        kept: list[Point] = []
        for (p, g), (q, h) in pairwise([*zip(part, heights, strict=True), (part[0], heights[0])]):
            if g >= 0:
                kept.append(p)
            if min(g, h) < 0 < max(g, h):
                kept.append([(h * i - g * j) / (h - g) for i, j in zip(p, q, strict=True)])
        if not kept:
            return False
        part = kept
    # The polygon as a fan of triangles; a point and a segment as triangles without area.
    part += part[-1:] * (3 - len(part))
    fan = [[part[0], p, q] for p, q in pairwise(part[1:])]
    reach = fraction(planes.radius) + rho
    if np.ndim(x) == 2:
        return min(_axis_distance2(_exact(x[0]), _exact(x[1]), one) for one in fan) <= reach * reach
    return min(exact_closest(one, _exact(x))[1] for one in fan) <= reach * reach


def axis_distance2(a: np.ndarray, b: np.ndarray, triangle: np.ndarray) -> Fraction:
    """Squared distance of the closed segment ab (3,) and the closed triangle (3, 3), any kind."""
    return _axis_distance2(_exact(a), _exact(b), [_exact(corner) for corner in triangle])


def _axis_distance2(p: Point, q: Point, corners: list[Point]) -> Fraction:
    """The least of the ends' distances, those of the edges, and 0 where they meet."""
    n = _cross(_minus(corners[1], corners[0]), _minus(corners[2], corners[0]))
    above, below = (_dot(n, _minus(end, corners[0])) for end in (p, q))
    found = [exact_closest(corners, p)[1], exact_closest(corners, q)[1]]
    if above * below < 0:
        share = above / (above - below)
        on_plane = [i + share * (j - i) for i, j in zip(p, q, strict=True)]
        found.append(exact_closest(corners, on_plane)[1])
    for r, s in combinations(corners, 2):
        # Ends of the one and insides of the other, both ways round, and the two insides.
        flat = [[r, s, s], [p, q, q]]
        found += [exact_closest(flat[0], end)[1] for end in (p, q)]
        found += [exact_closest(flat[1], end)[1] for end in (r, s)]
        u, v, w = _minus(q, p), _minus(s, r), _minus(r, p)
        m = _cross(u, v)
        size = _dot(m, m)
        if size:
            one, other = _dot(_cross(w, v), m) / size, _dot(_cross(w, u), m) / size
            if 0 <= one <= 1 and 0 <= other <= 1:
                found.append(_dot(w, m) ** 2 / size)
    return min(found)


def passages(
    triangles: np.ndarray, a: np.ndarray, b: np.ndarray
) -> list[tuple[int, Fraction, int]]:
    """Where the closed segment ab meets each triangle (m, 3, 3): row, place from 0 to 1, direction.

    The direction is 1 along the triangle's normal, −1 against it, and 0 where the segment runs in
    the triangle's plane (the place is then 0).
    """
    found = []
    for row in crossed(triangles, a, b):
        corner, second, third, p, q = (
            [Fraction(float(v)) for v in point] for point in (*triangles[row], a, b)
        )
        n = _cross(_minus(second, corner), _minus(third, corner))
        start, end = _dot(n, _minus(p, corner)), _dot(n, _minus(q, corner))
        if start == end:
            found.append((int(row), Fraction(0), 0))
        else:
            found.append((int(row), start / (start - end), 1 if start < end else -1))
    return found


def winding(triangles: np.ndarray, p: np.ndarray) -> int | None:
    """Winding number of closed triangles (m, 3, 3) around p; None: p is on one of them."""
    rng = np.random.default_rng(0)
    size = 4.0 * float(np.abs(triangles).max()) + float(np.abs(p).max())
    while True:
        direction = rng.normal(size=3)
        met = passages(triangles, p, p + size * direction / np.linalg.norm(direction))
        places = [place for _, place, _ in met]
        if Fraction(0) in places:
            return None
        if len(set(places)) == len(places):  # through no edge
            return sum(sign for _, _, sign in met)


def inner_side(triangle: np.ndarray, x: np.ndarray) -> int:
    """1 where x is strictly behind the plane of a triangle, −1 in front of it, 0 on it."""
    a, b, c, p = ([Fraction(float(v)) for v in point] for point in (*triangle, x))
    height = _dot(_cross(_minus(b, a), _minus(c, a)), _minus(p, a))
    return (height < 0) - (height > 0)


def _segments_meet(p: Point, q: Point, r: Point, s: Point) -> bool:
    """Whether the closed segments pq and rs share a point."""
    u, v, w = _minus(q, p), _minus(s, r), _minus(r, p)
    if _dot(w, _cross(u, v)) != 0:
        return False  # the four ends are not in one plane
    normals = (_cross(u, v), _cross(u, w), _cross(v, w))
    n = next((n for n in normals if any(n)), None)
    if n is None:
        # On one line, or points: intervals along every axis.
        return all(
            max(min(p[k], q[k]), min(r[k], s[k])) <= min(max(p[k], q[k]), max(r[k], s[k]))
            for k in range(3)
        )

    def turn(i: Point, j: Point, k: Point) -> Fraction:
        return _dot(n, _cross(_minus(j, i), _minus(k, i)))

    def between(i: Point, j: Point, k: Point) -> bool:
        return turn(i, j, k) == 0 and all(
            min(g, h) <= e <= max(g, h) for g, h, e in zip(i, j, k, strict=True)
        )

    if turn(p, q, r) * turn(p, q, s) < 0 and turn(r, s, p) * turn(r, s, q) < 0:
        return True
    return between(p, q, r) or between(p, q, s) or between(r, s, p) or between(r, s, q)


def _exact(p: np.ndarray) -> Point:
    return [fraction(v) for v in p]


def _minus(p: Point, q: Point) -> Point:
    return [i - j for i, j in zip(p, q, strict=True)]


def _dot(p: Point, q: Point) -> Fraction:
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]


def _cross(p: Point, q: Point) -> Point:
    return [
        p[1] * q[2] - p[2] * q[1],
        p[2] * q[0] - p[0] * q[2],
        p[0] * q[1] - p[1] * q[0],
    ]
