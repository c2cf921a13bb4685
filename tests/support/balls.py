"""Balls, and the shapes that they take."""

from __future__ import annotations

import numpy as np
import trimesh

import vf
from tests.support import naive


def ball(radius: float = 0.01, subdivisions: int = 2) -> vf.Surface:
    shape = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return vf.Surface.from_arrays(shape.vertices, shape.faces)


def bumped(rng: np.random.Generator, rest: np.ndarray, most: float) -> np.ndarray:
    """Vertices of a ball with a bump or dent, none displaced by more than `most` [m]."""
    along = rest @ naive.unit(rng) / np.linalg.norm(rest, axis=1)
    moved = rest * (rng.uniform(-0.3, 0.3) * along ** rng.integers(0, 4))[:, None]
    return moved * min(1.0, most / np.linalg.norm(moved, axis=1).max())
