"""A simulated arm with ideal tracking."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class SimulatedArm:
    """An `Arm` without inertia or delay: the measured joints are the last set-point, bitwise."""

    def __init__(self, q: NDArray[np.float64]) -> None:
        """Stand at the joints q (n,) [rad or m]."""
        self._q = q

    def measured(self) -> NDArray[np.float64]:
        """The last set-point (n,)."""
        return self._q

    def servo(self, q: NDArray[np.float64]) -> None:
        """Set the joints q (n,) at once."""
        self._q = q
