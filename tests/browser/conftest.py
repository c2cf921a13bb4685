"""A real session and page, watched and driven by a real Chromium. Shared by all browser tests.

They end with the browser tests: their threads must not tick under the tests that follow.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from app.bench.tools import watcher
from app.session import Session
from app.settings import Options
from app.view import Page
from tests.support.watching import FEWER_FRAMES, Visitor, settle

# A software renderer makes the browser complain about performance; that says nothing about us.
HARMLESS = (
    "GPU stall",
    "Clock: This module has been deprecated",
    "swiftshader",
    "WebGL is running",
)


@pytest.fixture(scope="package")
def chromium() -> str:
    try:
        return watcher.chromium()
    except watcher.NoBrowser as reason:
        if os.environ.get("VF_REQUIRE_BROWSER") == "1":
            pytest.fail(str(reason))
        pytest.skip(str(reason))


@pytest.fixture(scope="module")
def session(chromium: str) -> Iterator[Session]:
    # Half the usual rate, to leave a small machine something for the browser.
    with Session(Options(mesh="skull-coarse", rate=500.0)) as session:
        yield session


@pytest.fixture(scope="module")
def page(session: Session) -> Iterator[Page]:
    page = Page(session, "127.0.0.1", 0)
    yield page
    page.close()


@pytest.fixture(scope="package")
def browser(chromium: str) -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=list(watcher.ARGUMENTS))
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def open_tab(browser: Any) -> Iterator[Callable[[Page], Visitor]]:
    """Opens another tab on a page and waits until it knows the tab and has sent everything.

    It ends with the module: a software renderer makes every tab costly, most of all one that looks
    for a page that is gone.
    """
    tabs: list[Any] = []

    def open_it(page: Page) -> Visitor:
        known = set(page.server.get_clients())
        # Low resolution: a software renderer has a sixth of the pixels to fill.
        tab = browser.new_page(viewport={"width": 1280, "height": 720}, device_scale_factor=0.4)
        tab.add_init_script(FEWER_FRAMES)
        tabs.append(tab)
        visitor = Visitor(tab, -1, page)
        tab.on(
            "console",
            lambda message: (
                visitor.complaints.append(message.text)
                if message.type in ("error", "warning")
                and not any(word in message.text for word in HARMLESS)
                else None
            ),
        )
        tab.on("pageerror", lambda error: visitor.complaints.append(str(error)))
        tab.goto(page.url)
        settle(visitor, known)
        return visitor

    yield open_it
    for tab in tabs:
        tab.close()


@pytest.fixture(scope="module")
def visit(page: Page, open_tab: Callable[[Page], Visitor]) -> Callable[[], Visitor]:
    """Opens another tab on the page that most tests share."""
    return lambda: open_tab(page)


@pytest.fixture(scope="module")
def visitor(visit: Callable[[], Visitor]) -> Visitor:
    """The tab that the tests of a module share."""
    return visit()
