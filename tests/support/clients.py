"""Clients of the page that are no browser: requests and web sockets, well behaved or not."""

from __future__ import annotations

import http.client

import viser
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from app.view import Page

PROTOCOL = f"viser-v{viser.__version__}"


def asked(page: Page, path: str = "/", upgrade: bool = False, **headers: str) -> tuple[int, str]:
    """Status of the answer to a request, and the cookie that came with it."""
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


def joined(page: Page, **options: object) -> ClientConnection:
    """A client that is no browser, connected. viser counts it once it says where its camera is."""
    return connect(
        f"ws://127.0.0.1:{page.port}",
        subprotocols=[Subprotocol(PROTOCOL)],
        max_size=None,
        # Two threads that wait for a third to end can fail in Python before 3.13.
        ping_interval=None,
        **options,  # type: ignore[arg-type]
    )
