"""The control thread: ticks at absolute deadlines; missed ticks are counted, not made up for."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import logging
import os
import sys
import threading
import time
from collections.abc import Callable, Sequence
from typing import Protocol

import vf
from app.control.clock import Clock, Timing
from app.control.engine import Engine, Orders
from app.control.host import Host
from app.control.mailbox import Mailbox
from app.control.messages import State, Telemetry
from app.control.priority import CONTROL_PRIORITY, raise_thread_priority
from app.devices import protocols
from app.devices.report import Report
from app.motion.stream import Single, Stream
from app.words import Refused

log = logging.getLogger(__name__)

# Python's switch interval: a thread waits this long for the interpreter lock (GIL) before it
# requests it [s]. On wake-up the control thread waits a few intervals, since the page's threads
# compete with it. With a browser on the same two cores 99.97 % of ticks were less than 1 ms late at
# 20 µs, 99.93 % at 50 µs, 99.2 % at 100 µs and 98.5 % at 200 µs.
SWITCH_INTERVAL = 2e-5
# Each timed wait costs processor time, 20 to 60 µs on a virtual machine. If the waiting real-time
# threads (up to three) use up all cores, the thread that holds the lock never runs. So the interval
# is at least this factor times the cost of a wait, divided by the number of cores.
WAIT_COST_FACTOR = 4.0
LONGEST_INTERVAL = 2e-4  # upper bound of the switch interval [s]
# Wake-ups are about 50 µs late, so the loop busy-waits for this long before a deadline [s]; other
# threads still get the interpreter lock within the switch interval.
SPIN = 1e-4


class Devices(Protocol):
    """Masters and arms; see `app.devices.station`. No method blocks or raises."""

    @property
    def arm(self) -> protocols.Arm: ...

    @property
    def report(self) -> Report: ...

    def order(self, word: str) -> None:
        """A `state_command`, from any thread."""
        ...

    def before(self, orders: Orders, latest: Telemetry | None) -> Orders:
        """The orders of a tick, from those of the page and the tick before."""
        ...

    def after(self, telemetry: Telemetry, ticked: bool) -> None:
        """Tell the devices what became of it."""
        ...

    def close(self) -> None: ...


class ControlLoop(Host):
    """Runs an `Engine` in a thread of this process.

    A tick that ends after the next deadline is an overrun; the next deadline is then counted from
    its end, so that lost time is not made up for by faster ticks.

    Attributes:
        engine: the engine; only for the thread, and before it is started.
        dt: length of a tick [s].
        deadline: when the next tick is due, of `time.perf_counter` [s].
    """

    def __init__(
        self,
        orders: Mailbox[Orders],
        telemetry: Mailbox[Telemetry],
        dt: float,
        watch: Callable[[Orders, Telemetry, bool], None] | None = None,
        *,
        state: State | None = None,
        arm: protocols.Arm | None = None,
        devices: Devices | None = None,
        clock: Clock | Timing | None = None,
    ) -> None:
        """Does not start the thread.

        Args:
            dt: length of a tick [s].
            watch: called after every tick, like `Tape.take`.
            state, arm: as in `Engine`.
            devices: masters and arms that are elsewhere; closed with the loop.
            clock: is told the timing of every tick; None: one of its own.
        """
        super().__init__(orders, telemetry)
        first = orders.get()
        if first is None:
            raise ValueError("the loop needs orders to start from")
        self.dt = dt
        self.deadline = 0.0
        self._watch = watch
        self._devices = devices
        self._arm = arm if devices is None else devices.arm
        self.engine = Engine(first, state, self._arm)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="control")
        self.clock = Clock(dt) if clock is None else clock
        telemetry.put(self.engine.look(first, self.clock.stats))

    @property
    def alive(self) -> bool:
        return self._thread.is_alive()

    @property
    def place(self) -> tuple[int, int] | None:
        thread = self._thread.native_id
        return None if thread is None else (os.getpid(), thread)

    def share(self, surfaces: Sequence[vf.Surface]) -> None:
        pass  # they are in this process already

    def start(self) -> None:
        self._thread.start()

    def tick(self) -> Telemetry:
        """Do the next tick at once, on this thread, instead of starting the loop.

        Raises:
            Refused: it is started: its ticks have a clock.
        """
        if self.alive:
            raise Refused("the control loop runs by itself")
        return self._advance(None)[0]

    def close(self) -> None:
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()
        if self._devices is not None:
            self._devices.close()
        self._tape = None
        if self.tape is not None:
            self.tape.finish()

    def state_command(self, word: str) -> None:
        if self._devices is not None:
            self._devices.order(word)

    def show(self, stream: Stream, vertices: Single, late: float) -> bool:
        stream.hear(vertices, late)
        return True

    def restart(self) -> None:
        if not self.ended:
            raise Refused("the control loop runs")
        orders = self.orders.get()
        assert orders is not None
        state = self._continued(self.engine.state, self.engine.seen)
        self.engine = Engine(orders, state, self._arm)
        self.ended = ""
        self._thread = threading.Thread(target=self._run, name="control")
        self._thread.start()

    def _run(self) -> None:
        request_realtime()
        with _realtime_interpreter():
            try:
                self._loop()
            except Exception:
                # An error of the loop itself: those of a tick end in HELD.
                log.exception("the control thread stopped")
                self._fail("an error of the control loop")

    def _loop(self) -> None:
        clock, dt = self.clock, self.dt
        telemetry: Telemetry | None = None
        now = time.perf_counter
        spin = min(SPIN, 0.1 * dt)
        deadline = now() + dt
        while not self._stop.is_set():
            self.deadline = deadline
            pause = deadline - spin - now()
            if pause > 0.0:
                time.sleep(pause)
            started = now()
            while started < deadline:
                started = now()
            telemetry, ticked = self._advance(telemetry)
            ended = now()
            late = deadline + dt
            if ticked:
                status = telemetry.step.status if telemetry.step else vf.Status.HELD
                clock.record(status, started, started - deadline, ended - started, ended > late)
            else:
                clock.skip(started)
            deadline = late if ended <= late else ended
            if ended > late:
                time.sleep(0)  # release the interpreter lock even when every tick is late

    def _advance(self, before: Telemetry | None) -> tuple[Telemetry, bool]:
        """A tick, with all who are told of it; returns its telemetry, and whether it ticked."""
        engine, devices, tape = self.engine, self._devices, self._tape
        orders = self.orders.get()
        assert orders is not None
        if tape is not None and not tape.begun:
            tape.begin(engine.seen, engine.state)
        if devices is not None:
            orders = devices.before(orders, before)
        telemetry, ticked = engine.advance(orders, self.clock.stats)
        if devices is not None:
            devices.after(telemetry, ticked)
            self.devices = devices.report
        self.telemetry.put(telemetry)
        if tape is not None:
            tape.take(orders, telemetry, ticked)
        if self._watch is not None:
            self._watch(orders, telemetry, ticked)
        return telemetry, ticked


class _realtime_interpreter(contextlib.ContextDecorator):
    """Shortens the switch interval and garbage collections while a control loop runs."""

    _lock = threading.Lock()
    _users = 0
    _interval = 5e-3

    def __enter__(self) -> None:
        cls = _realtime_interpreter
        with cls._lock:
            cls._users += 1
            if cls._users == 1:
                cls._interval = sys.getswitchinterval()
                sys.setswitchinterval(_switch_interval(_wait_cost()))
                # A full collection visits every object of numba, viser and Pinocchio with the
                # interpreter locked, for tens of milliseconds. Frozen objects are not visited; new
                # garbage is still collected.
                gc.collect()
                gc.freeze()

    def __exit__(self, *error: object) -> None:
        cls = _realtime_interpreter
        with cls._lock:
            cls._users -= 1
            if cls._users == 0:
                gc.unfreeze()
                sys.setswitchinterval(cls._interval)


def _wait_cost() -> float:
    """Processor time of a wait for a lock that times out after `SWITCH_INTERVAL` [s]."""
    lock = threading.Lock()
    lock.acquire()
    spent = []
    for _ in range(5):
        began = time.thread_time()
        for _ in range(10):
            lock.acquire(timeout=SWITCH_INTERVAL)
        spent.append((time.thread_time() - began) / 10)
    return min(spent)  # larger values contain interruptions


def _switch_interval(cost: float, cores: int | None = None) -> float:
    """The switch interval [s] for this cost of a wait [s], see `WAIT_COST_FACTOR`."""
    factor = WAIT_COST_FACTOR / (cores or os.cpu_count() or 1)
    return min(max(SWITCH_INTERVAL, factor * cost), LONGEST_INTERVAL)


def request_realtime() -> None:
    """On Linux, set a timer slack of 1 µs (default: 50 µs) and real-time scheduling, if permitted.

    Real-time scheduling keeps other programs from delaying ticks; it needs a privilege that desktop
    users seldom have. The loop sleeps nine tenths of its time, and the kernel limits the processor
    time of real-time threads.
    """
    if not sys.platform.startswith("linux"):
        return
    PR_SET_TIMERSLACK = 29
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(PR_SET_TIMERSLACK, ctypes.c_ulong(1000), 0, 0, 0)
    raise_thread_priority(CONTROL_PRIORITY)
