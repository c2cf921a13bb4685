"""Response of the tool to the operator's goals: the real controller, or ideal tracking."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import vf
from app.scene.scene import warm_up
from robots import Arm

FloatArray = NDArray[np.float64]


class Follower(Protocol):
    """Moves the tool to goals, one per tick."""

    def __call__(self, goals: FloatArray) -> FloatArray:
        """Position of the tip after each tick, (n, 3), for goals (n, 3), base frame [m]."""
        ...


class IdealArm:
    """Ideal tracking: plain teleoperation without speed limits, for calibration."""

    def __call__(self, goals: FloatArray) -> FloatArray:
        return goals


class ControlledArm:
    """The sandbox's controller with an arm's kinematics, tick by tick, without a clock.

    Args:
        fixtures: none for plain teleoperation.
        T_base_start: the tip's pose at the start; its rotation is held.
        dt: length of a tick [s].
    """

    def __init__(
        self, arm: Arm, fixtures: Sequence[vf.Fixture], T_base_start: pin.SE3, dt: float
    ) -> None:
        warm_up()  # before time is measured
        self._controller = vf.Controller(arm.copy(), list(fixtures), vf.Settings(dt=dt))
        self._goal = pin.SE3(T_base_start)
        self.q = arm.inverse(T_base_start, start=arm.neutral)
        self.joints: list[FloatArray] = []
        self.statuses: Counter[vf.Status] = Counter()

    def __call__(self, goals: FloatArray) -> FloatArray:
        tips = np.empty_like(goals)
        joints = np.empty((len(goals), len(self.q)))
        statuses = []
        step, goal, q = self._controller.step, self._goal, self.q
        for i in range(len(goals)):
            goal.translation = goals[i]
            done = step(q, goal)
            q = done.q
            joints[i] = q
            tips[i] = done.tip.translation
            statuses.append(done.status)
        self.q = q
        self.joints.append(joints)
        self.statuses.update(statuses)
        return tips
