"""Margin maps: how far the anatomy may be from where a registration puts it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshes.errors import MeshError

FloatArray = NDArray[np.float64]

_COLLINEAR = 1e-3  # r.m.s. distance from their line, as a share of that across it


@dataclass(frozen=True)
class MarginMap:
    """The margins that a registration by fiducials needs, as a function of the place.

    Made by `margin_map`. The square of the target registration error is a quadratic form about the
    fiducials' centroid, so a map is small, and cheap to evaluate.

    Attributes:
        centre: (3,) the fiducials' centroid [m].
        axes: (3, 3) their principal axes as columns, each by how fast the squared error grows along
            it over its value at the centroid [1/m].
        least: the margin at the centroid [m].
    """

    centre: FloatArray
    axes: FloatArray
    least: float

    def at(self, points: ArrayLike) -> FloatArray:
        """Margins (n,) [m] at points (n, 3) [m] of the fiducials' frame."""
        away = (np.asarray(points, dtype=np.float64) - self.centre) @ self.axes
        return np.asarray(self.least * np.sqrt(1.0 + np.einsum("ij,ij->i", away, away)))

    def moved(self, T: FloatArray) -> MarginMap:
        """The same map in another frame, by a rigid transform (4, 4)."""
        R = T[:3, :3]
        return MarginMap(R @ self.centre + T[:3, 3], R @ self.axes, self.least)


def margins(
    vertices: ArrayLike, fiducials: ArrayLike, fle: float, factor: float = 2.0
) -> FloatArray:
    """A margin [m] for each vertex: ``factor`` times the target registration error there.

    The error of a rigid registration by N fiducials at a point is, as an r.m.s. length,

        TRE² ≈ FLE²/N (1 + ⅓ Σ d_k²/f_k²),  k = 1, 2, 3

    where d_k is the distance of the point from the fiducials' principal axis k, and f_k the r.m.s.
    distance of the fiducials from it (Fitzpatrick, West and Maurer, Predicting error in rigid-body
    point-based registration, IEEE Transactions on Medical Imaging 17, 1998). It is the first order
    in FLE, for errors alike in all directions and at all fiducials. A single registration may be
    off by more than its r.m.s. value; twice that is usual for a margin.

    Args:
        vertices: ``(n, 3)`` [m], in the frame of the fiducials.
        fiducials: ``(N, 3)`` [m], three or more that do not lie on one line.
        fle: fiducial localisation error [m]: the r.m.s. *length* of the error vector of one
            fiducial, √3 times the standard deviation of each coordinate.
        factor: without unit, positive.

    Returns:
        ``(n,)`` [m].

    Raises:
        meshes.MeshError: fewer than three fiducials, on one line, or values that are not finite.
    """
    return margin_map(fiducials, fle, factor).at(_points("vertices", vertices))


def margin_map(fiducials: ArrayLike, fle: float, factor: float = 2.0) -> MarginMap:
    """The map of `margins`, with its arguments.

    Raises:
        meshes.MeshError: as `margins`.
    """
    p = _points("fiducials", fiducials)
    if not (np.isfinite(fle) and fle > 0.0):
        raise MeshError(f"the fiducial localisation error must be a length above 0, not {fle}")
    if not (np.isfinite(factor) and factor > 0.0):
        raise MeshError(f"factor must be above 0, not {factor}")
    if len(p) < 3:
        raise MeshError(f"a registration needs three fiducials or more, not {len(p)}")
    centre = p.mean(axis=0)
    axes = np.linalg.svd(p - centre)[2]  # rows, the longest first
    along = ((p - centre) @ axes.T) ** 2
    f_squared = (along.sum(axis=1, keepdims=True) - along).mean(axis=0)  # (3,), rising
    if not f_squared[0] > _COLLINEAR**2 * f_squared[2]:
        raise MeshError(
            f"the {len(p)} fiducials lie on one line: the turn about it stays unknown; one more is "
            "needed beside it"
        )
    # A step along an axis is one away from the two others: Σ d_k²/f_k² = Σ_j y_j² Σ_{k≠j} 1/f_k².
    growth = ((1.0 / f_squared).sum() - 1.0 / f_squared) / 3.0
    return MarginMap(centre, axes.T * np.sqrt(growth), factor * fle / np.sqrt(len(p)))


def _points(name: str, points: ArrayLike) -> FloatArray:
    found = np.asarray(points, dtype=np.float64)
    if found.ndim != 2 or found.shape[1] != 3:
        raise MeshError(f"{name} must be of shape (n, 3), not {found.shape}")
    if not np.isfinite(found).all():
        raise MeshError(f"{name} must be finite")
    return found
