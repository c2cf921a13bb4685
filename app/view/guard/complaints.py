"""What goes to log and console: no more than whoever reads it can use, whatever clients try."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import logging
from collections.abc import Callable, Iterator
from typing import Any

import rich

from app.view.guard.allowance import Allowance

log = logging.getLogger(__package__)  # one for the whole guard

COMPLAINTS = (0.2, 10.0)  # errors that go to the log


def complain_sometimes() -> Callable[[asyncio.AbstractEventLoop, dict[str, Any]], None]:
    """viser's handlers fail on values of the wrong type, as often as a client sends one."""
    allowance = Allowance(*COMPLAINTS)

    def complain(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        if allowance.take():
            log.error("%s", context.get("message"), exc_info=context.get("exception"))

    return complain


@functools.cache
def quiet_log() -> logging.Logger:
    """websockets' log without what any passer-by can write there, with a traceback each time."""
    logger = log.getChild("connections")
    passing = ("opening handshake failed", "keepalive ping failed")
    logger.addFilter(lambda record: record.getMessage() not in passing)
    return logger


@contextlib.contextmanager
def quiet_console() -> Iterator[None]:
    """Keeps viser from printing a box of addresses and a farewell; the command line has its own."""
    console = rich.get_console()
    quiet, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = quiet
