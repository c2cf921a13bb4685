"""The session: owns scene, controller and control loop; the interface for views."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import robots
from app.control.engine import Orders
from app.control.host import Host
from app.control.loop import ControlLoop
from app.control.mailbox import Mailbox
from app.control.messages import Telemetry
from app.control.order_writer import OrderWriter
from app.control.process.handle import Child
from app.control.process.parent import ControlProcess
from app.control.watch import Crossing, Watch
from app.devices.driving import Driving
from app.devices.igtl.server import Server, server_of
from app.devices.page import PageMaster
from app.devices.spec import Spec
from app.devices.station import Station
from app.devices.streaming import Streaming
from app.kinds import Number, bare
from app.options import Scope, declared
from app.recording.capture import Tape
from app.scene import scene as scenes
from app.scene import worker
from app.scene.scene import Progress, Scene
from app.scene.work import Work
from app.settings import DECLARED, MESH, Options, kind_of
from app.structure import Structure
from app.words import Refused

DEFAULTS = Options()
OF_MESH = (*MESH, "margin", "guarded", "colour", "opacity")  # go with the mesh
STRUCTURE_LIVE = ("margin", "guard", "guarded", "name", "colour", "opacity")
LIVE = tuple(  # options that are set while a session runs
    name
    for name, entry in DECLARED.items()
    if entry.scope in (Scope.FIXTURE, Scope.VIEW, Scope.TELEOPERATION)
)


class Session(Driving):
    """A running sandbox with its control loop. Thread-safe. Poses are in the arm's base frame.

    Attributes:
        scene: the present `Scene`; replaced as a whole by `change`.
        options: the `Options` in force.
        master: the operator's input device; it is moved by the operator's orders.
        work: the long operation in progress, such as a `change`, if there is one.
        spec: masters and arms that are elsewhere; None: there are none.
    """

    def __init__(
        self,
        options: Options,
        progress: Progress | None = None,
        scene: Scene | None = None,
        process: bool = False,
    ) -> None:
        """Build the scene and the controller, without starting the control loop.

        Args:
            progress: called with a short text before each step.
            scene: a scene to use instead of building one from the options.
            process: whether the loop runs in a process of its own, in which nothing else makes a
                tick late, instead of a thread of this one. It takes the arms of the catalogue.

        Raises:
            ValueError: unknown names or an unusable mesh, with the reason.
            OSError: the process cannot be started.
        """
        with contextlib.ExitStack() as undo:
            child = Child() if process else None
            if child is not None:
                undo.callback(child.leave)
            self._build(options, progress or (lambda _text: None), scene, child)
            undo.pop_all()

    def _build(
        self, options: Options, say: Progress, scene: Scene | None, child: Child | None
    ) -> None:
        self.options = options
        if child is not None:
            say("preparing the kernels (the first start compiles them: up to a minute)")
            scenes.warm_up()
            child.warm_up()
        self.scene: Scene = scenes.build(options, 1, say) if scene is None else scene
        self.options = options = scenes.settled(options, self.scene)
        say("preparing the controller")
        if child is not None:
            child.share(self.scene.surfaces)
        plant = scenes.plant(self.scene, options)
        self.master = PageMaster(self.scene.T_base_start, options.scale, options.lock_orientation)
        self.work = Work()
        orders = Orders(
            plant,
            self.master.command(0),
            scale=options.scale,
            lock_orientation=options.lock_orientation,
        )
        self._watch = Watch(int(2.0 * options.rate))
        self.spec = spec = Spec.of(options)
        self._led = spec is not None and spec.leads
        self._server: Server | None = None
        self._loop: Host
        if child is None:
            self._writer = OrderWriter(orders)
            outbox: Mailbox[Telemetry] = Mailbox()
            self._loop = ControlLoop(
                self._writer.inbox, outbox, options.dt, self._ticked,
                devices=None if spec is None else Station(spec, plant.q0),
            )  # fmt: skip
        else:
            self._loop = ControlProcess(
                child, orders, options.dt, self._ticked, self._watch.miss, spec
            )
            self._writer = OrderWriter(orders, self._loop.orders)
        self._streaming = Streaming(self._loop)

    def __enter__(self) -> Session:
        try:
            self.start()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def start(self) -> None:
        """Start the control loop. The tool holds until the first `drive`.

        Raises:
            Refused: the control process ended instead.
            OptionError: an address cannot be listened on, the master's or that of a motion.
        """
        self._streaming.attend(self.scene)
        self._server = server_of(self)
        self._watch.start()
        self._loop.start()
        if self._server is not None:
            self._server.start()

    def close(self) -> None:
        """Stop the control loop and wait for it; finish a recording. Safe to call twice."""
        if self._server is not None:
            self._server.close()
        self._streaming.close()
        self._loop.close()
        self._watch.close()

    def latest(self) -> Telemetry:
        """The newest tick. Never blocks."""
        telemetry = self._loop.telemetry.get()
        assert telemetry is not None
        return telemetry

    @property
    def past(self) -> list[Telemetry]:
        """The ticks of the last two seconds, of the present scene, oldest first."""
        return [one for one in list(self._watch.past) if one.scene == self.scene.version]

    @property
    def crossing(self) -> Crossing | None:
        """Where the tip met what is guarded since the last reset or change of scene."""
        return self._watch.crossing

    @property
    def contacts(self) -> int:
        """Number of ticks, since then, in which the tip came to meet what is guarded, or crossed.

        Of structures that move: where they truly are.
        """
        return self._watch.contacts

    @property
    def unwatched(self) -> int:
        """Number of ticks that were not tested for a crossing; 0 in normal operation."""
        return self._watch.missed

    @property
    def tape(self) -> Tape | None:
        """The current recording or, if there is none, the last one; None: there was none."""
        return self._loop.tape

    def record(self, path: Path | str) -> Tape:
        """Record every order and tick from the next tick on, until `stop_recording` or `close`.

        No file is overwritten: if the path exists, another name is used, see `Tape.path`.

        Raises:
            Refused: a recording is under way, or the file cannot be made.
        """
        with self._writer.exclusive():
            return self._loop.record(path)

    def stop_recording(self) -> Tape:
        """Finish the recording's file; waits until it is written.

        Raises:
            Refused: there is no recording.
        """
        return self._loop.stop_recording()

    @property
    def ended(self) -> str:
        """Why the control loop ended by itself; empty: it did not. See `restart`."""
        return self._loop.ended

    def restart(self) -> None:
        """Run the control loop again after it `ended`: the tool holds where it was.

        Nothing else has changed: scene, options and the tick's number go on.

        Raises:
            Refused: it has not ended, or cannot be started again; or a replay is shown.
        """
        with self._writer.exclusive():
            self.master.place(self._tool())
            self.master.hold()
            self._command(autopilot=False)
            self._loop.restart()

    # Suspension, while a replay is shown

    def suspend(self, reason: str, stop: worker.Stop | None = None) -> None:
        """Pause the loop, end a drag, and refuse all orders until `go_on`.

        Args:
            reason: message of the refusals.
            stop: of the operation (see `work`) that this is part of; None: it is its own.

        Raises:
            Refused: already suspended, or another operation is in progress.
        """
        with self._writer.exclusive(), self.work.begin(stop):
            if self.master.held:
                self.master.let_go()
                self._command()
            self._writer.close(reason)

    def go_on(self) -> None:
        """Accept orders again, and resume if it ran before `suspend`. Safe to call twice."""
        self._writer.open()

    @property
    def suspended(self) -> bool:
        """Whether orders are refused, see `suspend`."""
        return bool(self._writer.closed)

    def set(self, **changes: Any) -> Options:
        """Change options of fixture, drawing and teleoperation; returns the options in force.

        Numbers are clamped to their range. A change of teleoperation does not move the proxy.

        Raises:
            Refused: another option, an invalid value, a corridor without a planned path or wider
                than its bends allow.
        """
        with self._writer.exclusive():
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
            if orders:
                self._writer.write(**orders)
            self.options = options
            if Scope.TELEOPERATION in changed:
                self._remap()
            return options

    def set_structure(self, number: int, **changes: Any) -> Options:
        """Change settings of a structure: 0 is the mesh, others follow in the order of the options.

        A change of its name, colour or opacity has no effect on the control loop.

        Args:
            changes: by name: margin [m], which is clamped to its range, guard, guarded, name,
                colour, opacity. The mesh has its guard and its name from the session's options.

        Raises:
            Refused: no such structure, another setting, or an invalid value.
        """
        with self._writer.exclusive():
            if number == 0:
                return self.set(**changes)
            there = self.options.structures
            if not 0 < number <= len(there):
                raise Refused(f"there is no structure {number}: they are 0 to {len(there)}")
            for name in changes:
                if name not in STRUCTURE_LIVE:
                    live = ", ".join(STRUCTURE_LIVE)
                    raise Refused(f"{name} is none of what is set of a structure: {live}")
            old = there[number - 1]
            motions = self.options.motions
            try:
                if changes.get("margin") is not None:
                    margin = bare(declared(Structure)["margin"].kind)
                    assert isinstance(margin, Number)
                    changes["margin"] = margin.clamped("margin", changes["margin"])
                new = replace(old, **changes)
                structures = (*there[: number - 1], new, *there[number:])
                if new.name != old.name:
                    motions = tuple(
                        replace(one, of=new.name) if one.of == old.name else one for one in motions
                    )
                options = replace(self.options, structures=structures, motions=motions)
                if (new.margin, new.guard, new.guarded) != (old.margin, old.guard, old.guarded):
                    self._writer.write(plant=scenes.plant(self.scene, options))
            except ValueError as error:
                raise Refused(str(error)) from None
            self.options = options
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
        """Change mesh or robot: the new scene is built while the old one runs, and then swapped in.

        The tool stays in place if that is free space in the new scene, else it moves to the new
        start; handle and proxy move to the tool.

        Args:
            mesh: catalogue name or path; None keeps the mesh and its unit.
            unit: of the mesh file.
            robot: name; None keeps the robot.
            progress: called with a short text before each step.
            stop: of the operation (see `work`) that this is part of; None: it is its own.
            more: other `Options` by name, such as ``repair=True``. With a new `mesh`, options of
                the mesh (`OF_MESH`) that are not given are reset to their defaults.

        Raises:
            Refused: another operation is in progress.
            Stopped: it was stopped.
            ValueError: unknown names or an unusable mesh; the old scene stays.
        """
        with contextlib.ExitStack() as stack:
            with self._writer.exclusive():  # raises `Refused` before the scene is built
                stop = stack.enter_context(self.work.begin(stop))
            wanted = {} if mesh is None else {name: getattr(DEFAULTS, name) for name in OF_MESH}
            named = {"mesh": mesh, "unit": unit, "robot": robot}
            wanted |= {name: value for name, value in named.items() if value is not None} | more
            options = replace(self.options, **wanted)
            if self.spec is not None and options.robot != self.spec.robot:
                raise Refused(f"the arm that is elsewhere is a {self.spec.robot}")
            stays = options.robot == self.scene.robot
            arm = self.scene.arm.copy() if stays else robots.load(options.robot)
            new = worker.build(options, self.scene.version + 1, arm, progress, stop)
            self._loop.share(new.surfaces)
            with self._writer.lock:
                # Settings may have changed while the scene was built.
                options = scenes.settled(replace(self.options, **wanted), new)
                plant = scenes.plant(new, options)
                self.master.hold()
                self._streaming.attend(new)
                self._command(autopilot=False, plant=plant, moving=True, pace=1.0)
                self.scene, self.options = new, options
                self._loop.wait_for_scene(new.version)
                self._remap()
                self.master.place(self._tool())
                self.master.hold()
            return new

    # Internal; callers hold the lock

    def _ticked(self, orders: Orders, telemetry: Telemetry, ticked: bool) -> None:
        """From the host of the loop, after every advance of the engine."""
        self._watch.take(orders, telemetry, ticked)
        if telemetry.step is not None:
            self.master.feel(telemetry.step.force)
            if self._led:
                # The handle is drawn where the other master wants the tool.
                self.master.handle = telemetry.target or telemetry.step.tip
