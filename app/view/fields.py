"""Number fields of settings: what is typed out of range is put right, and that is said."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from typing import Any

import viser

from app.view.hand import Hand, Tell

# What is out of range may be the beginning of a number that is not, so it is looked at this long
# after the last key [s].
PATIENCE = 1.0

Take = Callable[[float], object]


class NumberField:
    """A number of the panel and the setting behind it."""

    def __init__(
        self,
        control: viser.GuiNumberHandle[Any],
        limits: tuple[float, float],
        hand: Hand,
        tell: Tell,
        take: Take,
        shown: Callable[[], float | None],
    ) -> None:
        """Listen to a control.

        Args:
            limits: the least and the largest number, in the control's unit.
            take: gives a number within them to the session; a ValueError refuses it.
            shown: the number that is in force, in the control's unit; None leaves the last one.
        """
        self._control = control
        self._limits = limits
        self._hand = hand
        self._tell = tell
        self._take = take
        self._shown = shown
        self._good = float(control.value)  # the last one in force
        self._waiting: threading.Timer | None = None
        self._outside: float | None = None  # typed and not yet put right

        @control.on_update
        async def _typed(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:  # None: we set it ourselves
                self._typed(event.client, event.target.value)

    def sync(self) -> None:
        """Show the number in force, unless somebody is about to type another."""
        if self._outside is not None:
            return
        now = self._shown()
        if now is not None:
            self._good = now
        show(self._control, self._good)

    def _typed(self, client: viser.ClientHandle, typed: object) -> None:
        """On the event loop: act at once, or wait for the end of the number."""
        if self._waiting is not None:
            self._waiting.cancel()
        before, self._outside = self._outside, None
        low, high = self._limits
        number = float(typed) if isinstance(typed, int | float) else math.nan
        if low <= number <= high:
            # A browser puts a number right itself when its field is left.
            put_right = before if number in (low, high) else None
            self._hand.submit(self._act, client, number, put_right)
        elif math.isfinite(number):
            self._outside = number
            self._waiting = threading.Timer(PATIENCE, self._end, (client, number))
            self._waiting.daemon = True
            self._waiting.start()

    def _end(self, client: viser.ClientHandle, number: float) -> None:
        low, high = self._limits
        self._hand.submit(self._act, client, min(max(number, low), high), number)

    def _act(self, client: viser.ClientHandle, number: float, typed: float | None) -> None:
        """On the hand's worker: give it to the session, say what became of it."""
        self._outside = None
        try:
            self._take(number)
        except (ValueError, TypeError, OverflowError) as error:
            self._tell(client, f"{error}")
        else:
            self._good = number
            if typed is not None:
                low, high = self._limits
                self._tell(
                    client,
                    f"{self._control.label}: {number:g}, as {typed:g} is outside "
                    f"{low:g} to {high:g}.",
                )
        finally:
            self.sync()


def show(control: Any, value: Any) -> None:
    """Set a control without touching one that shows the value already, but for rounding."""
    shown = control.value
    if shown == value:
        return
    if isinstance(value, float) and isinstance(shown, int | float):
        if math.isclose(shown, value, rel_tol=1e-9, abs_tol=1e-12):
            return
        value = float(f"{value:.6g}")
    control.value = value
