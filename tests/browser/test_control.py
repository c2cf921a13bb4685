"""The control process dies under a page: the page says so, and one button brings it back."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from app.session import Session
from app.settings import Options
from app.view import Page
from app.view.controls.restart import LABEL
from tests.support.headless import moved
from tests.support.watching import Visitor, wait_until


@pytest.fixture(scope="module")
def session(chromium: str) -> Iterator[Session]:
    with Session(Options(mesh="cube", robot="point", rate=500.0), process=True) as session:
        yield session


def test_a_user_restarts_a_control_process_that_died(
    session: Session, page: Page, visit: Callable[[], Visitor]
) -> None:
    visitor = visit()
    button = visitor.tab.get_by_role("button", name=LABEL, exact=True)
    banner = visitor.tab.locator(".vf-banner")
    assert button.count() == 0
    session.set(radius=1e-3)
    session.drive(moved(session.scene.T_base_start, dx=2e-3, dz=-2e-3))
    wait_until(lambda: rests(session), "the tool to come to rest")
    for _ in range(2):
        place = session._loop.place
        assert place is not None
        os.kill(place[0], signal.SIGKILL)
        button.wait_for(timeout=30_000)
        wait_until(lambda: "The control loop ended (signal SIGKILL)" in banner.inner_text(), "it")
        before = session.latest()
        button.click()
        wait_until(
            lambda before=before: not session.ended and session.latest().tick > before.tick, "ticks"
        )
        button.wait_for(state="detached", timeout=30_000)
        wait_until(lambda: "Ready: drag the tool" in banner.inner_text(), "the banner")
        np.testing.assert_array_equal(session.latest().q, before.q)
        assert session.options.radius == 1e-3
    assert not visitor.complaints


def rests(session: Session) -> Any:
    now = session.latest()
    tip = now.step is not None and now.step.tip.translation
    return now.target is not None and np.allclose(tip, now.target.translation, atol=1e-6)
