"""Layer: the point where the tool's tip crossed the mesh."""

from __future__ import annotations

import viser

from app.control.watch import Crossing
from app.scene.moment import Moment
from app.view import palette
from app.view.drawing import nodes
from app.view.drawing.labels import Labels
from app.view.part import Clients, Part
from app.view.units import to_view


class CrossingMark(Part):
    """A dot and a label at the first crossing since the last reset or change of scene."""

    def __init__(self, api: viser.SceneApi, labels: Labels) -> None:
        self._dot = nodes.dot(api, "/crossing/dot", palette.ALARM, 0.1)
        self._label = labels.add("/crossing/label", anchor="top-left")
        self._shown: Crossing | None = None

    def frame(self, shown: Moment, clients: Clients) -> None:
        crossing = shown.crossing
        if crossing is self._shown:
            return
        self._shown = crossing
        self._dot.visible = self._label.visible = crossing is not None
        if crossing is not None:
            self._dot.position = self._label.position = to_view(crossing.point)
            what = "crossed" if crossing.centre else "touched"
            where = f" {crossing.structure}" if shown.scene.structures else ""
            self._label.text = f"✕ {what}{where} at tick {crossing.tick:,}"
