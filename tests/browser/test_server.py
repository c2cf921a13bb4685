"""A page that other machines reach, opened by a real browser with its token and without."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
import viser

from app.session import Session
from app.view import Page
from tests.support.watching import Visitor, wait_until

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def open_page(session: Session) -> Iterator[Page]:
    page = Page(session, "0.0.0.0", 0)
    yield page
    page.close()


def test_the_printed_address_opens_the_page_and_its_cookie_opens_it_again(
    open_page: Page, open_tab: Callable[[Page], Visitor]
) -> None:
    visitor = open_tab(open_page)
    bare = open_page.url.partition("?")[0]
    assert visitor.tab.evaluate("document.cookie") == "", "scripts do not see the token"
    known = set(open_page.server.get_clients())
    visitor.tab.goto(bare)
    wait_until(lambda: set(open_page.server.get_clients()) - known, "the page without its token")
    assert not visitor.complaints
    visitor.tab.close()


def test_without_the_token_there_is_a_sentence_and_no_page(open_page: Page, browser: Any) -> None:
    tab = browser.new_page()
    answer = tab.goto(open_page.url.partition("?")[0])
    assert answer.status == 403
    assert "A token is needed" in tab.inner_text("body")
    assert not open_page.server.get_clients()
    tab.close()


def test_another_site_s_script_gets_no_connection(open_page: Page, browser: Any) -> None:
    tab = browser.new_page()
    tab.goto("data:text/html,elsewhere")
    outcome = tab.evaluate(
        """([url, protocol]) => new Promise(resolve => {
          const socket = new WebSocket(url, [protocol]);
          socket.onopen = () => resolve("open");
          socket.onerror = () => resolve("refused");
        })""",
        [open_page.url.replace("http", "ws"), f"viser-v{viser.__version__}"],
    )
    assert outcome == "refused"
    tab.close()
