"""Conversion between metres and scene units: poses, directions, quaternions."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

VIEW_SCALE = 100.0
"""Scene units per metre. One unit is a centimetre: viser's clipping planes, zoom limits and
keyboard speed suit objects of a few units, and the anatomy measures centimetres."""


def to_view(p_base: ArrayLike) -> FloatArray:
    """Points or lengths of any shape, from metres to scene units."""
    return np.asarray(p_base, dtype=np.float64) * VIEW_SCALE


def to_buffer(p_base: ArrayLike) -> NDArray[np.float32]:
    """Points from metres to scene units, in single precision."""
    return to_view(p_base).astype(np.float32)


def pose_to_view(T_base_pose: pin.SE3) -> tuple[FloatArray, FloatArray]:
    """A pose [m] as viser writes it: unit quaternion wxyz (4,), position (3,) in scene units."""
    xyzw = pin.Quaternion(T_base_pose.rotation).coeffs()
    return np.array([xyzw[3], xyzw[0], xyzw[1], xyzw[2]]), to_view(T_base_pose.translation)


def pose_from_view(wxyz: ArrayLike, position: ArrayLike) -> pin.SE3:
    """The pose [m] of a node from a client's message.

    Raises:
        ValueError: wrong shape, not finite, or a quaternion far from unit length.
    """
    q, p = np.asarray(wxyz, dtype=np.float64), np.asarray(position, dtype=np.float64)
    if q.shape != (4,) or p.shape != (3,) or not (np.isfinite(q).all() and np.isfinite(p).all()):
        raise ValueError("the proxy's pose is not made of 4 + 3 finite numbers")
    length = float(np.linalg.norm(q))
    if not 0.5 < length < 2.0:
        raise ValueError(f"the proxy's quaternion has length {length:.3g} instead of 1")
    w, x, y, z = q / length
    return pin.SE3(pin.Quaternion(w, x, y, z).matrix(), p / VIEW_SCALE)


def same_pose(a: pin.SE3, b: pin.SE3) -> bool:
    """Whether two poses differ by less than the rounding of a browser (1 µm, 1e-5)."""
    moved = np.abs(a.translation - b.translation).max()
    turned = np.abs(a.rotation - b.rotation).max()
    return bool(moved < 1e-6 and turned < 1e-5)


def turn_z_to(normals: FloatArray) -> FloatArray:
    """Quaternions wxyz (m, 4) of the shortest rotations from +z to each unit normal (m, 3)."""
    x, y, z = normals.T
    q = np.stack([1.0 + z, -y, x, np.zeros_like(z)], axis=1)
    # For a normal of -z the shortest rotation is not unique: half a turn about x.
    q[z < -1.0 + 1e-9] = (0.0, 1.0, 0.0, 0.0)
    return q / np.linalg.norm(q, axis=1, keepdims=True)
