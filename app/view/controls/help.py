"""The help overlay: ten lines, opened by a button or a key for the client that asks."""

from __future__ import annotations

import functools
from typing import Any, Final

import viser

from app.view.clients.client_input import ClientInput
from app.view.clients.escape import EscapeKey

KEY: Final = "H"

# One line each; HTML.
LINES = (
    "<b>Drag the tool</b> onto the surface and along it; wheel or <kbd>Shift</kbd>: nearer and "
    "farther; <kbd>Ctrl</kbd> turns it, with both it slides along the surface below the pointer. "
    "<b>Or the gizmo</b>: arrows move the proxy, squares slide it, rings turn it.",
    "Pull it <b>into the bone</b>: the tool stops at the surface, held by the fixture’s planes.",
    "<b>Discs</b> are those planes, their colours the paper’s conditions (tab Legend); a strong "
    "one is active.",
    "The <b>ball</b> is the motion sphere: one tick moves the tool within it, so only the "
    "triangles it cuts count.",
    "The <b>orange arrow</b> is the simulated force on a surgeon’s hand: stiffness × distance from "
    "proxy to tool.",
    "<kbd>J</kbd> <kbd>L</kbd> <kbd>I</kbd> <kbd>K</kbd> <kbd>U</kbd> <kbd>O</kbd> nudge the "
    "proxy left, right, away, near, down, up by 0.1 mm; with <kbd>Shift</kbd> by 1 mm.",
    "<kbd>P</kbd> pauses and runs, <kbd>N</kbd> does one tick (<kbd>Shift</kbd> 10, "
    "<kbd>Alt</kbd> 100), <kbd>R</kbd> resets, <kbd>1</kbd>–<kbd>4</kbd> choose the rule.",
    "<b>Camera</b>: left button turns, right shifts, wheel zooms; <kbd>W</kbd> <kbd>A</kbd> "
    "<kbd>S</kbd> <kbd>D</kbd> <kbd>Q</kbd> <kbd>E</kbd> fly; <kbd>5</kbd>–<kbd>0</kbd>, "
    "<kbd>T</kbd>, <kbd>V</kbd> are views, <kbd>F</kbd> follows the tool, <kbd>X</kbd> cuts the "
    "anatomy open at its tip.",
    "<b>Rule</b>: <i>certified</i> holds on any mesh, <i>paper</i> has Conditions 1–3, "
    "<i>all</i> takes every face, <i>off</i> lets the tool through the bone.",
    "Lost? <b>Recall</b> puts the proxy back onto the tool, <b>Reset</b> both to the start. "
    "<kbd>Ctrl</kbd> <kbd>K</kbd> lists all commands and their keys.",
)


class Help:
    """At most one overlay on each client's page."""

    def __init__(
        self, server: viser.ViserServer, client_input: ClientInput, escape: EscapeKey, order: float
    ) -> None:
        """`order`: position of the button in the panel."""
        self._open: dict[int, tuple[Any, Any]] = {}  # by client: modal, and its closing function
        button = server.gui.add_button(
            "What am I looking at?",
            icon=viser.Icon.HELP_CIRCLE,
            color="gray",
            hint=f"Ten lines (key {KEY})",
            order=order,
        )
        command = server.gui.add_command(
            "Help", description="What is on the page, in ten lines", hotkey=KEY
        )

        @button.on_click
        async def _clicked(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:
                client_input.submit(self._toggle, event.client)

        @command.on_trigger
        async def _triggered(event: Any) -> None:
            if event.client is not None:
                client_input.submit(self._toggle, event.client)

        self._input = client_input
        self._escape = escape

    def _toggle(self, client: viser.ClientHandle) -> None:
        if client.client_id in self._open:
            self._close(client.client_id)
            return
        modal = client.gui.add_modal("The virtual-fixture sandbox in ten lines")
        shut = functools.partial(self._close, client.client_id)
        self._open[client.client_id] = modal, shut
        self._escape.opened(client.client_id, shut)
        with modal:
            items = "".join(f"<li>{line}</li>" for line in LINES)
            client.gui.add_html(f"<ol class='vf-help'>{items}</ol>")
            close = client.gui.add_button("Close", hint="Escape closes it too.")

        @close.on_click
        async def _closed(_event: viser.GuiEvent[Any]) -> None:
            self._input.submit(shut)

    def _close(self, client_id: int) -> None:
        modal, shut = self._open.pop(client_id, (None, None))
        if modal is not None:
            self._escape.closed(client_id, shut)
            modal.close()
