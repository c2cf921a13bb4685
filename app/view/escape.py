"""The Escape key: closes what was opened last on the page of the one who presses it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import viser

from app.view.hand import Hand

Close = Callable[[], None]


class Escape:
    """Dialogs say here that they are open; what all clients see may offer to be left."""

    def __init__(self, server: viser.ViserServer, hand: Hand) -> None:
        self._open: dict[int, list[Close]] = {}  # by client, the newest last
        self._offers: list[Callable[[], bool]] = []
        command = server.gui.add_command("Close what is open, leave a replay", hotkey="escape")

        @command.on_trigger
        async def _pressed(event: Any) -> None:
            if event.client is not None:
                hand.submit(self.press, event.client.client_id)

        @server.on_client_disconnect
        async def _gone(client: viser.ClientHandle) -> None:
            self._open.pop(client.client_id, None)

    def opened(self, client_id: int, close: Close) -> None:
        """A dialog is open on a client's page; `close` closes it."""
        self._open.setdefault(client_id, []).append(close)

    def closed(self, client_id: int, close: Close) -> None:
        """A dialog was closed in another way; for one that is not known nothing happens."""
        known = self._open.get(client_id, [])
        if close in known:
            known.remove(close)

    def offer(self, leave: Callable[[], bool]) -> None:
        """Something that all clients see, left when no dialog is open; says whether it was."""
        self._offers.append(leave)

    def press(self, client_id: int) -> None:
        """Close the newest dialog of that client or, if it has none, leave what all see."""
        known = self._open.get(client_id)
        if known:
            known.pop()()
            return
        for leave in reversed(self._offers):
            if leave():
                return
