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
    tool, proxy = np.array(p_tool, dtype=np.float64), np.array(p_proxy, dtype=np.float64)
    return np.asarray(master_force(tool, proxy, float(gain), float(cap)))


@njit(cache=True)
def master_force(p_tool, p_proxy, gain, cap):  # type: ignore[no-untyped-def]
    """`force` as a kernel."""
    F = gain * (p_tool - p_proxy)
    size = np.sqrt(F[0] * F[0] + F[1] * F[1] + F[2] * F[2])
    return F * (cap / size) if size > cap else F
