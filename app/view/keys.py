"""Everything that has a key. viser lists all of it in its palette too (Ctrl+K).

Taken already: W A S D Q E and the arrows fly viser's camera.
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
from app.view.hand import Hand, Tell

FloatArray = NDArray[np.float64]
Order = Callable[[viser.ClientHandle], object]  # what a client asks for

FINE = 1e-4  # [m] of the handle for each press
COARSE = 1e-3  # with Shift [m]

# Under the right hand what W A S D Q E are under the left one, which fly the camera. Directions as
# (right, away, up), seen by the one who presses.
NUDGES: dict[str, tuple[str, tuple[float, float, float]]] = {
    "J": ("left", (-1.0, 0.0, 0.0)),
    "L": ("right", (1.0, 0.0, 0.0)),
    "I": ("away", (0.0, 1.0, 0.0)),
    "K": ("near", (0.0, -1.0, 0.0)),
    "U": ("down", (0.0, 0.0, -1.0)),
    "O": ("up", (0.0, 0.0, 1.0)),
}
# How many ticks, by what is held with the key N.
STEPS: dict[str | None, int] = {None: 1, "shift": 10, "alt": 100}


class Keys:
    """The commands. What a key does comes after everything that was done before it."""

    def __init__(
        self,
        server: viser.ViserServer,
        session: Session,
        hand: Hand,
        tell: Tell,
        views: dict[str, tuple[str, Order]],
    ) -> None:
        """`views`, by key: what the palette calls an order about the picture, and the order."""
        self._gui = server.gui
        self._session = session
        self._hand = hand
        self._tell = tell
        self._add("Loop: pause, or run", "P", lambda _client: self._pause_or_run())
        for held, ticks in STEPS.items():
            label = f"Loop: pause, and do {ticks} tick{'s' if ticks > 1 else ''}"
            self._add(label, "N", partial(self._step, ticks), held)
        self._add("Reset tool and proxy", "R", lambda _client: session.reset())
        self._add("Recall the proxy to the tool", "C", lambda _client: session.recall())
        self._add("Autopilot: on, or off", "G", lambda _client: self._fly())
        for number, rule in enumerate(vf.RULES, 1):
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
                self._hand.submit(order, event.client)

    def _nudge(self, direction: FloatArray, length: float, client: viser.ClientHandle) -> None:
        if self._hand.owner is not None:
            if self._hand.owner != client.client_id:
                self._tell(client, f"{self._hand.name_of_owner} is dragging the proxy: wait.")
            return
        try:
            self._session.nudge(length * (seen_from(client.camera.wxyz) @ direction))
        except ValueError as error:
            self._tell(client, f"Not nudged: {error}.")
        self._hand.moved.set()

    def _pause_or_run(self) -> None:
        if self._session.latest().paused:
            self._session.resume()
        else:
            self._session.pause()

    def _step(self, ticks: int, _client: viser.ClientHandle) -> None:
        self._session.single_step(ticks)

    def _fly(self) -> None:
        self._session.set_autopilot(not self._session.latest().autopilot)

    def _rule(self, rule: str, _client: viser.ClientHandle) -> None:
        self._session.set(rule=rule)


def seen_from(wxyz: FloatArray) -> FloatArray:
    """The axes right, away and up of a viewer, as columns (3, 3): level, and up is +z.

    Args:
        wxyz: (4,) the camera's orientation, +z forward and +x right as viser has it. One that looks
            straight up or down has its top in place of forward.
    """
    w, x, y, z = np.asarray(wxyz, dtype=np.float64)
    right = np.array([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 0.0])
    # A camera held level has a level right; one that rolls is told so by its shadow on the floor.
    length = np.linalg.norm(right)
    right = right / length if length > 1e-6 else np.array([1.0, 0.0, 0.0])
    up = np.array([0.0, 0.0, 1.0])
    return np.column_stack([right, np.cross(up, right), up])
