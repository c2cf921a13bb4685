"""What a session asks of the host of its control loop: a thread of its own process, or another.

`app.control.loop` is the one, `app.control.process` the other.
"""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import vf
from app.control.clock import Clock, Timing
from app.control.engine import Orders
from app.control.mailbox import Mailbox
from app.control.messages import State, Telemetry
from app.devices.report import Report
from app.motion.movement import streamed
from app.motion.stream import Single, Stream
from app.recording.capture import Tape
from app.words import Refused


class Host(ABC):
    """Runs an `Engine`: orders come from one mailbox, telemetry goes to another.

    Attributes:
        orders: where the session puts its orders; the newest counts.
        telemetry: has the newest tick.
        tape: the current recording or, if there is none, the last one; None: there was none.
        clock: is told the timing of every tick.
        ended: why the loop ended without having been told to; empty: it did not.
        devices: how the devices were last; None: there are none but the page and its arm.
    """

    clock: Clock | Timing

    def __init__(self, orders: Mailbox[Orders], telemetry: Mailbox[Telemetry]) -> None:
        self.orders = orders
        self.telemetry = telemetry
        self.ended = ""
        self.devices: Report | None = None
        self.tape: Tape | None = None
        self._tape: Tape | None = None  # gets every tick
        self._recording = threading.Lock()  # for starting and ending a recording; not in ticks

    @property
    @abstractmethod
    def alive(self) -> bool:
        """Whether the loop runs."""

    @property
    @abstractmethod
    def place(self) -> tuple[int, int] | None:
        """Number of the process and of the thread that the loop runs in; None: it does not."""

    @abstractmethod
    def share(self, surfaces: Sequence[vf.Surface]) -> None:
        """Make surfaces ready for a plant to come. It may take long, in contrast to the plant.

        Raises:
            OSError: there is no memory for it.
        """

    @abstractmethod
    def start(self) -> None:
        """Start the loop; it ticks until `close`."""

    @abstractmethod
    def close(self) -> None:
        """Stop, wait for the loop, finish a recording. Safe to call twice, or before `start`."""

    @abstractmethod
    def restart(self) -> None:
        """Run again after it `ended`, from the last tick and with the newest orders.

        Raises:
            Refused: it has not ended, or cannot be started again.
        """

    @abstractmethod
    def state_command(self, word: str) -> None:
        """Order a state of the arm: "enable", "disable", "pause", "resume"."""

    @abstractmethod
    def show(self, stream: Stream, vertices: Single, late: float) -> bool:
        """Hand on a shape that has come for a structure, see `Stream.hear`.

        Returns:
            Whether the loop has it.
        """

    def _continued(self, state: State, seen: Orders) -> State:
        """The state to go on from after an end, with the newest orders taken as seen.

        Args:
            state: after the last tick.
            seen: the orders it was made by.
        """
        orders = self.orders.get()
        assert orders is not None
        state = replace(state, steps=orders.steps)
        if orders.resets != seen.resets or orders.plant.scene != seen.plant.scene:
            # What was ordered meanwhile: the tool is put to the start.
            start = orders.plant.q0
            same = orders.plant.scene == seen.plant.scene
            goes_on = same and streamed(orders.plant.courses) is not None
            phase = state.phase if goes_on else 0.0
            state = replace(
                state, q=start, target=None, autopilot_since=None, step=None, phase=phase
            )  # fmt: skip
        return state

    def _fail(self, why: str) -> None:
        """Say why the loop ended, and close the recording."""
        tape, self._tape = self._tape, None
        if tape is not None:
            tape.end(f"the control loop ended ({why})")
        self.ended = why

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
        """Wait until a tick ran in this scene, if the loop runs."""
        deadline = time.monotonic() + timeout
        while self.alive and time.monotonic() < deadline:
            telemetry = self.telemetry.get()
            if telemetry is not None and telemetry.scene == version and telemetry.step is not None:
                return
            time.sleep(1e-3)
