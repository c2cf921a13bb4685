"""The control process: the control loop, and nothing else. Run as a module by `handle`.

Its main thread takes messages from the page's process and builds plants; the control thread reads
its orders from shared memory and writes what became of them there.

It outlives the page's process. If that is gone, the tool holds: an arm keeps its place, whoever
stopped giving orders. The simulated arm is let go of after `HOLD_ALONE`, so that no process is left
for good.
"""

from __future__ import annotations

import contextlib
import logging
import os
import select
import signal
import socket
import sys
import time
from dataclasses import replace
from types import FrameType
from typing import Any

import numpy as np

import robots
import vf
from app.control.clock import Timing
from app.control.engine import Orders, Plant
from app.control.loop import ControlLoop
from app.control.mailbox import Mailbox
from app.control.messages import Command, State, Telemetry
from app.control.plant import assemble
from app.control.priority import BUILD_PRIORITY, raise_process_priority, raise_thread_priority
from app.control.process import surfaces, wire
from app.control.process.channel import Channel
from app.control.process.gaps import Gaps
from app.control.process.shared import Memory, Queue, Slot
from app.devices.spec import Spec
from app.devices.station import Station
from app.motion import stream as streams
from app.words import OptionError

log = logging.getLogger("vf-sandbox control")

HOLD_ALONE = 5.0  # how long the simulated arm is held when nobody is left to give orders [s]
PERIOD = 0.2  # between two looks at the loop; each may keep a tick waiting for microseconds [s]


class Inbox(Mailbox[Orders]):
    """The orders in shared memory, for the control thread.

    Attributes:
        plants: those that were built, by number.
        number, plant: of the orders in force, and of their plant.
    """

    __slots__ = ("_alone", "_count", "_slot", "number", "plant", "plants")

    def __init__(self, slot: Slot) -> None:
        super().__init__()
        self.plants: dict[int, Plant] = {}
        self.number = self.plant = 0
        self._slot = slot
        self._count = 0
        self._alone = False

    def get(self) -> Orders | None:
        """The newest orders whose plant is there; None: there never were any."""
        if self._slot.count != self._count and not self._alone:
            self._read()
        return self._value

    def hold(self) -> None:
        """Orders to hold the tool, whatever comes; nobody is left to give others."""
        self._alone = True
        held = self._value
        if held is not None:
            sequence = held.command.sequence + 1
            self._value = replace(held, command=Command(None, sequence), autopilot=False)

    def _read(self) -> None:
        count = self._slot.count
        message = self._slot.read()
        if message is None:
            return
        number, plant = wire.numbers_of(message)
        if plant in self.plants:
            self._value = wire.unpack_orders(message, self.plants[plant])
            self.number, self.plant, self._count = number, plant, count


class Child:
    """What the control process does."""

    def __init__(self, channel: Channel, memory: Memory) -> None:
        self._channel = channel
        self._inbox = Inbox(Slot(memory.data[: Slot.SIZE]))
        self._queue = Queue(memory.data[Slot.SIZE :])
        self._surfaces: list[vf.Surface] = []  # those of the newest plant
        self._loop: ControlLoop | None = None
        self._station: Station | None = None
        self._told: str = ""  # why to end

    def run(self) -> str:
        """Do what the page's process says until it says to end; returns why it ended otherwise."""
        while not self._told:
            ready, _, _ = select.select([self._channel], [], [], PERIOD)
            if ready:
                try:
                    content, fd = self._channel.receive()
                except EOFError:
                    return self._alone()
                if content[0] == "close":
                    break
                self._obey(content, fd)
            self._forget_plants()
            if self._station is not None:
                self.tell("devices", self._station.report)
            if self._loop is not None and not self._loop.alive:
                self._told = self._loop.ended or "the control loop ended"
        if self._loop is not None:
            self._loop.close()
        return self._told

    def stop(self, number: int, _frame: FrameType | None) -> None:
        """The handler of a signal: end in order."""
        self._told = f"it was told to ({signal.Signals(number).name})"

    def tell(self, *content: Any) -> None:
        """Send a message to the page's process."""
        with contextlib.suppress(OSError):  # it ended: the next look at the channel says so
            self._channel.send(*content)

    def _obey(self, content: tuple[Any, ...], fd: int | None) -> None:
        kind, *rest = content
        if kind == "warm":
            vf.Controller(robots.load("point"), [])  # compiles the kernels, or loads them
        elif kind == "surface":
            assert fd is not None
            place, *shared = rest
            self._surfaces = [*self._surfaces[:place], surfaces.attach(fd, *shared)]
        elif kind == "plant":
            self._build(*rest)
        elif kind == "start":
            self._start(*rest)
        elif kind == "shape":
            assert fd is not None
            self._show(Memory(fd, write=False), *rest)
        elif kind == "state" and self._station is not None:
            self._station.order(*rest)

    def _show(self, memory: Memory, key: str, count: int, late: float) -> None:
        """Take a shape that came for a structure, and say from when on it is the structure's."""
        memory.forget()
        stream = streams.known(key)
        if stream is None:  # of a scene that is no more, or not yet
            self.tell("shape", None)
            return
        vertices = np.frombuffer(memory.data, np.float32, 3 * count).reshape(-1, 3)
        frame = stream.hear(vertices, late)
        self.tell("shape", (frame.number, frame.shape, frame.seen))

    def _build(self, number: int, data: bytes) -> None:
        try:
            with Gaps(self._loop):
                description = surfaces.unpack(data, self._surfaces)
                plant = assemble(description, robots.load(description.robot))
        except Exception as error:
            log.exception("a plant could not be built")
            self.tell("failed", number, f"{type(error).__name__}: {error}")
            return
        self._inbox.plants[number] = plant
        self.tell("built", number)

    def _forget_plants(self) -> None:
        """Drop what is not in force any more; here, since the control thread has better to do."""
        plants = self._inbox.plants
        for number in [number for number in plants if number < self._inbox.plant]:
            del plants[number]

    def _start(self, dt: float, state: State | None, spec: Spec | None) -> None:
        timing = Timing()
        if spec is not None:
            first = self._inbox.get()
            assert first is not None
            try:
                self._station = Station(spec, first.plant.q0 if state is None else state.q)
            except OptionError as error:
                self._told = str(error)
                return

        def told(orders: Orders, telemetry: Telemetry, ticked: bool) -> None:
            made = None if spec is None else orders
            queue.put(teller.message(inbox.number, telemetry, ticked, made))

        queue, inbox = self._queue, self._inbox
        loop = ControlLoop(
            inbox, Mailbox(), dt, told, state=state, clock=timing, devices=self._station
        )
        teller = wire.Teller(loop.engine, timing)
        self._loop = loop
        loop.start()
        place = loop.place
        self.tell("running", None if place is None else place[1])

    def _alone(self) -> str:
        """The page's process is gone: hold, and end after a while."""
        loop = self._loop
        if loop is None or not loop.alive:
            return ""
        self._inbox.hold()
        if self._station is not None:
            self._station.order("disable")
        log.warning(
            "the page's process ended: the tool holds where it is; nobody can give orders any "
            "more, so the simulated arm is let go of in %g s",
            HOLD_ALONE,
        )
        until = time.monotonic() + HOLD_ALONE
        while loop.alive and not self._told and time.monotonic() < until:
            time.sleep(PERIOD)
        loop.close()
        log.warning("ended")
        return ""


def _main(channel: int, memory: int) -> int:
    # Its own errors end a line of the log, not this process.
    logging.raiseExceptions = False
    logging.basicConfig(format="%(name)s: %(message)s", level=logging.WARNING)
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    raise_process_priority()
    raise_thread_priority(BUILD_PRIORITY)
    child = Child(Channel(socket.socket(fileno=channel)), Memory(memory, write=True))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the page's process says when to end
    signal.signal(signal.SIGTERM, child.stop)
    why = child.run()
    if why:
        child.tell("ended", why)
    return 1 if why else 0


if __name__ == "__main__":
    # Imported, so that pickled classes belong to `app.control.process.child`, not to `__main__`.
    from app.control.process.child import _main as _named

    sys.exit(_named(int(sys.argv[1]), int(sys.argv[2])))
