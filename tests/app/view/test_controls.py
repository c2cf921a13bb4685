"""Keys, the Escape key and the help."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from app.session import Session
from app.settings import Options
from app.view.camera import viewer_axes
from app.view.clients.escape import EscapeKey
from app.view.controls.help import Help
from app.view.controls.keys import STEPS, Keys
from app.view.controls.views import Views
from tests.support.headless import wait_until
from tests.support.stand_ins import ClientInput, Gui, Handle, client


@pytest.fixture(scope="module")
def session() -> Iterator[Session]:
    with Session(Options(mesh="cube", robot="point", rate=500.0)) as session:
        yield session


@pytest.fixture
def panel(session: Session) -> SimpleNamespace:
    """All commands without a browser; the camera orders and the notifications."""
    gui, client_input = Gui(), ClientInput()
    looked: list[str] = []
    told: list[str] = []
    notify = lambda _client, text: told.append(text)  # noqa: E731
    server: Any = SimpleNamespace(gui=gui, on_client_disconnect=lambda function: function)
    escape = EscapeKey(server, client_input)  # type: ignore[arg-type]
    Help(server, client_input, escape, 0.0)  # type: ignore[arg-type]
    views = Views(
        server,
        client_input,  # type: ignore[arg-type]
        lambda _client, name: looked.append(name),
        lambda _client: looked.append("section"),
        {},
    )
    Keys(server, session, client_input, notify, views.commands())  # type: ignore[arg-type]
    return SimpleNamespace(gui=gui, looked=looked, told=told, escape=escape)


def test_every_key_has_one_command_and_none_of_visers(panel: Any) -> None:
    commands = panel.gui.commands()
    keys = {key for key, _ in commands}
    flying = {*"WASDQE", "arrowup", "arrowdown", "arrowleft", "arrowright"}
    assert not keys & flying
    # Nudges, pause, steps, reset, rules, views, lens, section.
    assert keys >= {*"JLIKUOPNRTVFXZBH1234567890", "escape"}
    assert {held for key, held in commands if key == "N"} == {None, "shift", "alt"}
    assert all(command.label for command in commands.values()), "each has a label"
    assert len({command.label for command in commands.values()}) == len(commands)


def test_keys_pause_step_choose_rules_and_reset(panel: Any, session: Session) -> None:
    commands = panel.gui.commands()
    me = client()
    press = lambda key, held=None: commands[key, held].act(me)  # noqa: E731
    press("P")
    wait_until(lambda: session.latest().paused)
    for held, ticks in STEPS.items():
        before = session.latest().tick
        press("N", held)
        wait_until(lambda n=before + ticks: session.latest().tick >= n)
        assert session.latest().tick == before + ticks
        assert session.latest().paused
    press("P")
    wait_until(lambda: not session.latest().paused)
    for number, rule in enumerate(("certified", "paper", "all", "off"), 1):
        press(str(number))
        assert session.options.rule == rule
    press("1")
    before_nudge = session.handle.translation.copy()
    press("J", "shift")
    moved = session.handle.translation - before_nudge
    np.testing.assert_allclose(moved, -1e-3 * viewer_axes(me.camera.wxyz)[:, 0], atol=1e-12)
    press("R")
    np.testing.assert_allclose(
        session.handle.translation, session.scene.T_base_start.translation, atol=1e-12
    )
    press("G")
    wait_until(lambda: session.latest().autopilot)
    press("C")
    wait_until(lambda: not session.latest().autopilot)
    for key, name in (("5", "Side"), ("6", "Front"), ("7", "Top"), ("0", "Arm"), ("X", "section")):
        press(key)
        assert panel.looked[-1] == name
    assert panel.told == []


def test_the_dark_theme_is_per_client(panel: Any) -> None:
    one, other = client(0), client(1)
    toggle = panel.gui.commands()["B", None]
    for _ in range(2):
        toggle.act(one)
    toggle.act(other)
    assert [theme["dark_mode"] for theme in one.gui.themes] == [True, False]
    assert [theme["dark_mode"] for theme in other.gui.themes] == [True]


def test_escape_closes_the_clients_newest_dialog_then_calls_the_fallbacks(panel: Any) -> None:
    escape, closed = panel.escape, []
    replay = [True]
    escape.add_fallback(lambda: bool(replay) and replay.pop())
    first, second = lambda: closed.append("first"), lambda: closed.append("second")
    escape.opened(0, first)
    escape.opened(0, second)
    escape.opened(1, lambda: closed.append("another's"))
    escape.press(0)
    assert closed == ["second"]
    escape.closed(0, first)  # by its own button
    escape.closed(0, first)
    escape.press(0)
    assert closed == ["second"]
    assert replay == []
    escape.press(0)  # nothing is open any more
    assert closed == ["second"]


def test_escape_closes_the_help(panel: Any) -> None:
    me = client()
    shut: list[bool] = []
    me.gui.add_modal = lambda _title: Handle(close=lambda: shut.append(True))
    commands = panel.gui.commands()
    commands["H", None].act(me)
    commands["escape", None].act(me)
    assert shut == [True]
    commands["escape", None].act(me)
    assert shut == [True]
