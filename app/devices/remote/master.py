"""The master's side over a transport: a console that commands the guard as a CRTK arm, or a hand.

A console sends goals of the tool (`servo_cp`, `move_jp`, …), which count as they are. A master that
only tells where it is (`measured_cp`) is a hand: it is latched to the tool at first contact and
whenever its clutch is released, translation relative and scaled, rotation aligned, as on the dVRK.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from app.control.teleoperation import Teleop, latch
from app.devices.crtk.motions import Motions
from app.devices.remote.arm import jaw_of
from app.devices.remote.border import HARMLESS, Border, JointBorder, PoseBorder, Reason
from app.devices.remote.messages import Message, Transport
from app.kinds.links import Address
from robots import Arm

FIRST = 10e-3, 0.35  # the first goal after a hold is so near to the tool [m, rad]
PATIENCE = 0.1  # after a longer hold goals begin at the tool anew [s]
GOALS = {
    f"{kind}_{space}": (kind, space)
    for kind in ("servo", "move", "interpolate")
    for space in ("cp", "jp")
}
WITHOUT = ("servo_cf", "servo_jf", "body/servo_cf", "spatial/servo_cf", "servo_cv", "servo_jv")


@dataclass
class Tick:
    """What a tick needs to know of the arm, to take goals.

    Attributes:
        q: (n,) where its joints are [rad or m].
        tool: pose of the tip there, base frame.
        refuses: why no motion is accepted; empty: it is.
        holds: why the tool holds in this tick, whatever is accepted; empty: it does not.
    """

    q: NDArray[np.float64]
    tool: pin.SE3
    refuses: str = ""
    holds: str = ""


@dataclass
class Asked:
    """What the master's side asked for in a tick besides motion.

    Attributes:
        states: words of `state_command`.
        passed: commands to the jaw that go on to the arm.
        free: whether the arm is to be let go of.
        warnings: why something was refused.
    """

    states: list[str] = field(default_factory=list)
    passed: list[Message] = field(default_factory=list)
    free: bool = False
    warnings: list[str] = field(default_factory=list)


class RemoteMaster:
    """Each tick: `poll`, then `target`.

    Attributes:
        handle: the hand's newest pose; None: it has none, or is a console.
        clutched: whether the hand's clutch is pressed.
        heard: how many poses and goals were taken.
        at: when the newest one arrived, by the monotonic clock [s].
        border: what was refused.
        motions: what the tool is to do.
    """

    def __init__(
        self,
        transport: Transport,
        address: Address,
        model: Arm,
        T_cp_tip: pin.SE3,
        speed: Callable[[pin.SE3, pin.SE3], float],
    ) -> None:
        """Args:
        model: of the arm, for this object's thread.
        T_cp_tip: the tip in the frame of the point that poses on the transport are of.
        speed: how long a move from one pose to another takes at least [s].
        """
        self.transport = transport
        self.handle: pin.SE3 | None = None
        self.clutched = False
        self.heard = 0
        self.at = -math.inf
        self.border = Border("master")
        self.motions = Motions(model, speed)
        self.scale, self.locked = 1.0, False
        self._model = model
        self._T_cp_tip = T_cp_tip
        self._poses, self._goals = PoseBorder(address.frame), PoseBorder("")
        self._joints = JointBorder(model.lower, model.upper, model.velocity)
        self._age = address.age + address.link.latest
        self._present = True  # whether the hand says that it is enabled
        self._teleop: Teleop | None = None
        self._held = False  # whether a value of this tick was refused
        self._since: float | None = None  # when the tool began to hold for a reason of the arm

    def poll(self, now: float, tick: Tick) -> Asked:
        """Read what has arrived by now [s], and take the goals that are accepted."""
        asked = Asked()
        self._held = False
        for message in self.transport.receive(now):
            name = message.name
            if name in GOALS:
                self._goal(message, tick, now, asked)
            elif name == "measured_cp":
                self._hand(message, now)
            elif name.endswith("clutch"):
                self._clutch(message)
            elif name == "operating_state":
                self._present = message.text in ("", "ENABLED")
            elif name == "state_command":
                asked.states.append(message.text)
            elif name == "hold":
                self.motions.hold()
            elif name == "free":
                self.motions.hold()
                asked.free = True
            elif name == "jaw/servo_jp":
                angle = jaw_of(message)
                if isinstance(angle, Reason):
                    self.border.refuse(angle, name, now)
                else:
                    asked.passed.append(Message(name, numbers=[angle]))
            elif name in WITHOUT:
                asked.warnings.append(f"{name} is refused: the guard takes poses and joints")
        return asked

    def target(self, now: float, tick: Tick) -> tuple[pin.SE3 | None, str]:
        """Where the tip is to go by now, and if nowhere, why."""
        if tick.refuses:
            self.release()
            return None, tick.refuses
        if tick.holds:
            self._since = now if self._since is None else self._since
            if now - self._since > PATIENCE:
                self.release()
            return None, tick.holds
        self._since = None
        if self._held:
            return None, "a value of the master was refused"
        if self.motions.streams or self.handle is not None:
            silent = now - self.at > self._age
            if silent:
                self.release()
                return None, "the master is silent"
        goal = self.motions.target(now)
        if goal is not None:
            return goal, ""
        if self.motions.commanded or self.handle is None:
            return None, "no motion is commanded"
        if self.clutched or not self._present:
            self._teleop = None
            return None, "the clutch is pressed" if self.clutched else "the master is not enabled"
        if self._teleop is None:
            self._teleop = latch(self.scale, self.handle, tick.tool, self.locked)
        return self._teleop.proxy(self.handle), ""

    def release(self) -> None:
        """Forget what drove the tool: goals must begin at it anew, and a hand is latched anew."""
        self.motions.hold()
        self._teleop = None
        self._goals.forget()
        self._poses.forget()
        self._joints.forget()

    def feel(self, force: Any, tool: pin.SE3, now: float) -> None:
        """Send the force (3,) [N], base frame, to the hand, in the hand's own axes."""
        body = tool if self.handle is None else self.handle
        wrench = [*(body.rotation.T @ force).tolist(), 0.0, 0.0, 0.0]
        self.transport.send(Message("body/servo_cf", numbers=wrench), now)

    def tell(self, message: Message, now: float) -> None:
        """Send feedback."""
        self.transport.send(message, now)

    def close(self) -> None:
        """Give back what it holds."""
        self.transport.close()

    def _hand(self, message: Message, now: float) -> None:
        pose = self._poses.checked(message)
        if isinstance(pose, Reason):
            self._refuse(pose, message.name, now)
            if pose is Reason.JUMP:
                # It goes on from wherever the hand is now, without the tool following the jump.
                self.release()
            return
        self.handle, self.at = pose, message.at
        self.heard += 1

    def _clutch(self, message: Message) -> None:
        if message.pressed or message.text == "released":
            self.clutched = message.pressed
            self._teleop = None

    def _goal(self, message: Message, tick: Tick, now: float, asked: Asked) -> None:
        """Take a goal of the tool, or refuse it."""
        kind, space = GOALS[message.name]
        if message.stamp == 0.0:  # of a command: none
            message.stamp = None
        streams = kind != "move"
        if not streams:
            (self._goals if space == "cp" else self._joints).forget()
        goal: Any = self._checked(message, space)
        if isinstance(goal, Reason):
            self._refuse(goal, message.name, now)
            return
        if tick.refuses:
            asked.warnings.append(f"{message.name} is refused: {tick.refuses}")
            return
        pose = goal * self._T_cp_tip if space == "cp" else self._model.tip(goal)
        if streams and not self.motions.streams and not _near(pose, tick.tool):
            apart = 1e3 * math.dist(pose.translation, tick.tool.translation)
            asked.warnings.append(
                f"{message.name} is refused: the first goal is {apart:.0f} mm from the tool, or "
                f"turned; it must be within {1e3 * FIRST[0]:g} mm and {FIRST[1]:g} rad"
            )
            (self._goals if space == "cp" else self._joints).forget()
            return
        self.heard += 1
        self.at = message.at
        if kind == "servo":
            self.motions.servo(pose)
        elif kind == "interpolate":
            self.motions.interpolate(pose, tick.tool, now)
        elif space == "cp":
            self.motions.move(tick.tool, pose, now)
        else:
            self.motions.move_joints(goal, tick.q, now)

    def _checked(self, message: Message, space: str) -> Any:
        if space == "cp":
            return self._goals.checked(message)
        return self._joints.checked(message)

    def _refuse(self, reason: Reason, name: str, now: float) -> None:
        self.border.refuse(reason, name, now)
        self._held = self._held or reason not in HARMLESS


def _near(pose: pin.SE3, tool: pin.SE3) -> bool:
    if math.dist(pose.translation, tool.translation) > FIRST[0]:
        return False
    turned = pin.log3(tool.rotation.T @ pose.rotation)
    return math.hypot(*turned) <= FIRST[1]
