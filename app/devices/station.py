"""Masters and arms in the control loop: what is asked of a tick, and what becomes of it.

`before` reads the devices and turns what they say into the tick's command, `after` tells them what
came of it. Both are called by the control thread, do not block and do not raise. Nothing goes to an
arm that is elsewhere before it was enabled.
"""

from __future__ import annotations

import logging
import math
import re
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import robots
from app.control.engine import Orders
from app.control.messages import Command, Telemetry
from app.devices import protocols
from app.devices.crtk.feedback import Feedback
from app.devices.crtk.state import Machine, State
from app.devices.remote import transports
from app.devices.remote.arm import RemoteArm
from app.devices.remote.line import Line
from app.devices.remote.master import Asked, RemoteMaster, Tick
from app.devices.report import Latencies, LinkReport, Rate, Report
from app.devices.simulated import SimulatedArm
from app.devices.spec import Spec, move_time
from robots import psm

log = logging.getLogger(__name__)

FloatArray = NDArray[np.float64]

GROSS = 5e-3  # farther off the certified path is a fault, not a hold [m]
REPORTED = 0.1  # period of the report [s]
QUIET = 2.0  # a reason to hold is logged again after so long [s]
WARNED = 0.2  # and told to the master's side [s]
BEYOND = {"psm": psm.TIP_LENGTH}
"""By robot: how far the tip lies beyond the point that poses on a wire are of, along its z [m]."""

_NUMBER = re.compile(r"[0-9.]+")


class Station:
    """The devices of a control loop.

    Attributes:
        arm: what the engine measures and moves.
        machine: the operating state.
        holds: why the tool holds in this tick; empty: it does not.
        report: the newest `Report`; any thread may read it.
    """

    def __init__(
        self, spec: Spec, q: FloatArray, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Open the devices; they need not be there yet.

        Args:
            q: (n,) where a simulated arm stands.
            clock: by which arrivals are stamped [s].

        Raises:
            OptionError: a device cannot be opened, with the reason.
        """
        self.spec = spec
        self._clock = clock
        at_arm, at_master = spec.addresses()
        model = robots.load(spec.robot)
        self.machine = Machine()
        self._model = model
        self._remote: RemoteArm | None = None
        self._master: RemoteMaster | None = None
        self._late: Line[Command] | None = None
        self._command = Command(None, 0)
        self.arm: protocols.Arm = SimulatedArm(q)
        beyond = BEYOND.get(spec.robot, 0.0)
        self._T_tip_cp = pin.SE3(np.eye(3), np.array([0.0, 0.0, -beyond]))
        if at_arm.networked:
            self.arm = self._remote = RemoteArm(
                transports.open(at_arm, "arm"), at_arm, model, spec.horizon, spec.dt
            )
        if at_master.networked:
            try:
                self._master = RemoteMaster(
                    transports.open(at_master, "master"), at_master, model,
                    self._T_tip_cp.inverse(), move_time,
                )  # fmt: skip
            except BaseException:
                self.close()
                raise
        elif not at_master.link.clear:
            self._late = Line(at_master.link)
        self._sim = at_master.scheme == "sim"
        self._urls = spec.arm, spec.master
        self._feedback = Feedback(spec.dt, self._T_tip_cp)
        self._words: deque[str] = deque()  # state commands from other threads
        self._enable = spec.enable
        self._asked = Asked()
        self.holds = ""
        self._logged: dict[str, float] = {}
        self._now = self._due = 0.0
        self._sequence = 0
        self._error = 0.0
        self._sent = 0
        self._errors = 0
        self._paused = False
        self._arrived = self._counted = -math.inf
        self._latencies = Latencies()
        self._rates = Rate(), Rate()
        self._limit = 0.0
        self.report = self._made_report(0.0)

    def order(self, word: str) -> None:
        """A `state_command` of the page or a program; from any thread, obeyed at the next tick."""
        self._words.append(word)

    def before(self, orders: Orders, latest: Telemetry | None) -> Orders:
        """The orders of the next tick.

        Args:
            orders: those of the page.
            latest: the tick before; None: there was none.
        """
        try:
            return self._before(orders, latest)
        except Exception:
            self._errors += 1
            self._log("an error of the devices' code; the tool holds", trace=True)
            self._sequence += 1
            held = Command(None, self._sequence)
            return replace(orders, command=held, autopilot=False, state=str(self.machine.state))

    def after(self, telemetry: Telemetry, ticked: bool) -> None:
        """Tell the devices what became of the tick."""
        try:
            self._after(telemetry, ticked)
        except Exception:
            self._errors += 1
            self._log("an error of the devices' code", trace=True)

    def close(self) -> None:
        """Give back what the devices hold. Safe to call twice."""
        for one in (self._remote, self._master):
            if one is not None:
                one.close()

    def _before(self, orders: Orders, latest: Telemetry | None) -> Orders:
        now = self._now = self._clock()
        remote, master, machine = self._remote, self._master, self.machine
        self._limit = _limit(orders, latest)
        holds = ""
        if remote is not None:
            remote.whole = orders.plant.options.guards_tool
            remote.poll(now)
            self._look_at_arm(remote, now)
            holds = remote.trouble
            if not holds and machine.state is State.ENABLED and remote.error > self._limit:
                holds = "the arm is off the certified path"
                remote.stop()
        self._obey_words(now)
        q = self.arm.measured()
        if q is None:
            q = orders.plant.q0 if latest is None else latest.q
        tick = Tick(q, orders.plant.arm.tip(q), machine.refuses(), holds)
        self._paused = orders.paused
        if master is None:
            return self._of_page(orders, tick)
        master.scale, master.locked = orders.scale, orders.lock_orientation
        asked = self._asked = master.poll(now, tick)
        for word in asked.states:
            self._obey(word)
        tick.refuses = machine.refuses()
        if asked.free and remote is not None:
            remote.command("free")
            asked.warnings.append("free: the arm is not guarded while it is let go of")
        if remote is not None and not tick.refuses:
            for message in asked.passed:
                remote.command(message.name, numbers=message.numbers)
        target, why = master.target(now, tick)
        self._hold(why)
        self._sequence += 1
        if target is not None and master.at > self._counted:
            self._arrived = self._counted = master.at
        return replace(
            orders,
            command=Command(target, self._sequence, False, False, now),
            autopilot=False,
            state=str(machine.state),
        )

    def _of_page(self, orders: Orders, tick: Tick) -> Orders:
        """The orders where the page or its script is the master."""
        command = orders.command
        if self._late is not None:
            if command.sequence != self._sequence:
                self._sequence = command.sequence
                self._late.put(command, self._now)
            for late, _ in self._late.take(self._now):
                if late.sequence > self._command.sequence:
                    self._command = late
            command = self._command
        why = tick.refuses or tick.holds
        self._hold(why)
        state = str(self.machine.state)
        if why:
            held = Command(None, command.sequence, command.clutch, command.held, command.stamp)
            return replace(orders, command=held, autopilot=False, state=state)
        autopilot = orders.autopilot or self._sim
        return replace(orders, command=command, autopilot=autopilot, state=state)

    def _look_at_arm(self, remote: RemoteArm, now: float) -> None:
        """Follow what the arm says of itself."""
        machine = self.machine
        told = remote.state
        if told is not None:
            machine.homed = told.homed
            if told.text == "FAULT" and machine.state is State.ENABLED:
                self._fail("the arm says that it is in FAULT")
            elif told.text not in ("", "ENABLED") and machine.state is State.ENABLED:
                machine.command("disable")
                self._warn(f"disabled, since the arm says that it is {told.text[:40]}")
        if machine.state is State.ENABLED and not remote.trouble:
            self._error = max(self._error, remote.error)
            if (off := remote.tip_error) > GROSS + self._limit:
                remote.stop()
                self._fail(f"the arm is {1e3 * off:.1f} mm off the certified path")
        if self._enable and not remote.trouble:
            self._enable = False
            self._obey("enable")
        remote.open = machine.state is State.ENABLED

    def _obey_words(self, now: float) -> None:
        while self._words:
            self._obey(self._words.popleft())
        if self._remote is None and self._enable:
            self._enable = False
            self._obey("enable")

    def _obey(self, word: str) -> None:
        """Obey a `state_command`, and pass it on to the arm."""
        remote, machine = self._remote, self.machine
        told = None if remote is None else remote.state
        before = machine.state
        refusal = ""
        if word == "enable" and told is not None and told.text not in ("", "ENABLED"):
            refusal = f"the arm itself is {told.text[:40]}: it was asked to enable itself"
        elif remote is not None and word == "enable" and remote.trouble:
            refusal = f"{remote.trouble}: it cannot be enabled"
        else:
            refusal = machine.command(word)
        if remote is not None and word in ("enable", "disable", "home", "unhome"):
            remote.command("state_command", text=word)
        if refusal:
            self._warn(refusal)
            return
        if machine.state is not before:
            log.warning("%s: the arm is %s", word, machine.state)
        if remote is not None and machine.state is State.ENABLED and before is not State.ENABLED:
            remote.join()
            self._error = 0.0
        if remote is not None:
            remote.open = machine.state is State.ENABLED

    def _fail(self, why: str) -> None:
        if self.machine.state is not State.FAULT:
            log.error("FAULT: %s", why)
            self._feedback.say("error", why)
        self.machine.fail(why)
        if self._remote is not None:
            self._remote.open = False

    def _hold(self, why: str) -> None:
        """Note why the tool holds in this tick, if it does."""
        if why and why != self.holds:
            self._log(f"the tool holds: {why}")
            self._feedback.say("status", f"holds: {why}")
        self.holds = why

    def _log(self, text: str, trace: bool = False) -> None:
        """Log a line unless one that begins like it was logged a moment ago."""
        if self._fresh(text, QUIET):
            log.warning(text, exc_info=trace)

    def _warn(self, text: str) -> None:
        """Tell the master's side why something was refused, and log it."""
        if self._fresh(f"said {text}", WARNED):
            self._feedback.say("warning", text)
        self._log(text)

    def _fresh(self, text: str, quiet: float) -> bool:
        """Whether no text that is the same but for its numbers came for so long [s]."""
        key = _NUMBER.sub("", text)
        if self._now - self._logged.get(key, -math.inf) < quiet:
            return False
        if len(self._logged) > 200:
            self._logged.clear()
        self._logged[key] = self._now
        return True

    def _after(self, telemetry: Telemetry, ticked: bool) -> None:
        now, remote, master = self._now, self._remote, self._master
        step = telemetry.step
        if ticked and telemetry.target is not None and not self.holds:
            self._sent += 1
            if self._arrived > -math.inf:
                self._latencies.add(self._clock() - self._arrived)
                self._arrived = -math.inf
        for warning in self._asked.warnings:
            self._warn(warning)
        self._asked = Asked()
        if master is not None:
            tool = telemetry.origin or (step.tip if step is not None else None)
            if step is not None and tool is not None:
                master.feel(step.force, tool, now)
            measured = self.arm.measured()
            busy = master.motions.busy(now)
            sent = telemetry.q if remote is None or remote.sent is None else remote.sent
            for message in self._feedback.messages(
                now, self.machine, busy, measured, sent, self._model
            ):
                master.tell(message, now)
            for message in [] if remote is None else remote.passed:
                master.tell(message, now)
        if now >= self._due:
            self._due = now + REPORTED
            self.report = self._made_report(now)

    def _made_report(self, now: float) -> Report:
        remote, master, machine = self._remote, self._master, self.machine
        return Report(
            state=str(machine.state),
            why=machine.why,
            homed=machine.homed,
            busy=master is not None and master.motions.busy(now),
            holds=self.holds,
            arm=_link(self._urls[0], remote, now, self._rates[0]),
            master=_link(self._urls[1], master, now, self._rates[1]),
            error=0.0 if remote is None else remote.error,
            largest=self._error,
            limit=self._limit,
            latency=self._latencies.summary(),
            sent=self._sent,
            errors=self._errors,
        )


def _link(url: str, device: Any, now: float, rate: Rate) -> LinkReport:
    if device is None:
        return LinkReport(url, age=0.0)
    age = now - device.at
    refused = dict(device.border.counts) | dict(device.transport.refused)
    trouble = getattr(device, "trouble", "")
    if not trouble and not math.isfinite(age):
        trouble = "not heard of"
    return LinkReport(url, device.transport.peer, rate.of(device.heard, now), age, trouble, refused)


def _limit(orders: Orders, latest: Telemetry | None) -> float:
    """How far an arm may be off its path with the certificate still holding [m].

    The certified segment keeps the standoff, and at its start the tip has all the room there is.
    An arm that is aside of the start goes to the same end, ever less aside: so up to that room it
    meets nothing. Half of it counts, since the room changes from tick to tick. Of an instrument
    that is guarded whole the room of its other parts is not known here: the standoff counts, for
    what is a bound of the error of all its parts.
    """
    options = orders.plant.options
    standoff = options.standoff
    step = None if latest is None else latest.step
    if step is None or options.guards_tool:
        return standoff
    return max(standoff, 0.5 * min(step.distance, step.radius))
