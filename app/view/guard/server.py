"""A guarded viser server, and counts of what it stores."""

from __future__ import annotations

import functools
import threading
from typing import Any

import viser
import websockets.asyncio.server

from app.view import script
from app.view.guard.access import Access
from app.view.guard.connection import Connection
from app.view.guard.logs import connection_log, limited_error_handler
from app.view.guard.messages import MAX_MESSAGE
from app.view.guard.patches import (
    GuardError,
    check_internals,
    disable_sharing,
    patch_message_events,
)

_swapping = threading.Lock()


def serve(host: str, port: int, token: str | None, **options: Any) -> viser.ViserServer:
    """A viser server whose requests and messages are checked.

    Args:
        token: required from clients; None: no token is required.
        options: of `viser.ViserServer`.

    Raises:
        OSError: the port is taken.
        GuardError: the installed viser or websockets is not supported.
    """
    check_internals()
    patch_message_events()
    access = Access(host, token)
    original = websockets.asyncio.server.serve
    wrapped: list[bool] = []

    def patched(handler: Any, *arguments: Any, **keywords: Any) -> Any:
        # Called on viser's thread: an exception here would block viser's constructor forever.
        process: Any = keywords.get("process_request")
        wrapped.append(process is not None)
        keywords.update(
            process_request=functools.partial(access.process, script.adding(process)),
            create_connection=Connection,
            max_size=MAX_MESSAGE,
            max_queue=4,
            server_header=None,
            logger=connection_log(),
        )
        return original(handler, *arguments, **keywords)

    with _swapping:
        websockets.asyncio.server.serve = patched  # type: ignore[assignment,misc]
        try:
            server = viser.ViserServer(host, port, **options)
        finally:
            websockets.asyncio.server.serve = original  # type: ignore[misc]
    try:
        if not wrapped or not all(wrapped):
            raise GuardError(f"viser {viser.__version__} does not serve as expected")
        if port not in (0, server.get_port()):
            raise OSError(f"port {port} on {host} was taken meanwhile: choose another with --port")
        disable_sharing(server)
        server.get_event_loop().set_exception_handler(limited_error_handler())
    except Exception:
        server.stop()
        raise
    return server


def resource_counts(server: viser.ViserServer) -> dict[str, int]:
    """Counts of what viser stores, to detect growth over a long run.

    Returns:
        "nodes" of the scene, "controls" of the panel, "messages" stored for new clients,
        connected "clients", and "backlog": the most messages that wait for one client.
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
