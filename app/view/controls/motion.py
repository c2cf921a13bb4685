"""Folder "Motion": whether the structures of the scene move, how fast, and how vertices come."""

from __future__ import annotations

from typing import Any

from app.devices.driving import PACE
from app.scene.moment import Moment
from app.scene.scene import Scene
from app.view.context import PageContext
from app.view.controls.fields import bind, show
from app.view.device_lamps import link_row, rows_table
from app.view.part import Part


class MotionControl(Part):
    """The folder; it is there only where structures move."""

    def __init__(self, context: PageContext) -> None:
        self._session, self._source = context.session, context.source
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
            self._link: Any = gui.add_html("", visible=False)
        for control, take in (
            (self._on, lambda value: self._session.move_structures(on=bool(value))),
            (self._pace, lambda value: self._session.move_structures(pace=float(value))),
        ):
            bind(control, context.client_input, context.notify, take, self._sync)
        self.set_scene(context.session.scene)

    def set_scene(self, scene: Scene) -> None:
        self._folder.visible = scene.moves

    def read_out(self, shown: Moment) -> None:
        link = shown.stream
        free = self._source.live and link is None
        self._on.disabled = self._pace.disabled = not free
        content = "" if link is None else rows_table([link_row("vertices", link)])
        if content != self._link.content:
            self._link.content, self._link.visible = content, bool(content)
        self._sync()

    def _sync(self) -> None:
        on, pace = self._session.motion
        show(self._on, on)
        show(self._pace, pace)
