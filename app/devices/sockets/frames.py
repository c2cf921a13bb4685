"""Shapes of a structure over TCP, while a session runs.

The sandbox listens; one sender at a time connects, and sends frames one after the other, in
little-endian order:

    4 bytes   "VERT"
    uint32    n, the number of vertices: that of the structure
    float64   time of the shape by the sender's clock [s], which increases
    float32   n × 3: x, y, z of every vertex, in the order of the mesh, in the mesh's own frame [m]

Nothing is sent back but one line of text to a sender that is turned away. A frame that is refused
changes nothing: the structure keeps its last shape, and the guard's margin grows with its age.
"""

from __future__ import annotations

import contextlib
import logging
import math
import select
import socket
import struct
import threading
import time
from collections import Counter
from collections.abc import Callable
from enum import StrEnum

import numpy as np

from app.devices.report import LinkReport, Rate
from app.kinds.links import Address
from app.motion.stream import FARTHEST, MOST, Single
from app.words import OptionError

log = logging.getLogger(__name__)

HEAD = struct.Struct("<4sId")
MAGIC = b"VERT"
SILENT = 1.0  # a sender that was silent for longer may be replaced by another one [s]
QUIET = 5.0  # a reason is logged again after so long without it; so long it is shown [s]
PERIOD = 0.1  # between two looks at whether to end [s]
COUNTED = 0.3  # between two looks at the rate [s]
DRIFT = 1e-4  # by which clocks may differ
_CHUNK = 1 << 20  # read at once [byte]
_DRAINED = 16  # reads of what a sender that is turned away still sends

Show = Callable[[Single, float], bool]


class Reason(StrEnum):
    """What was wrong with a frame or a sender."""

    MAGIC = "no frame"
    SIZE = "an absurd size"
    COUNT = "wrong number of vertices"
    FINITE = "not finite"
    RANGE = "a vertex farther than 10 m"
    BACK = "time goes back"
    SECOND = "a second sender"
    FAST = "faster than the declared bound"
    LOST = "not taken over"


_ENDS = (Reason.MAGIC, Reason.SIZE)  # what follows cannot be told apart: the sender is turned away
_TAKEN = (Reason.FAST,)  # the frame counts all the same


class _Clock:
    """How much later than the fastest a frame came, by its stamp.

    So frames that wait in a congested network are older than their arrival says. The two clocks may
    differ by `DRIFT`.
    """

    def __init__(self) -> None:
        self._least = math.inf
        self._at = 0.0

    def late(self, stamp: float, now: float) -> float:
        """By how much a frame of this stamp, which came now, is later than the fastest [s]."""
        took = now - stamp
        self._least = min(self._least + DRIFT * max(now - self._at, 0.0), took)
        self._at = now
        return took - self._least


class FrameServer:
    """Listens for the shapes of one structure, in a thread of its own.

    Args:
        address: where to listen; port 0 takes a free one.

    Attributes:
        url: where it listens.

    Raises:
        OptionError: it cannot listen there.
    """

    def __init__(self, address: Address) -> None:
        wanted = f"socket://{address.host}:{address.port}"
        try:
            found = socket.getaddrinfo(
                address.host, address.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
            )
            family, kind, protocol, _, where = found[0]
            self._listener = socket.socket(family, kind, protocol)
        except OSError as error:
            raise OptionError(f"{wanted}: unknown host ({error})") from None
        try:
            self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._listener.bind(where)
            self._listener.listen(4)
        except OSError as error:
            self._listener.close()
            raise OptionError(f"{wanted}: cannot listen there: {error.strerror or error}") from None
        self._listener.setblocking(False)
        self.asked = address
        self.url = f"socket://{address.host}:{self._listener.getsockname()[1]}"
        self._aim: tuple[Show, int, float] | None = None
        self._sender: _Sender | None = None
        self._peer = ""
        self._refused: Counter[str] = Counter()
        self._said: dict[Reason, float] = {}  # when each reason came last
        self._taken = 0
        self._taken_at = -math.inf
        self._rate, self._per_second, self._counted_at = Rate(), 0.0, -math.inf
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="vertices", daemon=True)

    def aim(self, show: Show, count: int, bound: float) -> None:
        """Hand frames to this function from now on.

        Args:
            show: takes vertices (n, 3) and by how much they came later than usual [s]; gives
                whether they are taken over.
            count: number of vertices.
            bound: declared, on the speed of any vertex [m/s].
        """
        self._aim = show, count, bound

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def close(self) -> None:
        """End the thread, and listen no more. Safe to call twice, or before `start`."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()
        self._listener.close()

    @property
    def report(self) -> LinkReport:
        """How it is now: `trouble` says what was wrong a moment ago, or that nothing comes."""
        now = time.monotonic()
        age = now - self._taken_at
        recent = [reason for reason, at in list(self._said.items()) if now - at < QUIET]
        trouble = ", ".join(recent)
        if not self._peer:
            trouble = ", ".join(["no sender", *recent])
        elif age > SILENT:
            trouble = ", ".join([f"nothing for {age:.0f} s" if age < 1e6 else "silent", *recent])
        return LinkReport(self.url, self._peer, self._per_second, age, trouble, dict(self._refused))

    def _run(self) -> None:
        try:
            while not self._stop.is_set():
                sender = self._sender
                waiting = [self._listener] + ([] if sender is None else [sender.socket])
                ready, _, _ = select.select(waiting, [], [], PERIOD)
                now = time.monotonic()
                if now > self._counted_at + COUNTED:
                    self._counted_at = now
                    self._per_second = self._rate.of(self._taken, now)
                if self._listener in ready:
                    self._accept()
                if sender is not None and sender is self._sender and sender.socket in ready:
                    self._read(sender)
        except Exception:
            log.exception("vertices are not listened for any more")
        finally:
            self._drop("")

    def _accept(self) -> None:
        try:
            connection, where = self._listener.accept()
        except OSError:
            return  # it is gone again
        peer = f"{where[0]}:{where[1]}"
        sender = self._sender
        if sender is not None and time.monotonic() - sender.heard < SILENT:
            self._count(Reason.SECOND, peer)
            _turn_away(connection, f"{self.url}: {self._peer} is sending here")
            return
        if sender is not None:
            self._drop("was silent, and another one came")
        connection.setblocking(False)
        log.warning("%s: vertices come from %s", self.url, peer)
        self._sender, self._peer = _Sender(connection), peer

    def _drop(self, why: str) -> None:
        """Part with the sender."""
        sender, self._sender = self._sender, None
        if sender is None:
            return
        if why:
            log.warning("%s: the sender %s %s", self.url, self._peer, why)
        self._peer = ""
        sender.socket.close()

    def _read(self, sender: _Sender) -> None:
        try:
            if not sender.read():
                self._drop("has left")
                return
        except BlockingIOError:
            return
        except OSError as error:
            self._drop(f"is gone ({error.strerror or error})")
            return
        aim = self._aim
        reason = sender.judge(0 if aim is None else aim[1])
        if reason in _ENDS:
            self._count(reason, self._peer)
            _turn_away(sender.socket, f"{self.url}: {reason}")
            self._drop(f"sent {reason}")
        elif reason is not None:
            self._count(reason, self._peer)
        elif sender.whole and aim is not None:
            show, _, bound = aim
            vertices, late, speed = sender.take()
            if speed > bound * 1.001:
                self._count(Reason.FAST, f"{1e3 * speed:.0f} mm/s")
            if show(vertices, late):
                self._taken += 1
                self._taken_at = time.monotonic()
            else:
                self._count(Reason.LOST, self._peer)

    def _count(self, reason: Reason, about: str) -> None:
        now = time.monotonic()
        if now - self._said.get(reason, -math.inf) > QUIET:
            log.warning("%s: %s (%s)", self.url, reason, about)
        self._said[reason] = now
        if reason not in _TAKEN:
            self._refused[reason] += 1


def _turn_away(connection: socket.socket, why: str) -> None:
    """Say why, and close."""
    connection.setblocking(False)
    with contextlib.suppress(OSError):
        connection.send(f"{why}\n".encode())
        connection.shutdown(socket.SHUT_WR)
        # What is left unread would reset the connection, and the line be lost.
        for _ in range(_DRAINED):
            connection.recv(_CHUNK)
    connection.close()


class _Sender:
    """The frames of one connection, as they arrive.

    Attributes:
        heard: when anything came last, monotonic time [s].
        whole: whether a frame is there that was judged and is good.
    """

    def __init__(self, connection: socket.socket) -> None:
        self.socket = connection
        self.heard = time.monotonic()
        self.whole = False
        self._head = bytearray(HEAD.size)
        self._body = bytearray()
        self._skip = 0  # of a frame that is refused [byte]
        self._filled = 0  # of head, or of head and body
        self._count = -1  # of vertices in the body; −1: the head is not whole
        self._stamp = -math.inf  # of the newest good frame
        self._stamped = 0.0  # of the frame that is coming
        self._before: Single | None = None
        self._clock = _Clock()

    def read(self) -> bool:
        """Read what there is of the present frame; whether the sender is still there.

        Raises:
            OSError: nothing is there, or the connection is broken.
        """
        if self._skip:
            got = len(self.socket.recv(min(self._skip, _CHUNK)))
            self._skip -= got
        elif self._count < 0:
            got = self.socket.recv_into(memoryview(self._head)[self._filled :])
            self._filled += got
        else:
            got = self.socket.recv_into(
                memoryview(self._body)[self._filled : self._filled + _CHUNK]
            )
            self._filled += got
        if got:
            self.heard = time.monotonic()
        return got > 0

    def judge(self, count: int) -> Reason | None:
        """What is wrong with the head or the frame that is whole now; `count`: vertices due."""
        if self._skip:
            return None
        if self._count < 0:
            return self._judge_head(count) if self._filled == HEAD.size else None
        if self._filled < len(self._body):
            return None
        return self._judge_body(count)

    def take(self) -> tuple[Single, float, float]:
        """The vertices (n, 3), by how much they came later than usual [s], and their speed [m/s].

        The speed is the largest of any vertex since the frame before, by the sender's clock.
        """
        vertices = np.frombuffer(self._body, "<f4").reshape(-1, 3).astype(np.float32)
        vertices.flags.writeable = False
        speed = 0.0
        if self._before is not None and len(self._before) == len(vertices):
            way = float(np.linalg.norm(vertices - self._before, axis=1).max())
            speed = way / (self._stamped - self._stamp)
        self._before, self._stamp = vertices, self._stamped
        late = self._clock.late(self._stamped, time.monotonic())
        self._next()
        return vertices, late, speed

    def _next(self) -> None:
        self.whole, self._count, self._filled = False, -1, 0

    def _judge_head(self, count: int) -> Reason | None:
        magic, n, stamp = HEAD.unpack(self._head)
        if magic != MAGIC:
            return Reason.MAGIC
        if not 1 <= n <= MOST:
            return Reason.SIZE
        reason = None
        if n != count:
            reason = Reason.COUNT
        elif not abs(stamp) < 1e12:
            reason = Reason.FINITE
        elif stamp <= self._stamp:
            reason = Reason.BACK
        if reason is not None:
            self._skip = 12 * n
            self._next()
            return reason
        self._stamped, self._count, self._filled = stamp, n, 0
        if len(self._body) != 12 * n:
            self._body = bytearray(12 * n)
        return None

    def _judge_body(self, count: int) -> Reason | None:
        found = np.frombuffer(self._body, "<f4")
        reason = None
        if self._count != count:  # another scene, meanwhile
            reason = Reason.COUNT
        elif not np.isfinite(found).all():
            reason = Reason.FINITE
        elif float(np.abs(found).max()) > FARTHEST:
            reason = Reason.RANGE
        if reason is not None:
            self._next()
            return reason
        self.whole = True
        return None
