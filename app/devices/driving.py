"""The operator's orders to a session: drag, clutch, pause, step, reset, autopilot."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from app.control.autopilot import Script
from app.control.host import Host
from app.control.messages import Telemetry
from app.control.order_writer import OrderWriter
from app.devices.page import PageMaster, checked_pose
from app.devices.report import LinkReport, Report
from app.devices.spec import Spec
from app.devices.streaming import Streaming
from app.kinds import Number
from app.motion.movement import streamed
from app.scene import scene as scenes
from app.scene.scene import Scene
from app.settings import Options
from app.words import Refused

PACE = Number(0.0, 2.0)  # of the motion of structures


class Driving(ABC):
    """What the operator orders of a `Session`. Thread-safe. Poses are in the arm's base frame."""

    scene: Scene
    options: Options
    master: PageMaster
    _writer: OrderWriter
    _loop: Host
    spec: Spec | None
    _streaming: Streaming

    @abstractmethod
    def latest(self) -> Telemetry:
        """The newest tick. Never blocks."""

    @property
    def handle(self) -> pin.SE3:
        """The master's present pose, at which the gizmo is drawn."""
        return self.master.handle

    def drive(self, target: pin.SE3, held: bool = False) -> None:
        """Move the handle; ends the autopilot.

        Args:
            target: pose of the handle, arm base frame; with scale 1 it is that of the proxy.
            held: a drag is going on: unless `drive` or `touch` is called again within
                `Options.stale_after`, the tool holds.

        Raises:
            Refused: not finite, not a rotation, or too far from the base. The pose stays.
        """
        with self._writer.exclusive():
            self.master.move(target, held)
            self._command(autopilot=False)

    def touch(self) -> None:
        """Keep a drag alive while the handle rests.

        Does not block: if another thread holds the lock, this does nothing.
        """
        if not self._writer.lock.acquire(blocking=False):
            return
        try:
            if self.master.held and not self._writer.closed:
                self._command()
        finally:
            self._writer.lock.release()

    def nudge(self, shift: ArrayLike) -> None:
        """Move the handle by shift (3,) [m], base frame; ends the autopilot.

        Raises:
            Refused: not three finite numbers, or too far from the base. The pose stays.
        """
        shift = np.asarray(shift, dtype=np.float64)
        if shift.shape != (3,) or not np.isfinite(shift).all():
            raise Refused(f"a nudge is three finite lengths, not {shift.tolist()}")
        with self._writer.exclusive():
            if self._writer.orders.autopilot:
                self.set_autopilot(False)
            self.drive(pin.SE3(self.handle.rotation, self.handle.translation + shift))

    def recall(self) -> None:
        """Move handle and proxy to the tool; ends the autopilot."""
        with self._writer.exclusive():
            self.master.place(self._tool())
            self._command(autopilot=False)

    def clutch(self, pressed: bool) -> None:
        """Press the clutch: the tool holds, the force is zero and the handle moves alone.

        On release the proxy is latched to the tool and the handle to the proxy.
        """
        with self._writer.exclusive():
            if pressed != self.master.clutched:
                self.master.clutch(pressed, self._tool())
                self._command()

    def pause(self) -> None:
        """Stop the ticks; telemetry keeps showing the last one."""
        with self._writer.exclusive():
            self._writer.write(paused=True)

    def resume(self) -> None:
        """Resume the ticks, with the present proxy."""
        with self._writer.exclusive():
            self._writer.write(paused=False)

    def single_step(self, ticks: int = 1) -> None:
        """Pause, and do exactly this number of ticks at the loop's rate."""
        with self._writer.exclusive():
            self._writer.write(paused=True, steps=self._writer.orders.steps + ticks)

    def reset(self) -> None:
        """Move the tool to the scene's start, and handle and proxy to the tool."""
        with self._writer.exclusive():
            self._to_start()
            self._command(autopilot=False, resets=self._writer.orders.resets + 1)

    def set_autopilot(self, on: bool) -> None:
        """On: the scene's script moves the proxy, from its beginning. Off: the proxy stays."""
        with self._writer.exclusive():
            if on == self._writer.orders.autopilot:
                return
            target = self.latest().target
            if on:
                self.master.hold()
            elif target is not None:
                self.master.place(target)
            self._command(autopilot=on)

    def move_structures(self, on: bool | None = None, pace: float | None = None) -> None:
        """Let the structures that have a motion move or rest where they are; set their pace.

        Args:
            on: None: as before.
            pace: seconds of motion, and of its tracker, per second, 0 to 2; None: as before.

        Raises:
            Refused: a pace that is no such number, or shapes that come from elsewhere, which are
                not to be stopped.
        """
        form = streamed(self.scene.courses)
        if form is not None:
            raise Refused(f"the vertices from {form.stream.address} come as they are sent")
        changes: dict[str, Any] = {}
        if on is not None:
            changes["moving"] = bool(on)
        if pace is not None:
            try:
                PACE.check("pace", pace)
            except ValueError as error:
                raise Refused(str(error)) from None
            changes["pace"] = float(pace)
        with self._writer.exclusive():
            self._writer.write(**changes)

    @property
    def motion(self) -> tuple[bool, float]:
        """Whether structures move, and at what pace, see `move_structures`."""
        orders = self._writer.orders
        return orders.moving, orders.pace

    @property
    def stream(self) -> LinkReport | None:
        """How shapes that come from elsewhere came last; None: none are to come."""
        return self._streaming.report

    def put(self, proxy: pin.SE3) -> None:
        """Set the pose of proxy and handle; ends the autopilot.

        Raises:
            Refused: not finite, not a rotation, or too far from the base.
        """
        pose = checked_pose(proxy)
        with self._writer.exclusive():
            self.master.hold()
            self.master.place(pose)
            self._command(autopilot=False)

    def perform(self, script: Script) -> None:
        """Move the tool to the scene's start and let this script move the proxy.

        It replaces the scene's own script until the scene is changed.
        """
        with self._writer.exclusive():
            scene = replace(self.scene, autopilot=script)
            plant = scenes.plant(scene, self.options)
            self._to_start()
            self._command(autopilot=True, plant=plant, resets=self._writer.orders.resets + 1)
            self.scene = scene

    @property
    def devices(self) -> Report | None:
        """How masters and arms that are elsewhere were last; None: there are none."""
        return self._loop.devices

    def state_command(self, word: str) -> None:
        """Order a state of the arm: "enable", "disable", "pause", "resume".

        What cannot be obeyed is logged. The handle moves to the tool.

        Raises:
            Refused: there is no arm but the sandbox's own.
        """
        if self.spec is None:
            raise Refused("the sandbox's own arm is always enabled")
        with self._writer.exclusive():
            self.master.place(self._tool())
            self.master.hold()
            self._command(autopilot=False)
            self._loop.state_command(word)

    # Internal; callers hold the lock

    def _to_start(self) -> None:
        """Move the handle to the tool's start, and clear the proxy."""
        self.master.place(self.scene.T_base_start)
        self.master.hold()

    def _remap(self) -> None:
        """Apply the present settings of teleoperation; the proxy does not move."""
        options = self.options
        self.master.remap(options.scale, options.lock_orientation)
        self._writer.write(scale=options.scale, lock_orientation=options.lock_orientation)

    def _command(self, **changes: Any) -> None:
        """Write the master's command together with other changes of the orders."""
        sequence = self._writer.orders.command.sequence + 1
        self._writer.write(command=self.master.command(sequence), **changes)

    def _tool(self) -> pin.SE3:
        """The tool's pose as last seen."""
        telemetry = self.latest()
        if telemetry.step is None or telemetry.scene != self.scene.version:
            return pin.SE3(self.scene.T_base_start)
        return pin.SE3(telemetry.step.tip)
