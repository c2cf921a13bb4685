"""A real session and page, watched and driven by a real Chromium. Shared by all browser tests."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from app.session import Session
from app.settings import Options
from app.view import Page

# Pytest's importlib mode puts no test folder on the path; these tests share `watching`.
sys.path.append(str(Path(__file__).parent))

from watching import Visitor, settle

# Software rendering; the rest keeps a sandboxed container and its network out of the way.
ARGUMENTS = [
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
# A software renderer makes the browser complain about performance; that says nothing about us.
HARMLESS = (
    "GPU stall",
    "Clock: This module has been deprecated",
    "swiftshader",
    "WebGL is running",
)


def find_chromium() -> str | None:
    """Path of a Chromium or Chrome: VF_CHROMIUM, or the usual names."""
    names = (os.environ.get("VF_CHROMIUM"), "chromium", "chromium-browser", "google-chrome")
    return next((path for name in names if name and (path := shutil.which(name))), None)


@pytest.fixture(scope="session")
def chromium() -> str:
    path = find_chromium()
    if path is None:
        reason = (
            "no Chromium found: install chromium (Debian) or Chrome, or name one in VF_CHROMIUM"
        )
        if os.environ.get("VF_REQUIRE_BROWSER") == "1":
            pytest.fail(reason)
        pytest.skip(reason)
    return path


@pytest.fixture(scope="session")
def session(chromium: str) -> Iterator[Session]:
    # Half the usual rate, to leave a small machine something for the browser.
    with Session(Options(mesh="skull-coarse", rate=500.0)) as session:
        yield session


@pytest.fixture(scope="session")
def page(session: Session) -> Iterator[Page]:
    page = Page(session, "127.0.0.1", 0)
    yield page
    page.close()


@pytest.fixture(scope="session")
def browser(chromium: str) -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=ARGUMENTS)
        yield browser
        browser.close()


@pytest.fixture(scope="session")
def visit(browser: Any, page: Page) -> Callable[[], Visitor]:
    """Opens another tab and waits until the page knows it and has sent everything."""

    def open_tab() -> Visitor:
        known = set(page.server.get_clients())
        # Low resolution: a software renderer has a sixth of the pixels to fill.
        tab = browser.new_page(viewport={"width": 1280, "height": 720}, device_scale_factor=0.4)
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

    return open_tab


@pytest.fixture(scope="session")
def visitor(visit: Callable[[], Visitor]) -> Visitor:
    """The tab that most tests share."""
    return visit()
