"""Number fields of options: a value out of range is clamped, and the client is notified."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from typing import Any

import viser

from app.view.clients.client_input import ClientInput, Notify

# A number out of range may be the beginning of one within: it is clamped only so long after the
# last key [s].
TYPING_DELAY = 1.0

Take = Callable[[float], object]


def obey(
    client: viser.ClientHandle,
    notify: Notify,
    take: Callable[[Any], object],
    value: Any,
    sync: Callable[[], None],
) -> None:
    """Take a value that a client gave, or tell the client why not; then show what is in force."""
    try:
        take(value)
    except (ValueError, TypeError, OverflowError) as error:
        notify(client, f"{error}")
    finally:
        sync()


def bind(
    control: Any,
    client_input: ClientInput,
    notify: Notify,
    take: Callable[[Any], object],
    sync: Callable[[], None],
) -> None:
    """Pass a control's new value to `take`, then show the value in force.

    Args:
        take: sets a value; raises ValueError to refuse it, which the client is told.
        sync: shows what is in force.
    """

    def order(client: viser.ClientHandle, value: Any) -> None:
        obey(client, notify, take, value, sync)

    @control.on_update
    async def _updated(event: viser.GuiEvent[Any]) -> None:
        if event.client is not None:  # None: set by this program
            client_input.submit(order, event.client, event.target.value)


class NumberField:
    """A number control and the option that it sets."""

    def __init__(
        self,
        control: viser.GuiNumberHandle[Any],
        limits: tuple[float, float],
        client_input: ClientInput,
        notify: Notify,
        take: Take,
        shown: Callable[[], float | None],
    ) -> None:
        """Listen to a control.

        Args:
            limits: lowest and highest number, in the control's unit.
            take: sets a number within the limits; raises ValueError to refuse it.
            shown: the number in force, in the control's unit; None: keep the last one.
        """
        self._control = control
        self._limits = limits
        self._input = client_input
        self._notify = notify
        self._take = take
        self._shown = shown
        self._good = float(control.value)  # the last one in force
        self._timer: threading.Timer | None = None
        self._outside: float | None = None  # typed, not yet clamped

        @control.on_update
        async def _typed(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:  # None: set by this program
                self._typed(event.client, event.target.value)

    def sync(self) -> None:
        """Show the number in force, unless a client is typing."""
        if self._outside is not None:
            return
        now = self._shown()
        if now is not None:
            self._good = now
        show(self._control, self._good)

    def _typed(self, client: viser.ClientHandle, typed: object) -> None:
        """On the event loop: set a number within the limits, wait with any other."""
        if self._timer is not None:
            self._timer.cancel()
        before, self._outside = self._outside, None
        low, high = self._limits
        number = float(typed) if isinstance(typed, int | float) else math.nan
        if low <= number <= high:
            # The browser clamps a number when its field loses the focus.
            clamped = before if number in (low, high) else None
            self._input.submit(self._act, client, number, clamped)
        elif math.isfinite(number):
            self._outside = number
            self._timer = threading.Timer(TYPING_DELAY, self._end, (client, number))
            self._timer.daemon = True
            self._timer.start()

    def _end(self, client: viser.ClientHandle, number: float) -> None:
        low, high = self._limits
        self._input.submit(self._act, client, min(max(number, low), high), number)

    def _act(self, client: viser.ClientHandle, number: float, typed: float | None) -> None:
        """On the input worker: set the number; `typed`: what it was before it was clamped."""
        self._outside = None
        try:
            self._take(number)
        except (ValueError, TypeError, OverflowError) as error:
            self._notify(client, f"{error}")
        else:
            self._good = number
            if typed is not None:
                low, high = self._limits
                self._notify(
                    client,
                    f"{self._control.label}: {number:g}, as {typed:g} is outside "
                    f"{low:g} to {high:g}.",
                )
        finally:
            self.sync()


def show(control: Any, value: Any) -> None:
    """Set a control's value, unless it equals the shown one up to rounding."""
    shown = control.value
    if shown == value:
        return
    if isinstance(value, float) and isinstance(shown, int | float):
        if math.isclose(shown, value, rel_tol=1e-9, abs_tol=1e-12):
            return
        value = float(f"{value:.6g}")
    control.value = value
