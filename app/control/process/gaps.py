"""Work beside a control thread in the same interpreter, done between its ticks."""

from __future__ import annotations

import sys
import time
from types import FrameType, TracebackType
from typing import Any

from app.control.loop import ControlLoop

# A call may take so long [s]: none begins when there is less time to the next tick, as the control
# thread waits for the interpreter until it has ended.
MARGIN = 4e-4
TICK = 2e-4  # what a tick takes, generously [s]


class Gaps:
    """While the context lasts, this thread looks at the clock before every call.

    It sleeps from a little before each tick to its end, so that the control thread finds the
    interpreter free. Where ticks follow each other too closely for that it does not.
    """

    def __init__(self, loop: ControlLoop | None) -> None:
        """`loop`: whose ticks are waited for; None: there are none yet."""
        self._loop = loop if loop is not None and loop.dt > MARGIN + 2.0 * TICK else None

    def __enter__(self) -> None:
        if self._loop is not None:
            sys.setprofile(self._look)

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._loop is not None:
            sys.setprofile(None)

    def _look(self, _frame: FrameType, _event: str, _argument: Any) -> None:
        assert self._loop is not None
        left = self._loop.deadline - time.perf_counter()
        if left < MARGIN:
            time.sleep(max(left, 0.0) + TICK)
