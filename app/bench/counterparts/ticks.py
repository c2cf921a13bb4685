"""What every tick of a session did, by its number."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.control.engine import Orders
from app.control.messages import Telemetry
from app.session import Session

PATIENCE = 20.0  # for a tick that must come [s]


class Ticks:
    """Listens to a session whose loop is a process of its own; before it is started.

    Attributes:
        newest: number of the newest tick.
        contacts: how often the tool came to where it is pushed back.
        pushed: ticks in which it was.
        held: ticks in which it held.
        count: ticks that were heard of.
    """

    ROOM = 1 << 16  # of ticks that are kept, the newest

    def __init__(self, session: Session) -> None:
        self.newest = self.contacts = self.pushed = self.held = self.count = 0
        self._starts = np.full(self.ROOM, np.nan)
        self._holds = np.ones(self.ROOM, dtype=bool)
        self._touches = False
        self._started = np.nan
        loop: Any = session._loop
        # The loop publishes a summary and the newest tick only: intercept what it hands on.
        self._record, self._watch = loop.clock.record, loop._watch
        loop.clock.record, loop._watch = self._recorded, self._ticked

    def _recorded(self, status: Any, started: float, *more: Any) -> None:
        self._started = started
        self._record(status, started, *more)

    def _ticked(self, orders: Orders, telemetry: Telemetry, ticked: bool) -> None:
        if ticked:
            k = telemetry.tick
            # A message of a tick has the timing of the one before.
            self._starts[(k - 1) % self.ROOM] = self._started
            self._starts[k % self.ROOM] = np.nan
            holds = telemetry.target is None
            self._holds[k % self.ROOM] = holds
            touches = telemetry.step is not None and bool(telemetry.step.force.any()) and not holds
            self.contacts += touches and not self._touches
            self._touches = touches
            self.pushed += touches
            self.held += holds
            self.count += 1
            self.newest = k
        self._watch(orders, telemetry, ticked)

    def wait(self, moving: bool, since: int, patience: float = PATIENCE) -> bool:
        """Wait for a tick after tick `since` that moves the tool, or holds it; whether it came."""
        deadline = time.monotonic() + patience
        seen = since
        while True:
            newest = self.newest
            for k in range(max(seen + 1, newest - self.ROOM // 2), newest + 1):
                if self._holds[k % self.ROOM] != moving:
                    return True
            seen = max(seen, newest)
            if time.monotonic() > deadline:
                return False
            time.sleep(2e-3)

    def holds(self, before: float, after: float, more: int) -> tuple[NDArray[np.bool_], int]:
        """Whether ticks held: from the one under way at a time to `more` after another time [s].

        Returns them, and the number of the last. Waits for them.

        Raises:
            TimeoutError: there are no ticks.
        """
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            newest = self.newest
            numbers = np.arange(max(newest - self.ROOM // 2, 1), newest)  # the newest has no start
            starts = self._starts[numbers % self.ROOM]
            late = np.flatnonzero(starts > after)
            if len(late) >= more:
                first = max(int(np.searchsorted(starts, before, "right")) - 1, 0)
                chosen = numbers[first : late[more - 1] + 1]
                return self._holds[chosen % self.ROOM].copy(), int(chosen[-1])
            time.sleep(2e-3)
        raise TimeoutError("the guard does not tick")
