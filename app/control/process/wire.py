"""Orders and telemetry as messages between the page's process and the control process.

Every number keeps its bits, so that a recording is the same wherever it is made.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import vf
from app.control.clock import Timing
from app.control.engine import Engine, Orders, Plant
from app.control.messages import STATES, Command, LoopStats, State, Telemetry

# Number of the orders and of their plant; driven, clutch, held, paused, autopilot, lock, moving;
# sequence, steps, resets; stamp, scale, pace; target (3, 4).
_ORDERS = struct.Struct("<QQ7?qqqddd12d")
# Number of the orders; ticked, stepped, repeated, driven, from, paused, autopilot, stale; tick,
# scene, sequence, steps, silent, tick of the autopilot's start (−1: it is off); joints; phase, that
# before; of the step when it began, and how many joints it has; timing of the period before: what
# it was, status, overrun; whether the command of devices follows; lost; started, late, spent. A
# multiple of eight bytes: arrays stand behind it.
_TICK = struct.Struct("<Q8?qqqqqqQdddQBB?3x??ddd")
# What devices made of the orders: driven, clutch, held, autopilot; joints known, measured;
# operating state; sequence; stamp; target (3, 4). The measured joints follow.
_DEVICES = struct.Struct("<6?Bxqd12d")
_POSE = 96  # of a pose (3, 4) [byte]
_NO_POSE = bytes(_POSE)


def pack_orders(number: int, plant: int, orders: Orders) -> bytes:
    """Orders of this number, for the plant of that number."""
    command, target = orders.command, orders.command.target
    return _ORDERS.pack(
        number,
        plant,
        target is not None,
        command.clutch,
        command.held,
        orders.paused,
        orders.autopilot,
        orders.lock_orientation,
        orders.moving,
        command.sequence,
        orders.steps,
        orders.resets,
        command.stamp,
        orders.scale,
        orders.pace,
        *(np.zeros(12) if target is None else target.homogeneous[:3].ravel()),
    )


def numbers_of(message: bytes) -> tuple[int, int]:
    """Number of the orders in a message, and of their plant."""
    number, plant = struct.unpack_from("<QQ", message)
    return number, plant


def unpack_orders(message: bytes, plant: Plant) -> Orders:
    """The orders of a message, for the plant that they name."""
    (
        _number, _plant, driven, clutch, held, paused, autopilot, lock, moving, sequence, steps,
        resets, stamp, scale, pace, *target,
    ) = _ORDERS.unpack(message)  # fmt: skip
    T = np.array(target).reshape(3, 4)
    return Orders(
        plant=plant,
        command=Command(
            pin.SE3(T[:, :3], T[:, 3]) if driven else None, sequence, clutch, held, stamp
        ),
        paused=paused,
        steps=steps,
        resets=resets,
        autopilot=autopilot,
        scale=scale,
        lock_orientation=lock,
        moving=moving,
        pace=pace,
    )


class Teller:
    """Makes a message of every tick; in the control process."""

    def __init__(self, engine: Engine, timing: Timing) -> None:
        self._engine = engine
        self._timing = timing
        self._step: vf.Step | None = None
        self._target: tuple[pin.SE3 | None, bytes] = (None, _NO_POSE)

    def message(
        self, number: int, telemetry: Telemetry, ticked: bool, made: Orders | None = None
    ) -> bytes:
        """The message of a tick by the orders of this number.

        Args:
            made: what devices made of these orders; None: there are none.
        """
        step, target, origin = telemetry.step, telemetry.target, telemetry.origin
        record, n, began = (b"", 0, 0.0) if step is None else step.packed
        steps, silent, since = self._engine.counts
        if target is not self._target[0]:
            self._target = target, _packed(target)
        timing, times = self._timing.last[:3], self._timing.last[3:]
        head = _TICK.pack(
            number,
            ticked,
            step is not None,
            step is not None and step is self._step,
            target is not None,
            origin is not None,
            telemetry.paused,
            telemetry.autopilot,
            telemetry.stale,
            telemetry.tick,
            telemetry.scene,
            telemetry.sequence,
            steps,
            silent,
            -1 if since is None else since,
            len(telemetry.q),
            telemetry.phase,
            telemetry.phase_before,
            began,
            n,
            *timing,
            made is not None,
            telemetry.lost,
            *times,
        )
        self._step = step
        devices = b"" if made is None else _packed_devices(made, telemetry)
        poses = self._target[1] + _packed(origin)
        return b"".join((head, poses, telemetry.q.tobytes(), devices, record))


@dataclass(frozen=True)
class Told:
    """A message of a tick.

    Attributes:
        order: number of the orders it was made by.
        ticked: whether the engine ticked.
        telemetry: of the tick.
        timing: of the period before, as `Timing.last`.
        steps, silent, autopilot_since: as those of `State`.
        made: what devices made of the orders: command, autopilot, operating state; None: there are
            no devices.
    """

    order: int
    ticked: bool
    telemetry: Telemetry
    timing: tuple[int, int, bool, float, float, float]
    steps: int
    silent: int
    autopilot_since: int | None
    made: tuple[Command, bool, str] | None = None

    def orders(self, given: Orders) -> Orders:
        """The orders of the tick, from those of the page's process."""
        if self.made is None:
            return given
        command, autopilot, state = self.made
        return replace(given, command=command, autopilot=autopilot, state=state)

    @property
    def state(self) -> State:
        """The engine's state after the tick."""
        return State(
            q=self.telemetry.q,
            tick=self.telemetry.tick,
            steps=self.steps,
            silent=self.silent,
            autopilot_since=self.autopilot_since,
            target=self.telemetry.target,
            stale=self.telemetry.stale,
            step=self.telemetry.step,
            phase=self.telemetry.phase,
        )


class Listener:
    """Reads the messages of a `Teller`, one after the other or some of them."""

    def __init__(self, dt: float) -> None:
        """`dt`: length of a tick [s]."""
        self._dt = dt
        # The last poses: a tool at rest gives the same ones again and again.
        self._target: tuple[bytes, pin.SE3] = (b"", pin.SE3.Identity())
        self._origin = self._target

    def told(self, message: bytes, stats: LoopStats, before: vf.Step | None) -> Told:
        """What a message tells of a tick.

        Args:
            stats: becomes part of the telemetry.
            before: the step of the message before, which this one may repeat; None: not known.
        """
        (
            order, ticked, stepped, repeated, driven, came, paused, autopilot, stale, tick, scene,
            sequence, steps, silent, since, joints, phase, phase_before, began, n, what, status,
            overrun, led, lost, started, late, spent,
        ) = _TICK.unpack_from(message)  # fmt: skip
        at = _TICK.size
        target = origin = None
        if driven:
            self._target = _same_or_new(self._target, message[at : at + _POSE])
            target = self._target[1]
        if came:
            self._origin = _same_or_new(self._origin, message[at + _POSE : at + 2 * _POSE])
            origin = self._origin[1]
        at += 2 * _POSE
        end = at + 8 * joints
        known, measured, made = True, None, None
        if led:
            known, measured, made = _devices(message, end, joints)
            end += _DEVICES.size + 8 * joints
        step = before if repeated else None
        if stepped and step is None:
            step = vf.Step.unpacked(message[end:], n, began)
        telemetry = Telemetry(
            tick, tick * self._dt, np.frombuffer(message, np.float64, joints, at), target, step,
            stats, scene, sequence, paused, autopilot, stale, origin, phase, phase_before, lost,
            known, measured,
        )  # fmt: skip
        return Told(
            order, ticked, telemetry, (what, status, overrun, started, late, spent), steps, silent,
            None if since < 0 else since, made,
        )  # fmt: skip


def _packed_devices(made: Orders, telemetry: Telemetry) -> bytes:
    command, target, measured = made.command, made.command.target, telemetry.measured
    head = _DEVICES.pack(
        target is not None,
        command.clutch,
        command.held,
        made.autopilot,
        telemetry.known,
        measured is not None,
        STATES.index(made.state),
        command.sequence,
        command.stamp,
        *(np.zeros(12) if target is None else target.homogeneous[:3].ravel()),
    )
    return head + (np.zeros_like(telemetry.q) if measured is None else measured).tobytes()


def _devices(
    message: bytes, at: int, joints: int
) -> tuple[bool, NDArray[np.float64] | None, tuple[Command, bool, str]]:
    """Whether the joints were known, what was measured, and what the devices made of the orders."""
    driven, clutch, held, autopilot, known, senses, state, sequence, stamp, *target = (
        _DEVICES.unpack_from(message, at)
    )
    T = np.array(target).reshape(3, 4)
    pose = pin.SE3(T[:, :3], T[:, 3]) if driven else None
    measured = np.frombuffer(message, np.float64, joints, at + _DEVICES.size) if senses else None
    made = Command(pose, sequence, clutch, held, stamp), autopilot, STATES[state]
    return known, measured, made


def _same_or_new(last: tuple[bytes, pin.SE3], part: bytes) -> tuple[bytes, pin.SE3]:
    """A pose with its bytes: the last one, if it has these bytes."""
    if part == last[0]:
        return last
    T = np.frombuffer(part, np.float64).reshape(3, 4)
    return part, pin.SE3(T[:, :3], T[:, 3])


def _packed(pose: pin.SE3 | None) -> bytes:
    return _NO_POSE if pose is None else pose.homogeneous[:3].tobytes()
