"""Structures that move, on the page: drawn where they are, stopped and paced by its controls."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from app.motion.declared import Motion, Tracker
from app.session import Session
from app.settings import Options
from app.view import Page
from tests.support.watching import Visitor, wait_until

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def session(chromium: str) -> Iterator[Session]:
    options = Options(
        mesh="cube",
        robot="point",
        rate=500.0,
        motions=(Motion("breathing", move=(0.02, 0.0, 0.0), period=2.0),),
        tracker=Tracker(rate=10.0, latency=0.2, bound=0.1),
    )
    with Session(options) as session:
        yield session


@pytest.fixture(scope="module")
def visitor(page: Page, open_tab: Callable[[Page], Visitor]) -> Visitor:
    return open_tab(page)


def test_it_stops_and_goes_on_by_the_box_and_is_drawn_elsewhere_meanwhile(
    visitor: Visitor, session: Session
) -> None:
    box = visitor.tab.get_by_label("Structures move")
    box.scroll_into_view_if_needed()
    box.click()
    wait_until(lambda: not session.motion[0], "the structures to rest")
    rested = session.latest().phase
    first = visitor.picture("rested")
    assert session.latest().phase == rested
    box.click()
    wait_until(lambda: session.motion[0], "the structures to move")
    # Half a breath on.
    wait_until(lambda: abs(session.latest().phase - rested) % 2.0 > 0.9, "the structure elsewhere")
    second = visitor.picture("moved")
    assert np.mean(np.abs(first.astype(float) - second.astype(float)).max(axis=2) > 20) > 0.005
    assert visitor.complaints == []


def test_the_read_outs_have_margin_age_and_contacts(visitor: Visitor) -> None:
    assert visitor.readout("tip met the true anatomy").startswith("0")
    assert 0.2 <= float(visitor.readout("age of the last sighting").split()[0]) <= 0.4
