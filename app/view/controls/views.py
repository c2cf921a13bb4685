"""Folder "View": camera views, lens, section, colours of the panels, layers."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import viser

from app.view import camera, style
from app.view.clients.client_input import ClientInput
from app.view.controls.keys import Order

Look = Callable[[viser.ClientHandle, str], None]
Layers = dict[str, tuple[bool, Callable[[bool], None]]]

# Key of each view.
KEYS = {
    "Arm": "0",
    "Anatomy": "9",
    "Site": "8",
    "Tool": "T",
    "Follow": "F",
    "Surgeon": "V",
    "Side": "5",
    "Front": "6",
    "Top": "7",
}
GROUPS = (
    ("Look at", "The whole arm, the anatomy, or where the tool is at work.",
     ("Arm", "Anatomy", "Site")),
    ("Close-up", "Follow goes along with the tool; again: no more. Surgeon looks as through an "
     "endoscope.", ("Tool", "Follow", "Surgeon")),
    ("Along", "An axis of the arm’s base: x (from the side), y (from the front), z (from above, "
     "where the arm stands in the way: Layers has a switch for it).",
     tuple(camera.AXES)),
)  # fmt: skip
PERSPECTIVE, PARALLEL = "Perspective", "Parallel"
LIGHT, DARK = "Light", "Dark"
SECTION_KEY, LENS_KEY, DARK_KEY = "X", "Z", "B"


class Views:
    """The folder's controls, and the same orders for keys. Each acts for the client that asks."""

    def __init__(
        self,
        server: viser.ViserServer,
        client_input: ClientInput,
        look: Look,
        section: Order,
        layers: Layers,
    ) -> None:
        """`look` moves a client's camera to a named view; `section` switches the section plane."""
        self._gui = server.gui
        self._input = client_input
        self._look = look
        self._section = section
        self._dark: set[int] = set()  # clients; used by the input worker only
        with server.gui.add_folder("View"):
            for label, hint, names in GROUPS:
                keys = ", ".join(KEYS[name] for name in names)
                self._group(
                    label, f"{hint} Keys {keys}.", {n: partial(self._view, n) for n in names}
                )
            self._group(
                "Lens",
                "Parallel shows equal sizes equally large: a lens of 2° from far away, with which "
                f"half a picture’s height towards you makes 1.8 % of size. Key {LENS_KEY}.",
                {
                    PERSPECTIVE: lambda c: camera.set_lens(c, camera.FIELD_OF_VIEW),
                    PARALLEL: lambda c: camera.set_lens(c, camera.PARALLEL),
                },
            )
            self._group(
                "Section",
                "Hide the part of the mesh between the tool’s tip and your eye, for all clients; "
                f"of another structure if that is chosen in the tab Mesh. Key {SECTION_KEY}.",
                {"Cut at the tip, or not": section},
            )
            self._group(
                "Page",
                f"Colours of the panels, on your page alone. Key {DARK_KEY}.",
                {
                    LIGHT: lambda c: self._set_dark(c, False),
                    DARK: lambda c: self._set_dark(c, True),
                },
            )
            with server.gui.add_folder("Layers", expand_by_default=False):
                for name, (shown, switch) in layers.items():
                    self._layer(name, shown, switch)

    def commands(self) -> dict[str, tuple[str, Order]]:
        """Label and order of each command, by key."""
        found: dict[str, tuple[str, Order]] = {
            key: (f"View: {name.lower()}", partial(self._view, name)) for name, key in KEYS.items()
        }
        found[KEYS["Follow"]] = ("View: follow the tool, or stop it", partial(self._view, "Follow"))
        found[LENS_KEY] = ("View: parallel, or perspective", self._toggle_lens)
        found[SECTION_KEY] = ("View: cut the anatomy at the tip, or not", self._section)
        found[DARK_KEY] = ("Page: dark, or light", self._toggle_dark)
        return found

    def _view(self, name: str, client: viser.ClientHandle) -> None:
        self._look(client, name)

    def _toggle_lens(self, client: viser.ClientHandle) -> None:
        parallel = camera.is_parallel(client)
        camera.set_lens(client, camera.FIELD_OF_VIEW if parallel else camera.PARALLEL)

    def _toggle_dark(self, client: viser.ClientHandle) -> None:
        self._set_dark(client, client.client_id not in self._dark)

    def _set_dark(self, client: viser.ClientHandle, dark: bool) -> None:
        (self._dark.add if dark else self._dark.discard)(client.client_id)
        style.set_theme(client.gui, dark)

    def _group(self, label: str, hint: str, orders: dict[str, Order]) -> None:
        group = self._gui.add_button_group(label, tuple(orders), hint=hint)

        @group.on_click
        async def _clicked(event: viser.GuiEvent[Any]) -> None:
            order = orders.get(str(event.target.value))
            if event.client is not None and order is not None:
                self._input.submit(order, event.client)

    def _layer(self, name: str, shown: bool, switch: Callable[[bool], None]) -> None:
        box = self._gui.add_checkbox(name, shown)

        @box.on_update
        async def _switch(event: viser.GuiEvent[Any]) -> None:
            switch(bool(event.target.value))
