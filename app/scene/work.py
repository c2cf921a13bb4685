"""One long piece of work at a time: a mesh on its way, a file being measured, a replay opened."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator

from app.refused import Refused
from app.scene.worker import Stop


class Work:
    """The work under way. Whoever begins another is refused; anybody may stop it or ask for it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._stop = Stop()

    @property
    def going(self) -> bool:
        """Whether there is one."""
        return self._lock.locked()

    @contextlib.contextmanager
    def begin(self, within: Stop | None = None) -> Iterator[Stop]:
        """Do one for as long as the context lasts; gives what `stop` calls.

        Args:
            within: what the work under way was given, of which this is a part.

        Raises:
            Refused: another one is under way.
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
        """Give up the work under way, if there is one; nothing is changed then."""
        self._stop()
