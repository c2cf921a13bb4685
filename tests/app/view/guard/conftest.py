"""A page with a running control loop, for tests with hostile clients."""

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
    """Not checked per test: the page's thread pools end with the page."""


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
    """A page that listens on all addresses of this machine."""
    with serving(session, "0.0.0.0") as page:
        yield page


@pytest.fixture(autouse=True)
def ticking(session: Session) -> Iterator[None]:
    """After each test the control loop still runs."""
    yield
    before = session.latest().tick
    wait_until(lambda: session.latest().tick > before + 5)
