"""Requests that are refused: other host names, other sites, no token."""

from __future__ import annotations

import http.client
import socket

import pytest
from websockets.exceptions import InvalidStatus
from websockets.typing import Origin

from app.view import Page, guard
from app.view.guard.access import COOKIE
from tests.support.clients import asked, joined


@pytest.mark.parametrize("upgrade", [False, True])
@pytest.mark.parametrize(
    "host",
    ["evil.example", "evil.example:8080", "127.0.0.1.evil.example", "192.168.1.7", "a@127.0.0.1"],
)
def test_dns_rebinding_is_refused(page: Page, host: str, upgrade: bool) -> None:
    assert asked(page, upgrade=upgrade, Host=host)[0] == 421


@pytest.mark.parametrize("upgrade", [False, True])
@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "http://127.0.0.1:1", "https://localhost", ""]
)
def test_another_site_s_requests_are_refused(page: Page, origin: str, upgrade: bool) -> None:
    assert asked(page, upgrade=upgrade, Origin=origin)[0] == 403


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "[::1]"])
def test_the_page_s_own_requests_pass(page: Page, host: str) -> None:
    own = f"{host}:{page.port}"
    assert asked(page, Host=own)[0] == 200
    assert asked(page, Host=own, Origin=f"http://{own}")[0] == 200
    assert asked(page, Host=own, Origin=f"http://{own}", upgrade=True)[0] == 101
    assert asked(page, Host="localhost:9000", upgrade=True)[0] == 101, "through ssh -L"


def test_a_websocket_from_another_site_is_refused(page: Page) -> None:
    with pytest.raises(InvalidStatus), joined(page, origin=Origin("http://evil.example")):
        pass
    with joined(page, origin=Origin(f"http://127.0.0.1:{page.port}")) as socket:
        assert socket.recv(timeout=10.0)


def test_no_other_site_may_frame_the_page(page: Page) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", page.port, timeout=10.0)
    connection.request("GET", "/")
    headers = connection.getresponse().headers
    connection.close()
    assert "frame-ancestors 'none'" in headers["Content-Security-Policy"]
    assert headers["Referrer-Policy"] == "no-referrer"


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "::1", "127.1.2.3"])
def test_a_loopback_host_has_no_token(host: str) -> None:
    assert guard.token_for(host) is None


def test_access_needs_the_token(open_page: Page) -> None:
    page = open_page
    token = page.url.partition("/?token=")[2]
    assert len(token) >= 32
    assert token != guard.token_for("0.0.0.0"), "each start has another token"
    for upgrade in (False, True):
        for path in (
            "/",
            "/?token=",
            "/?token=" + token[:-1],
            "/?token=%ff%00",
            "/?Token=" + token,
        ):
            assert asked(page, path, upgrade)[0] == 403, path
        wrong = f"{COOKIE}{page.port}={token[::-1]}"
        assert asked(page, upgrade=upgrade, Cookie=wrong)[0] == 403
    status, cookie = asked(page, f"/?token={token}")
    assert status == 200
    assert {"HttpOnly", "SameSite=Strict", "Path=/"} <= {w.strip() for w in cookie.split(";")}
    shown = cookie.partition(";")[0]
    assert asked(page, Cookie=f"other=1; {shown}")[0] == 200
    assert asked(page, Cookie=shown, upgrade=True)[0] == 101
    assert asked(page, Cookie=shown, upgrade=True, Host="192.168.1.7:8080")[0] == 101
    assert asked(page, Cookie=shown, upgrade=True, Host="evil.example")[0] == 421
    assert asked(page, Cookie=shown, upgrade=True, Origin="http://evil.example")[0] == 403
    assert "anybody" in page.warning
    assert token in page.warning


@pytest.mark.parametrize(
    "path",
    [
        "/" + "x" * 256, "/" + "x" * 5000, "/" + "x" * 8150, "/" + "x" * 9000, "/" + "x" * 100_000,
        "/" + "a/" * 3000, "/%00", "/index.html%00", "/%ff%fe", "/%F0%9F",
        "/%2e%2e/%2e%2e/etc/passwd",
        "/..%5c..%5c", "/?" + "q=1&" * 1500, "/assets", "//", "/.", "/%", "/index.html/x",
        "/\\..\\..", "/~root", "/%0d%0aX:%20y",
    ],
    ids=lambda path: path[:12] + str(len(path)),
)  # fmt: skip
def test_no_path_causes_a_server_error(path: str, page: Page) -> None:
    with socket.create_connection(("127.0.0.1", page.server.get_port()), timeout=10) as wire:
        wire.sendall(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode("latin-1"))
        answer = b""
        try:
            while b"\r\n" not in answer and (part := wire.recv(4096)):
                answer += part
        except ConnectionResetError:
            pass
    status = answer.partition(b"\r\n")[0].decode()
    if len(path) > 8192:
        assert status == ""  # websockets does not read such a line to its end
    else:
        assert status.startswith(("HTTP/1.1 200", "HTTP/1.1 4")), (path[:40], status)
