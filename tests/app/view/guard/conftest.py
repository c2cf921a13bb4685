"""A page with a control loop behind it that ticks on, whatever hostile clients do to the page."""

from __future__ import annotations

import http.client
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
import viser
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from app.session import Session
from app.settings import Options
from app.view import Page

PROTOCOL = f"viser-v{viser.__version__}"


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
def ticking(session: Session, wait_until: Callable[..., None]) -> Iterator[None]:
    """Whatever a test did to the page, the loop is alive after it."""
    yield
    before = session.latest().tick
    wait_until(lambda: session.latest().tick > before + 5)


@pytest.fixture(scope="session")
def asked() -> Callable[..., tuple[int, str]]:
    """Status of the answer to a request, and the cookie that came with it."""

    def ask(page: Page, path: str = "/", upgrade: bool = False, **headers: str) -> tuple[int, str]:
        headers = {"Host": f"127.0.0.1:{page.port}", **headers}
        if upgrade:
            headers |= {
                "Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13",
                "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Protocol": PROTOCOL,
            }  # fmt: skip
        connection = http.client.HTTPConnection("127.0.0.1", page.port, timeout=10.0)
        try:
            connection.putrequest("GET", path, skip_host=True)
            for name, value in headers.items():
                connection.putheader(name, value)
            connection.endheaders()
            answer = connection.getresponse()
            return answer.status, answer.headers.get("Set-Cookie", "")
        finally:
            connection.close()

    return ask


@pytest.fixture(scope="session")
def joined() -> Callable[..., ClientConnection]:
    """A client that is no browser, connected. viser counts it once it says where its camera is."""

    def join(page: Page, **options: object) -> ClientConnection:
        return connect(
            f"ws://127.0.0.1:{page.port}",
            subprotocols=[Subprotocol(PROTOCOL)],
            max_size=None,
            # Two threads that wait for a third to end can fail in Python before 3.13.
            ping_interval=None,
            **options,  # type: ignore[arg-type]
        )

    return join
