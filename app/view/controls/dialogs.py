"""Dialogs for one client: controls, an action button, and Cancel."""

from __future__ import annotations

import html
import threading
from collections.abc import Callable
from typing import Any

import viser

from app.view.clients.escape import EscapeKey

_closing = threading.Lock()
_STYLE = (
    "margin:0 .75em .4em;font-size:13px;line-height:1.4;color:var(--vf-ink);overflow-wrap:anywhere"
)


def ask(
    client: viser.ClientHandle,
    escape: EscapeKey,
    title: str,
    text: str,
    action: str,
    job: Callable[[], None],
    color: Any = None,
) -> None:
    """Run the job if the client presses the button labelled `action`.

    Args:
        text: explanation, plain text.
        job: runs in viser's thread pool and reports its errors itself.
        color: of the button.
    """
    dialog = client.gui.add_modal(title)
    with dialog:
        client.gui.add_html(f"<div style='{_STYLE}'>{html.escape(text)}</div>")
        _buttons(client, escape, dialog, action, job, color)


def ask_name(
    client: viser.ClientHandle,
    escape: EscapeKey,
    title: str,
    name: str,
    action: str,
    job: Callable[[str], None],
) -> None:
    """Run the job with the name that the client types; `name` is the initial text."""
    dialog = client.gui.add_modal(title)
    with dialog:
        box = client.gui.add_text("Name", name)
        _buttons(client, escape, dialog, action, lambda: job(str(box.value)))


def _buttons(
    client: viser.ClientHandle,
    escape: EscapeKey,
    dialog: Any,
    action: str,
    job: Callable[[], None],
    color: Any = None,
) -> None:
    go = client.gui.add_button(action, color=color)
    cancel = client.gui.add_button("Cancel", color="gray", hint="Escape does the same.")

    def shut() -> None:
        close(dialog)

    escape.opened(client.client_id, shut)

    # Plain functions: viser runs them in its thread pool, so they may block.
    @go.on_click
    def _go(_event: viser.GuiEvent[Any]) -> None:
        escape.closed(client.client_id, shut)
        if close(dialog):
            job()

    @cancel.on_click
    def _cancelled(_event: viser.GuiEvent[Any]) -> None:
        escape.closed(client.client_id, shut)
        close(dialog)


def close(dialog: Any) -> bool:
    """Close a dialog; whether it was open: a double click closes it twice."""
    with _closing:
        if dialog.closed:
            return False
        dialog.close()
        return True
