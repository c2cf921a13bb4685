"""Name and colour of each client, and the line that tells a client who drags the proxy."""

from __future__ import annotations

import contextlib
from collections.abc import Callable

import viser

from app.scene.moment import Moment
from app.view import palette
from app.view.part import Clients, Part

# Distinct with any of the common colour blindnesses; the number identifies a client as well.
COLORS = (palette.BLUE, palette.ORANGE, palette.GREEN, palette.PURPLE, palette.SKY, palette.BLACK)


def name(client_id: int) -> str:
    """A client's name on all pages."""
    return f"client {client_id + 1}"


def color(client_id: int) -> palette.Rgb:
    """A client's colour; six colours in turn."""
    return COLORS[client_id % len(COLORS)]


def line(client_id: int, owner: int | None, clients: int) -> str:
    """HTML line for one client: its name and who drags the proxy; empty for a single client.

    Args:
        client_id: the client that reads it.
        owner: the client that drags the proxy, or None.
        clients: number of clients.
    """
    if clients < 2:
        return ""
    if owner is None:
        words = f"You are {_badge(client_id)}, one of {clients}. Nobody drags the proxy."
    elif owner == client_id:
        words = f"You ({_badge(client_id)}) have the proxy, one of {clients} clients."
    else:
        words = f"Another client is dragging: {_badge(owner)} has the proxy."
    return (
        "<div style='margin:0 .75em .3em;font-size:11.5px;line-height:1.35;color:var(--vf-soft)'>"
        f"{words}</div>"
    )


def _badge(client_id: int) -> str:
    return f"<b style='color:{palette.css(color(client_id))}'>■</b> <b>{name(client_id)}</b>"


class ClientLines(Part):
    """The line on each client's panel."""

    def __init__(self, owner: Callable[[], int | None], order: float) -> None:
        """`owner` returns the client that drags the proxy; `order`: position in the panel."""
        self._owner = owner
        self._order = order
        self._lines: dict[int, viser.GuiHtmlHandle] = {}

    def text(self, client_id: int) -> str:
        """The line of one client, as HTML."""
        shown = self._lines.get(client_id)
        return "" if shown is None else str(shown.content)

    def frame(self, shown: Moment, clients: Clients) -> None:
        owner = self._owner()
        for gone in self._lines.keys() - clients.keys():
            del self._lines[gone]
        for client_id, client in clients.items():
            text = line(client_id, owner, len(clients))
            shown_line = self._lines.get(client_id)
            # The client may disconnect meanwhile; the next frame drops its line.
            with contextlib.suppress(Exception):
                if shown_line is None:
                    if text:
                        self._lines[client_id] = client.gui.add_html(text, order=self._order)
                elif shown_line.content != text:
                    shown_line.content = text
