"""Checks everything that comes from a device before it may reach a tick.

A value is taken, or refused with a `Reason`; nothing here raises. What is refused is counted, and
logged when its reason is new or was not seen for a while.
"""

from __future__ import annotations

import logging
import math
from collections import Counter
from enum import StrEnum

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from app.devices.remote.messages import Message

log = logging.getLogger(__name__)

FloatArray = NDArray[np.float64]
FARTHEST = 2.0  # a pose may be so far from the base frame's origin [m]
ORTHONORMAL = 1e-3  # a rotation may miss that by so much
BACK = 0.1  # a stamp that is older than the newest by more is of another clock [s]
RESTARTED = 0.25  # a clock that has been back for so long counts [s]
QUIET = 5.0  # a reason is logged again after so long without it [s]
FAST = 4.0  # measured joints may move so many times faster than the arm's limits say
SLACK = 5e-3  # and by so much at once [rad or m]
SURE = 0.02  # after a longer gap a leap counts when a second measurement confirms it [s]
OUTSIDE = 0.02  # and so far outside their limits, in shares of the range
HAND = 2.0  # a hand may move so fast [m/s] …
HAND_TURN = 20.0  # … and turn so fast [rad/s] …
HAND_SLACK = 5e-3, 0.1  # … beyond so much at once [m, rad]
_TINY = 2.2250738585072014e-308  # a smaller number but zero is memory that was never written


class Reason(StrEnum):
    """Why a value was refused."""

    INVALID = "marked as not valid"
    NUMBERS = "not numbers"
    FINITE = "not finite"
    COUNT = "wrong number of joints"
    FRAME = "wrong frame"
    RANGE = "out of range"
    ROTATION = "not a rotation"
    JUMP = "a jump"
    BACK = "time goes back"
    REPEATED = "repeated"
    LATE = "overtaken by a newer one"


HARMLESS = frozenset({Reason.REPEATED, Reason.LATE})
"""What networks do all the time: ignored, and the values before stay good."""


class Order:
    """Sorts values by their stamps: nothing older than what was taken is taken.

    A clock that goes back by more than `BACK` and stays there for `RESTARTED` is taken as the new
    one: the device was started again.
    """

    def __init__(self) -> None:
        self._newest: float | None = None
        self._back: tuple[float, float] | None = None  # stamp and arrival when time went back

    def refused(self, message: Message) -> Reason | None:
        """Why the value does not come next; None: it does."""
        stamp = message.stamp
        if stamp is None:
            return None
        if not math.isfinite(stamp):
            return Reason.FINITE
        newest = self._newest
        if newest is None or stamp > newest:
            return None
        if stamp == newest:
            return Reason.REPEATED
        if stamp > newest - BACK:
            return Reason.LATE
        if self._back is None or stamp < self._back[0]:
            self._back = stamp, message.at
        if message.at - self._back[1] < RESTARTED:
            return Reason.BACK
        self._newest = None
        return None

    def taken(self, message: Message) -> float | None:
        """Note that it was taken; returns the time since the one before [s], None: not known."""
        stamp, newest = message.stamp, self._newest
        self._newest, self._back = stamp, None
        return None if stamp is None or newest is None else stamp - newest


class Border:
    """Counts and logs what one device has that is refused.

    Attributes:
        name: of the device, for the log.
        counts: how often, by reason.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.counts: Counter[str] = Counter()
        self._logged: dict[str, float] = {}

    def refuse(self, reason: str, what: str, now: float) -> None:
        """Note that a value was refused."""
        self.counts[reason] += 1
        if now - self._logged.get(reason, -math.inf) > QUIET:
            log.warning("%s: %s refused: %s", self.name, what, reason)
        self._logged[reason] = now


class JointBorder:
    """Checks measured joints or joint goals of an arm, one after the other."""

    def __init__(self, lower: FloatArray, upper: FloatArray, velocity: FloatArray) -> None:
        """Limits (n,) of the arm's model [rad or m, per s]."""
        slack = OUTSIDE * (upper - lower)
        self._lower, self._upper = lower - slack, upper + slack
        self._velocity = FAST * velocity
        self._order = Order()
        self._last: tuple[FloatArray, float] | None = None  # taken last, and when it arrived
        self._leapt: tuple[FloatArray, float] | None = None  # refused last as a jump, and when

    def forget(self) -> None:
        """Take whatever comes next: the arm may have been moved meanwhile."""
        self._last = self._leapt = None

    def checked(self, message: Message) -> FloatArray | Reason:
        """The joints (n,), read-only, or why they are refused."""
        if not message.valid or message.stamp == 0.0:
            return Reason.INVALID
        q = numbers(message.numbers, len(self._lower))
        if isinstance(q, Reason):
            return q
        if (q < self._lower).any() or (q > self._upper).any():
            return Reason.RANGE
        if (reason := self._order.refused(message)) is not None:
            return reason
        if self._last is not None and not self._follows(q, message.at, *self._last):
            self._leapt = q, message.at
            return Reason.JUMP
        self._order.taken(message)
        self._last, self._leapt = (q, message.at), None
        return q

    def _follows(self, q: FloatArray, now: float, before: FloatArray, at: float) -> bool:
        """Whether an arm can have gone from the joints before to q since then.

        The longer the gap, the farther an arm can have gone in it: a single wrong value would be
        believed. So a leap over a long gap needs a second value that agrees.
        """
        way, since = np.abs(q - before), max(now - at, 0.0)
        if (way > self._velocity * since + SLACK).any():
            return False
        if (way <= self._velocity * min(since, SURE) + SLACK).all():
            return True
        if self._leapt is None:
            return False
        there, then = self._leapt
        return bool((np.abs(q - there) <= self._velocity * max(now - then, 0.0) + SLACK).all())


class PoseBorder:
    """Checks poses of a master, or goals of the tool, one after the other."""

    def __init__(self, frame: str) -> None:
        """`frame`: that poses are in; empty: that of the first pose that names one."""
        self._frame = frame
        self._order = Order()
        self._last: tuple[pin.SE3, float] | None = None

    def forget(self) -> None:
        """Take whatever comes next."""
        self._last = None

    def checked(self, message: Message) -> pin.SE3 | Reason:
        """The pose, or why it is refused."""
        if not message.valid or message.stamp == 0.0:
            return Reason.INVALID
        pose = pose_of(message)
        if isinstance(pose, Reason):
            return pose
        if message.frame and not self._frame:
            self._frame = message.frame
        if message.frame and message.frame != self._frame:
            return Reason.FRAME
        if (reason := self._order.refused(message)) is not None:
            return reason
        if self._last is not None:
            before, at = self._last
            since = max(message.at - at, 0.0)
            if not near(before, pose, since):
                return Reason.JUMP
        self._order.taken(message)
        self._last = pose, message.at
        return pose


def near(before: pin.SE3, pose: pin.SE3, since: float) -> bool:
    """Whether a hand can have gone from one pose to another in this time [s]."""
    moved = math.dist(before.translation, pose.translation)
    if moved > HAND * since + HAND_SLACK[0]:
        return False
    # The angle from the trace: cos = (tr − 1) / 2.
    trace = float(np.vdot(before.rotation, pose.rotation))
    turned = math.acos(min(max(0.5 * (trace - 1.0), -1.0), 1.0))
    return turned <= HAND_TURN * since + HAND_SLACK[1]


def pose_of(message: Message) -> pin.SE3 | Reason:
    """The pose of a message, its rotation made orthonormal to rounding, or why it is none."""
    rows = message.rotation
    if not isinstance(rows, (list, tuple)) or len(rows) != 3:
        return Reason.ROTATION
    parts: list[list[float]] = []
    for part in (*rows, message.translation):
        found = _finite(part, 3)
        if isinstance(found, Reason):
            return Reason.NUMBERS if found is Reason.COUNT else found
        parts.append(found)
    a, b, c, p = parts
    if max(map(abs, p)) > FARTHEST:
        return Reason.RANGE
    # A far larger entry would overflow in the products.
    if max(map(abs, (*a, *b, *c))) > 2.0:
        return Reason.ROTATION
    lengths = (_dot(a, a) - 1.0, _dot(b, b) - 1.0, _dot(c, c) - 1.0)
    if max(map(abs, (*lengths, _dot(a, b), _dot(b, c), _dot(c, a)))) > ORTHONORMAL:
        return Reason.ROTATION
    # The third row of a rotation is the cross product of the others, that of a mirror its opposite.
    if _dot(_cross(a, b), c) < 0.0:
        return Reason.ROTATION
    turn = pin.Quaternion(np.array((a, b, c)))
    return pin.SE3(turn.normalized().matrix(), np.array(p))


def numbers(values: object, count: int) -> FloatArray | Reason:
    """An array (count,), read-only, of what should be a list of finite numbers."""
    found = _finite(values, count)
    if isinstance(found, Reason):
        return found
    array = np.array(found)
    array.flags.writeable = False
    return array


def _finite(values: object, count: int) -> list[float] | Reason:
    """A list of so many finite floats."""
    if not isinstance(values, (list, tuple)):
        return Reason.NUMBERS
    if len(values) != count:
        return Reason.COUNT
    found = []
    for value in values:
        if type(value) is not float:
            if value is None:
                return Reason.FINITE
            if type(value) is not int:
                return Reason.NUMBERS
            if abs(value) > 1 << 53:
                return Reason.RANGE
        size = abs(value)
        # Not so for nan.
        if not (_TINY <= size < math.inf or size == 0.0):
            return Reason.FINITE
        found.append(float(value))
    return found


def _dot(a: list[float], b: list[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: list[float], b: list[float]) -> list[float]:
    return [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
