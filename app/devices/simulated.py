"""The simulated arm, which is where it was sent."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class SimulatedArm:
    """An `Arm` without inertia or delay: the joints are the last set-point, to the bit."""

    def __init__(self, q: NDArray[np.float64]) -> None:
        """Stand at the joints q (n,) [rad or m]."""
        self._q = q

    def measured(self) -> NDArray[np.float64]:
        """The last set-point (n,)."""
        return self._q

    def servo(self, q: NDArray[np.float64]) -> None:
        """Be at q (n,) at once."""
        self._q = q
