"""The force a surgeon would feel at the master."""

from __future__ import annotations

import numpy as np

from vf.kernels import njit
from vf.planes import FloatArray


@njit(cache=True)
def force(p_tool: FloatArray, p_proxy: FloatArray, gain: float, cap: float) -> FloatArray:
    """F = K (p_tool − p_proxy) [N], shortened to at most `cap` [N].

    Args:
        p_tool, p_proxy: (3,) constrained tool tip and proxy, base frame [m].
        gain: K [N/m].
        cap: what the master can give in its weakest direction [N].
    """
    F = gain * (p_tool - p_proxy)
    size = np.sqrt(F[0] * F[0] + F[1] * F[1] + F[2] * F[2])
    return F * (cap / size) if size > cap else F
