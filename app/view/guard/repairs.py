"""What of viser is mended from outside: its senders' sleep, and its way to the public.

All of that, and the rest of the guard, hangs on insides of viser and websockets: `check` looks
whether they are there.
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


class Unguarded(RuntimeError):
    """viser or websockets is not what this package knows how to guard."""


class WakeUp(asyncio.Event):
    """Wakes those who send what is in a buffer, and is deaf outside of their event loop.

    `AsyncMessageBuffer.push` sets its event from whatever thread calls it, then once more in the
    loop. If the first falls between a sender's look at the event and its falling asleep, the second
    finds the event set already and wakes nobody, nor does any later one: the page stands still.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__()
        self._home = loop

    def set(self) -> None:
        """Wake them if this is their loop; otherwise leave it to the call that will be."""
        if asyncio._get_running_loop() is self._home:
            super().set()


@functools.cache
def wake_in_the_loop() -> None:
    """Give every buffer of viser's a `WakeUp`."""
    theirs = AsyncMessageBuffer.__init__

    @functools.wraps(theirs)
    def ours(self: AsyncMessageBuffer, *arguments: Any, **keywords: Any) -> None:
        theirs(self, *arguments, **keywords)
        self.message_event = WakeUp(self.event_loop)

    AsyncMessageBuffer.__init__ = ours  # type: ignore[method-assign]


def never_share(server: viser.ViserServer) -> None:
    """Take away the way to viser's tunnel, from clients and from ourselves."""
    connection = server._websock_server
    for kind in SHARE:
        connection.unregister_handler(getattr(wire, kind))

    def refuse(*_: object, **__: object) -> str | None:
        raise Unguarded("this page is not shared with the public")

    server.request_share_url = refuse  # type: ignore[method-assign]
    if server._share_tunnel is not None:
        raise Unguarded("viser has opened a tunnel unasked")


def check() -> None:
    """Fail at the start rather than be open.

    Raises:
        Unguarded: naming what is missing.
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
        raise Unguarded(
            f"viser {viser.__version__} with websockets {websockets.__version__} cannot be "
            f"guarded: {', '.join(missing)} missing"
        )
