"""A gamepad or a 3D mouse on a client's machine: what it says, and the motion it asks for."""

from __future__ import annotations

import math
import time
from collections.abc import Container
from dataclasses import dataclass
from functools import partial

import numpy as np
import pinocchio as pin
import viser
from numpy.typing import NDArray

from app.session import Session
from app.view.camera import viewer_axes
from app.view.clients.client_input import ClientInput

FloatArray = NDArray[np.float64]

GAMEPAD = "gamepad"  # what moves the proxy
SPEED = 0.02  # of the handle with a stick pressed to its end [m/s]
SPIN = 0.8  # [rad/s]
FINE = 0.2  # of both, while a trigger is pressed
DEAD = 0.12  # deflection that counts as none: sticks do not come back to zero
LONGEST = 0.1  # time between two messages that counts, so that a delay is no leap [s]
MOST = 32  # axes, and buttons, of a device
# Buttons of the Gamepad API's standard layout.
CLUTCH, TURN, TRIGGERS = 0, (4, 5), (6, 7)


@dataclass(frozen=True)
class State:
    """What a device says: axes −1 to 1 and which buttons are pressed."""

    standard: bool  # the standard layout; else the six axes of a 3D mouse
    axes: tuple[float, ...]
    pressed: frozenset[int]

    def twist(self) -> tuple[FloatArray, FloatArray]:
        """Motion (3,) and turn (3,) asked for along right, away and up, each up to 1."""
        stick = [_beyond_dead(value) for value in self.axes]
        if self.standard:
            left, right = (stick[0], -stick[1]), (stick[2], -stick[3])
            if self.pressed & set(TURN):
                return np.zeros(3), np.array([-right[1], right[0], -left[0]])
            return np.array([left[0], left[1], right[1]]), np.array([0.0, 0.0, -right[0]])
        # A 3D mouse has x to the right, y to the user and z down, likewise for the turns.
        x, y, z, rx, ry, rz = stick
        return np.array([x, -y, -z]), np.array([rx, -ry, -rz])

    @property
    def pace(self) -> float:
        return FINE if self.standard and self.pressed & set(TRIGGERS) else 1.0


def read(text: str) -> State | None:
    """What page.js sent: layout, axes, numbers of the pressed buttons, time; None: unusable."""
    parts = text.split("|")
    if len(parts) != 4 or parts[0] not in ("standard", ""):
        return None
    try:
        axes = tuple(float(one) for one in parts[1].split(",") if one)
        pressed = frozenset(int(one) for one in parts[2].split(",") if one)
    except ValueError:
        return None
    least = 4 if parts[0] else 6
    usable = least <= len(axes) <= MOST and len(pressed) <= MOST
    if not usable or not all(abs(value) <= 1.0 for value in axes):
        return None
    return State(bool(parts[0]), axes[:least], pressed)


class Gamepad:
    """Moves the handle at the speed that the sticks say, in the directions of the client's view.

    Where no message comes nothing moves. Who drags the gizmo or the tool goes first.
    """

    def __init__(self, session: Session, client_input: ClientInput) -> None:
        self._session = session
        self._input = client_input
        self._last: dict[int, float] = {}  # of clients whose device moves: time of the last message
        self._clutched: int | None = None  # client that presses the clutch

    def take(self, client: viser.ClientHandle, text: str) -> None:
        """On the worker: one message of a client."""
        state = read(text)
        if state is None:
            self.end(client)
            return
        move, turn = state.twist()
        number = client.client_id
        self._clutch(number, CLUTCH in state.pressed)
        if not (move.any() or turn.any()):
            self.end(client)
            return
        now = time.monotonic()
        elapsed = min(now - self._last.get(number, now), LONGEST)
        phase = "update" if number in self._last else "start"
        axes = viewer_axes(client.camera.wxyz)
        pace = state.pace * elapsed
        shift, about = axes @ move * (SPEED * pace), axes @ turn * (SPIN * pace)
        if self._input.drag(GAMEPAD, client, number, phase, partial(self._moved, shift, about)):
            self._last[number] = now
        else:
            self._last.pop(number, None)

    def end(self, client: viser.ClientHandle) -> None:
        """The sticks are at rest."""
        if self._last.pop(client.client_id, None) is not None:
            handle = self._session.handle
            self._input.drag(GAMEPAD, client, client.client_id, "end", lambda: handle)

    def forget(self, clients: Container[int]) -> None:
        """From the view thread: release the clutch of a client that has left."""
        number = self._clutched
        if number is not None and number not in clients:
            self._input.submit(self._clutch, number, False)

    def _clutch(self, number: int, pressed: bool) -> None:
        if pressed and self._clutched is None:
            self._clutched = number
            self._session.clutch(True)
        elif not pressed and self._clutched == number:
            self._clutched = None
            self._session.clutch(False)

    def _moved(self, shift: FloatArray, about: FloatArray) -> pin.SE3:
        handle = self._session.handle
        return pin.SE3(pin.exp3(about) @ handle.rotation, handle.translation + shift)


def _beyond_dead(value: float) -> float:
    """A deflection −1 to 1 without the part around zero, continuous."""
    return math.copysign(max(abs(value) - DEAD, 0.0) / (1.0 - DEAD), value)
