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
from collections.abc import Callable
from pathlib import Path

import numpy as np

import vf
from app.control.engine import Engine, Orders
from app.control.mailbox import Mailbox
from app.control.messages import LoopStats, Telemetry
from app.recording.capture import Tape
from app.refused import Refused

log = logging.getLogger(__name__)

SUMMARIES = 4  # of the statistics, per second
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
# Real-time priorities, where the system permits them.
CONTROL_PRIORITY = 10
VIEW_PRIORITY = 5


class ControlLoop:
    """Runs an `Engine` in its own thread: orders come from one mailbox, telemetry goes to another.

    A tick that ends after the next deadline is an overrun; the next deadline is then counted from
    its end, so that lost time is not made up for by faster ticks.

    Attributes:
        tape: the current recording or, if there is none, the last one; None: there was none.
    """

    def __init__(
        self,
        orders: Mailbox[Orders],
        telemetry: Mailbox[Telemetry],
        dt: float,
        watch: Callable[[Orders, Telemetry, bool], None] | None = None,
    ) -> None:
        """Does not start the thread. `watch` is called after every tick, like `Tape.take`."""
        first = orders.get()
        if first is None:
            raise ValueError("the loop needs orders to start from")
        self._orders = orders
        self._telemetry = telemetry
        self._dt = dt
        self._watch = watch
        self._engine = Engine(first)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="control")
        self._clock = _Clock(dt)
        self._recording = threading.Lock()  # for starting and ending a recording; not in ticks
        self._tape: Tape | None = None  # gets every tick
        self.tape: Tape | None = None
        telemetry.put(self._engine.look(first, self._clock.stats))

    @property
    def alive(self) -> bool:
        """Whether the thread runs."""
        return self._thread.is_alive()

    def start(self) -> None:
        """Start the thread; it ticks until `close`."""
        self._thread.start()

    def close(self) -> None:
        """Stop, wait for the thread, finish a recording. Safe to call twice, or before `start`."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()
        self._tape = None
        if self.tape is not None:
            self.tape.finish()

    def record(self, path: Path | str) -> Tape:
        """Record from the next tick on.

        Raises:
            Refused: a recording is under way, or the file cannot be made.
        """
        with self._recording:
            if self.tape is not None and self.tape.running:
                raise Refused("a recording is under way: stop it first")
            try:
                self.tape = self._tape = Tape(path)
            except OSError as error:
                raise Refused(f"cannot record to {path}: {error.strerror or error}") from None
            return self.tape

    def stop_recording(self) -> Tape:
        """Finish the recording's file; waits until it is written.

        Raises:
            Refused: there is no recording.
        """
        with self._recording:
            tape, self._tape = self._tape, None
        if tape is None:
            raise Refused("nothing is being recorded")
        tape.finish()
        return tape

    def wait_for_scene(self, version: int, timeout: float = 5.0) -> None:
        """Wait until a tick ran in this scene, if the thread runs."""
        deadline = time.monotonic() + timeout
        while self.alive and time.monotonic() < deadline:
            telemetry = self._telemetry.get()
            if telemetry is not None and telemetry.scene == version and telemetry.step is not None:
                return
            time.sleep(1e-3)

    def _run(self) -> None:
        _request_realtime()
        with _realtime_interpreter():
            try:
                self._loop()
            except Exception:
                # An error of the loop itself: those of a tick end in HELD.
                log.exception("the control thread stopped")
                raise

    def _loop(self) -> None:
        engine, clock, dt = self._engine, self._clock, self._dt
        now = time.perf_counter
        spin = min(SPIN, 0.1 * dt)
        deadline = now() + dt
        while not self._stop.is_set():
            pause = deadline - spin - now()
            if pause > 0.0:
                time.sleep(pause)
            started = now()
            while started < deadline:
                started = now()
            orders = self._orders.get()
            assert orders is not None
            tape = self._tape
            if tape is not None and not tape.begun:
                tape.begin(engine.seen, engine.state)
            telemetry, ticked = engine.advance(orders, clock.stats)
            self._telemetry.put(telemetry)
            if tape is not None:
                tape.take(orders, telemetry, ticked)
            if self._watch is not None:
                self._watch(orders, telemetry, ticked)
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


class _Clock:
    """Timing of the last second in ring buffers, summarised `SUMMARIES` times a second."""

    def __init__(self, dt: float) -> None:
        size = max(10, round(1.0 / dt))
        self.stats = LoopStats()
        self._spent = np.zeros(size)  # [s]
        self._late = np.zeros(size)  # [s]
        self._starts = np.zeros(size)  # [s]
        self._filled = 0
        self._next = 0
        self._overruns = 0
        self._counts = dict.fromkeys(vf.Status, 0)
        self._due = 0.0
        self._idle = False

    def record(
        self, status: vf.Status, started: float, late: float, spent: float, overrun: bool
    ) -> None:
        """Note one tick; times in seconds of the monotonic clock."""
        if self._idle:
            # Samples from before a pause would falsify the rate.
            self._idle = False
            self._filled = self._next = 0
        k = self._next
        self._spent[k], self._late[k], self._starts[k] = spent, late, started
        self._next = (k + 1) % len(self._spent)
        self._filled = min(self._filled + 1, len(self._spent))
        self._overruns += overrun
        self._counts[status] += 1
        if started >= self._due:
            self._due = started + 1.0 / SUMMARIES
            self._summarise()

    def skip(self, started: float) -> None:
        """Note a period without a tick (paused)."""
        if not self._idle or started >= self._due:
            self._idle = True
            self._due = started + 1.0 / SUMMARIES
            self._summarise()

    def _summarise(self) -> None:
        n = self._filled
        if n == 0:
            self.stats = LoopStats(overruns=self._overruns, counts=dict(self._counts))
            return
        spent, late = self._spent[:n], self._late[:n]
        newest = self._starts[self._next - 1]
        oldest = self._starts[self._next % n]
        k = int(0.99 * (n - 1))
        self.stats = LoopStats(
            rate=float((n - 1) / (newest - oldest)) if newest > oldest else 0.0,
            tick_median=float(np.partition(spent, n // 2)[n // 2]),
            tick_worst=float(spent.max()),
            late_p99=float(np.partition(late, k)[k]),
            late_worst=float(late.max()),
            overruns=self._overruns,
            counts=dict(self._counts),
        )


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


def raise_process_priority() -> None:
    """Raise this process's scheduling priority, where the system permits it.

    Call it before other threads are started: they inherit it. The control thread's own priority is
    not enough: it waits for the thread that holds the interpreter lock, which may be preempted by
    another process such as a browser.
    """
    if sys.platform.startswith("linux"):
        with contextlib.suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, 0, -10)


def _request_realtime() -> None:
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


def raise_thread_priority(priority: int) -> None:
    """Schedule the calling thread in real time if the system permits it, else raise its priority.

    Threads and processes that it starts do not inherit real-time scheduling.
    """
    if not sys.platform.startswith("linux"):
        return
    thread = threading.get_native_id()
    try:
        policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(thread, policy, os.sched_param(priority))
    except OSError:
        with contextlib.suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, thread, -10)
