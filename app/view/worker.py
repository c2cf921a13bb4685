"""A thread for what is too slow for a frame: the newest question counts, older ones are dropped."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Generic, TypeVar

log = logging.getLogger(__name__)

Question = TypeVar("Question")
Answer = TypeVar("Answer")

IDLE = 0.5  # a thread that was asked nothing for longer ends [s]


class Worker(Generic[Question, Answer]):
    """Answers the newest question on a thread that is there only while questions come."""

    def __init__(self, name: str, answer: Callable[[Question], Answer]) -> None:
        self._name = name
        self._answer = answer
        self._changed = threading.Condition()
        self._question: Question | None = None
        self._running = False
        self._newest: Answer | None = None
        self.took = 0.0
        """How long the last answer took [s]."""

    def ask(self, question: Question) -> None:
        """Replace the waiting question, if there is one. Does not wait for answers."""
        with self._changed:
            self._question = question
            if self._running:
                self._changed.notify()
                return
            self._running = True
        threading.Thread(target=self._run, name=self._name, daemon=True).start()

    def newest(self) -> Answer | None:
        """The newest answer, None before the first. Never waits."""
        return self._newest

    def _run(self) -> None:
        while True:
            with self._changed:
                if self._question is None:
                    self._changed.wait(IDLE)
                if self._question is None:
                    self._running = False
                    return
                question, self._question = self._question, None
            started = time.monotonic()
            try:
                self._newest = self._answer(question)
            except Exception:
                log.exception("%s: no answer", self._name)
            self.took = time.monotonic() - started
