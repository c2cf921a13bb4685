"""Records a running loop without delaying it: the loop appends to a queue, a thread writes."""

from __future__ import annotations

import errno
import logging
import threading
from collections import deque
from pathlib import Path

from app.console import count
from app.control.engine import Orders
from app.control.messages import State, Telemetry
from app.recording.format import RecordingError
from app.recording.write import Recorder

log = logging.getLogger(__name__)

PERIOD = 0.05  # between two writes [s]
BEHIND = 20_000  # capacity of the queue [ticks]


class Tape:
    """A recording in progress.

    The control thread calls `begin` once and `take` after each tick, which only appends to a queue.
    A thread writes the queue to the file every `PERIOD`; what is written stays readable even if
    this process is killed. If the queue or the disk is full, the recording ends, with the reason in
    `note` and, if possible, in the file; the loop continues.

    Attributes:
        path: of the file; another one than was requested if that existed.
        asked: the path that was requested.
        begun: whether `begin` was called.
        note: why the recording ended before `finish`; empty: it did not.
        rows: number of ticks in the file.
    """

    def __init__(self, path: Path | str) -> None:
        """Make the file and start the writing thread.

        Raises:
            OSError: it cannot be made.
        """
        recorder = Recorder(path)
        self.path, self.asked = recorder.path, Path(path)
        self.begun = False
        self.note = ""
        self.rows = 0
        self._queue: deque[tuple[Orders, Telemetry, bool] | tuple[Orders, State]] = deque()
        self._newest: Orders | None = None
        self._ended = False
        self._stop = threading.Event()
        self._thread = threading.Thread(
            target=self._run, args=(recorder,), name="tape", daemon=True
        )
        self._thread.start()

    @property
    def running(self) -> bool:
        """Whether the writing thread runs."""
        return self._thread.is_alive()

    @property
    def outcome(self) -> str:
        """The result of the recording, in one sentence."""
        if not self.rows:
            return f"Nothing was recorded{': ' + self.note if self.note else ''}."
        ending = f"; it ended because {self.note}" if self.note else ""
        return f"Recorded {count(self.rows, 'tick')} to {self.path}{ending}.{self.elsewhere}"

    @property
    def elsewhere(self) -> str:
        """Why the file has another name than was requested, in one sentence; empty: it has not."""
        return f" ({self.asked.name} was there already.)" if self.path != self.asked else ""

    def begin(self, seen: Orders, state: State) -> None:
        """From the control thread: the state before the first recorded tick."""
        self._queue.append((seen, state))
        self.begun = True

    def take(self, orders: Orders, telemetry: Telemetry, ticked: bool) -> None:
        """From the control thread, after every advance of the engine. Never waits, never raises."""
        if not ticked and orders is self._newest:
            return  # paused: nothing happened
        self._newest = orders
        if len(self._queue) < BEHIND and not self._ended:
            self._queue.append((orders, telemetry, ticked))
        else:
            self._ended = True

    def lose(self) -> None:
        """Ticks were lost before they came here: the recording ends."""
        self._ended = True

    def end(self, note: str) -> None:
        """Finish, because of what `note` says."""
        self.note = self.note or note
        self.finish()

    def finish(self) -> None:
        """Write the rest of the queue and close the file. Safe to call twice."""
        self._stop.set()
        self._thread.join()

    def _run(self, recorder: Recorder) -> None:
        try:
            while not self._stop.wait(PERIOD) and not self._ended:
                self._drain(recorder)
            self._drain(recorder)
            if self._ended:
                self.note = self.note or f"the writing fell {BEHIND:,} ticks behind"
        except (RecordingError, OSError) as error:
            self.note = _reason(error)
        except Exception as error:
            log.exception("the recording failed")
            self.note = f"of an error of this program ({error!r})"
        self._ended = True
        # Whoever keeps the tape does not keep the scene.
        self._queue.clear()
        self._newest = None
        try:
            if recorder.rows:
                recorder.close(self.note)
        except (RecordingError, OSError) as error:
            self.note = self.note or _reason(error)
        self.rows = recorder.kept
        if not self.rows:
            recorder.discard()
        if self.note:
            log.warning("%s", self.outcome)

    def _drain(self, recorder: Recorder) -> None:
        queue = self._queue
        for _ in range(len(queue)):
            item = queue.popleft()
            if len(item) == 2:
                recorder.begin(*item)
            else:
                recorder.add(*item)
        recorder.flush()
        self.rows = recorder.kept


def _reason(error: Exception) -> str:
    if not isinstance(error, OSError):
        return str(error)
    full = error.errno in (errno.ENOSPC, errno.EDQUOT)
    return f"{'the disk is full' if full else 'the file cannot be written'} ({error.strerror})"
