"""The Escape key: closes the newest dialog of the client that presses it, or leaves a replay."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import viser

from app.view.clients.client_input import ClientInput

Close = Callable[[], None]


class EscapeKey:
    """Open dialogs by client, and what to leave when the client has none."""

    def __init__(self, server: viser.ViserServer, client_input: ClientInput) -> None:
        self._open: dict[int, list[Close]] = {}  # by client, oldest first
        self._fallbacks: list[Callable[[], bool]] = []
        command = server.gui.add_command("Close what is open, leave a replay", hotkey="escape")

        @command.on_trigger
        async def _pressed(event: Any) -> None:
            if event.client is not None:
                client_input.submit(self.press, event.client.client_id)

        @server.on_client_disconnect
        async def _disconnected(client: viser.ClientHandle) -> None:
            self._open.pop(client.client_id, None)

    def opened(self, client_id: int, close: Close) -> None:
        """Register an open dialog; `close` closes it."""
        self._open.setdefault(client_id, []).append(close)

    def closed(self, client_id: int, close: Close) -> None:
        """Forget a dialog that was closed in another way, if it is registered."""
        known = self._open.get(client_id, [])
        if close in known:
            known.remove(close)

    def add_fallback(self, leave: Callable[[], bool]) -> None:
        """Call `leave` when the client has no dialog; it returns whether there was something."""
        self._fallbacks.append(leave)

    def press(self, client_id: int) -> None:
        """Close the newest dialog of a client; without one, try the fallbacks, newest first."""
        known = self._open.get(client_id)
        if known:
            known.pop()()
            return
        for leave in reversed(self._fallbacks):
            if leave():
                return
