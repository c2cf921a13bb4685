"""Protocols of a master and an arm. A device is a class that implements one; it need not inherit.

Poses are in the arm's base frame, lengths in metres, angles in radians, forces in newtons. No
method blocks: a driver of real hardware communicates on its own thread, and validates its input
there (finite, orthonormal, in range, in order, not too old).
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class Master(Protocol):
    """An input device held by the operator, with force feedback."""

    @property
    def handle(self) -> pin.SE3:
        """The newest valid pose of the handle."""
        ...

    @property
    def clutched(self) -> bool:
        """Whether the clutch is pressed: the handle moves alone, the tool holds."""
        ...

    @property
    def held(self) -> bool:
        """Whether the operator is moving it; then commands must keep coming, or the tool holds."""
        ...

    def feel(self, force: FloatArray) -> None:
        """From the control thread, each tick: the force (3,) on the operator's hand [N]."""
        ...


class Arm(Protocol):
    """A robot arm: measured joints and joint set-points."""

    def measured(self) -> FloatArray | None:
        """The present joints (n,); None, if unknown or too old, holds the tool."""
        ...

    def servo(self, q: FloatArray) -> None:
        """Set the joint set-point q (n,), once a tick; it stays in force until the next call.

        It is within one tick's motion, except after a reset or a change of scene, which move the
        tool to the scene's start. The next tick starts from `measured` in any case.
        """
        ...
