"""What the attacks share: any triangles as a surface, and its judges in rational arithmetic.

Every triangle is looked at; floats only pass over those that are out of question by far more than
they can be wrong.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np

import vf
from app.studies.verification import exact


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
    rows = [t for t in np.flatnonzero(near) if exact.meets(a, b, triangles[t])]
    return np.array(rows, dtype=np.int64)


def leaking(
    triangles: np.ndarray, planes: vf.Planes, x: np.ndarray, tip_radius: float = 0.0
) -> np.ndarray:
    """Which of the triangles (m, 3, 3) break point 2 of the statement in docs/certified.md: exact.

    They have a point within planes.radius + tip radius of x that is strictly behind no plane moved
    back by the tip's radius.
    """
    x = np.asarray(x, dtype=np.float64)
    size = float(max(np.abs(triangles).max(), np.abs(x).max()))
    reach = planes.radius + tip_radius
    # A box farther away than the ball, or three corners well behind one plane.
    off = np.maximum(np.maximum(triangles.min(axis=1) - x, x - triangles.max(axis=1)), 0.0)
    open_ = np.linalg.norm(off, axis=1) <= reach * (1.0 + 1e-9) + 1e-12 * size
    rows = np.flatnonzero(open_)
    if len(planes):
        heights = triangles[rows] @ planes.normals.T - (planes.offsets - tip_radius)
        rows = rows[~(heights.max(axis=1) < -1e-12 * size).any(axis=1)]
    return np.array(
        [
            t
            for t in rows
            if exact.uncovered(
                triangles[t], planes.normals, planes.offsets, x, planes.radius, tip_radius
            )
            is not None
        ],
        dtype=np.int64,
    )


def obeys(planes: vf.Planes, x: np.ndarray, y: np.ndarray) -> bool:
    """Whether the claim speaks of the step from x to y, computed as a caller would."""
    return bool(np.linalg.norm(y - x) <= planes.radius and (planes.slack(y) >= 0.0).all())


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


def _minus(p: list[Fraction], q: list[Fraction]) -> list[Fraction]:
    return [s - t for s, t in zip(p, q, strict=True)]


def _dot(p: list[Fraction], q: list[Fraction]) -> Fraction:
    return sum((s * t for s, t in zip(p, q, strict=True)), Fraction(0))


def _cross(p: list[Fraction], q: list[Fraction]) -> list[Fraction]:
    return [p[k - 2] * q[k - 1] - p[k - 1] * q[k - 2] for k in range(3)]
