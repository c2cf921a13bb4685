"""Folder "Hand": contact as sound and vibration, and a gamepad or 3D mouse as the hand.

The page's own script (`page.js`) does what a browser can do and viser cannot: it reads what to do
from an HTML element, and writes what a gamepad, the wheel and a second finger say into the hidden
text field behind it.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any

import numpy as np
import viser

from app.scene.moment import Moment
from app.view.clients.client_input import ClientInput
from app.view.clients.gamepad import Gamepad
from app.view.clients.grab import Grab
from app.view.context import PageContext
from app.view.part import Clients, Part

FULL = 4.0  # force of the loudest sound [N]
LOUDEST = 0.25
# Pitch of the first structure without force [Hz], and the steps to those of the others: a
# pentatonic scale, in which all tones go together.
LOWEST = 220.0
SCALE = (0, 3, 5, 7, 10)  # [semitones]
BENT = 12.0  # by which the full force raises the pitch [semitones]
MIN_FORCE = 0.02  # a weaker force is not heard [N]
MIN_PUSH = 1e-6  # of a plane that holds [m]


class Senses:
    """The element that tells browsers what to play, and the field in which their script answers.

    It says nothing of contacts while neither sound nor gamepad is on.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        client_input: ClientInput,
        grab: Grab,
        take: Callable[[viser.ClientHandle, str], None] | None = None,
    ) -> None:
        """Add both.

        Args:
            grab: is told of the wheel and the second finger.
            take: on the input's worker, is told what a gamepad says; None: nobody is.
        """
        self._grab = grab
        self._contacts, self._touching, self._said = 0, False, ""
        self._element: Any = gui.add_html("")
        field: Any = gui.add_text("Gamepad", "")

        @field.on_update
        async def _answered(event: viser.GuiEvent[Any]) -> None:
            kind, _, said = str(event.target.value).partition(":")
            if event.client is None:
                return
            if kind == "reach":
                client_input.submit(self._reach, event.client, said)
            elif kind == "pad" and take is not None:
                client_input.submit(take, event.client, said)

        self._say(False, False, "0", "0")

    def frame(self, shown: Moment, sound: bool, gamepad: bool = False) -> None:
        """From the view thread: say what is heard and felt."""
        force = float(np.linalg.norm(shown.force))
        of = holder(shown)
        # In free space there is a force too, of the way by which the tool is behind the proxy.
        touching = of is not None and force > MIN_FORCE
        self._contacts += (sound or gamepad) and touching and not self._touching
        self._touching = touching
        if not sound or of is None or not touching:
            self._say(sound, gamepad, "0", "0")
            return
        level = LOUDEST * min(force / FULL, 1.0)
        self._say(sound, gamepad, f"{pitch(of, force):.0f}", f"{level:.3f}")

    def _reach(self, client: viser.ClientHandle, said: str) -> None:
        with contextlib.suppress(ValueError):  # of a client that is not the page
            depth, turn, _ = map(float, said.split("|"))
            self._grab.reach(client, depth, turn)

    def _say(self, sound: bool, gamepad: bool, hertz: str, level: str) -> None:
        said = (
            f"<div class='vf-orders vf-hand' data-sound='{int(sound)}' "
            f"data-gamepad='{int(gamepad)}' data-held='{int(self._grab.holds)}' "
            f"data-pitch='{hertz}' data-level='{level}' data-contacts='{self._contacts}'></div>"
        )
        if said != self._said:
            self._said = said
            self._element.content = said


class Feel(Part):
    """The folder with its switches."""

    def __init__(self, context: PageContext, grab: Grab) -> None:
        """`grab` is told of the wheel and the second finger."""
        gui = context.server.gui
        self._input = context.client_input
        self._gamepad = Gamepad(context.session, context.client_input)
        self._senses = Senses(gui, context.client_input, grab, self._take)
        with gui.add_folder("Hand", expand_by_default=False) as self.folder:
            self._sound: Any = gui.add_checkbox(
                "Sound",
                False,
                hint="A tone while the fixture holds the tool: louder and higher with the force, "
                "another for each structure, with a short one at first contact (and a vibration, "
                "on a phone).",
            )
            self._pad: Any = gui.add_checkbox(
                "Gamepad or 3D mouse",
                False,
                hint="Left stick: right, away. Right stick: up, turn; with a bumper both turn. "
                "A trigger: fine. First button: clutch. It vibrates at a contact.",
            )

        @self._pad.on_update
        async def _switched(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None and not event.target.value:
                self._input.submit(self._gamepad.end, event.client)

    def frame(self, shown: Moment, clients: Clients) -> None:
        self._gamepad.forget(clients)
        self._senses.frame(shown, bool(self._sound.value), bool(self._pad.value))

    def _take(self, client: viser.ClientHandle, said: str) -> None:
        if self._pad.value:
            self._gamepad.take(client, said)


def holder(shown: Moment) -> int | None:
    """Number of the fixture that pushes the tool most; None: none does."""
    step = shown.telemetry.step
    if step is None or not len(step.multipliers):
        return None
    most = int(step.multipliers.argmax())
    if step.multipliers[most] <= MIN_PUSH:
        return None
    return 0 if step.planes.fixtures is None else int(step.planes.fixtures[most])


def pitch(structure: int, force: float) -> float:
    """The tone [Hz] of a structure that is pressed with a force [N]."""
    octave, step = divmod(structure, len(SCALE))
    semitones = 12 * (octave % 3) + SCALE[step] + BENT * min(force / FULL, 1.0)
    return float(LOWEST * 2.0 ** (semitones / 12.0))
