"""The tip of the PSM from its Denavit-Hartenberg table, for whoever judges where it was."""

from __future__ import annotations

import numpy as np

_HALF = np.pi / 2
# α, a, θ offset, d, whether prismatic; modified (Craig).
_ROWS = (
    (_HALF, 0.0, _HALF, 0.0, False),
    (-_HALF, 0.0, -_HALF, 0.0, False),
    (_HALF, 0.0, 0.0, -0.4318, True),
    (0.0, 0.0, 0.0, 0.4162, False),
    (-_HALF, 0.0, -_HALF, 0.0, False),
    (-_HALF, 0.0091, -_HALF, 0.0, False),
)


def tips(q: np.ndarray) -> np.ndarray:
    """Positions (k, 3) of the tip at joints (k, 6), base frame [m]."""
    T = np.broadcast_to(np.eye(4), (len(q), 4, 4)).copy()
    for joint, (alpha, a, offset, shift, prismatic) in enumerate(_ROWS):
        theta = np.full(len(q), offset) if prismatic else q[:, joint] + offset
        d = q[:, joint] + shift if prismatic else np.full(len(q), shift)
        ca, sa, ct, st = np.cos(alpha), np.sin(alpha), np.cos(theta), np.sin(theta)
        A = np.zeros((len(q), 4, 4))
        A[:, 0] = np.stack([ct, -st, 0 * ct, 0 * ct + a], 1)
        A[:, 1] = np.stack([st * ca, ct * ca, 0 * ct - sa, -sa * d], 1)
        A[:, 2] = np.stack([st * sa, ct * sa, 0 * ct + ca, ca * d], 1)
        A[:, 3, 3] = 1.0
        T = T @ A
    return (T @ np.array([0.0, 0.0102, 0.0, 1.0]))[:, :3]
