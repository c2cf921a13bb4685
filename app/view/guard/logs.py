"""Log and console: limited in rate, without messages that any client can cause."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import logging
from collections.abc import Callable, Iterator
from typing import Any

import rich

from app.view.guard.token_bucket import TokenBucket

log = logging.getLogger(__package__)  # one for the whole guard

ERRORS = (0.2, 10.0)  # logged [1/s], at once


def limited_error_handler() -> Callable[[asyncio.AbstractEventLoop, dict[str, Any]], None]:
    """Exception handler of the event loop: viser's handlers fail on values of the wrong type."""
    bucket = TokenBucket(*ERRORS)

    def handle(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        if bucket.take():
            log.error("%s", context.get("message"), exc_info=context.get("exception"))

    return handle


@functools.cache
def connection_log() -> logging.Logger:
    """Logger for websockets, without the tracebacks of failed handshakes and keepalive pings."""
    logger = log.getChild("connections")
    dropped = ("opening handshake failed", "keepalive ping failed")
    logger.addFilter(lambda record: record.getMessage() not in dropped)
    return logger


@contextlib.contextmanager
def quiet_console() -> Iterator[None]:
    """Suppress what viser prints at start and stop; the command line prints its own."""
    console = rich.get_console()
    quiet, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = quiet
