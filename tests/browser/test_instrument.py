"""What a user sees of the whole instrument: the shaft on the rim of the fontanelle."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from app.scenarios.presets import PRESETS
from app.scenarios.staging import begin
from app.session import Session
from app.settings import Options
from app.view import Page
from tests.support.watching import Visitor, drawn_share, wait_until

pytestmark = pytest.mark.slow
SCENARIO = PRESETS["through-the-fontanelle"]


@pytest.fixture(scope="module")
def session(chromium: str) -> Iterator[Session]:
    with Session(SCENARIO.applied(Options(rate=500.0))) as session:
        yield session


@pytest.fixture(scope="module")
def page(session: Session) -> Iterator[Page]:
    page = Page(session, "127.0.0.1", 0, SCENARIO)
    begin(SCENARIO, session)
    yield page
    page.close()


@pytest.fixture(scope="module")
def visitor(page: Page, open_tab: Callable[[Page], Visitor]) -> Visitor:
    return open_tab(page)


def test_the_page_names_the_part_that_is_held_and_draws_its_capsule(
    visitor: Visitor, session: Session, page: Page
) -> None:
    wait_until(lambda: session.latest().time > 9.9, "the script to end")
    visitor.tab.get_by_text("The fixture holds the shaft back").wait_for()
    visitor.tab.get_by_text("nearest part: shaft").wait_for()
    assert 0.019 < float(visitor.readout("nearest part: shaft")) < 0.03
    page._instrument.show = True  # as the layer's switch does
    visitor.tab.wait_for_timeout(3000)
    assert drawn_share(visitor.picture("shaft-on-the-rim")) > 0.03
    session.set(guard="tip")
    visitor.tab.get_by_text("shaft is in the mesh: only the tip is guarded.").wait_for()
