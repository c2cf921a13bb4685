"""Changes to viser from outside: a lost wake-up is fixed, sharing is disabled.

`check_internals` verifies that the internals used by this package exist.
"""

from __future__ import annotations

import asyncio
import functools
import inspect
from typing import Any

import viser
import websockets.asyncio.server
from viser import _messages as wire
from viser.infra import _infra
from viser.infra._async_message_buffer import AsyncMessageBuffer
from websockets.asyncio.server import ServerConnection

from app.view.guard.messages import INBOUND

SHARE = ("ShareUrlRequest", "ShareUrlDisconnect")


class GuardError(RuntimeError):
    """The installed viser or websockets cannot be guarded, or sharing was requested."""


class LoopEvent(asyncio.Event):
    """An event that is set on its event loop only.

    `AsyncMessageBuffer.push` sets its event on the calling thread, then once more on the loop. If
    the first call falls between a sender's test of the event and its registration as a waiter, the
    event is set already at the second call, which then wakes no waiter: no message is sent again.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__()
        self._loop_of_waiters = loop

    def set(self) -> None:
        """Set the event; does nothing on another thread, as a call on the loop follows."""
        if asyncio._get_running_loop() is self._loop_of_waiters:
            super().set()


@functools.cache
def patch_message_events() -> None:
    """Give every message buffer of viser a `LoopEvent`."""
    original = AsyncMessageBuffer.__init__

    @functools.wraps(original)
    def patched(self: AsyncMessageBuffer, *arguments: Any, **keywords: Any) -> None:
        original(self, *arguments, **keywords)
        self.message_event = LoopEvent(self.event_loop)

    AsyncMessageBuffer.__init__ = patched  # type: ignore[method-assign]


def disable_sharing(server: viser.ViserServer) -> None:
    """Remove viser's public tunnel, for clients and for this program."""
    connection = server._websock_server
    for kind in SHARE:
        connection.unregister_handler(getattr(wire, kind))

    def refuse(*_: object, **__: object) -> str | None:
        raise GuardError("this page is not shared with the public")

    server.request_share_url = refuse  # type: ignore[method-assign]
    if server._share_tunnel is not None:
        raise GuardError("viser has opened a tunnel")


def check_internals() -> None:
    """Verify viser's and websockets' internals at the start.

    Raises:
        GuardError: something is missing; the message names it.
    """
    wanted: list[tuple[object, str]] = [
        *((wire, kind) for kind in (*INBOUND, *SHARE)),
        *(
            (ServerConnection, name)
            for name in (
                "recv", "close", "respond", "process_event", "data_received", "send_data",
                "pause_writing", "resume_writing", "connection_lost",
            )
        ),
        (_infra.websockets.asyncio.server, "serve"),
        (_infra.WebsockServer, "unregister_handler"),
        (AsyncMessageBuffer, "push"),
        (viser.ViserServer, "request_share_url"),
    ]  # fmt: skip
    missing = [name for owner, name in wanted if not hasattr(owner, name)]
    fields = inspect.signature(AsyncMessageBuffer).parameters
    missing += [name for name in ("event_loop", "message_event") if name not in fields]
    taken = inspect.signature(websockets.asyncio.server.serve).parameters
    missing += [
        name
        for name in ("process_request", "create_connection", "max_size", "max_queue", "logger")
        if name not in taken
    ]
    if missing:
        raise GuardError(
            f"viser {viser.__version__} with websockets {websockets.__version__} cannot be "
            f"guarded: {', '.join(missing)} missing"
        )
