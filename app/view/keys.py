"""Nudging the proxy with keys that viser's camera does not use."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from app.session import Session
from app.view.hand import Hand, Tell

FloatArray = NDArray[np.float64]

FINE = 1e-4  # [m] of the handle for each press
COARSE = 1e-3  # with Shift [m]

# Under the right hand what W A S D Q E are under the left one, which fly the camera. Directions as
# (right, away, up), seen by the one who presses.
KEYS: dict[str, tuple[str, tuple[float, float, float]]] = {
    "J": ("left", (-1.0, 0.0, 0.0)),
    "L": ("right", (1.0, 0.0, 0.0)),
    "I": ("away", (0.0, 1.0, 0.0)),
    "K": ("near", (0.0, -1.0, 0.0)),
    "U": ("down", (0.0, 0.0, -1.0)),
    "O": ("up", (0.0, 0.0, 1.0)),
}


class Keys:
    """Twelve commands: six directions, fine and coarse. Also found in the palette (Ctrl+K)."""

    def __init__(self, server: viser.ViserServer, session: Session, hand: Hand, tell: Tell) -> None:
        self._session = session
        self._hand = hand
        self._tell = tell
        for key, (word, direction) in KEYS.items():
            for length in (FINE, COARSE):
                command = server.gui.add_command(
                    f"Nudge the proxy {word} by {length * 1e3:g} mm",
                    hotkey=key,  # type: ignore[arg-type]
                    modifier="shift" if length == COARSE else None,
                )
                command.on_trigger(partial(self._pressed, direction, length))

    async def _pressed(
        self, direction: tuple[float, float, float], length: float, event: Any
    ) -> None:
        if event.client is not None:
            self._hand.submit(self._nudge, event.client, np.array(direction), length)

    def _nudge(self, client: viser.ClientHandle, direction: FloatArray, length: float) -> None:
        if self._hand.owner is not None:
            if self._hand.owner != client.client_id:
                self._tell(client, f"{self._hand.name_of_owner} is dragging the proxy: wait.")
            return
        try:
            self._session.nudge(length * (seen_from(client.camera.wxyz) @ direction))
        except ValueError as error:
            self._tell(client, f"Not nudged: {error}.")
        self._hand.moved.set()


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
