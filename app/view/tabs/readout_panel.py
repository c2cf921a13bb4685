"""The left-hand panel with read-outs and legend, and the banner."""

from __future__ import annotations

import viser

from app.scene.moment import Moment
from app.session import Session
from app.view.part import Part
from app.view.source import Source
from app.view.tabs import legend, readouts
from app.view.tabs.measuring import Measuring


class ReadoutPanel(Part):
    """Tabs with the read-outs and the legend; other parts add tabs to `panel`."""

    def __init__(
        self, server: viser.ViserServer, session: Session, source: Source, order: float
    ) -> None:
        """`order`: position of the banner in the panel of controls."""
        self._session, self._source = session, source
        self._measuring = Measuring()
        self._banner = server.gui.add_html("", order=order)
        self.panel = server.gui.add_panel()
        with self.panel.add_tab("Read-outs"):
            self._table = server.gui.add_html("")
        with self.panel.add_tab("Legend"):
            server.gui.add_html(legend.legend())
        self.panel.dock_left()
        self.panel.set_width(290)

    def read_out(self, shown: Moment) -> None:
        options, telemetry = shown.options, shown.telemetry
        session = self._session
        extras = self._measuring.measure(shown, session.unwatched, session.ended)
        self._table.content = readouts.readouts(telemetry, options, extras)
        if self._source.live:
            self._banner.content = readouts.banner(telemetry, options, extras, shown.clutched)
        else:
            self._banner.content = readouts.note(self._source.caption)
