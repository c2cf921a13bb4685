"""What the attacks share: any triangles as a surface, and its judges in rational arithmetic.

Every triangle is looked at; floats only pass over those that are out of question by far more than
they can be wrong.
"""

from __future__ import annotations

import numpy as np

import vf
from app.verification import exact


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
