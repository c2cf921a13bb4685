"""The map from the operator's handle to the proxy: scaled, clutched, as on the dVRK.

Translation is relative to the last clutch, p_proxy = scale (p_handle − p_handle,0) + p_proxy,0;
rotation is absolute after an alignment captured at the same moment, or locked to what it was then.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin


@dataclass(frozen=True)
class Teleop:
    """A latched handle-to-proxy map; poses in the arm's base frame.

    Attributes:
        scale: metres of proxy per metre of handle.
        T_base_handle0: the handle when latched.
        T_base_proxy0: the proxy when latched: where the tool was.
        locked: the proxy keeps its orientation, however the handle is turned.
    """

    scale: float
    T_base_handle0: pin.SE3
    T_base_proxy0: pin.SE3
    locked: bool = False

    def proxy(self, T_base_handle: pin.SE3) -> pin.SE3:
        """The proxy that belongs to a handle pose, both in the arm's base frame."""
        handle0, proxy0 = self.T_base_handle0, self.T_base_proxy0
        moved = T_base_handle.translation - handle0.translation
        p_proxy = proxy0.translation + self.scale * moved
        if self.locked:
            return pin.SE3(np.array(proxy0.rotation), p_proxy)
        alignment = handle0.rotation.T @ proxy0.rotation
        return pin.SE3(T_base_handle.rotation @ alignment, p_proxy)


def latch(
    scale: float, T_base_handle: pin.SE3, T_base_proxy: pin.SE3, locked: bool = False
) -> Teleop:
    """A map that takes this handle pose to this proxy pose; later motion counts from here."""
    return Teleop(scale, pin.SE3(T_base_handle), pin.SE3(T_base_proxy), locked)
