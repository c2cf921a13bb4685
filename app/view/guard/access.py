"""Access control of HTTP requests: Host, Origin, token, rate."""

from __future__ import annotations

import ipaddress
import re
import secrets
import socket
from http import HTTPStatus
from typing import Any
from urllib.parse import parse_qs, urlsplit

from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from app.view.guard.token_bucket import TokenBucket

# Of all clients together, as (average [1/s], burst).
CONNECTIONS = (2.0, 40.0)  # WebSockets, each of which is sent the whole scene
REQUESTS = (100.0, 500.0)
CLIENTS = 32  # at a time

COOKIE = "vf-sandbox-token-"  # followed by the port: all ports of a host share its cookies

_HOST = re.compile(r"(\[[0-9a-fA-F:.]+\]|[A-Za-z0-9._-]+)(:\d{1,5})?")


def token_for(host: str) -> str | None:
    """A new token for a host that other machines can reach; None for a loopback address."""
    return None if host == "localhost" or _is_loopback(host) else secrets.token_urlsafe(24)


class Access:
    """Decides about each HTTP request, a WebSocket's handshake among them."""

    def __init__(self, host: str, token: str | None) -> None:
        self._token = token
        self._requests = TokenBucket(*REQUESTS)
        self._connections = TokenBucket(*CONNECTIONS)
        self._names = {"localhost"}
        if token is not None:
            own = socket.gethostname().lower()
            self._names |= {host.lower(), own, f"{own}.local"}

    def process(self, answer: Any, connection: ServerConnection, request: Request) -> Any:
        """The response to a request: a refusal, or what viser's handler `answer` returns."""
        refusal = self.refusal(request)
        opens = bool(request.headers.get_all("Upgrade"))
        if refusal is None and opens:
            refusal = self._over_limit(connection)
        if refusal is not None:
            return _with_headers(connection.respond(*refusal))
        try:
            response = answer(connection, request)
        except (OSError, ValueError):
            # viser opens a file of that name, which may be too long or contain a NUL.
            response = connection.respond(HTTPStatus.NOT_FOUND, "There is no such page.\n")
        if response is not None:
            _with_headers(response)
            if self._token is not None and self._token_in_url(request):
                response.headers["Set-Cookie"] = (
                    f"{_cookie(connection)}={self._token}; Path=/; HttpOnly; SameSite=Strict"
                )
        return response

    def refusal(self, request: Request) -> tuple[HTTPStatus, str] | None:
        """Why a request is refused, or None."""
        hosts = request.headers.get_all("Host")
        if len(hosts) != 1 or not self._is_own_name(hosts[0]):
            return HTTPStatus.MISDIRECTED_REQUEST, (
                "Unknown host name. Open the address that vf-sandbox printed.\n"
            )
        origins = request.headers.get_all("Origin")
        # Programs other than browsers send no Origin; they carry no cookies of a user either.
        if origins and [o.lower() for o in origins] != [f"http://{hosts[0]}".lower()]:
            return HTTPStatus.FORBIDDEN, "Requests from other sites are refused.\n"
        if self._token is not None and not (
            self._token_in_url(request) or self._token_in_cookie(request)
        ):
            return HTTPStatus.FORBIDDEN, (
                "A token is needed. Open the whole address that vf-sandbox printed, "
                "with ?token=… at its end.\n"
            )
        if not self._requests.take():
            return HTTPStatus.SERVICE_UNAVAILABLE, "Too many requests: wait a moment.\n"
        return None

    def _over_limit(self, connection: ServerConnection) -> tuple[HTTPStatus, str] | None:
        if len(connection.server.connections) >= CLIENTS:
            return HTTPStatus.SERVICE_UNAVAILABLE, f"{CLIENTS} clients are connected already.\n"
        if not self._connections.take():
            return HTTPStatus.SERVICE_UNAVAILABLE, "Too many connections: wait a moment.\n"
        return None

    def _is_own_name(self, host: str) -> bool:
        match = _HOST.fullmatch(host)
        if match is None:
            return False
        name = match[1].strip("[]").lower()
        if name in self._names:
            return True
        # DNS rebinding: the browser sends the attacker's host name, so only numeric addresses pass.
        return _is_address(name) if self._token is not None else _is_loopback(name)

    def _token_in_url(self, request: Request) -> bool:
        try:
            shown = parse_qs(urlsplit(request.path).query, max_num_fields=50).get("token", [])
        except ValueError:
            return False
        return any(self._is_token(text) for text in shown)

    def _token_in_cookie(self, request: Request) -> bool:
        pairs = [
            pair.partition("=")
            for header in request.headers.get_all("Cookie")
            for pair in header.split(";")
        ]
        return any(
            self._is_token(value.strip())
            for name, _, value in pairs
            if name.strip().startswith(COOKIE)
        )

    def _is_token(self, text: str) -> bool:
        assert self._token is not None
        return secrets.compare_digest(
            text.encode("utf-8", "surrogatepass"), self._token.encode("utf-8")
        )


def _with_headers(response: Response) -> Response:
    """Forbid other sites to frame the page, and the browser to send its URL with the token."""
    response.headers["Content-Security-Policy"] = "frame-ancestors 'none'"
    response.headers["X-Frame-Options"] = "DENY"
    response.headers["X-Content-Type-Options"] = "nosniff"
    response.headers["Referrer-Policy"] = "no-referrer"
    return response


def _cookie(connection: ServerConnection) -> str:
    return f"{COOKIE}{connection.local_address[1]}"


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _is_loopback(name: str) -> bool:
    return _is_address(name) and ipaddress.ip_address(name).is_loopback
