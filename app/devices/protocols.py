"""What a master and an arm must offer. A device is one class that does; it need not inherit.

Poses are in the arm's base frame, lengths in metres, angles in radians, forces in newtons. No
method waits: a device that talks to hardware does so on a thread of its own, and checks there what
comes in (finite, orthonormal, in range, in order, not too old).
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class Master(Protocol):
    """What an operator holds: it says where it is, and takes the force on the operator's hand."""

    @property
    def handle(self) -> pin.SE3:
        """Its pose, the newest that passed the checks."""
        ...

    @property
    def clutched(self) -> bool:
        """Whether the clutch is pressed: the handle moves alone, the tool holds."""
        ...

    @property
    def held(self) -> bool:
        """Whether it is in a hand, so that it must go on saying so or the tool holds."""
        ...

    def feel(self, force: FloatArray) -> None:
        """From the control thread, each tick: the force (3,) on the operator's hand [N]."""
        ...


class Arm(Protocol):
    """A robot's joints: where they are, and where they are to go."""

    def measured(self) -> FloatArray | None:
        """The joints (n,) as they are now; None: not known, or too old: the tool holds."""
        ...

    def servo(self, q: FloatArray) -> None:
        """Go to the joints q (n,), once a tick; without another call the last ones stay.

        They are one tick away, except after a reset or a change of scene, which put the tool to the
        scene's start. Wherever the arm is by the next tick, that tick starts from `measured`.
        """
        ...
