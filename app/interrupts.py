"""Ctrl-C and SIGTERM as something to wait for."""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Callable, Iterator
from types import FrameType


@contextlib.contextmanager
def interrupts() -> Iterator[Callable[[], None]]:
    """Gives a function that waits for Ctrl-C or SIGTERM; for the main thread only.

    From here on no signal is lost: as exceptions they would be where one comes in a callback that
    another library made, and some are made all the time. The function returns at once if one came
    before it was called. After it has returned, another one interrupts as usual.
    """
    heard, ring = os.pipe()
    os.set_blocking(ring, False)
    # An interrupt that a shell had its background job ignore stays ignored.
    numbers = [
        number
        for number in (signal.SIGINT, signal.SIGTERM)
        if signal.getsignal(number) not in (signal.SIG_IGN, None)
    ]
    # The signal's number is written where the signal is caught. Python's own handlers run later,
    # and not at all while the main thread reads.
    fd = signal.set_wakeup_fd(ring, warn_on_full_buffer=False)
    before = [signal.signal(number, _nothing) for number in numbers]

    def restore() -> None:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)
        signal.set_wakeup_fd(fd)

    def wait() -> None:
        while not set(os.read(heard, 64)) & set(numbers):
            pass
        restore()

    try:
        yield wait
    finally:
        restore()
        os.close(heard)
        os.close(ring)


def _nothing(number: int, frame: FrameType | None) -> None:
    """The wake-up descriptor has it."""
