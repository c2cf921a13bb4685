"""Folder "Motion": whether the structures of the scene move, and how fast."""

from __future__ import annotations

from typing import Any

import viser

from app.devices.driving import PACE
from app.scene.moment import Moment
from app.scene.scene import Scene
from app.view.context import PageContext
from app.view.controls.fields import show
from app.view.part import Part


class MotionControl(Part):
    """The folder; it is there only where structures move."""

    def __init__(self, context: PageContext) -> None:
        self._session, self._source = context.session, context.source
        self._input, self._notify = context.client_input, context.notify
        gui = context.server.gui
        with gui.add_folder("Motion") as self._folder:
            self._on: Any = gui.add_checkbox(
                "Structures move", True, hint="Off, they rest where they are, and so does time."
            )
            self._pace: Any = gui.add_slider(
                "Speed ×",
                PACE.low,
                PACE.high,
                0.05,
                1.0,
                hint="Time of the motion, and of its tracker, over that of the tool.",
            )
        self._bind(self._on, lambda value: self._session.move_structures(on=bool(value)))
        self._bind(self._pace, lambda value: self._session.move_structures(pace=float(value)))
        self.set_scene(context.session.scene)

    def set_scene(self, scene: Scene) -> None:
        self._folder.visible = scene.moves

    def read_out(self, shown: Moment) -> None:
        live = self._source.live
        self._on.disabled = self._pace.disabled = not live
        self._sync()

    def _sync(self) -> None:
        on, pace = self._session.motion
        show(self._on, on)
        show(self._pace, pace)

    def _bind(self, control: Any, take: Any) -> None:
        """Pass a control's new value to `take`, then show the value in force."""

        def order(client: viser.ClientHandle, value: Any) -> None:
            try:
                take(value)
            except (ValueError, TypeError, OverflowError) as error:
                self._notify(client, f"{error}")
            finally:
                self._sync()

        @control.on_update
        async def _updated(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:  # None: set by this program
                self._input.submit(order, event.client, event.target.value)
