"""Who is who: each client's number and colour, and which of them has the proxy."""

from __future__ import annotations

import contextlib
from collections.abc import Callable

import viser

from app.recording.playback import Moment
from app.view import palette
from app.view.part import Clients, Part

# Told apart by people with any colour blindness; the number says the same.
COLORS = (palette.BLUE, palette.ORANGE, palette.GREEN, palette.PURPLE, palette.SKY, palette.BLACK)


def name(client_id: int) -> str:
    """What a client is called on everybody's page."""
    return f"client {client_id + 1}"


def color(client_id: int) -> palette.Rgb:
    """The client's colour; the seventh has the first one's again."""
    return COLORS[client_id % len(COLORS)]


def line(client_id: int, owner: int | None, clients: int) -> str:
    """HTML of what one client is told about the others and itself; empty if it is all alone.

    Args:
        client_id: who reads it.
        owner: who drags the proxy, if anybody.
        clients: how many there are.
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


class Who(Part):
    """A line of its own on each client's panel. Called from the view thread only."""

    def __init__(self, owner: Callable[[], int | None], order: float) -> None:
        """`owner`: who drags the proxy; `order`: where in the panel the line stands."""
        self._owner = owner
        self._order = order
        self._lines: dict[int, viser.GuiHtmlHandle] = {}

    def told(self, client_id: int) -> str:
        """What that client's line says."""
        shown = self._lines.get(client_id)
        return "" if shown is None else str(shown.content)

    def frame(self, shown: Moment, clients: Clients) -> None:
        """Bring every client's line up to date; writes only what changed."""
        owner = self._owner()
        for gone in self._lines.keys() - clients.keys():
            del self._lines[gone]
        for client_id, client in clients.items():
            text = line(client_id, owner, len(clients))
            told = self._lines.get(client_id)
            # A client may vanish at any moment; it is gone from the list the next time.
            with contextlib.suppress(Exception):
                if told is None:
                    if text:
                        self._lines[client_id] = client.gui.add_html(text, order=self._order)
                elif told.content != text:
                    told.content = text
