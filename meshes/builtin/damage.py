"""Typical defects of real meshes, generated for tests and demonstrations.

Every kind takes and returns vertices (n, 3) [m] and faces (m, 3), is deterministic for a seed, and
does not change its input.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from meshes.content import Arrays

SHARE = 0.05  # of the faces, for kinds that change some of them


def kinds() -> tuple[str, ...]:
    """Names of all kinds of damage."""
    return tuple(_KINDS)


def damage(kind: str, arrays: Arrays, seed: int = 0) -> Arrays:
    """The mesh with one kind of damage.

    Raises:
        ValueError: unknown kind; lists the valid ones.
    """
    if kind not in _KINDS:
        raise ValueError(f"unknown damage {kind!r}: choose one of {', '.join(_KINDS)}")
    vertices, faces = arrays
    v = np.array(vertices, dtype=np.float64)
    f = np.array(faces, dtype=np.int64)
    return _KINDS[kind](v, f, np.random.default_rng(seed))


Vertices = NDArray[np.float64]
Faces = NDArray[np.int64]


def _sample(faces: Faces, rng: np.random.Generator) -> NDArray[np.int64]:
    count = max(1, round(SHARE * len(faces)))
    return rng.choice(len(faces), size=count, replace=False)


def _none(v: Vertices, f: Faces, rng: np.random.Generator) -> Arrays:
    return v, f


def _unwelded(v: Vertices, f: Faces, rng: np.random.Generator) -> Arrays:
    return v[f].reshape(-1, 3), np.arange(3 * len(f), dtype=np.int64).reshape(-1, 3)


def _flipped(v: Vertices, f: Faces, rng: np.random.Generator) -> Arrays:
    rows = _sample(f, rng)
    f[rows] = f[rows][:, ::-1]
    return v, f


def _inside_out(v: Vertices, f: Faces, rng: np.random.Generator) -> Arrays:
    return v, np.ascontiguousarray(f[:, ::-1])


def _holes(v: Vertices, f: Faces, rng: np.random.Generator) -> Arrays:
    return v, np.delete(f, _sample(f, rng), axis=0)


def _duplicated(v: Vertices, f: Faces, rng: np.random.Generator) -> Arrays:
    extra = f[_sample(f, rng)]
    turned = rng.random(len(extra)) < 0.5
    extra[turned] = extra[turned][:, ::-1]
    return v, np.concatenate([f, extra])


def _jittered(v: Vertices, f: Faces, rng: np.random.Generator) -> Arrays:
    size = np.linalg.norm(np.ptp(v, axis=0))
    soup, faces = _unwelded(v, f, rng)
    return soup + rng.uniform(-1e-5, 1e-5, soup.shape) * size, faces


def _slivers(v: Vertices, f: Faces, rng: np.random.Generator) -> Arrays:
    """Needles, caps and faces without area along the edges of some faces."""
    rows = f[_sample(f, rng)]
    a, b = v[rows[:, 0]], v[rows[:, 1]]
    share = rng.uniform(0.0, 1.0, (len(rows), 1))
    middle = a + share * (b - a)
    middle[::2] += rng.normal(size=(len(middle[::2]), 3)) * 1e-9
    first = len(v) + np.arange(len(rows))
    extra = np.column_stack([rows[:, 0], rows[:, 1], first])
    extra[::5, 2] = extra[::5, 0]  # two corners in one
    return np.concatenate([v, middle]), np.concatenate([f, extra])


def _fin(v: Vertices, f: Faces, rng: np.random.Generator) -> Arrays:
    """A sheet without thickness standing on the mesh, across three of its vertices."""
    size = np.linalg.norm(np.ptp(v, axis=0))
    row = f[rng.integers(len(f))]
    a, b = v[row[0]], v[row[1]]
    normal = np.cross(b - a, v[row[2]] - a)
    up = normal / max(float(np.linalg.norm(normal)), 1e-30) * 0.05 * size
    along = (b - a) / max(float(np.linalg.norm(b - a)), 1e-30) * 0.05 * size
    corners = np.array([a - along - up, a + along - up, a + along + up, a - along + up])
    n = len(v)
    return np.concatenate([v, corners]), np.concatenate([f, [[n, n + 1, n + 2], [n, n + 2, n + 3]]])


def _interpenetrating(v: Vertices, f: Faces, rng: np.random.Generator) -> Arrays:
    """A second copy, turned and shifted by a third, through the first."""
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    K = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    R = np.eye(3) + np.sin(1.0) * K + (1.0 - np.cos(1.0)) * K @ K
    centre = 0.5 * (v.min(axis=0) + v.max(axis=0))
    other = (v - centre) @ R.T + centre + np.ptp(v, axis=0) / 3.0
    return np.concatenate([v, other]), np.concatenate([f, f + len(v)])


def _sheet(v: Vertices, f: Faces, rng: np.random.Generator) -> Arrays:
    """Only the upper part: an open sheet."""
    height = v[f].mean(axis=1)[:, 2]
    return v, f[height >= np.median(height)]


_KINDS: dict[str, Callable[[Vertices, Faces, np.random.Generator], Arrays]] = {
    "none": _none,
    "unwelded": _unwelded,
    "flipped": _flipped,
    "inside-out": _inside_out,
    "holes": _holes,
    "duplicated": _duplicated,
    "jittered": _jittered,
    "slivers": _slivers,
    "fin": _fin,
    "interpenetrating": _interpenetrating,
    "sheet": _sheet,
}
