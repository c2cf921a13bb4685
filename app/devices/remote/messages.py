"""What devices say to each other, whatever they say it over; not checked (see `border`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol


@dataclass(slots=True)
class Message:
    """A CRTK command or feedback. Which of the values it has depends on its name.

    Attributes:
        name: such as "servo_jp" or "jaw/measured_js".
        numbers: joints [rad or m], or force and torque [N, N m].
        velocity: of joints [rad/s or m/s].
        rotation: rows of a rotation.
        translation: [m].
        text: a word, a state, or a sentence.
        pressed: of a button.
        frame: name of the frame a pose is in; empty: not said.
        stamp: time by the sender's clock [s]; None: none.
        valid: whether the sender says that the values are valid.
        homed, busy: of an operating state.
        at: time of arrival, by our monotonic clock [s].
    """

    name: str
    numbers: object = None
    velocity: object = None
    rotation: object = None
    translation: object = None
    text: str = ""
    pressed: bool = False
    frame: str = ""
    stamp: float | None = None
    valid: bool = True
    homed: bool = False
    busy: bool = False
    at: float = 0.0


class Transport(Protocol):
    """Carries messages to and from one device. All calls are from the control thread; none blocks.

    Attributes:
        refused: how many of what arrived could not be read, by reason.
        peer: who is at the other end, for people; empty: nobody yet.
    """

    refused: dict[str, int]

    @property
    def peer(self) -> str: ...

    def receive(self, now: float) -> Sequence[Message]:
        """What has arrived, in the order of arrival. `now`: of the monotonic clock [s]."""
        ...

    def send(self, message: Message, now: float) -> None:
        """Send a message if there is anybody to send it to."""
        ...

    def close(self) -> None:
        """Give back what it holds. Safe to call twice."""
        ...
