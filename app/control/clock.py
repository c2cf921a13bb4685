"""Timing of a control loop: what every tick took, summarised."""

from __future__ import annotations

import numpy as np

import vf
from app.control.messages import LoopStats

SUMMARIES = 4  # of the statistics, per second
NONE, TICKED, SKIPPED = 0, 1, 2  # what a period of the loop was


class Clock:
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


class Timing:
    """A clock that only keeps what it was told last, for a `Clock` in another process.

    Attributes:
        stats: none.
        last: what the period was, status, overrun, started, late and spent as in `Clock.record`.
    """

    def __init__(self) -> None:
        self.stats = LoopStats()
        self.last: tuple[int, int, bool, float, float, float] = (NONE, 0, False, 0.0, 0.0, 0.0)

    def record(
        self, status: vf.Status, started: float, late: float, spent: float, overrun: bool
    ) -> None:
        """Note one tick."""
        self.last = TICKED, int(status), overrun, started, late, spent

    def skip(self, started: float) -> None:
        """Note a period without a tick."""
        self.last = SKIPPED, 0, False, started, 0.0, 0.0
