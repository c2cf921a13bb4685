"""Whether a surface shows nothing but its front to whoever looks from outside."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components


def shows_fronts_only(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> bool:
    """Whether every piece of a surface is closed and wound outwards, so backs need no drawing.

    A cavity or a body that is inside out makes it False, and so does a surface whose corners are
    not shared between faces: what is not known to be needless is drawn.

    Args:
        vertices: (n, 3).
        faces: (m, 3) corners of triangles.
    """
    if len(faces) == 0:
        return False
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2).astype(np.int64)
    n = len(vertices)
    there, back = np.sort(ends @ [n, 1]), np.sort(ends @ [1, n])
    # Every edge is walked once each way.
    if (there != back).any() or (there[1:] == there[:-1]).any():
        return False
    links = coo_array((np.ones(len(ends), dtype=np.int8), ends.T), shape=(n, n))
    count, piece = connected_components(links, directed=False)
    a, b, c = (vertices - vertices.mean(axis=0))[faces.T]
    six_volumes = np.bincount(piece[faces[:, 0]], np.einsum("ij,ij->i", np.cross(a, b), c), count)
    # Corners that no face uses are pieces without volume.
    used = np.bincount(piece[faces[:, 0]], minlength=count) > 0
    return bool((six_volumes[used] > 0.0).all())
