"""What the page shows of masters and arms that are elsewhere, and its buttons for the arm."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import pytest

from app.devices.report import LinkReport, Report
from app.session import Session
from app.settings import Options
from app.view import Page
from app.view import device_lamps as devices
from app.view.device_lamps import BUTTONS, DeviceLamps
from tests.support.counterparts import counterpart, free_port
from tests.support.headless import wait_until
from tests.support.stand_ins import ClientInput, Gui

GOOD = Report(
    "ENABLED", "", True, False, "",
    LinkReport("socket://h:1", "h:9", 1480.0, 0.0012, "", {"repeated": 3}),
    LinkReport("socket://h:2", "h:8", 1000.0, 0.001),
    error=12e-6, largest=40e-6, limit=1e-4, latency=(0.9e-3, 2e-3), sent=7,
)  # fmt: skip


def shown(report: Report) -> list[str]:
    rows = re.findall(r"<tr>(.*?)</tr>", devices.table(report))
    return [re.sub(r"<[^>]*>", " ", row).strip() for row in rows]


def lamps(report: Report) -> list[str]:
    return re.findall(r"background:([^']+)'", devices.table(report))


def test_rates_ages_and_latencies_are_shown() -> None:
    text = " | ".join(shown(GOOD))
    for words in (
        "ENABLED", "follows", "1480 Hz, 1 ms old, 3 refused", "12 µm of 100 µm",
        "0.90 ms, 99.9 % 2.00 ms",
    ):  # fmt: skip
        assert words in text
    assert len(set(lamps(GOOD))) == 1


def test_lamps_differ_where_something_is_wrong() -> None:
    good = lamps(GOOD)[0]
    fault = replace(GOOD, state="FAULT", why="it is <far> off", holds="the arm is FAULT")
    assert lamps(fault)[:2] != [good, good]
    assert "it is &lt;far&gt; off" in devices.table(fault)
    silent = replace(GOOD, arm=replace(GOOD.arm, trouble="the arm is silent"))
    assert lamps(silent)[2] != good
    assert "socket://h:1: the arm is silent" in " ".join(shown(silent))
    assert lamps(replace(GOOD, error=2e-4))[4] != good


def test_the_sandbox_has_no_lamps() -> None:
    class Alone:
        spec = None

    gui = Gui()
    server: Any = type("Server", (), {"gui": gui})
    DeviceLamps(server, Alone(), ClientInput(), 0.0)  # type: ignore[arg-type]
    assert gui.made == []


def test_the_button_enables_the_arm() -> None:
    port = free_port()
    options = Options(mesh="cube", robot="psm", arm=f"socket://127.0.0.1:{port}?age=200ms")
    with Session(options) as session, counterpart("arm", port) as arm:
        page = Page(session, "127.0.0.1", 0)
        try:
            wait_until(lambda: session.devices is not None and session.devices.arm.rate > 0)
            part = next(p for p in page._parts if isinstance(p, DeviceLamps))
            page._read_out()
            assert "DISABLED" in part._table.content
            gui = Gui()
            server: Any = type("Server", (), {"gui": gui})
            made = DeviceLamps(server, session, ClientInput(), 0.0)  # type: ignore[arg-type]
            assert made._table is not None
            enable, disable = (one for one in gui.made if one.label in BUTTONS.values())
            enable.act(None)
            wait_until(lambda: session.devices.state == "ENABLED")
            disable.act(None)
            wait_until(lambda: session.devices.state == "DISABLED")
        finally:
            page.close()
        arm.quit()


def test_an_arm_of_the_sandbox_needs_no_state() -> None:
    with Session(Options(mesh="cube", robot="point")) as session:
        assert session.devices is None
        with pytest.raises(ValueError, match="always enabled"):
            session.state_command("enable")
