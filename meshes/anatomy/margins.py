"""Margin maps: how far the anatomy may be from where a registration puts it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshes.errors import MeshError

_COLLINEAR = 1e-3  # r.m.s. distance from their line, as a share of that across it


def margins(
    vertices: ArrayLike, fiducials: ArrayLike, fle: float, factor: float = 2.0
) -> NDArray[np.float64]:
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
    v, p = np.asarray(vertices, dtype=np.float64), np.asarray(fiducials, dtype=np.float64)
    for name, points in (("vertices", v), ("fiducials", p)):
        if points.ndim != 2 or points.shape[1] != 3:
            raise MeshError(f"{name} must be of shape (n, 3), not {points.shape}")
        if not np.isfinite(points).all():
            raise MeshError(f"{name} must be finite")
    if not (np.isfinite(fle) and fle > 0.0):
        raise MeshError(f"the fiducial localisation error must be a length above 0, not {fle}")
    if not (np.isfinite(factor) and factor > 0.0):
        raise MeshError(f"factor must be above 0, not {factor}")
    if len(p) < 3:
        raise MeshError(f"a registration needs three fiducials or more, not {len(p)}")
    centre = p.mean(axis=0)
    axes = np.linalg.svd(p - centre)[2]  # rows, the longest first

    def squared(points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Squared distances ``(n, 3)`` from the three axes."""
        along = (points - centre) @ axes.T
        return np.sum(along**2, axis=1, keepdims=True) - along**2

    f_squared = squared(p).mean(axis=0)  # (3,), the least is that from the longest axis
    if not f_squared[0] > _COLLINEAR**2 * f_squared[2]:
        raise MeshError(
            f"the {len(p)} fiducials lie on one line: the turn about it stays unknown; one more is "
            "needed beside it"
        )
    tre_squared = fle**2 / len(p) * (1.0 + (squared(v) / f_squared).sum(axis=1) / 3.0)
    return factor * np.sqrt(tre_squared)
