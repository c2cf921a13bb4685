"""One running sandbox: owns arm, scene, fixture, controller and loop; what a view talks to."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

import robots
from app.control.autopilot import Script
from app.control.engine import Orders
from app.control.loop import ControlLoop
from app.control.mailbox import Mailbox
from app.control.messages import Command, Telemetry
from app.control.teleoperation import Teleop, latch
from app.control.watch import Crossing, Watch
from app.kinds import Number
from app.options import Scope
from app.recording.capture import Tape
from app.scene import scene as scenes
from app.scene import worker
from app.scene.scene import Progress, Scene
from app.settings import DECLARED, MESH, Options, kind_of

FARTHEST = 2.0  # a proxy farther from the arm's base than this is a mistake, not a wish [m]
DEFAULTS = Options()
LIVE = tuple(  # options that are set while a session runs
    name for name, told in DECLARED.items() if told.scope in (Scope.FIXTURE, Scope.TELEOPERATION)
)


class Refused(ValueError):
    """Input that is not acted upon; the message says why. What went on before goes on."""


class Session:
    """A sandbox with its control thread. Every method may be called from any thread.

    The operator moves a handle (the page's gizmo); teleoperation maps it to the proxy, which is
    the goal of the tool. With scale 1 and no clutch the two are the same. All poses are in the
    arm's base frame.

    Attributes:
        scene: the present `Scene`; replaced as a whole by `change`.
        options: the present `Options`, with the values really in force.
        handle: the handle's present pose: where the gizmo belongs when nobody drags it.
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
        self._lock = threading.RLock()  # writers only; the loop and `latest` never take it
        self._changing = threading.Lock()
        self._stop = worker.Stop()  # of the newest change
        self._orders = Orders(
            plant,
            Command(None, 0, stamp=time.monotonic()),
            scale=options.scale,
            lock_orientation=options.lock_orientation,
        )
        self._inbox: Mailbox[Orders] = Mailbox(self._orders)
        self._outbox: Mailbox[Telemetry] = Mailbox()
        self._watch = Watch()
        self._loop = ControlLoop(self._inbox, self._outbox, options.dt, self._watch.take)
        self._tape: Tape | None = None
        self._suspended = ""  # why orders are refused
        self._goes_on = True  # once it is not suspended any more
        self._clutched = False
        self.handle = pin.SE3(self.scene.T_base_start)
        self._teleop = self._latched(self.handle)

    def __enter__(self) -> Session:
        self.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def start(self) -> None:
        """Start the control thread. The tool holds until the first `drive`."""
        self._watch.start()
        self._loop.start()

    def close(self) -> None:
        """Stop the control thread and wait for it; finish a recording. Safe to call twice."""
        self._loop.close()
        self._watch.close()
        self._loop.tape = None
        if self._tape is not None:
            self._tape.finish()

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
    def clutched(self) -> bool:
        """Whether the clutch is pressed."""
        return self._clutched

    @property
    def tape(self) -> Tape | None:
        """The recording under way or, if none is, the last one; None: there was none."""
        return self._tape

    def record(self, path: Path | str) -> Tape:
        """Record every order and tick from the next tick on, until `stop_recording` or `close`.

        No file is written over: where there is one of this name, the recording takes another, see
        `Tape.path`.

        Raises:
            Refused: a recording is under way, or the file cannot be made.
        """
        with self._turn():
            if self._tape is not None and self._tape.running:
                raise Refused("a recording is under way: stop it first")
            try:
                self._tape = Tape(path)
            except OSError as error:
                raise Refused(f"cannot record to {path}: {error.strerror or error}") from None
            self._loop.tape = self._tape
            return self._tape

    def stop_recording(self) -> Tape:
        """Finish the recording's file; waits until it is written.

        Raises:
            Refused: there is no recording.
        """
        with self._lock:
            if self._tape is None or self._loop.tape is None:
                raise Refused("nothing is being recorded")
            self._loop.tape = None
            tape = self._tape
        tape.finish()
        return tape

    # While something else is on the page

    def suspend(self, reason: str) -> None:
        """Stop the ticks, let go of the handle, and refuse every order until `go_on`.

        Args:
            reason: what those are told who want something of the session meanwhile.

        Raises:
            Refused: it is suspended already, or another mesh or robot is on its way.
        """
        with self._turn():
            if not self._changing.acquire(blocking=False):
                raise Refused("another change is under way: wait until it is done")
            self._suspended, self._goes_on = reason, not self._orders.paused
            if self._orders.command.held:
                self._command(self._orders.command.target)
            self._order(paused=True)

    def go_on(self) -> None:
        """Take orders again, and tick if it did before `suspend`. Safe to call twice."""
        with self._lock:
            if self._suspended:
                self._suspended = ""
                self._changing.release()
                self._order(paused=not self._goes_on)

    @property
    def suspended(self) -> bool:
        """Whether orders are refused for now."""
        return bool(self._suspended)

    # What the operator does

    def drive(self, target: pin.SE3, held: bool = False) -> None:
        """Move the handle. Ends the autopilot: the hand has priority.

        Args:
            target: pose of the handle, arm base frame; with scale 1 that is the proxy.
            held: a drag is going on; then call again (the same pose will do, or `touch`) before
                `Options.stale_after` runs out, or the tool holds.

        Raises:
            Refused: not finite, not a rotation, or farther than `FARTHEST` from the base. The
                session goes on with the pose it had.
        """
        handle = checked_pose(target)
        with self._turn():
            proxy = self._teleop.proxy(handle)
            _check_distance(proxy)
            self.handle = handle
            if self._clutched:
                proxy = self._orders.command.target  # the handle moves alone
            self._command(proxy, held, autopilot=False)

    def touch(self) -> None:
        """Say that the drag is still alive though the handle rests.

        Never waits: while a setter is at work (some milliseconds) this does nothing.
        """
        if not self._lock.acquire(blocking=False):
            return
        try:
            if self._orders.command.held and not self._suspended:
                self._command(self._orders.command.target, held=True)
        finally:
            self._lock.release()

    def nudge(self, shift: ArrayLike) -> None:
        """Move the handle by shift (3,) [m], base frame, and no farther; ends the autopilot.

        Raises:
            Refused: not three finite numbers, or it leads too far away. Nothing moves then.
        """
        shift = np.asarray(shift, dtype=np.float64)
        if shift.shape != (3,) or not np.isfinite(shift).all():
            raise Refused(f"a nudge is three finite lengths, not {shift.tolist()}")
        with self._turn():
            if self._orders.autopilot:
                self.set_autopilot(False)
            self.drive(pin.SE3(self.handle.rotation, self.handle.translation + shift))

    def recall(self) -> None:
        """Put handle and proxy back onto the tool; ends the autopilot."""
        with self._turn():
            self._latch_on_tool(handle_too=True)
            self._command(pin.SE3(self.handle), autopilot=False)

    def clutch(self, pressed: bool) -> None:
        """Pressed: the tool holds, the force is zero and the handle moves alone.

        Released: handle and proxy are latched anew, the proxy where the tool is.
        """
        with self._turn():
            if pressed == self._clutched:
                return
            self._clutched = pressed
            target = self._orders.command.target
            if not pressed:
                self._latch_on_tool(handle_too=False)
                target = self._teleop.proxy(self.handle)
            self._command(target)

    def pause(self) -> None:
        """Stop the ticks; telemetry keeps showing the last one."""
        with self._turn():
            self._order(paused=True)

    def resume(self) -> None:
        """Let the ticks go on. The proxy that counts is the one of this moment."""
        with self._turn():
            self._order(paused=False)

    def single_step(self, ticks: int = 1) -> None:
        """Pause, and do exactly so many ticks, one after the other at the loop's rate."""
        with self._turn():
            self._order(paused=True, steps=self._orders.steps + ticks)

    def reset(self) -> None:
        """Put the tool back to the scene's start, and handle and proxy onto it."""
        with self._turn():
            self.handle = pin.SE3(self.scene.T_base_start)
            self._teleop = self._latched(self.handle)
            self._clutched = False
            self._command(None, autopilot=False, resets=self._orders.resets + 1)

    def set_autopilot(self, on: bool) -> bool:
        """Let a scripted path drive the proxy, from its beginning. Off: the proxy stays there."""
        with self._turn():
            if on == self._orders.autopilot:
                return on
            if on:
                self._clutched = False
                self._command(None, autopilot=True)
                return on
            target = self.latest().target
            if target is not None:
                self.handle = pin.SE3(target)
                self._teleop = self._latched(self.handle)
            self._command(target, autopilot=False)
            return on

    def put(self, proxy: pin.SE3) -> None:
        """Put the proxy there, and the handle with it; ends the autopilot.

        Raises:
            Refused: not finite, not a rotation, or farther than `FARTHEST` from the base.
        """
        pose = checked_pose(proxy)
        with self._turn():
            self._clutched = False
            self.handle = pose
            self._teleop = self._latched(pose)
            self._command(pose, autopilot=False)

    def perform(self, script: Script) -> None:
        """Put the tool to the scene's start and let this script drive the proxy from there.

        It takes the place of the scene's own autopilot until the scene is changed.
        """
        with self._turn():
            self.scene = replace(self.scene, autopilot=script)
            plant = scenes.plant(self.scene, self.options)
            self.handle = pin.SE3(self.scene.T_base_start)
            self._teleop = self._latched(self.handle)
            self._clutched = False
            resets = self._orders.resets + 1
            self._command(None, autopilot=True, plant=plant, resets=resets)

    def set(self, **changes: Any) -> Options:
        """Change options of the fixture and of teleoperation; returns those then in force.

        A number out of range is clamped. Where teleoperation changes the proxy does not jump.

        Raises:
            Refused: an option that is none of these, a value that is unknown or not a number, a
                corridor without a planned path or wider than its bends allow.
        """
        with self._turn():
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
            proxy = self._teleop.proxy(self.handle)
            self.options = options
            if Scope.TELEOPERATION in changed:
                self._teleop = self._latched(proxy)
                orders.update(scale=options.scale, lock_orientation=options.lock_orientation)
            if orders:
                self._order(**orders)
            return options

    def change(
        self,
        mesh: str | None = None,
        unit: str | None = None,
        robot: str | None = None,
        progress: Callable[[str], None] | None = None,
        **more: Any,
    ) -> Scene:
        """Another mesh or robot: built aside while the old one runs, then swapped between ticks.

        The tool stays where it is if that is free space in the new scene, else it is put to the
        new start; handle and proxy are put onto it.

        Args:
            mesh: catalogue name or path; None keeps the mesh (and its unit).
            unit: of the mesh file.
            robot: name; None keeps the robot.
            progress: called with a few words before each step.
            more: other `Options` by name, such as ``repair=True``. Of those that belong to the mesh
                (`settings.MESH`) another mesh takes the ones named here and the defaults.

        Raises:
            Refused: another change is under way.
            Stopped: `stop_change` was called.
            ValueError: unknown names or an unusable mesh, with the reason; the old scene goes on.
        """
        with self._turn():
            pass  # refused now rather than after the scene is built
        if not self._changing.acquire(blocking=False):
            raise Refused("another change is under way: wait until it is done")
        self._stop = stop = worker.Stop()
        try:
            wanted: dict[str, Any] = {}
            if mesh is not None:
                wanted = {name: getattr(DEFAULTS, name) for name in MESH}
            for name, value in (("mesh", mesh), ("unit", unit), ("robot", robot)):
                if value is not None:
                    wanted[name] = value
            wanted.update(more)
            options = replace(self.options, **wanted)
            stays = options.robot == self.scene.robot
            arm = self.scene.arm.copy() if stays else robots.load(options.robot)
            new = worker.build(options, self.scene.version + 1, arm, progress, stop)
            if stop.asked:
                raise worker.Stopped("stopped: nothing is changed")
            with self._lock:
                # Settings may have moved on while the scene was being built.
                options = replace(self.options, **wanted)
                plant = scenes.plant(new, options)
                self.scene, self.options, self._clutched = new, options, False
                self._command(None, autopilot=False, plant=plant)
                self._await_scene()
                self._latch_on_tool(handle_too=True)
            return new
        finally:
            self._changing.release()

    def stop_change(self) -> None:
        """Give up the change under way, if there is one: the old scene goes on."""
        self._stop()

    # Inner workings; callers hold the lock

    @contextlib.contextmanager
    def _turn(self) -> Iterator[None]:
        """The lock for an order of the operator's, which is refused while suspended."""
        with self._lock:
            if self._suspended:
                raise Refused(self._suspended)
            yield

    def _latched(self, proxy: pin.SE3) -> Teleop:
        """The map that takes the present handle to this proxy, by the present settings."""
        options = self.options
        return latch(options.scale, self.handle, proxy, options.lock_orientation)

    def _order(self, **changes: Any) -> None:
        with self._lock:
            self._orders = replace(self._orders, **changes)
            self._inbox.put(self._orders)

    def _command(self, target: pin.SE3 | None, held: bool = False, **changes: Any) -> None:
        """A new command, together with other changes that must be seen at the same tick."""
        command = Command(
            target=target,
            sequence=self._orders.command.sequence + 1,
            clutch=self._clutched,
            held=held,
            stamp=time.monotonic(),
        )
        self._order(command=command, **changes)

    def _tool(self) -> pin.SE3:
        """The tool's pose as last seen."""
        telemetry = self.latest()
        if telemetry.step is None or telemetry.scene != self.scene.version:
            return pin.SE3(self.scene.T_base_start)
        return pin.SE3(telemetry.step.tip)

    def _latch_on_tool(self, handle_too: bool) -> None:
        tool = self._tool()
        if handle_too:
            self.handle = tool
        self._teleop = self._latched(tool)

    def _await_scene(self, timeout: float = 5.0) -> None:
        """Wait until the loop runs in the present scene, to learn where the tool is in it."""
        deadline = time.monotonic() + timeout
        while self._loop.alive and time.monotonic() < deadline:
            telemetry = self.latest()
            if telemetry.scene == self.scene.version and telemetry.step is not None:
                return
            time.sleep(1e-3)


def checked_pose(pose: pin.SE3) -> pin.SE3:
    """A copy of a pose that came from outside, its rotation made orthonormal to rounding.

    Raises:
        Refused: not finite, not a rotation within 1e-3, or farther than `FARTHEST` away.
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
    if distance > FARTHEST:
        raise Refused(
            f"the proxy is {distance:.2f} m from the arm's base; at most {FARTHEST:g} m is allowed"
        )
