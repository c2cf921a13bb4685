"""Masters and arms that are elsewhere: lamps, rates, ages, latencies, and the arm's state."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from typing import Any

import viser

from app.devices.report import LinkReport, Report
from app.scene.moment import Moment
from app.session import Session
from app.view import palette
from app.view.clients.client_input import ClientInput
from app.view.part import Part

BUTTONS = {"enable": "Enable the arm", "disable": "Disable the arm"}
_STYLE = (
    "width:calc(100% - 1.5em);margin:0 .75em .4em;font-size:12px;line-height:1.35;"
    "border-collapse:collapse;font-variant-numeric:tabular-nums;color:var(--vf-ink)"
)
_LAMP = "display:inline-block;width:9px;height:9px;border-radius:50%;margin-right:6px"


class DeviceLamps(Part):
    """A table of devices and the buttons for the arm; only where any device is elsewhere."""

    def __init__(
        self,
        server: viser.ViserServer,
        session: Session,
        client_input: ClientInput,
        order: float,
    ) -> None:
        """`order`: position in the panel of controls."""
        self._session, self._input = session, client_input
        self._table: Any = None
        if session.spec is None:
            return
        self._table = server.gui.add_html("", order=order)
        if session.spec.arm == "sim":
            return
        for step, (word, label) in enumerate(BUTTONS.items(), 1):
            button = server.gui.add_button(
                label,
                order=order + 0.1 * step,
                color="red" if word == "disable" else None,
                hint="Set-points go to the arm only while it is enabled.",
            )
            button.on_click(self._ordering(word))

    def read_out(self, shown: Moment) -> None:
        if self._table is not None:
            report = self._session.devices
            self._table.content = "" if report is None else table(report)

    def _ordering(self, word: str) -> Any:
        async def clicked(event: viser.GuiEvent[Any]) -> None:
            self._input.submit(lambda _client: self._session.state_command(word), event.client)

        return clicked


def table(report: Report) -> str:
    """The devices as HTML: a lamp, a name and figures each."""
    state = report.state + (f": {report.why}" if report.why else "")
    good = report.state == "ENABLED"
    color = palette.GREEN if good else palette.ALARM if report.why else palette.ORANGE
    rows = [
        _row(color, "state", state),
        _row(palette.GREEN if not report.holds else palette.ORANGE, "tool",
             f"holds: {report.holds}" if report.holds else "follows"),
        link_row("arm", report.arm),
        link_row("master", report.master),
    ]  # fmt: skip
    if report.arm.url != "sim":
        over = report.error > report.limit
        rows.append(
            _row(
                palette.ALARM if over else palette.GREEN,
                "off the path",
                f"{1e6 * report.error:.0f} µm of {1e6 * report.limit:.0f} µm",
            )
        )
    median, worst = report.latency
    if not math.isnan(median):
        rows.append(
            _row(palette.GREEN, "latency", f"{1e3 * median:.2f} ms, 99.9 % {1e3 * worst:.2f} ms")
        )
    return rows_table(rows)


def rows_table(rows: Sequence[str]) -> str:
    """Rows of devices as a table."""
    return f"<table class='vf-devices' style='{_STYLE}'>{''.join(rows)}</table>"


def link_row(name: str, link: LinkReport) -> str:
    """A device as a row: a lamp, its name, and how it is."""
    if link.trouble:
        return _row(palette.ALARM, name, f"{link.url}: {link.trouble}")
    text = link.url
    if link.rate:
        text += f", {link.rate:.0f} Hz, {1e3 * link.age:.0f} ms old"
    refused = sum(link.refused.values())
    return _row(palette.GREEN, name, text + (f", {refused:,} refused" if refused else ""))


def _row(color: palette.Rgb, name: str, text: str) -> str:
    lamp = f"<span style='{_LAMP};background:{palette.css(color)}'></span>"
    return (
        f"<tr><td style='white-space:nowrap;padding-right:8px'>{lamp}{html.escape(name)}</td>"
        f"<td style='overflow-wrap:anywhere'>{html.escape(text)}</td></tr>"
    )
