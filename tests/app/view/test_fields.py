"""Number fields: typed values are clamped, refused, and notified."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from app.view.controls import fields
from app.words import Refused
from tests.support.stand_ins import ClientInput, Handle, client


class Typing:
    """A number field with a stand-in for its timer."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, take: Callable[[float], object]) -> None:
        self.timers: list[Any] = []
        self.told: list[str] = []
        self.value = 5.0

        def timer(_seconds: float, function: Any, arguments: Any) -> Any:
            made = SimpleNamespace(on=False)
            made.start = lambda: setattr(made, "on", True)
            made.cancel = lambda: setattr(made, "on", False)
            made.end = lambda: function(*arguments) if made.on else None
            self.timers.append(made)
            return made

        monkeypatch.setattr(fields.threading, "Timer", timer)

        def takes(value: float) -> None:
            take(value)
            self.value = value

        self.control = Handle(label="Radius [mm]", value=5.0)
        self.field = fields.NumberField(
            self.control,  # type: ignore[arg-type]
            (0.05, 20.0),
            ClientInput(),  # type: ignore[arg-type]
            lambda _client, text: self.told.append(text),
            takes,
            lambda: self.value,
        )

    def type(self, *texts: float) -> None:
        for number in texts:
            self.control.act(client(), value=number)
            self.field.sync()  # the page does four times a second

    def wait(self) -> None:
        for timer in self.timers:
            timer.end()


def test_a_number_in_range_is_set_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    typing = Typing(monkeypatch, lambda value: None)
    typing.type(7.5)
    assert typing.value == 7.5
    assert typing.told == []


def test_a_number_is_not_clamped_while_it_is_typed(monkeypatch: pytest.MonkeyPatch) -> None:
    typing = Typing(monkeypatch, lambda value: None)
    typing.type(0.0)
    assert typing.control.value == 0.0, "the field is left alone while somebody types"
    typing.type(0.0, 0.5)
    typing.wait()
    assert typing.value == 0.5
    assert typing.control.value == 0.5
    assert typing.told == []


@pytest.mark.parametrize(("typed", "becomes"), [(900.0, 20.0), (0.0, 0.05), (-3.0, 0.05)])
def test_a_clamped_number_is_shown_and_notified(
    monkeypatch: pytest.MonkeyPatch, typed: float, becomes: float
) -> None:
    for browser_clamps in (False, True):
        typing = Typing(monkeypatch, lambda value: None)
        typing.type(typed)
        if browser_clamps:  # it does so when the field is left
            typing.type(becomes)
        typing.wait()
        assert typing.value == becomes
        assert typing.control.value == becomes
        assert len(typing.told) == 1
        for word in ("Radius", f"{typed:g}", f"{becomes:g}", "0.05 to 20"):
            assert word in typing.told[0]


def test_a_refused_number_is_reset_and_notified(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(value: float) -> None:
        raise Refused(f"a corridor of {value:g} mm is wider than the path's bends allow")

    typing = Typing(monkeypatch, refuse)
    typing.type(12.0)
    assert typing.control.value == 5.0
    assert "12 mm is wider" in typing.told[0]
