"""An arm that is elsewhere: measured joints come over a transport, set-points go over it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.devices.remote.border import HARMLESS, Border, JointBorder, Reason, numbers
from app.devices.remote.messages import Message, Transport
from app.devices.remote.tracked import Tracked
from app.kinds.links import Address
from robots import Arm
from vf.kernels import njit

FloatArray = NDArray[np.float64]
PASSED_ON = ("jaw/measured_js", "jaw/setpoint_js", "error", "warning", "status")


class RemoteArm:
    """An `Arm`. Each tick, in this order: `poll`, `measured`, and perhaps `servo`.

    Attributes:
        q: (n,) the newest good joints; None: there never were any.
        at: when they arrived, by the monotonic clock [s].
        trouble: why the joints are not to be relied on in this tick; empty: they are.
        whole: whether `error` is to be that of the whole instrument; else of the tip.
        error: how far the arm is off the certified path [m], see `Tracked.error`.
        tip_error: the same of the tip alone [m].
        sent: (n,) the last set-point; None: none since the arm was joined.
        open: whether set-points may go to it.
        state: what the arm says of its own operating state; None: nothing.
        border: what was refused.
        heard: how many measurements were taken.
        passed: messages of this tick that are for whoever uses the arm.
    """

    def __init__(
        self, transport: Transport, address: Address, model: Arm, horizon: float, dt: float
    ) -> None:
        """Args:
        model: of the arm, for this object's thread.
        horizon: a set-point is not farther than the arm's limits allow in this time [s].
        dt: length of a tick, in which a set-point moves no more than the limits allow [s].
        """
        self.transport = transport
        self.q: FloatArray | None = None
        self.at = -math.inf
        self.trouble = "the arm is not heard of"
        self.whole = False
        self.error = self.tip_error = 0.0
        self.sent: FloatArray | None = None
        self.open = False
        self.state: Message | None = None
        self.border = Border("arm")
        self.heard = 0
        self.passed: list[Message] = []
        self._address = address
        self._joints = JointBorder(model.lower, model.upper, model.velocity)
        self._reach = model.velocity * horizon * (1.0 + 1e-6) + 1e-9
        self._step = model.velocity * dt
        self._age = address.age + address.link.latest
        # As many ticks as the arm may be behind, at 1 kHz; more often there are fewer new segments.
        self._path = Tracked(model, 32 + math.ceil(2e3 * address.link.latest), self._reach)
        self._ways = np.zeros((3, len(model.lower)))
        share_within(self._ways, self._step)  # compiled now
        self._now = 0.0

    def poll(self, now: float) -> None:
        """Read what has arrived by now [s]."""
        self._now = now
        self.passed = []
        bad: Reason | None = None
        new = False
        for message in self.transport.receive(now):
            name = message.name
            if name == "measured_js":
                q = self._joints.checked(message)
                if isinstance(q, Reason):
                    self.border.refuse(q, name, now)
                    bad = bad if q in HARMLESS else q
                else:
                    if message.at - self.at > self._age:
                        self._path.anchor(q)  # whatever happened meanwhile, it is joined here
                        self.sent = None
                    self.q, self.at, new = q, message.at, True
                    self.heard += 1
            elif name == "operating_state":
                self.state = message
            elif name in PASSED_ON:
                self.passed.append(message)
            if message.frame and self._address.frame and message.frame != self._address.frame:
                bad = Reason.FRAME
                self.border.refuse(bad, name, now)
        if self.q is None:
            self.trouble = f"measured joints: {bad}" if bad else "the arm is not heard of"
        elif now - self.at > self._age:
            self.trouble = "the arm is silent"
        else:
            self.trouble = f"measured joints: {bad}" if bad else ""
        if new and self.q is not None:
            self.tip_error, self.error = self._path.error(self.q, self.whole)

    def measured(self) -> FloatArray | None:
        """The measured joints (n,); None: not to be relied on."""
        return None if self.trouble else self.q

    def servo(self, q: FloatArray) -> None:
        """Send a set-point (n,), if that is allowed and within reach of where the arm is.

        It is certified from the measured joints on. What goes to the arm is a point on that way,
        since set-points must not be faster than the arm's limits, however stiff it follows them.
        """
        if not self.open or self.trouble or self.q is None:
            return
        if (np.abs(q - self.q) > self._reach).any():
            # Such as after a reset, which moves the simulated arm to the scene's start.
            self.border.refuse("farther than a tick may go", "set-point", self._now)
            return
        self._path.add(self.q, q)
        before = self.q if self.sent is None else self.sent
        ways = self._ways
        ways[0], ways[1], ways[2] = self.q, q, before
        share = share_within(ways, self._step)
        self.sent = self.q + share * (q - self.q)
        self._send("servo_jp", numbers=self.sent.tolist())

    def join(self) -> None:
        """Let the certified path begin where the arm stands."""
        if self.q is not None:
            self._path.anchor(self.q)
        self.error = self.tip_error = 0.0
        self.sent = None

    def stop(self) -> None:
        """Have the arm stay where it is, off the path as it may be."""
        q = self.q
        self.join()
        if q is not None and self.open:
            self._send("servo_jp", numbers=q.tolist())

    def command(self, name: str, **values: Any) -> None:
        """Pass another command on to the arm."""
        self._send(name, **values)

    def close(self) -> None:
        """Give back what it holds."""
        self.transport.close()

    def _send(self, name: str, **values: Any) -> None:
        self.transport.send(Message(name, **values), self._now)


@njit(cache=True)
def share_within(ways, step):  # type: ignore[no-untyped-def]
    """The largest share of a way, 0 … 1, that ends a step (n,) or less from the set-point before.

    `ways`: (3, n) where the way starts and ends, and the set-point before. If all of the way is
    farther off than that, it is the nearest point, by the joint farthest off.
    """
    first, last, moves = -np.inf, np.inf, False
    for j in range(ways.shape[1]):
        start, way = ways[0, j], ways[1, j] - ways[0, j]
        if way == 0.0:
            continue
        moves = True
        one, other = (ways[2, j] - step[j] - start) / way, (ways[2, j] + step[j] - start) / way
        first, last = max(first, min(one, other)), min(last, max(one, other))
    if not moves:
        return 1.0
    first, last = max(first, 0.0), min(last, 1.0)
    share = last if last >= first else 0.5 * (first + last)
    return min(max(share, 0.0), 1.0)


def jaw_of(message: Message) -> float | Reason:
    """The angle of a command to the jaw [rad], or why it is refused."""
    angle = numbers(message.numbers, 1)
    if isinstance(angle, Reason):
        return angle
    return float(angle[0]) if abs(angle[0]) <= math.pi else Reason.RANGE
