"""Scheduling priorities of processes and threads, as far as the system permits them.

A browser that draws on the same cores pushes other programs off them: ticks would be late, and a
drag would reach the tool late.
"""

from __future__ import annotations

import contextlib
import os
import sys
import threading
from collections.abc import Callable
from functools import partial

# In real time.
CONTROL_PRIORITY = 10
BUILD_PRIORITY = 5  # of the control process's other thread, which may hold the interpreter lock
# Of the page's threads between the mouse and the orders. In a thread's host the control thread also
# waits for them, if one of them is pushed off its core while it holds the interpreter lock.
VIEW_PRIORITY = 5


def raise_process_priority() -> None:
    """Raise this process's scheduling priority, where the system permits it.

    Call it before other threads are started: they inherit it. It concerns the threads that hold the
    interpreter lock while a thread of a higher priority waits for it.
    """
    if sys.platform.startswith("linux"):
        with contextlib.suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, 0, -10)


def raise_thread_priority(priority: int) -> None:
    """Schedule the calling thread in real time if the system permits it, else raise its priority.

    Threads and processes that it starts do not inherit real-time scheduling.
    """
    if not sys.platform.startswith("linux"):
        return
    thread = threading.get_native_id()
    try:
        policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(thread, policy, os.sched_param(priority))
    except OSError:
        with contextlib.suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, thread, -10)


def just_below() -> Callable[[], None]:
    """What another thread has to call that the calling thread may have to wait for.

    Where the calling thread runs in real time the other one then does so too, just below it. Else
    it runs as it is.
    """
    if sys.platform.startswith("linux"):
        with contextlib.suppress(OSError):
            if os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO:
                return partial(
                    raise_thread_priority, max(os.sched_getparam(0).sched_priority - 1, 1)
                )
    return _stay


def _stay() -> None:
    """Leave the calling thread as it is."""
