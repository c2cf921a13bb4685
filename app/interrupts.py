"""Ctrl-C and SIGTERM: as something to wait for, and as the end of a command."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from types import FrameType

AGAIN = 0.05  # [s] until a signal that came at a bad moment comes again
# Code that an exception at any moment leaves broken, as `file:function`.
_WHOLE = re.compile(
    # Half a module is the cause of errors that nobody understands.
    r"^<frozen importlib"
    # LLVM's objects belong to somebody, which is written down after the call that made it so. In
    # between an exception lets them be freed twice, which ends the process.
    r"|/llvmlite/binding/"
    # A kernel's files, and its way from there into memory.
    r"|/numba/core/caching\.py:"
    # The compiler's lock, which nobody would give back. Not what runs under it: a kernel may take
    # ten seconds to compile.
    r"|/numba/core/compiler_lock\.py:(acquire|release|__enter__|__exit__)$"
    # A cluster of which only some workers have begun cannot be closed.
    r"|/distributed/deploy/(local|spec)\.py:__init__$"
)


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


class Terminated(KeyboardInterrupt):
    """SIGTERM: ends a command as Ctrl-C does."""


def arm() -> None:
    """From here on Ctrl-C and SIGTERM are a `KeyboardInterrupt` in the main thread, none is lost.

    One that comes in code that must not be left halfway (imports, LLVM) comes again when that is
    done, and so does one that a library's callback has swallowed.
    """
    if threading.current_thread() is not threading.main_thread():
        return
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) not in (signal.SIG_IGN, None):
            signal.signal(number, _stop)
    signal.signal(signal.SIGALRM, _ring)
    sys.unraisablehook = _not_lost


def disarm() -> None:
    """The command has ended: another Ctrl-C ends what is left of the process at once."""
    if threading.current_thread() is threading.main_thread():
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number in (signal.SIGINT, signal.SIGTERM):
            if signal.getsignal(number) is _stop:
                signal.signal(number, signal.SIG_DFL)


def exit_code(stop: KeyboardInterrupt) -> int:
    """What a shell expects of a program that was ended like this."""
    return 128 + (signal.SIGTERM if isinstance(stop, Terminated) else signal.SIGINT)


def _stop(number: int, frame: FrameType | None) -> None:
    while frame is not None:
        if _WHOLE.search(f"{frame.f_code.co_filename}:{frame.f_code.co_name}"):
            _again(number)
            return
        frame = frame.f_back
    signal.setitimer(signal.ITIMER_REAL, 0.0)  # one that has waited is this one
    raise Terminated if number == signal.SIGTERM else KeyboardInterrupt


def _not_lost(lost: sys.UnraisableHookArgs) -> None:
    if lost.exc_type is not None and issubclass(lost.exc_type, KeyboardInterrupt):
        _again(signal.SIGTERM if issubclass(lost.exc_type, Terminated) else signal.SIGINT)
    else:
        sys.__unraisablehook__(lost)


_waiting: int = signal.SIGINT


def _again(number: int) -> None:
    # By an alarm, not a thread: to start one takes locks, which what was interrupted may hold.
    global _waiting
    _waiting = number
    signal.setitimer(signal.ITIMER_REAL, AGAIN)


def _ring(number: int, frame: FrameType | None) -> None:
    signal.raise_signal(_waiting)  # to whoever waits for it by then
