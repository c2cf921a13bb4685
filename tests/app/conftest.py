"""What the tests of the headless app share."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from app import session as sessions
from app.control import order_writer
from tests.support.headless import Tape


@pytest.fixture
def tapes(monkeypatch: pytest.MonkeyPatch) -> list[Tape]:
    """The mailboxes of the sessions to come, all they were given: orders, then telemetry."""
    made: list[Tape] = []

    def recorded(value: object = None) -> Tape:
        made.append(Tape(value))
        return made[-1]

    for module in (order_writer, sessions):
        monkeypatch.setattr(module, "Mailbox", recorded)
    return made


@pytest.fixture(autouse=True)
def no_thread_left_behind() -> Iterator[None]:
    before = set(threading.enumerate())
    yield
    left = [t for t in threading.enumerate() if t not in before]
    for thread in left:
        thread.join(2.0)  # one that was told to stop may take a moment (a progress bar's)
    assert [t.name for t in left if t.is_alive()] == []
