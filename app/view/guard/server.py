"""A viser server behind the guard, and what it keeps. Here the guard is put together."""

from __future__ import annotations

import functools
import threading
from typing import Any

import viser
import websockets.asyncio.server

from app.view import script
from app.view.guard.complaints import complain_sometimes, quiet_log
from app.view.guard.connection import Connection
from app.view.guard.door import Door
from app.view.guard.messages import LARGEST
from app.view.guard.repairs import Unguarded, check, never_share, wake_in_the_loop

_swapping = threading.Lock()


def serve(host: str, port: int, token: str | None, **options: Any) -> viser.ViserServer:
    """A viser server behind the guard.

    Args:
        token: what a client must show; None lets everybody in who reaches it.
        options: of `viser.ViserServer`.

    Raises:
        OSError: the port is taken.
        Unguarded: the installed viser is not the one this was written for.
    """
    check()
    wake_in_the_loop()
    door = Door(host, token)
    theirs = websockets.asyncio.server.serve
    wrapped: list[bool] = []

    def ours(handler: Any, *arguments: Any, **keywords: Any) -> Any:
        # In viser's thread, where an exception would make its constructor wait forever.
        process: Any = keywords.get("process_request")
        wrapped.append(process is not None)
        keywords.update(
            process_request=functools.partial(door.process, script.adding(process)),
            create_connection=Connection,
            max_size=LARGEST,
            max_queue=4,
            server_header=None,
            logger=quiet_log(),
        )
        return theirs(handler, *arguments, **keywords)

    with _swapping:
        websockets.asyncio.server.serve = ours  # type: ignore[assignment,misc]
        try:
            server = viser.ViserServer(host, port, **options)
        finally:
            websockets.asyncio.server.serve = theirs  # type: ignore[misc]
    try:
        if not wrapped or not all(wrapped):
            raise Unguarded(f"viser {viser.__version__} does not serve as it used to")
        if port not in (0, server.get_port()):
            raise OSError(f"port {port} on {host} was taken meanwhile: choose another with --port")
        never_share(server)
        server.get_event_loop().set_exception_handler(complain_sometimes())
    except Exception:
        server.stop()
        raise
    return server


def census(server: viser.ViserServer) -> dict[str, int]:
    """What viser keeps, in numbers: a page that runs for days must not keep more and more.

    Returns:
        "nodes" of the scene, "controls" of the panel, "messages" kept for whoever joins,
        "clients" connected, and "backlog", the most messages that one of them has yet to be sent.
    """
    shared = server._websock_server._broadcast_buffer
    states = list(server._websock_server._client_state_from_id.values())
    with shared.buffer_lock:
        behind = [shared.message_counter - 1 - sent for sent in shared.generator_cursors.values()]
        kept = len(shared.message_from_id)
    own = [len(state.message_buffer.message_from_id) for state in states]
    return {
        "nodes": len(server.scene._handle_from_node_name),
        "controls": len(server.gui._gui_input_handle_from_uuid),
        "messages": kept,
        "clients": len(states),
        "backlog": max([*behind, *own], default=0),
    }
