"""The force a surgeon would feel at the master."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from vf.kernels import njit
from vf.planes import FloatArray


def force(p_tool: ArrayLike, p_proxy: ArrayLike, gain: float, cap: float) -> FloatArray:
    """F = K (p_tool − p_proxy) [N], shortened to at most `cap` [N].

    Args:
        p_tool, p_proxy: (3,) constrained tool tip and proxy, base frame [m].
        gain: K [N/m].
        cap: what the master can give in its weakest direction [N].
    """
    F = np.empty(3)
    tool, proxy = np.array(p_tool, dtype=np.float64), np.array(p_proxy, dtype=np.float64)
    master_force(tool, proxy, float(gain), float(cap), F)
    return F


@njit(cache=True)
def master_force(p_tool, p_proxy, gain, cap, F):  # type: ignore[no-untyped-def]
    """`force` as a kernel: F (≥ 3,) is written."""
    square = 0.0
    for k in range(3):
        F[k] = gain * (p_tool[k] - p_proxy[k])
        square += F[k] * F[k]
    size = np.sqrt(square)
    if size > cap:
        for k in range(3):
            F[k] *= cap / size
