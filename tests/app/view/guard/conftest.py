"""A page with a control loop behind it that ticks on, whatever hostile clients do to the page."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from app.session import Session
from app.settings import Options
from app.view import Page
from tests.support.headless import wait_until


@pytest.fixture(autouse=True)
def no_thread_left_behind() -> None:
    """The page's pools start threads as they are needed, and end them with the page."""


@pytest.fixture(scope="module")
def session() -> Iterator[Session]:
    with Session(Options(mesh="cube", robot="point", rate=200.0)) as session:
        yield session


@contextmanager
def serving(session: Session, host: str) -> Iterator[Page]:
    page = Page(session, host, 0)
    try:
        yield page
    finally:
        page.close()


@pytest.fixture(scope="module")
def page(session: Session) -> Iterator[Page]:
    before = set(threading.enumerate())
    with serving(session, "127.0.0.1") as page:
        yield page
    for thread in set(threading.enumerate()) - before:
        thread.join(5.0)
        assert not thread.is_alive(), thread.name


@pytest.fixture(scope="module")
def open_page(session: Session) -> Iterator[Page]:
    """One that listens on every address of this machine."""
    with serving(session, "0.0.0.0") as page:
        yield page


@pytest.fixture(autouse=True)
def ticking(session: Session) -> Iterator[None]:
    """Whatever a test did to the page, the loop is alive after it."""
    yield
    before = session.latest().tick
    wait_until(lambda: session.latest().tick > before + 5)
