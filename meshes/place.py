"""Where a mesh goes in the arm's workspace, and the lighter copy of it that the page draws."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshes.errors import MeshError
from meshes.thin import thin


class Pose(Protocol):
    """A rigid transform that knows its 4 × 4 matrix, such as ``pinocchio.SE3``."""

    @property
    def homogeneous(self) -> NDArray[np.float64]: ...


class Display(NamedTuple):
    """What the page draws: vertices ``(n, 3)`` [m], faces ``(m, 3)``, whether it is lighter."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    decimated: bool


def placement(
    vertices: ArrayLike, T_base_tip_neutral: Pose | ArrayLike, gap: float = 0.015
) -> NDArray[np.float64]:
    """The translation ``(3,)`` [m] from a mesh's own axes to the arm's base frame.

    It brings the middle of the top face of the bounding box ``gap`` [m] below (−z of the base
    frame) the arm's tip in its neutral pose, given as a pose or a 4 × 4 matrix. Apply it also to
    what belongs to the mesh, such as :func:`meshes.planned_cut`.
    """
    points = np.asarray(vertices, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0:
        raise MeshError(f"cannot place vertices of shape {points.shape}: give (n, 3), n > 0")
    T = np.asarray(getattr(T_base_tip_neutral, "homogeneous", T_base_tip_neutral), dtype=np.float64)
    if T.shape != (4, 4) or not np.isfinite(T).all():
        raise ValueError(f"T_base_tip_neutral must be a pose or a finite 4 x 4 matrix, not {T}")
    low, high = points.min(axis=0), points.max(axis=0)
    top = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, high[2]])
    return T[:3, 3] - np.array([0.0, 0.0, gap]) - top


def place(
    vertices: ArrayLike, T_base_tip_neutral: Pose | ArrayLike, gap: float = 0.015
) -> NDArray[np.float64]:
    """The vertices ``(n, 3)`` [m] moved under the arm's tip, in its base frame: a new array.

    A pure translation, see :func:`placement`. Apply it once, before the ``Surface`` is built.
    """
    points = np.asarray(vertices, dtype=np.float64)
    return points + placement(points, T_base_tip_neutral, gap)


def display(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], limit: int = 100_000
) -> Display:
    """A copy to draw, of at most ``limit`` triangles; the arrays themselves if they are few enough.

    Control always queries the full mesh. Quadric decimation keeps the shape within a fraction of
    an edge; degenerate leftovers do not matter to a drawing. A mesh that will not shrink (open
    edges everywhere) is thinned by dropping triangles evenly, so that the limit always holds.
    """
    if limit < 4:
        raise ValueError(f"limit must be at least 4 triangles, not {limit}")
    if len(faces) <= limit:
        return Display(vertices, faces, False)
    thinned = thin(vertices, faces, limit)
    if thinned is None or not 0 < len(thinned[1]) <= limit:
        keep = np.linspace(0, len(faces) - 1, limit).astype(np.int64)
        return Display(vertices, faces[keep], True)
    return Display(*thinned, True)
