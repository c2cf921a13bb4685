"""The last seconds in slow motion: what is shown, and that the session goes on afterwards."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import nullcontext
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pinocchio as pin
import pytest

from app.session import Session
from app.settings import Options
from app.view import slow_motion
from app.view.source import Source
from app.words import Refused
from tests.support.headless import wait_until


@pytest.fixture
def session() -> Iterator[Session]:
    with Session(Options(mesh="sphere", robot="point")) as session:
        wait_until(lambda: session.latest().step is not None)
        yield session


class Shown:
    """The part without a page, and a clock that the test turns."""

    def __init__(self, session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 100.0
        monkeypatch.setattr(slow_motion, "time", SimpleNamespace(monotonic=lambda: self.now))
        self.source = Source(session)
        self.context = MagicMock(session=session, source=self.source)
        self.context.fixture.suppressed = False
        self.context.client_input.submit = lambda order: order()
        self.part = slow_motion.SlowMotion(self.context, nullcontext())  # type: ignore[arg-type]

    def press(self) -> None:
        self.part._toggle()


def test_shows_the_last_ticks_slowly_and_goes_on(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = Shown(session, monkeypatch)
    start = session.handle.translation.copy()
    session.drive(pin.SE3(np.eye(3), start + np.array([4e-3, 0.0, 0.0])))
    goal = start + np.array([4e-3, 0.0, 0.0])
    wait_until(lambda: np.allclose(session.latest().step.tip.translation, goal, atol=1e-6))
    shown.press()
    assert session.suspended
    assert not shown.source.live
    with pytest.raises(Refused, match="slow motion"):
        session.drive(session.handle)
    ticks = shown.part._ticks
    assert [b.tick - a.tick for a, b in itertools.pairwise(ticks)] == [1] * (len(ticks) - 1)
    length = ticks[-1].time - ticks[0].time
    seen = []
    for share in (0.0, 0.5, 0.9, 1.5):
        shown.now = 100.0 + share * length / slow_motion.PACE
        moment = shown.source.now()
        seen.append(moment.telemetry.tick)
        assert moment.telemetry in ticks
    expected = [ticks[0].tick + share * (len(ticks) - 1) for share in (0.0, 0.5, 0.9, 1.0)]
    np.testing.assert_allclose(seen, expected, atol=1.0)
    shown.part.read_out(shown.source.now())  # beyond its end
    assert shown.source.live
    assert not session.suspended
    before = session.latest().tick
    wait_until(lambda: session.latest().tick > before)


def test_it_is_left_on_the_button_and_by_escape(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = Shown(session, monkeypatch)
    (leave,) = (call.args[0] for call in shown.context.escape.add_fallback.call_args_list)
    assert not leave()
    for end in (shown.press, leave):
        shown.press()
        assert session.suspended
        shown.part.read_out(shown.source.now())
        assert not shown.source.live
        end()
        assert shown.source.live
        assert not session.suspended


def test_it_is_refused_beside_a_replay_and_before_anything_happened(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = Shown(session, monkeypatch)
    shown.source.override = shown.source.now
    with pytest.raises(Refused, match="leave the replay"):
        shown.press()
    shown.source.override = None
    session.change(mesh="cube")
    monkeypatch.setattr(type(session), "past", [])
    with pytest.raises(Refused, match="nothing has happened"):
        shown.press()
    assert shown.source.live
    assert not session.suspended


def test_ticks_of_another_scene_are_none_of_the_past(session: Session) -> None:
    session.change(mesh="cube")
    wait_until(lambda: len(session.past) > 3)
    assert {one.scene for one in session.past} == {session.scene.version}
    assert len(session._watch.past) <= 2.0 * session.options.rate
