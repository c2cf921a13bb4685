"""Whether only front faces of a surface are visible from outside."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components


def shows_fronts_only(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> bool:
    """Whether every component is closed and oriented outwards, so that back faces can be culled.

    False for a cavity, an inverted component, and a surface whose vertices are not shared between
    faces.

    Args:
        vertices: (n, 3).
        faces: (m, 3) corners of triangles.
    """
    if len(faces) == 0:
        return False
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2).astype(np.int64)
    n = len(vertices)
    there, back = np.sort(ends @ [n, 1]), np.sort(ends @ [1, n])
    # Closed and consistently oriented: every half-edge has exactly one opposite half-edge.
    if (there != back).any() or (there[1:] == there[:-1]).any():
        return False
    links = coo_array((np.ones(len(ends), dtype=np.int8), ends.T), shape=(n, n))
    count, piece = connected_components(links, directed=False)
    a, b, c = (vertices - vertices.mean(axis=0))[faces.T]
    six_volumes = np.bincount(piece[faces[:, 0]], np.einsum("ij,ij->i", np.cross(a, b), c), count)
    # Vertices that no face uses are components without volume.
    used = np.bincount(piece[faces[:, 0]], minlength=count) > 0
    return bool((six_volumes[used] > 0.0).all())
