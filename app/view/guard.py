"""What stands between the page and the network: who may connect, and what they may send.

viser asks nobody for a name, checks no Origin, believes what clients say and opens a tunnel to the
public when one asks for it. Now and then it also stops sending for good. All that is put right
here, and everything of viser's and websockets' insides that it takes; `_check` says so at the start
should one of them have changed.
"""

from __future__ import annotations

import asyncio
import functools
import inspect
import ipaddress
import logging
import math
import re
import secrets
import socket
import threading
import time
import typing
from collections.abc import Callable
from http import HTTPStatus
from typing import Any, Union, get_args, get_origin
from urllib.parse import parse_qs, urlsplit

import msgspec
import viser
import websockets.asyncio.server
from viser import _messages as wire
from viser.infra import _infra
from viser.infra._async_message_buffer import AsyncMessageBuffer
from websockets.asyncio.server import ServerConnection
from websockets.frames import Frame
from websockets.http11 import Request, Response

log = logging.getLogger(__name__)

LARGEST = 8 * 2**20  # message [byte]; a rendered picture may be that large
SMALL = 64 * 2**10  # what is no file and no picture stays below [byte]
TEXT = 4096  # characters in one string
ITEMS = 1000  # entries in one list
DEPTH = 4  # lists within lists

# A browser sends up to some 20 messages/s of a drag, 50 of the camera, 20 of a slider, and has them
# in a bunch when something was slow.
MESSAGES = (200.0, 600.0)  # per client [1/s], at once
EXCESS = (10.0, 500.0)  # of those dropped for that reason, before the connection is closed
MISTAKES = (0.2, 20.0)  # messages that no browser would send, likewise
FRAMES = (4000.0, 12_000.0)  # pings and fragments too: beyond, the connection is cut
FILES = (50e6, 10e6)  # parts of files are not dropped but taken later [byte/s], [byte]
OPENINGS = (2.0, 40.0)  # connections of all clients together, each of which is sent the scene
REQUESTS = (100.0, 500.0)
CLIENTS = 32
STALLED = 20.0  # a client that takes nothing for so long is disconnected [s],
BEHIND = 300.0  # or takes less than there is for it for so long [s],
BACKLOG = 256 * 2**20  # or has so much waiting for it: viser sends up to 128 MB at once [byte]
COMPLAINTS = (0.2, 10.0)  # errors that go to the log

INBOUND = (
    "GuiUpdateMessage", "GuiButtonHoldMessage", "GuiFormSubmitMessage", "GuiFormDirtyMessage",
    "FileTransferStartUpload", "FileTransferPart", "CommandTriggerMessage",
    "LocalStorageGetItemResponseMessage", "ViewerCameraMessage", "GetRenderResponseMessage",
    "ScenePointerMessage", "SceneNodeClickMessage", "SceneNodeDragMessage",
    "TransformControlsUpdateMessage", "TransformControlsDragStartMessage",
    "TransformControlsDragEndMessage",
)  # fmt: skip
LARGE = ("FileTransferPart", "GetRenderResponseMessage")
SHARE = ("ShareUrlRequest", "ShareUrlDisconnect")

_HOST = re.compile(r"(\[[0-9a-fA-F:.]+\]|[A-Za-z0-9._-]+)(:\d{1,5})?")
_swapping = threading.Lock()


class Unguarded(RuntimeError):
    """viser or websockets is not what this module knows how to guard."""


def serve(host: str, port: int, token: str | None, **options: Any) -> viser.ViserServer:
    """A viser server behind the guard.

    Args:
        token: what a client must show; None lets everybody in who reaches it.
        options: of `viser.ViserServer`.

    Raises:
        OSError: the port is taken.
        Unguarded: the installed viser is not the one this was written for.
    """
    _check()
    _wake_in_the_loop()
    door = Door(host, token)
    theirs = websockets.asyncio.server.serve
    wrapped: list[bool] = []

    def ours(handler: Any, *arguments: Any, **keywords: Any) -> Any:
        # In viser's thread, where an exception would make its constructor wait forever.
        process = keywords.get("process_request")
        wrapped.append(process is not None)
        keywords.update(
            process_request=functools.partial(door.process, process),
            create_connection=Connection,
            max_size=LARGEST,
            max_queue=4,
            server_header=None,
            logger=_quiet_log(),
        )
        return theirs(handler, *arguments, **keywords)

    with _swapping:
        websockets.asyncio.server.serve = ours  # type: ignore[assignment,misc]
        try:
            server = viser.ViserServer(host, port, **options)
        finally:
            websockets.asyncio.server.serve = theirs  # type: ignore[misc]
    try:
        if not wrapped or not all(wrapped):
            raise Unguarded(f"viser {viser.__version__} does not serve as it used to")
        if port not in (0, server.get_port()):
            raise OSError(f"port {port} on {host} was taken meanwhile: choose another with --port")
        _never_share(server)
        server.get_event_loop().set_exception_handler(_complain_sometimes())
    except Exception:
        server.stop()
        raise
    return server


def token_for(host: str) -> str | None:
    """A fresh token where strangers can reach the page, None where only this machine can."""
    return None if host == "localhost" or _is_loopback(host) else secrets.token_urlsafe(24)


def census(server: viser.ViserServer) -> dict[str, int]:
    """What viser keeps, in numbers: a page that runs for days must not keep more and more.

    Returns:
        "nodes" of the scene, "controls" of the panel, "messages" kept for whoever joins,
        "clients" connected, and "backlog", the most messages that one of them has yet to be sent.
    """
    shared = server._websock_server._broadcast_buffer
    states = list(server._websock_server._client_state_from_id.values())
    with shared.buffer_lock:
        behind = [shared.message_counter - 1 - sent for sent in shared.generator_cursors.values()]
        kept = len(shared.message_from_id)
    own = [len(state.message_buffer.message_from_id) for state in states]
    return {
        "nodes": len(server.scene._handle_from_node_name),
        "controls": len(server.gui._gui_input_handle_from_uuid),
        "messages": kept,
        "clients": len(states),
        "backlog": max([*behind, *own], default=0),
    }


class Door:
    """Decides about each HTTP request, a WebSocket's handshake among them."""

    def __init__(self, host: str, token: str | None) -> None:
        self._token = token
        self._requests = Allowance(*REQUESTS)
        self._openings = Allowance(*OPENINGS)
        self._names = {"localhost"}
        if token is not None:
            own = socket.gethostname().lower()
            self._names |= {host.lower(), own, f"{own}.local"}

    def process(self, theirs: Any, connection: ServerConnection, request: Request) -> Any:
        """The answer to a request: a refusal, or whatever viser has to say."""
        refusal = self.refusal(request)
        opens = bool(request.headers.get_all("Upgrade"))
        if refusal is None and opens:
            refusal = self._too_many(connection)
        if refusal is not None:
            return _with_headers(connection.respond(*refusal))
        response = theirs(connection, request)
        if response is not None:
            _with_headers(response)
            if self._token is not None and self._shown_in_address(request):
                response.headers["Set-Cookie"] = (
                    f"{_cookie(connection)}={self._token}; Path=/; HttpOnly; SameSite=Strict"
                )
        return response

    def refusal(self, request: Request) -> tuple[HTTPStatus, str] | None:
        """Why a request is refused, or None."""
        hosts = request.headers.get_all("Host")
        if len(hosts) != 1 or not self._is_ours(hosts[0]):
            return HTTPStatus.MISDIRECTED_REQUEST, (
                "This page does not go by that name. Open it by the address it printed.\n"
            )
        origins = request.headers.get_all("Origin")
        # Programs that are no browsers name no origin, and carry nobody's cookies.
        if origins and [o.lower() for o in origins] != [f"http://{hosts[0]}".lower()]:
            return HTTPStatus.FORBIDDEN, "Requests from other sites are refused.\n"
        if self._token is not None and not (
            self._shown_in_address(request) or self._shown_in_cookie(request)
        ):
            return HTTPStatus.FORBIDDEN, (
                "A token is needed. Open the whole address that vf-sandbox printed, "
                "with ?token=… at its end.\n"
            )
        if not self._requests.take():
            return HTTPStatus.SERVICE_UNAVAILABLE, "Too many requests: wait a moment.\n"
        return None

    def _too_many(self, connection: ServerConnection) -> tuple[HTTPStatus, str] | None:
        if len(connection.server.connections) >= CLIENTS:
            return HTTPStatus.SERVICE_UNAVAILABLE, f"{CLIENTS} clients are connected already.\n"
        if not self._openings.take():
            return HTTPStatus.SERVICE_UNAVAILABLE, "Too many connections: wait a moment.\n"
        return None

    def _is_ours(self, host: str) -> bool:
        match = _HOST.fullmatch(host)
        if match is None:
            return False
        name = match[1].strip("[]").lower()
        if name in self._names:
            return True
        # Whoever has rebound a name of theirs to our address still sends that name. An address in
        # figures is the server's own, if it is not only for this machine.
        return _is_address(name) if self._token is not None else _is_loopback(name)

    def _shown_in_address(self, request: Request) -> bool:
        try:
            shown = parse_qs(urlsplit(request.path).query, max_num_fields=50).get("token", [])
        except ValueError:
            return False
        return any(self._is_token(text) for text in shown)

    def _shown_in_cookie(self, request: Request) -> bool:
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


COOKIE = "vf-sandbox-token-"  # and the port: cookies do not tell ports of one machine apart


class Connection(ServerConnection):
    """A WebSocket that hands on sound messages at a bearable rate, and does not wait for ever."""

    def __init__(self, *arguments: Any, **keywords: Any) -> None:
        super().__init__(*arguments, **keywords)
        self._frames = Allowance(*FRAMES)
        self._messages = Allowance(*MESSAGES)
        self._excess = Allowance(*EXCESS)
        self._mistakes = Allowance(*MISTAKES)
        self._files = Allowance(*FILES)
        self._expelled = False
        self._added = 0  # to what waits, since it was looked at [byte]
        self._behind_since = 0.0
        self._watch: asyncio.TimerHandle | None = None

    async def recv(self, decode: bool | None = None) -> Any:
        """The next message that is worth handing on."""
        while True:
            raw = await super().recv(decode)
            if self._expelled:
                continue  # came in before the end was known
            if len(raw) > SMALL:
                # Not reading on holds back the sender, a browser with a file included.
                await asyncio.sleep(self._files.owe(len(raw)))
            elif not self._messages.take():
                if not self._excess.take():
                    await self._expel("too many messages")
                continue
            problem = problem_with(raw)
            if problem is None:
                return raw
            if not self._mistakes.take():
                await self._expel(problem)

    async def _expel(self, reason: str) -> None:
        self._expelled = True
        log.warning("a client was disconnected: %s", reason)
        try:
            async with asyncio.timeout(1.0):
                await self.close(1008, reason)
        except TimeoutError:
            self.transport.abort()

    def process_event(self, event: Any) -> None:
        """Also counts what never becomes a message: pings, and parts of one that never ends."""
        if isinstance(event, Frame) and not self._frames.take():
            self.transport.abort()
            return
        super().process_event(event)

    def data_received(self, data: bytes) -> None:
        """Answers to pings are written without asking whether anybody reads them."""
        super().data_received(data)
        if self.transport.get_write_buffer_size() > BACKLOG:
            self.transport.abort()

    def send_data(self) -> None:
        """Hand over what is to be sent."""
        before = self.transport.get_write_buffer_size()
        super().send_data()
        self._added += self.transport.get_write_buffer_size() - before

    def pause_writing(self) -> None:
        """The client takes less than there is for it: from here on, see that it takes some."""
        super().pause_writing()
        # websockets' own keepalive cannot: its ping waits for the client to read as well.
        self._behind_since = self.loop.time()
        self._look_again()

    def resume_writing(self) -> None:
        """The client keeps up again."""
        self._stop_looking()
        super().resume_writing()

    def connection_lost(self, exc: Exception | None) -> None:
        """Nobody is there any more."""
        self._stop_looking()
        super().connection_lost(exc)

    def _look_again(self) -> None:
        self._added = 0
        waiting = self.transport.get_write_buffer_size()
        self._watch = self.loop.call_later(STALLED, self._look, waiting)

    def _stop_looking(self) -> None:
        if self._watch is not None:
            self._watch.cancel()
            self._watch = None

    def _look(self, before: int) -> None:
        taken = before + self._added - self.transport.get_write_buffer_size()
        if taken <= 0 or self.loop.time() - self._behind_since > BEHIND:
            log.warning("a client was disconnected: it does not read what it is sent")
            self.transport.abort()
        else:
            self._look_again()


class Allowance:
    """A token bucket: `rate` per second on average, `burst` at once."""

    def __init__(self, rate: float, burst: float) -> None:
        self._rate, self._burst = rate, burst
        self._left = burst
        self._since = time.monotonic()

    def take(self) -> bool:
        """Whether there is one left to take."""
        self._refill()
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True

    def owe(self, amount: float) -> float:
        """Take in any case; for how long to wait until that is made up for [s]."""
        self._refill()
        self._left -= amount
        return max(0.0, -self._left / self._rate)

    def _refill(self) -> None:
        now = time.monotonic()
        self._left = min(self._burst, self._left + self._rate * (now - self._since))
        self._since = now


def problem_with(raw: bytes | str) -> str | None:
    """What is wrong with a message as it came in, or None: then viser can read it."""
    if not isinstance(raw, bytes):
        return "a message in text"
    try:
        fields = msgspec.msgpack.decode(raw)
    except (msgspec.MsgspecError, RecursionError, ValueError):
        return "a message that is no msgpack"
    kind = fields.pop("type", None) if isinstance(fields, dict) else None
    if not isinstance(kind, str) or kind not in INBOUND:
        return "a message of an unknown kind"
    if len(raw) > SMALL and kind not in LARGE:
        return f"a {kind} that is too large"
    hints, required = _shape(kind)
    if not required <= fields.keys() <= hints.keys():
        return f"a {kind} with other fields"
    for name, value in fields.items():
        if not _fits(value, hints[name]):
            return f"a {kind} with an impossible {name}"
    # viser sets whatever attribute of a control a client names.
    if kind == "GuiUpdateMessage" and fields["updates"].keys() != {"value"}:
        return "an update of something else than a value"
    return None


@functools.cache
def _shape(kind: str) -> tuple[dict[str, Any], set[str]]:
    """Fields of a message with their types, and those that must be there."""
    message = getattr(wire, kind)
    parameters = inspect.signature(message).parameters.values()
    hints = typing.get_type_hints(message)
    return (
        {p.name: hints[p.name] for p in parameters},
        {p.name for p in parameters if p.default is inspect.Parameter.empty},
    )


def _fits(value: Any, hint: Any) -> bool:
    """Whether a decoded value is of a field's type, its numbers finite, its size bounded."""
    origin, choices = get_origin(hint), get_args(hint)
    if origin is Union:
        return any(_fits(value, choice) for choice in choices)
    if origin is typing.Literal:
        return any(type(value) is type(choice) and value == choice for choice in choices)
    if origin is tuple:
        if not isinstance(value, list) or len(value) > ITEMS:
            return False
        if choices[-1] is Ellipsis:
            choices = choices[:1] * len(value)
        return len(value) == len(choices) and all(map(_fits, value, choices))
    if origin is dict:
        return isinstance(value, dict) and _is_plain(value, DEPTH)
    if hint in (int, float):
        # Numbers are all of one kind in a browser.
        return type(value) in (int, float) and math.isfinite(value)
    if hint is str:
        return isinstance(value, str) and len(value) <= TEXT
    return hint in (bytes, type(None)) and isinstance(value, hint)


def _is_plain(value: Any, depth: int) -> bool:
    """Whether a value of any type is one that a control can have."""
    if isinstance(value, list | dict):
        if depth == 0 or len(value) > ITEMS:
            return False
        parts = [*value, *value.values()] if isinstance(value, dict) else value
        return all(_is_plain(part, depth - 1) for part in parts)
    if isinstance(value, str):
        return len(value) <= TEXT
    return value is None or (type(value) in (bool, int, float) and math.isfinite(value))


class WakeUp(asyncio.Event):
    """Wakes those who send what is in a buffer, and is deaf outside of their event loop.

    `AsyncMessageBuffer.push` sets its event from whatever thread calls it, then once more in the
    loop. If the first falls between a sender's look at the event and its falling asleep, the second
    finds the event set already and wakes nobody, nor does any later one: the page stands still.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__()
        self._home = loop

    def set(self) -> None:
        """Wake them if this is their loop; otherwise leave it to the call that will be."""
        if asyncio._get_running_loop() is self._home:
            super().set()


@functools.cache
def _wake_in_the_loop() -> None:
    """Give every buffer of viser's a `WakeUp`."""
    theirs = AsyncMessageBuffer.__init__

    @functools.wraps(theirs)
    def ours(self: AsyncMessageBuffer, *arguments: Any, **keywords: Any) -> None:
        theirs(self, *arguments, **keywords)
        self.message_event = WakeUp(self.event_loop)

    AsyncMessageBuffer.__init__ = ours  # type: ignore[method-assign]


def _never_share(server: viser.ViserServer) -> None:
    """Take away the way to viser's tunnel, from clients and from ourselves."""
    connection = server._websock_server
    for kind in SHARE:
        connection.unregister_handler(getattr(wire, kind))

    def refuse(*_: object, **__: object) -> str | None:
        raise Unguarded("this page is not shared with the public")

    server.request_share_url = refuse  # type: ignore[method-assign]
    if server._share_tunnel is not None:
        raise Unguarded("viser has opened a tunnel unasked")


def _check() -> None:
    """Fail at the start rather than be open.

    Raises:
        Unguarded: naming what is missing.
    """
    wanted: list[tuple[object, str]] = [
        *((wire, kind) for kind in (*INBOUND, *SHARE)),
        *(
            (ServerConnection, name)
            for name in (
                "recv", "close", "respond", "process_event", "data_received", "send_data",
                "pause_writing", "resume_writing", "connection_lost",
            )
        ),
        (_infra.websockets.asyncio.server, "serve"),
        (_infra.WebsockServer, "unregister_handler"),
        (AsyncMessageBuffer, "push"),
        (viser.ViserServer, "request_share_url"),
    ]  # fmt: skip
    missing = [name for owner, name in wanted if not hasattr(owner, name)]
    fields = inspect.signature(AsyncMessageBuffer).parameters
    missing += [name for name in ("event_loop", "message_event") if name not in fields]
    taken = inspect.signature(websockets.asyncio.server.serve).parameters
    missing += [
        name
        for name in ("process_request", "create_connection", "max_size", "max_queue", "logger")
        if name not in taken
    ]
    if missing:
        raise Unguarded(
            f"viser {viser.__version__} with websockets {websockets.__version__} cannot be "
            f"guarded: {', '.join(missing)} missing"
        )


def _with_headers(response: Response) -> Response:
    """No other site may frame the page, and none is told its address, which has the token."""
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


def _complain_sometimes() -> Callable[[asyncio.AbstractEventLoop, dict[str, Any]], None]:
    """viser's handlers fail on values of the wrong type, as often as a client sends one."""
    allowance = Allowance(*COMPLAINTS)

    def complain(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        if allowance.take():
            log.error("%s", context.get("message"), exc_info=context.get("exception"))

    return complain


@functools.cache
def _quiet_log() -> logging.Logger:
    """websockets' log without what any passer-by can write there, with a traceback each time."""
    logger = log.getChild("connections")
    passing = ("opening handshake failed", "keepalive ping failed")
    logger.addFilter(lambda record: record.getMessage() not in passing)
    return logger
