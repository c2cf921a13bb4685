"""Serialises long operations of a session: loading or measuring a mesh, opening a replay."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator

from app.scene.worker import Stop
from app.words import Refused


class Work:
    """At most one operation at a time; a second one is refused. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._stop = Stop()

    @property
    def going(self) -> bool:
        """Whether an operation is in progress."""
        return self._lock.locked()

    @contextlib.contextmanager
    def begin(self, within: Stop | None = None) -> Iterator[Stop]:
        """An operation, as long as the context lasts; yields the `Stop` that cancels it.

        Args:
            within: the `Stop` of the operation that this one is part of; None: a new operation.

        Raises:
            Refused: another one is in progress.
        """
        if within is not None:
            yield within
            return
        if not self._lock.acquire(blocking=False):
            raise Refused("another change is under way: wait until it is done")
        try:
            self._stop = Stop()
            yield self._stop
        finally:
            self._lock.release()

    def stop(self) -> None:
        """Cancel the operation in progress, if there is one; the session stays unchanged."""
        self._stop()
