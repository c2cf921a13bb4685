"""Registration of the skull: fiducials measured with noise, and the rigid fit to them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

import meshes

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Registration:
    """A rigid fit to corresponding points.

    Attributes:
        T: (4, 4) from the model's frame to the frame of the measurement.
        fre: fiducial registration error, root mean square distance at the fiducials [m].
    """

    T: FloatArray
    fre: float


def fit(model: ArrayLike, measured: ArrayLike) -> Registration:
    """The rotation and translation that bring points (n, 3) of the model onto the measured ones.

    Least squares in closed form (Kabsch, by SciPy), never a reflection.

    Raises:
        ValueError: fewer than three points, different numbers, not finite, or all on one line.
    """
    a, b = np.asarray(model, dtype=np.float64), np.asarray(measured, dtype=np.float64)
    if a.ndim != 2 or a.shape[1:] != (3,) or a.shape != b.shape or len(a) < 3:
        raise ValueError(f"a fit needs three or more pairs of points, got {a.shape} and {b.shape}")
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise ValueError("the points of a fit must be finite")
    a0, b0 = a.mean(axis=0), b.mean(axis=0)
    spread = np.linalg.svd(a - a0, compute_uv=False)
    if spread[1] <= 1e-9 * spread[0]:
        raise ValueError("the points of a fit lie on one line: any turn about it fits as well")
    rotation = Rotation.align_vectors(b - b0, a - a0)[0].as_matrix()
    T = np.eye(4)
    T[:3, :3] = rotation
    T[:3, 3] = b0 - rotation @ a0
    residual = a @ rotation.T + T[:3, 3] - b
    return Registration(T, float(np.sqrt((residual**2).sum(axis=1).mean())))


def measure(points: ArrayLike, localisation_error: float, rng: np.random.Generator) -> FloatArray:
    """Points (n, 3) as measured, each off by `localisation_error` [m] (root mean square, 3D)."""
    p = np.asarray(points, dtype=np.float64)
    return np.asarray(p + rng.normal(scale=localisation_error / np.sqrt(3.0), size=p.shape))


def target_error(registration: Registration, T_true: ArrayLike, targets: ArrayLike) -> float:
    """Target registration error: root mean square distance at targets (k, 3) of the model [m]."""
    points = np.asarray(targets)
    off = meshes.transformed(registration.T, points) - meshes.transformed(T_true, points)
    return float(np.sqrt((off**2).sum(axis=1).mean()))
