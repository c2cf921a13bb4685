"""Records a running loop without holding it up: the loop appends, another thread writes."""

from __future__ import annotations

import logging
import threading
from collections import deque
from pathlib import Path

from app.engine import Orders, State
from app.messages import Telemetry
from app.recording.format import RecordingError
from app.recording.write import Recorder

log = logging.getLogger(__name__)

PERIOD = 0.05  # between two rounds of the writing thread [s]
BEHIND = 20_000  # ticks that may wait to be written


class Tape:
    """One recording under way.

    The control thread calls `begin` once and `take` after each tick: a look at a length and an
    append. If the writing thread falls behind by `BEHIND` ticks, or the disk is full, the recording
    ends there, with the reason in the file and in `note`; the loop goes on.

    Attributes:
        path: of the file, which is there once `running` is False, unless nothing was recorded.
        begun: whether `begin` was called.
        note: why the recording ended, if it was not told to.
    """

    def __init__(self, path: Path | str) -> None:
        """Open the file and start the writing thread.

        Raises:
            RecordingError: the file exists.
            OSError: it cannot be written.
        """
        self._recorder = Recorder(path)
        self.path = self._recorder.path
        self.begun = False
        self.note = ""
        self.rows = 0
        """How many ticks are written."""
        self._queue: deque[tuple[Orders, Telemetry, bool] | tuple[Orders, State]] = deque()
        self._lost = False
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="tape", daemon=True)
        self._thread.start()

    @property
    def running(self) -> bool:
        """Whether ticks are still taken or written."""
        return self._thread.is_alive()

    @property
    def outcome(self) -> str:
        """A sentence on what came of it."""
        if not self.rows:
            return f"Nothing was recorded{': ' + self.note if self.note else ''}."
        ending = f"; it ended because {self.note}" if self.note else ""
        return f"Recorded {self.rows:,} ticks to {self.path}{ending}."

    def begin(self, seen: Orders, state: State) -> None:
        """From the control thread: what the ticks to come start from."""
        self._queue.append((seen, state))
        self.begun = True

    def take(self, orders: Orders, telemetry: Telemetry, ticked: bool) -> None:
        """From the control thread, after every advance of the engine. Never waits, never raises."""
        if not ticked and orders is self._newest:
            return  # paused: nothing happened
        self._newest = orders
        if len(self._queue) < BEHIND and not self._lost:
            self._queue.append((orders, telemetry, ticked))
        else:
            self._lost = True

    _newest: Orders | None = None

    def finish(self) -> None:
        """Write what is still waiting and wait for the file. Safe to call twice."""
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        recorder = self._recorder
        try:
            while not self._stop.wait(PERIOD) and not self._lost:
                self._drain()
            self._drain()
            if self._lost:
                self.note = f"the writing fell {BEHIND:,} ticks behind"
        except (RecordingError, OSError) as error:
            self.note = str(error)
        except Exception as error:
            log.exception("the recording failed")
            self.note = f"of an error of this program ({error!r})"
        self._lost = True  # nothing is taken any more
        self._queue.clear()
        try:
            if recorder.rows:
                recorder.close(self.note)
            else:
                recorder.discard()
        except (RecordingError, OSError) as error:
            self.note = str(error)
            self.rows = 0
            recorder.discard()
        if self.note:
            log.warning("%s", self.outcome)

    def _drain(self) -> None:
        queue, recorder = self._queue, self._recorder
        for _ in range(len(queue)):
            item = queue.popleft()
            if len(item) == 2:
                recorder.begin(*item)
            else:
                recorder.add(*item)
        self.rows = recorder.rows
