"""A participant's hand on a session: what it orders arrives after the condition's delay."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import pinocchio as pin

from app.session import Session
from app.words import Refused


class Hand:
    """Orders of a drag, passed on to a session a time after they were given. Thread-safe.

    Everything else is the session's own. A view has this instead of the session: the handle is
    where the hand has it, and the tool follows late.

    Attributes:
        delay: from the hand to the tool [s].
        closed: why the tool cannot be moved now; empty: it can.
    """

    def __init__(self, session: Session, clock: Callable[[], float] = time.monotonic) -> None:
        """`clock`: time [s], such as that of simulated ticks."""
        self._session = session
        self._clock = clock
        self._waiting: deque[tuple[float, pin.SE3, bool]] = deque()
        self._lock = threading.RLock()
        self.delay = 0.0
        self.closed = ""

    def __getattr__(self, name: str) -> Any:
        return getattr(self._session, name)

    @property
    def handle(self) -> pin.SE3:
        """Where the hand has the handle, arm base frame."""
        with self._lock:
            return self._waiting[-1][1] if self._waiting else self._session.handle

    def drive(self, target: pin.SE3, held: bool = False) -> None:
        """As `Session.drive`, a delay later; what is refused then is dropped.

        Raises:
            Refused: it is `closed`; as `Session.drive`, where there is no delay.
        """
        with self._lock:
            if self.closed:
                raise Refused(self.closed)
            if self.delay or self._waiting:
                self._waiting.append((self._clock() + self.delay, pin.SE3(target), held))
                return
        self._session.drive(target, held)

    def recall(self) -> None:
        """As `Session.recall`; what is on its way is dropped.

        Raises:
            Refused: it is `closed`; as `Session.recall`.
        """
        if self.closed:
            raise Refused(self.closed)
        self.drop()
        self._session.recall()

    def drop(self) -> None:
        """Forget what is on its way."""
        with self._lock:
            self._waiting.clear()

    def pump(self) -> None:
        """Pass on what is due; to be called often, by one thread."""
        now = self._clock()
        while True:
            with self._lock:
                if not self._waiting or self._waiting[0][0] > now:
                    return
                _, target, held = self._waiting[0]
                with contextlib.suppress(Refused):
                    self._session.drive(target, held)
                self._waiting.popleft()
