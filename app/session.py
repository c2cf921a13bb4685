"""One running sandbox: owns arm, scene, fixture, controller and loop; what a view talks to."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

import robots
from app.control.autopilot import Script
from app.control.desk import Desk
from app.control.engine import Orders
from app.control.loop import ControlLoop
from app.control.mailbox import Mailbox
from app.control.messages import Telemetry
from app.control.watch import Crossing, Watch
from app.devices.page import PageMaster, checked_pose
from app.kinds import Number
from app.options import Scope
from app.recording.capture import Tape
from app.refused import Refused
from app.scene import scene as scenes
from app.scene import worker
from app.scene.scene import Progress, Scene
from app.scene.work import Work
from app.settings import DECLARED, MESH, Options, kind_of

DEFAULTS = Options()
LIVE = tuple(  # options that are set while a session runs
    name for name, told in DECLARED.items() if told.scope in (Scope.FIXTURE, Scope.TELEOPERATION)
)


class Session:
    """A sandbox with its control thread. Every method may be called from any thread.

    All poses are in the arm's base frame.

    Attributes:
        scene: the present `Scene`; replaced as a whole by `change`.
        options: the present `Options`, with the values really in force.
        master: what the operator holds; it is moved through the methods here.
        work: the one long piece of work that may be under way, such as a `change`.
    """

    def __init__(
        self, options: Options, progress: Progress | None = None, scene: Scene | None = None
    ) -> None:
        """Build the scene and the controller, without starting the thread.

        Args:
            progress: called with a few words before each step.
            scene: one that was built otherwise than these options say.

        Raises:
            ValueError: unknown names or an unusable mesh, with the reason.
        """
        say = progress or (lambda _text: None)
        self.options = options
        self.scene: Scene = scenes.build(options, 1, say) if scene is None else scene
        say("preparing the controller")
        plant = scenes.plant(self.scene, options)
        self.master = PageMaster(self.scene.T_base_start, options.scale, options.lock_orientation)
        self.work = Work()
        orders = Orders(
            plant,
            self.master.command(0),
            scale=options.scale,
            lock_orientation=options.lock_orientation,
        )
        self._desk = Desk(orders)
        self._outbox: Mailbox[Telemetry] = Mailbox()
        self._watch = Watch()
        self._loop = ControlLoop(self._desk.inbox, self._outbox, options.dt, self._ticked)

    def __enter__(self) -> Session:
        self.start()
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def start(self) -> None:
        """Start the control thread. The tool holds until the first `drive`."""
        self._watch.start()
        self._loop.start()

    def close(self) -> None:
        """Stop the control thread and wait for it; finish a recording. Safe to call twice."""
        self._loop.close()
        self._watch.close()

    def latest(self) -> Telemetry:
        """The newest tick. Never blocks."""
        telemetry = self._outbox.get()
        assert telemetry is not None
        return telemetry

    @property
    def crossing(self) -> Crossing | None:
        """Where the tip met the mesh since the last reset or change of scene, whatever the rule."""
        return self._watch.crossing

    @property
    def unwatched(self) -> int:
        """Ticks since the start that nobody tested for a crossing; 0 unless something is wrong."""
        return self._watch.missed

    @property
    def handle(self) -> pin.SE3:
        """The master's present pose: where the gizmo belongs when nobody drags it."""
        return self.master.handle

    @property
    def tape(self) -> Tape | None:
        """The recording under way or, if none is, the last one; None: there was none."""
        return self._loop.tape

    def record(self, path: Path | str) -> Tape:
        """Record every order and tick from the next tick on, until `stop_recording` or `close`.

        No file is written over: where there is one of this name, the recording takes another, see
        `Tape.path`.

        Raises:
            Refused: a recording is under way, or the file cannot be made.
        """
        with self._desk.turn():
            return self._loop.record(path)

    def stop_recording(self) -> Tape:
        """Finish the recording's file; waits until it is written.

        Raises:
            Refused: there is no recording.
        """
        return self._loop.stop_recording()

    # While something else is on the page

    def suspend(self, reason: str, stop: worker.Stop | None = None) -> None:
        """Stop the ticks, let go of the handle, and refuse every order until `go_on`.

        Args:
            reason: what those are told who want something of the session meanwhile.
            stop: of the `work` that this belongs to, if it does.

        Raises:
            Refused: it is suspended already, or other work is under way.
        """
        with self._desk.turn(), self.work.begin(stop):
            if self.master.held:
                self.master.let_go()
                self._command()
            self._desk.close(reason)

    def go_on(self) -> None:
        """Take orders again, and tick if it did before `suspend`. Safe to call twice."""
        self._desk.open()

    @property
    def suspended(self) -> bool:
        """Whether orders are refused for now."""
        return bool(self._desk.closed)

    # What the operator does

    def drive(self, target: pin.SE3, held: bool = False) -> None:
        """Move the handle. Ends the autopilot: the hand has priority.

        Args:
            target: pose of the handle, arm base frame; with scale 1 that is the proxy.
            held: a drag is going on; then call again (the same pose will do, or `touch`) before
                `Options.stale_after` runs out, or the tool holds.

        Raises:
            Refused: not finite, not a rotation, or too far from the base. The pose stays.
        """
        with self._desk.turn():
            self.master.move(target, held)
            self._command(autopilot=False)

    def touch(self) -> None:
        """Say that the drag is still alive though the handle rests.

        Never waits: while a setter is at work (some milliseconds) this does nothing.
        """
        if not self._desk.lock.acquire(blocking=False):
            return
        try:
            if self.master.held and not self._desk.closed:
                self._command()
        finally:
            self._desk.lock.release()

    def nudge(self, shift: ArrayLike) -> None:
        """Move the handle by shift (3,) [m], base frame, and no farther; ends the autopilot.

        Raises:
            Refused: not three finite numbers, or it leads too far away. Nothing moves then.
        """
        shift = np.asarray(shift, dtype=np.float64)
        if shift.shape != (3,) or not np.isfinite(shift).all():
            raise Refused(f"a nudge is three finite lengths, not {shift.tolist()}")
        with self._desk.turn():
            if self._desk.orders.autopilot:
                self.set_autopilot(False)
            self.drive(pin.SE3(self.handle.rotation, self.handle.translation + shift))

    def recall(self) -> None:
        """Put handle and proxy back onto the tool; ends the autopilot."""
        with self._desk.turn():
            self.master.place(self._tool())
            self._command(autopilot=False)

    def clutch(self, pressed: bool) -> None:
        """Pressed: the tool holds, the force is zero and the handle moves alone.

        Released: handle and proxy are latched anew, the proxy where the tool is.
        """
        with self._desk.turn():
            if pressed != self.master.clutched:
                self.master.clutch(pressed, self._tool())
                self._command()

    def pause(self) -> None:
        """Stop the ticks; telemetry keeps showing the last one."""
        with self._desk.turn():
            self._desk.write(paused=True)

    def resume(self) -> None:
        """Let the ticks go on. The proxy that counts is the one of this moment."""
        with self._desk.turn():
            self._desk.write(paused=False)

    def single_step(self, ticks: int = 1) -> None:
        """Pause, and do exactly so many ticks, one after the other at the loop's rate."""
        with self._desk.turn():
            self._desk.write(paused=True, steps=self._desk.orders.steps + ticks)

    def reset(self) -> None:
        """Put the tool back to the scene's start, and handle and proxy onto it."""
        with self._desk.turn():
            self._to_start()
            self._command(autopilot=False, resets=self._desk.orders.resets + 1)

    def set_autopilot(self, on: bool) -> None:
        """Let a scripted path drive the proxy, from its beginning. Off: the proxy stays there."""
        with self._desk.turn():
            if on == self._desk.orders.autopilot:
                return
            target = self.latest().target
            if on:
                self.master.hold()
            elif target is not None:
                self.master.place(target)
            self._command(autopilot=on)

    def put(self, proxy: pin.SE3) -> None:
        """Put the proxy there, and the handle with it; ends the autopilot.

        Raises:
            Refused: not finite, not a rotation, or too far from the base.
        """
        pose = checked_pose(proxy)
        with self._desk.turn():
            self.master.hold()
            self.master.place(pose)
            self._command(autopilot=False)

    def perform(self, script: Script) -> None:
        """Put the tool to the scene's start and let this script drive the proxy from there.

        It takes the place of the scene's own autopilot until the scene is changed.
        """
        with self._desk.turn():
            self.scene = replace(self.scene, autopilot=script)
            plant = scenes.plant(self.scene, self.options)
            self._to_start()
            self._command(autopilot=True, plant=plant, resets=self._desk.orders.resets + 1)

    def set(self, **changes: Any) -> Options:
        """Change options of the fixture and of teleoperation; returns those then in force.

        A number out of range is clamped. Where teleoperation changes the proxy does not jump.

        Raises:
            Refused: an option that is none of these, a value that is unknown or not a number, a
                corridor without a planned path or wider than its bends allow.
        """
        with self._desk.turn():
            orders: dict[str, Any] = {}
            changed = set()
            try:
                for name, value in changes.items():
                    if name not in LIVE:
                        raise Refused(f"{name} is none of what is set live: {', '.join(LIVE)}")
                    kind = kind_of(name)
                    if isinstance(kind, Number) and value is not None:
                        changes[name] = kind.clamped(name, value)
                    if changes[name] != getattr(self.options, name):
                        changed.add(DECLARED[name].scope)
                if changes.get("corridor") is not None and self.scene.planned_path is None:
                    raise Refused("no path is planned on this mesh: there is no corridor")
                options = replace(self.options, **changes)
                if Scope.FIXTURE in changed:
                    orders["plant"] = scenes.plant(self.scene, options)
            except ValueError as error:
                raise Refused(str(error)) from None
            self.options = options
            if orders:
                self._desk.write(**orders)
            if Scope.TELEOPERATION in changed:
                self._remap()
            return options

    def change(
        self,
        mesh: str | None = None,
        unit: str | None = None,
        robot: str | None = None,
        progress: Callable[[str], None] | None = None,
        stop: worker.Stop | None = None,
        **more: Any,
    ) -> Scene:
        """Another mesh or robot: built aside while the old one runs, then swapped between ticks.

        The tool stays where it is if that is free space in the new scene, else it is put to the
        new start; handle and proxy are put onto it.

        Args:
            mesh: catalogue name or path, `unit` is the file's; None keeps the mesh and its unit.
            robot: name; None keeps the robot.
            progress: called with a few words before each step.
            stop: of the `work` that this belongs to; None: it is one of its own.
            more: other `Options` by name, such as ``repair=True``. Of those that belong to the mesh
                (`settings.MESH`) another mesh takes the ones named here and the defaults.

        Raises:
            Refused: other work is under way.
            Stopped: it was stopped.
            ValueError: unknown names or an unusable mesh, with the reason; the old scene goes on.
        """
        with contextlib.ExitStack() as stack:
            with self._desk.turn():  # refused now rather than after the scene is built
                stop = stack.enter_context(self.work.begin(stop))
            wanted = {} if mesh is None else {name: getattr(DEFAULTS, name) for name in MESH}
            named = {"mesh": mesh, "unit": unit, "robot": robot}
            wanted |= {name: value for name, value in named.items() if value is not None} | more
            options = replace(self.options, **wanted)
            stays = options.robot == self.scene.robot
            arm = self.scene.arm.copy() if stays else robots.load(options.robot)
            new = worker.build(options, self.scene.version + 1, arm, progress, stop)
            with self._desk.lock:
                # Settings may have moved on while the scene was being built.
                options = replace(self.options, **wanted)
                plant = scenes.plant(new, options)
                self.scene, self.options = new, options
                self.master.hold()
                self._command(autopilot=False, plant=plant)
                self._loop.wait_for_scene(new.version)
                self._remap()
                self.master.place(self._tool())
                self.master.hold()
            return new

    # Inner workings; callers hold the lock

    def _ticked(self, orders: Orders, telemetry: Telemetry, ticked: bool) -> None:
        """From the control thread, after every advance of the engine."""
        self._watch.take(orders, telemetry, ticked)
        if telemetry.step is not None:
            self.master.feel(telemetry.step.force)

    def _to_start(self) -> None:
        """The handle where the tool starts, and no proxy."""
        self.master.place(self.scene.T_base_start)
        self.master.hold()

    def _remap(self) -> None:
        """The teleoperation by the present settings; the proxy does not jump."""
        options = self.options
        self.master.remap(options.scale, options.lock_orientation)
        self._desk.write(scale=options.scale, lock_orientation=options.lock_orientation)

    def _command(self, **changes: Any) -> None:
        """What the master says, and other changes that must be seen at the same tick."""
        sequence = self._desk.orders.command.sequence + 1
        self._desk.write(command=self.master.command(sequence), **changes)

    def _tool(self) -> pin.SE3:
        """The tool's pose as last seen."""
        telemetry = self.latest()
        if telemetry.step is None or telemetry.scene != self.scene.version:
            return pin.SE3(self.scene.T_base_start)
        return pin.SE3(telemetry.step.tip)
