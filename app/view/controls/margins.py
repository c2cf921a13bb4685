"""Legend of the heat map of margins, in the panel of controls while the map is drawn."""

from __future__ import annotations

import viser

from app.scene.moment import Moment
from app.view.drawing.anatomy import Anatomy
from app.view.drawing.heat.bands import legend
from app.view.part import Part


class MarginLegend(Part):
    """Nothing is there while no structure is drawn in the colours of its margin."""

    def __init__(self, server: viser.ViserServer, anatomy: Anatomy, order: float) -> None:
        """`order`: position in the panel of controls."""
        self._anatomy = anatomy
        self._html = server.gui.add_html("", order=order, visible=False)

    def read_out(self, shown: Moment) -> None:
        scale = self._anatomy.margins
        content = "" if scale is None else legend(scale)
        if self._html.content != content:
            self._html.content = content
            self._html.visible = scale is not None
