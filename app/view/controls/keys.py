"""Keyboard commands, which viser also lists in its command palette (Ctrl+K).

W A S D Q E and the arrow keys are taken: they move viser's camera.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

import vf
from app.session import Session
from app.view.camera import viewer_axes
from app.view.clients.client_input import ClientInput, Notify

FloatArray = NDArray[np.float64]
Order = Callable[[viser.ClientHandle], object]  # called with the client that gives it

FINE = 1e-4  # motion of the handle per key press [m]
COARSE = 1e-3  # with Shift [m]

# The right hand's counterpart of W A S D Q E. Directions as (right, away, up) in the client's view.
NUDGES: dict[str, tuple[str, tuple[float, float, float]]] = {
    "J": ("left", (-1.0, 0.0, 0.0)),
    "L": ("right", (1.0, 0.0, 0.0)),
    "I": ("away", (0.0, 1.0, 0.0)),
    "K": ("near", (0.0, -1.0, 0.0)),
    "U": ("down", (0.0, 0.0, -1.0)),
    "O": ("up", (0.0, 0.0, 1.0)),
}
# Ticks per press of N, by modifier key.
STEPS: dict[str | None, int] = {None: 1, "shift": 10, "alt": 100}

KEYED = 4  # rules that have a key, `1` and so on; the others are only in the list


class Keys:
    """The commands; each is queued behind the client's earlier input."""

    def __init__(
        self,
        server: viser.ViserServer,
        session: Session,
        client_input: ClientInput,
        notify: Notify,
        views: dict[str, tuple[str, Order]],
    ) -> None:
        """`views`: label and order of the camera commands, by key."""
        self._gui = server.gui
        self._session = session
        self._input = client_input
        self._notify = notify
        self._add("Loop: pause, or run", "P", lambda _client: self._pause_or_run())
        for held, ticks in STEPS.items():
            label = f"Loop: pause, and do {ticks} tick{'s' if ticks > 1 else ''}"
            self._add(label, "N", partial(self._step, ticks), held)
        self._add("Reset tool and proxy", "R", lambda _client: session.reset())
        self._add("Recall the proxy to the tool", "C", lambda _client: session.recall())
        self._add("Autopilot: on, or off", "G", lambda _client: self._toggle_autopilot())
        for number, rule in enumerate(vf.RULES[:KEYED], 1):
            self._add(f"Rule: {rule}", str(number), partial(self._rule, rule))
        for key, (label, order) in views.items():
            self._add(label, key, order)
        for key, (word, direction) in NUDGES.items():
            for length, held in ((FINE, None), (COARSE, "shift")):
                self._add(
                    f"Nudge the proxy {word} by {length * 1e3:g} mm",
                    key,
                    partial(self._nudge, np.array(direction), length),
                    held,
                )

    def _add(self, label: str, key: str, order: Order, held: str | None = None) -> None:
        command = self._gui.add_command(
            label,
            hotkey=key,  # type: ignore[arg-type]
            modifier=held,  # type: ignore[arg-type]
        )

        @command.on_trigger
        async def _pressed(event: Any) -> None:
            if event.client is not None:
                self._input.submit(order, event.client)

    def _nudge(self, direction: FloatArray, length: float, client: viser.ClientHandle) -> None:
        if self._input.owner is not None:
            if self._input.owner != client.client_id:
                self._notify(client, f"{self._input.owner_name} is dragging the proxy: wait.")
            return
        try:
            self._session.nudge(length * (viewer_axes(client.camera.wxyz) @ direction))
        except ValueError as error:
            self._notify(client, f"Not nudged: {error}.")
        self._input.moved.set()

    def _pause_or_run(self) -> None:
        if self._session.latest().paused:
            self._session.resume()
        else:
            self._session.pause()

    def _step(self, ticks: int, _client: viser.ClientHandle) -> None:
        self._session.single_step(ticks)

    def _toggle_autopilot(self) -> None:
        self._session.set_autopilot(not self._session.latest().autopilot)

    def _rule(self, rule: str, _client: viser.ClientHandle) -> None:
        self._session.set(rule=rule)
