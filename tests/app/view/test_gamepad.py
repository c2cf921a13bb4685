"""A gamepad's messages: read, refused, and turned into motion of the proxy."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.session import Session
from app.settings import Options
from app.view.clients import gamepad
from app.view.clients.client_input import ClientInput
from app.view.controls import feel

STANDARD = "standard|{}|{}|1"


@pytest.mark.parametrize(
    "text",
    [
        "", "standard|0,0,0,0|", "standard|0,0,0|0|1", "xbox|0,0,0,0||1", "|0,0,0,0||1",
        "standard|0,0,0,nan||1", "standard|0,0,0,1.5||1", "standard|0,0,0,inf||1",
        "standard|a,0,0,0||1", "standard|0,0,0,0|x|1", "standard|" + "0," * 40 + "||1",
    ],
)  # fmt: skip
def test_what_is_no_state_of_a_device_is_none(text: str) -> None:
    assert gamepad.read(text) is None


@given(st.text(max_size=60))
def test_no_text_breaks_it(text: str) -> None:
    state = gamepad.read(text)
    if state is not None:
        move, turn = state.twist()
        assert np.abs(np.concatenate([move, turn])).max() <= 1.0


@pytest.mark.parametrize(
    ("axes", "pressed", "move", "turn"),
    [
        ("1,0,0,0", "", [1, 0, 0], [0, 0, 0]),
        ("0,-1,0,0", "", [0, 1, 0], [0, 0, 0]),  # a stick pushed forward says −1
        ("0,0,0,-1", "", [0, 0, 1], [0, 0, 0]),
        ("0,0,1,0", "", [0, 0, 0], [0, 0, -1]),
        ("0,0,0,-1", "5", [0, 0, 0], [-1, 0, 0]),
        ("0.1,-0.1,0.05,0", "", [0, 0, 0], [0, 0, 0]),
    ],
)
def test_directions_of_the_sticks(
    axes: str, pressed: str, move: list[float], turn: list[float]
) -> None:
    state = gamepad.read(STANDARD.format(axes, pressed))
    assert state is not None
    np.testing.assert_allclose(state.twist()[0], move, atol=1e-12)
    np.testing.assert_allclose(state.twist()[1], turn, atol=1e-12)


def test_directions_of_a_3d_mouse() -> None:
    state = gamepad.read("|0.0,-1.0,0.0,0.0,0.0,1.0||1")
    assert state is not None
    np.testing.assert_allclose(state.twist()[0], [0.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(state.twist()[1], [0.0, 0.0, -1.0], atol=1e-12)


@pytest.fixture
def session() -> Iterator[Session]:
    with Session(Options(mesh="sphere", robot="point")) as session:
        yield session


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [10.0]
    monkeypatch.setattr(gamepad.time, "monotonic", lambda: now[0])
    return now


class Pad:
    """A client with a gamepad, without a browser: messages are taken at once."""

    def __init__(self, session: Session, number: int, entry: ClientInput) -> None:
        # A camera that looks down, its right along x: away, level, is y.
        camera = SimpleNamespace(wxyz=np.array([0.0, 1.0, 0.0, 0.0]))
        self.client: Any = SimpleNamespace(client_id=number, camera=camera)
        self.pad = gamepad.Gamepad(session, entry)

    def say(self, axes: str, pressed: str = "") -> None:
        self.pad.take(self.client, STANDARD.format(axes, pressed))


@pytest.fixture
def pads(session: Session) -> Iterator[tuple[Pad, Pad, ClientInput]]:
    clients: dict[int, Any] = {}
    server: Any = SimpleNamespace(get_clients=lambda: clients)
    entry = ClientInput(session, server, MagicMock(), MagicMock())
    one, other = Pad(session, 1, entry), Pad(session, 2, entry)
    other.pad = one.pad
    clients.update({1: one.client, 2: other.client})
    yield one, other, entry
    entry.close()


def test_moves_at_the_speed_of_the_stick_and_stops_with_the_messages(
    session: Session, pads: tuple[Pad, Pad, ClientInput], clock: list[float]
) -> None:
    pad, other, entry = pads
    start = session.handle.translation.copy()
    pad.say("1,0,0,0")
    for _ in range(10):
        clock[0] += 0.05
        pad.say("1,0,0,0")
    np.testing.assert_allclose(session.handle.translation - start, [0.01, 0.0, 0.0], atol=1e-9)
    assert entry.owner == 1
    other.say("0,1,0,0")
    clock[0] += 0.05
    other.say("0,1,0,0")
    np.testing.assert_allclose(session.handle.translation - start, [0.01, 0.0, 0.0], atol=1e-9)
    clock[0] += 30.0  # a tab in the background
    pad.say("1,0,0,0", "6")
    fine = gamepad.FINE * gamepad.SPEED * gamepad.LONGEST
    np.testing.assert_allclose(session.handle.translation[0] - start[0], 0.01 + fine, atol=1e-9)
    pad.say("0,0,0,0")
    assert entry.owner is None
    clock[0] += 1.0
    other.say("0,0,0,-1")
    assert entry.owner == 2


def test_the_clutch_is_released_when_its_client_leaves(
    session: Session, pads: tuple[Pad, Pad, ClientInput], clock: list[float]
) -> None:
    pad, other, entry = pads
    pad.say("0,0,0,0", "0")
    assert session.master.clutched
    other.say("0,0,0,0")
    assert session.master.clutched, "another's device does not release it"
    pad.pad.forget({1: None, 2: None})
    pad.pad.forget({2: None})
    entry._worker.submit(lambda: None).result()
    assert not session.master.clutched


def test_tones_rise_with_the_force_and_differ_by_structure() -> None:
    tones = [feel.pitch(k, 0.0) for k in range(15)]
    assert len(set(tones)) == 15
    assert tones[0] == feel.LOWEST
    assert feel.pitch(2, 4.0) == pytest.approx(2.0 * feel.pitch(2, 0.0))
    assert feel.pitch(2, 100.0) == feel.pitch(2, 4.0)
