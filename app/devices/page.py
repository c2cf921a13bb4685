"""The page's gizmo as a master: handle, clutch, and the map from handle to proxy."""

from __future__ import annotations

import math
import time

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from app.control.messages import Command
from app.control.teleoperation import latch
from app.words import Refused

FARTHEST_PROXY = 2.0  # reject targets farther from the arm's base than this [m]


class PageMaster:
    """A `Master` that is moved in the browser. All poses are in the arm's base frame.

    Teleoperation maps the handle to the proxy, which is the goal of the tool; with scale 1 and no
    clutch the two are the same. Only one thread at a time may call; any may read an attribute.

    Attributes:
        handle: the handle's present pose, at which the gizmo is drawn.
        clutched: whether the clutch is pressed: the handle moves alone, the tool holds.
        held: whether a drag is going on.
        target: the proxy; None holds the tool.
        force: (3,) on the operator's hand, drawn by the page [N].
    """

    def __init__(self, handle: pin.SE3, scale: float, locked: bool) -> None:
        """Handle and proxy at the same pose; scale and lock as in `Teleop`."""
        self.handle = pin.SE3(handle)
        self.clutched = False
        self.held = False
        self.target: pin.SE3 | None = None
        self.force: NDArray[np.float64] = np.zeros(3)
        self._teleop = latch(scale, handle, handle, locked)

    def feel(self, force: NDArray[np.float64]) -> None:
        """From the control thread, each tick: the force (3,) on the operator's hand [N]."""
        self.force = force

    def command(self, sequence: int) -> Command:
        """The present state as a command with this sequence number."""
        return Command(self.target, sequence, self.clutched, self.held, time.monotonic())

    def move(self, pose: pin.SE3, held: bool) -> None:
        """Move the handle; the proxy follows unless the clutch is pressed.

        Raises:
            Refused: not a pose, or it or the proxy is too far away. Nothing moves then.
        """
        handle = checked_pose(pose)
        proxy = self._teleop.proxy(handle)
        _check_distance(proxy)
        self.handle, self.held = handle, held
        if not self.clutched:
            self.target = proxy

    def place(self, pose: pin.SE3) -> None:
        """Set the pose of handle and proxy."""
        self.handle = self.target = pin.SE3(pose)
        self.held = False
        self._latch(pose)

    def hold(self) -> None:
        """Clear the proxy, so that the tool holds; release the clutch; the handle stays."""
        self.target = None
        self.clutched = self.held = False

    def let_go(self) -> None:
        """End the drag."""
        self.held = False

    def clutch(self, pressed: bool, T_base_tool: pin.SE3) -> None:
        """Press or release the clutch; on release the handle's pose is latched to the tool's."""
        self.clutched, self.held = pressed, False
        if not pressed:
            self._latch(T_base_tool)
            self.target = self._teleop.proxy(self.handle)

    def remap(self, scale: float, locked: bool) -> None:
        """Set scale and lock, as in `Teleop`; the proxy does not move."""
        proxy = self._teleop.proxy(self.handle)
        self._teleop = latch(scale, self.handle, proxy, locked)

    def _latch(self, proxy: pin.SE3) -> None:
        self._teleop = latch(self._teleop.scale, self.handle, proxy, self._teleop.locked)


def checked_pose(pose: pin.SE3) -> pin.SE3:
    """A copy of a pose that came from outside, its rotation made orthonormal to rounding.

    Raises:
        Refused: not finite, not a rotation within 1e-3, or farther than `FARTHEST_PROXY` away.
    """
    p, R = np.array(pose.translation), np.array(pose.rotation)
    if not (np.isfinite(p).all() and np.isfinite(R).all()):
        raise Refused("the proxy is not finite")
    if np.abs(R @ R.T - np.eye(3)).max() > 1e-3 or np.linalg.det(R) < 0.0:
        raise Refused("the proxy's rotation is not a rotation (not orthonormal, or mirrored)")
    T_base_pose = pin.SE3(pin.Quaternion(R).normalized().matrix(), p)
    _check_distance(T_base_pose)
    return T_base_pose


def _check_distance(pose: pin.SE3) -> None:
    distance = math.hypot(*pose.translation)
    if distance > FARTHEST_PROXY:
        raise Refused(
            f"the proxy is {distance:.2f} m from the arm's base; "
            f"at most {FARTHEST_PROXY:g} m is allowed"
        )
