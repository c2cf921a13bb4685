"""What the guard tells the master's side of itself, as a CRTK arm does."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from app.devices.crtk.state import Machine
from app.devices.remote.messages import Message
from robots import Arm

FAST = 5e-3  # period of joints and poses [s]
SLOW = 1e-2  # of the operating state and velocities [s]
STATISTICS = 1.0  # of the statistics of the period [s]
FRAME = "base"  # name of the frame that poses are in
MOST = 50  # sentences that wait to be said


class Feedback:
    """Makes the messages that are due."""

    def __init__(self, dt: float, T_tip_cp: pin.SE3) -> None:
        """Args:
        dt: length of a tick [s].
        T_tip_cp: the point that poses on a wire are of, in the frame of the tip.
        """
        self._dt = dt
        self._T_tip_cp = T_tip_cp
        self._due = {FAST: 0.0, SLOW: 0.0, STATISTICS: 0.0}
        self._sentences: deque[tuple[str, str]] = deque(maxlen=MOST)
        self._state: tuple[object, ...] = ()
        self._periods: list[float] = []
        self._last = math.nan
        self._before: tuple[float, pin.SE3] | None = None

    def say(self, kind: str, text: str) -> None:
        """Say a sentence with the next messages; `kind`: "error", "warning" or "status"."""
        self._sentences.append((kind, text))

    def messages(
        self,
        now: float,
        machine: Machine,
        busy: bool,
        measured: NDArray[np.float64] | None,
        setpoint: NDArray[np.float64],
        model: Arm,
    ) -> list[Message]:
        """What is due now [s].

        Args:
            measured: (n,) joints; None: not known, and marked as not valid.
            setpoint: (n,) joints.
            model: of the arm.
        """
        found = [Message(kind, text=text, stamp=now) for kind, text in self._sentences]
        self._sentences.clear()
        if math.isfinite(self._last) and len(self._periods) < 100_000:
            self._periods.append(now - self._last)
        self._last = now
        state = (machine.state, machine.homed, busy)
        if self._is_due(SLOW, now) or state != self._state:
            self._state = state
            found.append(
                Message(
                    "operating_state", text=str(machine.state), homed=machine.homed, busy=busy,
                    stamp=now,
                )
            )  # fmt: skip
            self._velocity(now, measured, model, found)
        if self._is_due(FAST, now):
            self._positions(now, measured, setpoint, model, found)
        if self._is_due(STATISTICS, now) and self._periods:
            periods = np.array(self._periods)
            self._periods.clear()
            numbers = [periods.mean(), periods.std(), periods.min(), periods.max()]
            found.append(
                Message("period_statistics", numbers=[float(x) for x in numbers], stamp=now)
            )
        return found

    def _positions(
        self,
        now: float,
        measured: NDArray[np.float64] | None,
        setpoint: NDArray[np.float64],
        model: Arm,
        found: list[Message],
    ) -> None:
        for name, joints, valid in (
            ("measured", setpoint if measured is None else measured, measured is not None),
            ("setpoint", setpoint, True),
        ):
            stamp = now if valid else 0.0
            pose = model.tip(joints) * self._T_tip_cp
            found.append(Message(f"{name}_js", numbers=joints.tolist(), stamp=stamp, valid=valid))
            found.append(
                Message(
                    f"{name}_cp", rotation=pose.rotation.tolist(),
                    translation=pose.translation.tolist(), frame=FRAME, text="tool", stamp=stamp,
                    valid=valid,
                )
            )  # fmt: skip

    def _velocity(
        self, now: float, measured: NDArray[np.float64] | None, model: Arm, found: list[Message]
    ) -> None:
        if measured is None:
            self._before = None
            return
        pose = model.tip(measured) * self._T_tip_cp
        before, self._before = self._before, (now, pose)
        if before is None or now <= before[0]:
            return
        since = now - before[0]
        linear = (pose.translation - before[1].translation) / since
        angular = pin.log3(pose.rotation @ before[1].rotation.T) / since
        numbers = [*linear.tolist(), *angular.tolist()]
        found.append(Message("measured_cv", numbers=numbers, stamp=now))

    def _is_due(self, period: float, now: float) -> bool:
        if now < self._due[period]:
            return False
        # Ticks do not fall on the period exactly.
        self._due[period] = now + period - 0.5 * self._dt
        return True
