"""A UDP socket as the transport of one device."""

from __future__ import annotations

import contextlib
import errno
import logging
import socket
import struct
import sys
import time
from collections import Counter
from typing import Any

from app.devices.remote.line import Line
from app.devices.remote.messages import Message
from app.devices.sockets.dialect import LARGEST, Unreadable, decode, encode
from app.kinds.links import Address
from app.words import OptionError

log = logging.getLogger(__name__)

MOST = 64  # datagrams that are read in a tick: a flood must not make it late
FORGOTTEN = 1.0  # a sender that was silent for longer may be replaced by another one [s]
_STAMPED = 35  # SO_TIMESTAMPNS of Linux: the kernel stamps what arrives
_ANCILLARY = 64  # room for that stamp [byte]


class Endpoint:
    """Messages over UDP in the streamer's dialect. For the control thread; nothing blocks.

    Listening, it hears whoever sends to its port first, and answers to where that came from;
    another sender is ignored until the first one has been silent for `FORGOTTEN`. Else it sends to
    the address it was given, and hears what comes from there.

    Attributes:
        refused: how many datagrams could not be read or sent, by reason.
        port: of this end.
    """

    def __init__(self, address: Address) -> None:
        """Open the socket.

        Raises:
            OptionError: the host is unknown, or the port taken.
        """
        self.refused: dict[str, int] = Counter()
        self._address = address
        self._inwards: Line[bytes] = Line(address.link, 1)
        self._outwards: Line[bytes] = Line(address.link, 2)
        self._only: str | None = None  # the only host that is heard
        self._peer: Any = None
        self._heard = 0.0
        url = f"{address.scheme}://{address.host}:{address.port}"
        try:
            found = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_DGRAM)
        except OSError as error:
            raise OptionError(f"{url}: unknown host ({error})") from None
        family, kind, protocol, _, where = found[0]
        self._socket = socket.socket(family, kind, protocol)
        self._socket.setblocking(False)
        try:
            if address.listen:
                self._listen(where)
            else:
                self._peer = where
                self._socket.bind(("", 0))
        except OSError as error:
            self._socket.close()
            raise OptionError(f"{url}: cannot listen there: {error.strerror or error}") from None
        self.port: int = self._socket.getsockname()[1]
        self._stamped = False
        if sys.platform.startswith("linux"):
            with contextlib.suppress(OSError):
                self._socket.setsockopt(socket.SOL_SOCKET, _STAMPED, 1)
                self._stamped = True

    @property
    def peer(self) -> str:
        """Host and port of the other end; empty: nobody yet."""
        return "" if self._peer is None else f"{self._peer[0]}:{self._peer[1]}"

    def receive(self, now: float) -> list[Message]:
        """What has arrived; what cannot be read is counted in `refused`."""
        clear = self._address.link.clear
        messages: list[Message] = []
        behind = time.time() - now  # from our monotonic clock to that of the kernel's stamps
        for _ in range(MOST):
            try:
                data, stamps, _flags, sender = self._socket.recvmsg(LARGEST + 1, _ANCILLARY)
            except BlockingIOError:
                break
            except OSError:  # what was sent before reached nobody
                self.refused["nobody listens"] += 1
                continue
            if not self._is_ours(sender, now):
                self.refused["from a stranger"] += 1
                continue
            at = self._stamp(stamps, behind, now)
            if clear:
                self._read(data, at, messages)
            else:
                self._inwards.put(data, at)
        if not clear:
            for data, at in self._inwards.take(now):
                self._read(data, at, messages)
            self._flush(now)
        return messages

    def send(self, message: Message, now: float) -> None:
        """Send a message as one datagram; what cannot be sent is counted in `refused`."""
        if self._peer is None:
            return
        try:
            data = encode(message)
        except (ValueError, TypeError) as error:
            self.refused[f"not sent: {error}"[:80]] += 1
            return
        if self._address.link.clear:
            self._put(data)
        else:
            self._outwards.put(data, now)
            self._flush(now)

    def close(self) -> None:
        self._socket.close()

    def _listen(self, where: Any) -> None:
        """Bind to the address, or where that is another machine's, to its port here."""
        try:
            self._socket.bind(where)
        except OSError as error:
            if error.errno != errno.EADDRNOTAVAIL:
                raise
            self._only = where[0]
            self._socket.bind(("", where[1]))

    def _is_ours(self, sender: Any, now: float) -> bool:
        if sender == self._peer:
            self._heard = now
            return True
        if not self._address.listen or (self._only is not None and sender[0] != self._only):
            return False
        if self._peer is not None and now - self._heard < FORGOTTEN:
            return False
        log.warning("%s: heard from %s:%d", self._address.scheme, sender[0], sender[1])
        self._peer, self._heard = sender, now
        return True

    def _read(self, data: bytes, at: float, messages: list[Message]) -> None:
        try:
            if len(data) > LARGEST:
                raise Unreadable(f"longer than {LARGEST} byte")
            messages += decode(data, at)
        except Unreadable as error:
            self.refused[str(error)] += 1

    def _stamp(self, stamps: Any, behind: float, now: float) -> float:
        """When the kernel received it, by our monotonic clock [s]."""
        for level, kind, data in stamps:
            if level == socket.SOL_SOCKET and kind == _STAMPED and len(data) >= 16:
                seconds, nanoseconds = struct.unpack("qq", data[:16])
                return min(seconds + 1e-9 * nanoseconds - behind, now)
        return now

    def _flush(self, now: float) -> None:
        for data, _ in self._outwards.take(now):
            self._put(data)

    def _put(self, data: bytes) -> None:
        try:
            self._socket.sendto(data, self._peer)
        except OSError as error:  # nobody listens, or the buffer is full
            self.refused[f"not sent: {error.strerror}"] += 1
