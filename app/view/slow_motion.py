"""The last two seconds in slow motion, in place of the session."""

from __future__ import annotations

import time
from typing import Any

import viser

from app.control.messages import Telemetry
from app.scene.moment import Moment
from app.view.context import PageContext
from app.view.part import Part
from app.words import Refused

PACE = 0.2  # of the replay
LAST = "the last seconds are shown in slow motion, and the session waits: Escape ends it"


class SlowMotion(Part):
    """A button that shows what just happened, to all clients. The session is suspended meanwhile.

    It returns to the session by itself at the end, or on the button or Escape.
    """

    def __init__(self, context: PageContext, folder: viser.GuiFolderHandle) -> None:
        """The button is added to the folder."""
        self._context, self._session, self._source = context, context.session, context.source
        self._ticks: list[Telemetry] = []  # what is shown; empty: nothing
        self._began = 0.0
        with folder:
            self._button: Any = context.server.gui.add_button(
                "Last 2 s in slow motion",
                hint="What just happened, at a fifth of its speed. The session waits meanwhile.",
                icon=viser.Icon.HISTORY,
            )

        @self._button.on_click
        async def _pressed(_event: viser.GuiEvent[Any]) -> None:
            context.client_input.submit(self._toggle)

        context.escape.add_fallback(self.leave)

    def _toggle(self) -> None:
        if self.leave():
            return
        if not self._source.live or self._context.fixture.suppressed:
            raise Refused("leave the replay or “Freeze and explore” first")
        self._session.suspend(LAST)
        ticks = self._session.past
        if not ticks:
            self._session.go_on()
            raise Refused("nothing has happened in this scene yet")
        self._context.client_input.release()
        self._began = time.monotonic()
        self._ticks = ticks
        self._source.override = self._now

    def leave(self) -> bool:
        """Return to the session; whether it was in slow motion."""
        if not self._ticks:
            return False
        self._ticks = []
        self._source.override = None
        self._session.go_on()
        return True

    def read_out(self, shown: Moment) -> None:
        ticks = self._ticks
        if ticks and self._passed() > ticks[-1].time - ticks[0].time:
            self._context.client_input.submit(self.leave)
        label = "Back to the session" if ticks else "Last 2 s in slow motion"
        if self._button.label != label:
            self._button.label = label

    def _passed(self) -> float:
        """How much of what is shown has been shown [s]."""
        return PACE * (time.monotonic() - self._began)

    def _now(self) -> Moment:
        ticks = self._ticks
        if not ticks:  # it ends while a frame is drawn
            return self._source.shown
        length, dt = ticks[-1].time - ticks[0].time, self._session.options.dt
        passed = min(self._passed(), length)
        self._source.caption = (
            f"Slow motion: {length - passed:.2f} s before the session was stopped. It waits."
        )
        return self._source.moment(ticks[min(round(passed / dt), len(ticks) - 1)])
