"""Round tubes with closed ends along a smooth path: vessels, nerves, canals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold, Mesh64
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from meshes.content import Arrays

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Tube:
    """A closed tube.

    Attributes:
        vertices: ``(n, 3)``, in the unit of its path.
        faces: ``(m, 3)``, the corners anticlockwise seen from outside.
        centres: ``(n, 3)`` the point of the path that a vertex belongs to.
        share: ``(n,)`` where that is along the path, 0 to 1.
    """

    vertices: FloatArray
    faces: NDArray[np.int64]
    centres: FloatArray
    share: FloatArray


def tube(path: ArrayLike, radius: float, sides: int = 24) -> Tube:
    """A tube about a smooth curve through points ``(k, 3)``, with half balls at its ends.

    Its triangles are about as long as wide. The curve must not bend more tightly than ``radius``.
    """
    knots = np.asarray(path, dtype=np.float64)
    places = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(knots, axis=0), axis=1))])
    curve = CubicSpline(places, knots)
    count = max(2, round(places[-1] / (2.0 * np.pi * radius / sides))) + 1
    at = np.linspace(0.0, places[-1], count)
    points, tangents = curve(at), curve(at, 1)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    caps = max(2, sides // 4)
    bend = np.linspace(0.0, np.pi / 2, caps + 1)[1:-1]
    # Rings: of the half ball before the path, of the path, of the half ball after it.
    which = np.concatenate(
        [np.zeros(caps - 1, int), np.arange(count), np.full(caps - 1, count - 1)]
    )
    shift = radius * np.concatenate([-np.sin(bend[::-1]), np.zeros(count), np.sin(bend)])
    sizes = radius * np.concatenate([np.cos(bend[::-1]), np.ones(count), np.cos(bend)])
    across, up = _frames(tangents)
    angles = 2.0 * np.pi * np.arange(sides) / sides
    ring = (
        np.cos(angles)[:, None] * across[which][:, None]
        + np.sin(angles)[:, None] * up[which][:, None]
    )
    middles = points[which] + shift[:, None] * tangents[which]
    body = middles[:, None] + sizes[:, None, None] * ring
    ends = np.stack([points[0] - radius * tangents[0], points[-1] + radius * tangents[-1]])
    vertices = np.concatenate([body.reshape(-1, 3), ends])
    owner = np.concatenate([np.repeat(which, sides), [0, count - 1]])
    return Tube(vertices, _faces(len(which), sides), points[owner], owner / (count - 1))


def _frames(tangents: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two unit vectors across each tangent, without twist from one to the next."""
    across = np.empty_like(tangents)
    first = np.eye(3)[np.abs(tangents[0]).argmin()]
    for k, tangent in enumerate(tangents):
        first = first - tangent * (first @ tangent)
        first = first / np.linalg.norm(first)
        across[k] = first
    return across, np.cross(tangents, across)


def _faces(rings: int, sides: int) -> NDArray[np.int64]:
    """Faces of rings of vertices one after the other, and of the two ends, the last vertices."""
    here, beside = np.arange(sides), (np.arange(sides) + 1) % sides
    low = sides * np.arange(rings - 1)[:, None]
    a, b = low + here, low + beside
    first, last = rings * sides, rings * sides + 1
    top = (rings - 1) * sides
    return np.concatenate(
        [
            np.stack([a, b, b + sides], axis=2).reshape(-1, 3),
            np.stack([a, b + sides, a + sides], axis=2).reshape(-1, 3),
            np.column_stack([np.full(sides, first), beside, here]),
            np.column_stack([np.full(sides, last), top + here, top + beside]),
        ]
    ).astype(np.int64)


def as_solid(arrays: Tube | Arrays) -> Manifold:
    """A closed mesh as a solid for Boolean operations."""
    vertices, faces = (arrays.vertices, arrays.faces) if isinstance(arrays, Tube) else arrays
    return Manifold(
        Mesh64(np.ascontiguousarray(vertices), np.ascontiguousarray(faces, dtype=np.uint64))
    )


def united(parts: Sequence[Manifold]) -> Manifold:
    """The union of solids, without the slivers along their seams."""
    whole = parts[0]
    for part in parts[1:]:
        whole = whole + part
    return whole.simplify(0.01)
