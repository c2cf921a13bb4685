"""SIGINT (Ctrl-C) and SIGTERM: as events to wait for, and as exceptions that end a command."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from types import FrameType

RETRY_DELAY = 0.05  # until a signal that came inside uninterruptible code is raised again [s]
# Code in which an asynchronous exception leaves an inconsistent state, as `file:function`.
_UNINTERRUPTIBLE = re.compile(
    # A partly imported module stays in `sys.modules`.
    r"^<frozen importlib"
    # LLVM objects change owner in one call, and Python records the owner after it: an exception in
    # between frees them twice, which crashes the process.
    r"|/llvmlite/binding/"
    # Reading and writing of cached kernels.
    r"|/numba/core/caching\.py:"
    # The compiler's lock would never be released. The code under the lock may be interrupted:
    # compiling a kernel can take ten seconds.
    r"|/numba/core/compiler_lock\.py:(acquire|release|__enter__|__exit__)$"
    # A cluster whose workers are only partly started cannot be closed.
    r"|/distributed/deploy/(local|spec)\.py:__init__$"
)


@contextlib.contextmanager
def interrupts() -> Iterator[Callable[[], None]]:
    """Yields a function that waits for SIGINT or SIGTERM; for the main thread only.

    Within the context no signal is lost, whereas an exception raised inside a callback of a library
    can be. The function returns at once if a signal came before it was called. After it has
    returned, the previous handlers are in force again.
    """
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    # A shell makes its background jobs ignore SIGINT: keep it ignored.
    numbers = [
        number
        for number in (signal.SIGINT, signal.SIGTERM)
        if signal.getsignal(number) not in (signal.SIG_IGN, None)
    ]
    # The C handler writes the signal's number to the pipe; Python's handlers do not run while the
    # main thread blocks in `read`.
    fd = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    before = [signal.signal(number, _ignore) for number in numbers]

    def restore() -> None:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)
        signal.set_wakeup_fd(fd)

    def wait() -> None:
        while not set(os.read(reader, 64)) & set(numbers):
            pass
        restore()

    try:
        yield wait
    finally:
        restore()
        os.close(reader)
        os.close(writer)


def _ignore(number: int, frame: FrameType | None) -> None:
    """The signal is read from the wake-up pipe."""


class Terminated(KeyboardInterrupt):
    """SIGTERM, which ends a command as Ctrl-C does."""


def install() -> None:
    """From now on SIGINT and SIGTERM raise a `KeyboardInterrupt` in the main thread.

    A signal during uninterruptible code (imports, LLVM) is raised again after it, and so is one
    whose exception was discarded in a callback of a library.
    """
    if threading.current_thread() is not threading.main_thread():
        return
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) not in (signal.SIG_IGN, None):
            signal.signal(number, _stop)
    signal.signal(signal.SIGALRM, _on_alarm)
    sys.unraisablehook = _on_unraisable


def uninstall() -> None:
    """After the command: another signal ends the process at once."""
    if threading.current_thread() is threading.main_thread():
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number in (signal.SIGINT, signal.SIGTERM):
            if signal.getsignal(number) is _stop:
                signal.signal(number, signal.SIG_DFL)


def exit_code(stop: KeyboardInterrupt) -> int:
    """The exit code that a shell expects: 128 + number of the signal."""
    return 128 + (signal.SIGTERM if isinstance(stop, Terminated) else signal.SIGINT)


def _stop(number: int, frame: FrameType | None) -> None:
    while frame is not None:
        if _UNINTERRUPTIBLE.search(f"{frame.f_code.co_filename}:{frame.f_code.co_name}"):
            _retry(number)
            return
        frame = frame.f_back
    signal.setitimer(signal.ITIMER_REAL, 0.0)  # cancels a pending retry
    raise Terminated if number == signal.SIGTERM else KeyboardInterrupt


def _on_unraisable(lost: sys.UnraisableHookArgs) -> None:
    if lost.exc_type is not None and issubclass(lost.exc_type, KeyboardInterrupt):
        _retry(signal.SIGTERM if issubclass(lost.exc_type, Terminated) else signal.SIGINT)
    else:
        sys.__unraisablehook__(lost)


_pending: int = signal.SIGINT


def _retry(number: int) -> None:
    # An alarm, not a thread: starting a thread takes locks that the interrupted code may hold.
    global _pending
    _pending = number
    signal.setitimer(signal.ITIMER_REAL, RETRY_DELAY)


def _on_alarm(number: int, frame: FrameType | None) -> None:
    signal.raise_signal(_pending)
