"""Background computations that take longer than a frame; only the newest request is kept."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Generic, TypeVar

log = logging.getLogger(__name__)

Request = TypeVar("Request")
Result = TypeVar("Result")

IDLE = 0.5  # the thread ends after so long without a request [s]


class Worker(Generic[Request, Result]):
    """Computes the newest request on a thread that ends when no requests come."""

    def __init__(self, name: str, compute: Callable[[Request], Result]) -> None:
        self._name = name
        self._compute = compute
        self._changed = threading.Condition()
        self._request: Request | None = None
        self._running = False
        self._latest: Result | None = None
        self.duration = 0.0
        """Time of the last computation [s]."""

    def request(self, request: Request) -> None:
        """Replace the waiting request, if there is one; returns at once."""
        with self._changed:
            self._request = request
            if self._running:
                self._changed.notify()
                return
            self._running = True
        threading.Thread(target=self._run, name=self._name, daemon=True).start()

    def latest(self) -> Result | None:
        """The newest result, None before the first; returns at once."""
        return self._latest

    def _run(self) -> None:
        while True:
            with self._changed:
                if self._request is None:
                    self._changed.wait(IDLE)
                if self._request is None:
                    self._running = False
                    return
                request, self._request = self._request, None
            started = time.monotonic()
            try:
                self._latest = self._compute(request)
            except Exception:
                log.exception("%s: no result", self._name)
            self.duration = time.monotonic() - started
