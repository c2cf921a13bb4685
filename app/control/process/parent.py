"""The control loop in a process of its own, from the page's side. The other side is `child`.

Whatever the page's process does, no tick is late for it: health reports, uploads and drawing have
an interpreter of their own. Orders go there and ticks come from there through shared memory, which
has no name: nothing is left of it when both processes have ended, however they did.
"""

from __future__ import annotations

import contextlib
import logging
import select
import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import vf
from app.control.clock import SKIPPED, TICKED, Clock
from app.control.engine import Orders, Plant
from app.control.host import Host
from app.control.mailbox import Mailbox
from app.control.messages import LoopStats, State, Telemetry
from app.control.plant import describe
from app.control.priority import VIEW_PRIORITY, raise_thread_priority
from app.control.process import surfaces, wire
from app.control.process.handle import PATIENCE, Child
from app.control.process.shared import Memory, Queue, Slot
from app.devices.spec import Spec
from app.motion.stream import Frame, Single, Stream
from app.recording.capture import Tape
from app.words import Refused

log = logging.getLogger(__name__)

PERIOD = 0.01  # between two looks at the ticks [s]
START = 120.0  # for its first tick: it may have to compile the kernels [s]


class _Inbox(Mailbox[Orders]):
    """Puts orders into shared memory as well."""

    __slots__ = ("_post",)

    def __init__(self, value: Orders, post: Callable[[Orders], None]) -> None:
        super().__init__(value)
        self._post = post

    def put(self, value: Orders) -> None:
        """Replace the orders.

        Raises:
            Refused: the control process cannot use their plant; the orders before stay.
        """
        self._post(value)
        super().put(value)


class _Outbox(Mailbox[Telemetry]):
    """The newest tick in shared memory."""

    __slots__ = ("_newest", "_number")

    def __init__(
        self, value: Telemetry, newest: Callable[[int], tuple[int, Telemetry] | None]
    ) -> None:
        super().__init__(value)
        self._number = 0
        self._newest = newest

    def get(self) -> Telemetry | None:
        """The newest tick, the same object as before if there is no newer one."""
        found = self._newest(self._number)
        if found is not None:
            self._number, self._value = found
        return self._value


class ControlProcess(Host):
    """Runs an `Engine` in another process.

    A thread of this process reads every tick for the recorder and the watch. If it falls behind so
    far that the shared memory is full, ticks are lost for them, and counted.

    Attributes:
        clock: the timing of the ticks.
    """

    def __init__(
        self,
        child: Child,
        orders: Orders,
        dt: float,
        watch: Callable[[Orders, Telemetry, bool], None],
        missed: Callable[[int], None],
        spec: Spec | None = None,
    ) -> None:
        """Give a new process its first orders; it does not tick yet.

        Args:
            child: belongs to this object from here on.
            dt: length of a tick [s].
            watch: called with every tick, from a thread of its own.
            missed: called with how many ticks `watch` was not called for.
            spec: of masters and arms that are elsewhere.

        Raises:
            Refused: the process cannot use these orders.
        """
        self._child = child
        self._slot = Slot(child.memory.data[: Slot.SIZE])
        self._queue = Queue(child.memory.data[Slot.SIZE :])
        self._dt = dt
        self._spec = spec
        self._listener = wire.Listener(dt)
        self._watch, self._missed = watch, missed
        self.clock = Clock(dt)
        self._changed = threading.Condition()  # something came from the process
        self._reading = threading.Lock()
        # What became of the shape that was shown last; None: not known yet.
        self._taken_over: tuple[tuple[int, int, float] | None] | None = None
        self._showing = threading.Lock()
        self._running = False
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="control link", daemon=True)
        # Orders that were put, but for those before the ones that were in force when a tick was
        # read last.
        self._put: deque[tuple[int, Orders]] = deque()
        self._number = 0  # of the newest orders
        self._plants = 0  # how many plants there were
        self._plant: Plant | None = None  # the newest
        # What was read last: number of the message, its orders, what has the engine's state.
        self._taken = 0
        self._seen = orders
        self._last: wire.Told | State = State(
            q=orders.plant.q0, tick=0, steps=orders.steps, silent=0, autopilot_since=None,
            target=None, stale=False,
        )  # fmt: skip
        first = Telemetry(
            tick=0, time=0.0, q=orders.plant.q0, target=None, step=None, stats=LoopStats(),
            scene=orders.plant.scene, sequence=orders.command.sequence, paused=orders.paused,
            autopilot=orders.autopilot, stale=False,
        )  # fmt: skip
        super().__init__(_Inbox(orders, self._post), _Outbox(first, self._newer))
        self._post(orders)

    @property
    def alive(self) -> bool:
        return self._running and not self.ended

    @property
    def place(self) -> tuple[int, int] | None:
        thread = self._child.thread
        return None if thread is None else (self._child.process.pid, thread)

    def share(self, surfaces: Sequence[vf.Surface]) -> None:
        self._child.share(surfaces)

    def start(self) -> None:
        """Start the loop, and wait for its first tick.

        Raises:
            Refused: the process ended, or is not ready in time.
        """
        self._begin(None)

    def close(self) -> None:
        self._stop.set()
        self._child.end()
        if self._thread.is_alive():
            self._thread.join()  # it sees that the other end is closed
        self._child.leave()
        self._running = False
        self._drain()
        self._tape = None
        if self.tape is not None:
            self.tape.finish()

    def restart(self) -> None:
        if not self.ended:
            raise Refused("the control process runs")
        self._thread.join()
        orders = self.orders.get()
        assert orders is not None
        state = self._last = self._continued(self._state, self._seen)
        self._seen = orders
        try:
            self._child = Child(self._child)
        except OSError as error:
            raise Refused(f"the control process cannot be started: {error}") from None
        self.ended = ""
        if self._spec is not None and self._spec.arm != "sim":
            # An arm that is elsewhere is enabled by a person, after an accident too.
            self._spec = replace(self._spec, enable=False)
        self._hand_over(self._plants, orders.plant)
        self._thread = threading.Thread(target=self._run, name="control link", daemon=True)
        self._begin(state)

    def state_command(self, word: str) -> None:
        with contextlib.suppress(OSError):  # the process ended
            self._child.channel.send("state", word)

    def show(self, stream: Stream, vertices: Single, late: float) -> bool:
        with self._showing:
            if not self.alive:
                return False
            self._taken_over = None
            try:
                memory = Memory.create(vertices.nbytes)
                memory.data[:] = vertices.data.cast("B")
                content = ("shape", stream.key, len(vertices), late)
                self._child.channel.send(*content, fd=memory.fd)
                memory.forget()
            except OSError:  # the process ended, or there is no memory
                return False
            self._wait(lambda: self._taken_over is not None, PATIENCE)
            found = self._taken_over
            if found is None or found[0] is None:
                return False
            stream.put(Frame(*found[0], vertices))
            return True

    def stop_recording(self) -> Tape:
        self._drain()  # the ticks up to now
        return super().stop_recording()

    def _begin(self, state: State | None) -> None:
        child = self._child
        with contextlib.suppress(OSError):
            child.channel.send("start", self._dt, state, self._spec)
        self._thread.start()
        self._wait(lambda: child.thread is not None, START)
        if child.thread is None:
            why = self.ended or "it did not answer"
            raise Refused(f"the control process could not be started: {why}")
        self._running = True

    def _wait(self, condition: Callable[[], bool], patience: float) -> None:
        """Wait until the condition holds, the process ended, or so much time [s] is over."""
        with self._changed:
            self._changed.wait_for(lambda: condition() or bool(self.ended), patience)

    def _post(self, orders: Orders) -> None:
        """Put orders into shared memory, after their plant is built there.

        Raises:
            Refused: it cannot be.
        """
        if orders.plant is not self._plant:
            number = self._plants + 1
            if not self.ended:
                self._hand_over(number, orders.plant)
            self._plants, self._plant = number, orders.plant
        self._number += 1
        self._put.append((self._number, orders))
        self._slot.write(wire.pack_orders(self._number, self._plants, orders))

    def _hand_over(self, number: int, plant: Plant) -> None:
        """Have the process build a plant; waits for it while the loop runs.

        Raises:
            Refused: it cannot be built there.
        """
        child = self._child
        try:
            data = surfaces.pack(describe(plant))
        except Exception as error:
            raise Refused(f"what the control process cannot be given: {error}") from None
        try:
            shared = child.share(plant.surfaces)
        except OSError as error:
            raise Refused(f"no shared memory for the mesh: {error}") from None
        with contextlib.suppress(OSError):  # the process ended: its orders wait
            if child.has != shared:
                for place, one in enumerate(shared):
                    child.channel.send("surface", place, one.pickled, one.places, fd=one.memory.fd)
                child.has = shared
            child.channel.send("plant", number, data)
        if self._running:
            self._wait(lambda: child.built >= number or number in child.failed, PATIENCE)
            if number in child.failed:
                raise Refused(f"the control process cannot use this: {child.failed[number]}")
            if child.built < number and not self.ended:
                raise Refused("the control process does not answer; nothing is changed")

    def _newer(self, number: int) -> tuple[int, Telemetry] | None:
        """The newest tick and its number, if that is another one."""
        found = self._queue.newest()
        if found is None or found[0] == number:
            return None
        told = wire.Listener(self._dt).told(found[1], self.clock.stats, None)
        return found[0], told.telemetry

    def _run(self) -> None:
        """Read messages and ticks until the process ends."""
        # As those of the page's threads that wait for the interpreter lock when this one has it.
        raise_thread_priority(VIEW_PRIORITY)
        channel = self._child.channel
        while True:
            ready, _, _ = select.select([channel], [], [], PERIOD)
            if ready:
                try:
                    content, _ = channel.receive()
                except EOFError:
                    break
                self._hear(*content)
            try:
                self._drain()
            except Exception:
                log.exception("ticks could not be read")
        self._drain()
        if not self._stop.is_set():
            self._end()

    def _hear(self, kind: str, *rest: Any) -> None:
        child = self._child
        with self._changed:
            if kind == "built":
                child.built = rest[0]
            elif kind == "failed":
                child.failed[rest[0]] = rest[1]
            elif kind == "running":
                child.thread = rest[0]
            elif kind == "shape":
                self._taken_over = (rest[0],)
            elif kind == "devices":
                self.devices = rest[0]
            elif kind == "ended":
                child.ending = rest[0]
            self._changed.notify_all()

    def _end(self) -> None:
        """The process ended, and nobody told it to."""
        why = self._child.end()
        self._child.channel.close()
        log.error("the control process ended: %s", why)
        with self._changed:
            self._running = False
            self._fail(why)
            self._changed.notify_all()

    def _drain(self) -> None:
        """Hand all new ticks to recorder and watch."""
        with self._reading:
            for number, message in self._queue.take():
                lost = number - self._taken - 1
                before = self._step if lost == 0 else None
                told = self._listener.told(message, self.clock.stats, before)
                self._taken = number
                tape = self._tape
                if lost > 0:
                    self._missed(lost)
                    if tape is not None:
                        tape.lose()
                what, status, overrun, started, late, spent = told.timing
                if what == TICKED:
                    self.clock.record(vf.Status(status), started, late, spent, overrun)
                elif what == SKIPPED:
                    self.clock.skip(started)
                orders = told.orders(self._orders_of(told.order))
                if tape is not None:
                    if not tape.begun:
                        tape.begin(self._seen, self._state)
                    tape.take(orders, told.telemetry, told.ticked)
                self._watch(orders, told.telemetry, told.ticked)
                self._seen, self._last = orders, told

    @property
    def _state(self) -> State:
        """The engine's state after what was read last."""
        last = self._last
        return last if isinstance(last, State) else last.state

    @property
    def _step(self) -> vf.Step | None:
        """The step of what was read last."""
        last = self._last
        return last.step if isinstance(last, State) else last.telemetry.step

    def _orders_of(self, number: int) -> Orders:
        """The orders of this number; earlier ones are forgotten."""
        put = self._put
        while len(put) > 1 and put[1][0] <= number:
            put.popleft()
        return put[0][1]
