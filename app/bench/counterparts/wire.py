"""What the stand-ins share: a paced loop, lines on stdin, times at which datagrams came."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import struct
import time
from collections.abc import Callable, Iterator

_STAMPED = 35  # SO_TIMESTAMPNS of Linux: the kernel stamps what arrives
LARGEST = 1024  # the streamer reads no more of a datagram [byte]


def udp() -> socket.socket:
    """A UDP socket that does not block and, on Linux, says when a datagram arrived."""
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.setblocking(False)
    with contextlib.suppress(OSError):
        made.setsockopt(socket.SOL_SOCKET, _STAMPED, 1)
    return made


def heard(on: socket.socket) -> Iterator[tuple[bytes, tuple[str, int], float]]:
    """What has arrived: the datagram, its sender, and when, by the monotonic clock [s].

    The time is the kernel's: how late this process looked is not in it.
    """
    behind = time.time() - time.monotonic()
    while True:
        try:
            data, more, _flags, sender = on.recvmsg(LARGEST, 64)
        except BlockingIOError:
            return
        except OSError:  # what was sent before reached nobody
            continue
        at = time.monotonic()
        for level, kind, content in more:
            if level == socket.SOL_SOCKET and kind == _STAMPED and len(content) >= 16:
                seconds, nanoseconds = struct.unpack("qq", content[:16])
                at = min(seconds + 1e-9 * nanoseconds - behind, at)
        yield data, sender, at


def paced(period: float, step: Callable[[float], None], obey: Callable[[str], None]) -> None:
    """Call `step(now)` every `period` [s], and `obey` with every line of stdin, until ``quit``.

    What is more than 10 ms late is not made up for.
    """
    os.set_blocking(0, False)
    print("ready", flush=True)
    due, typed = time.monotonic(), b""
    while True:
        due = max(due + period, time.monotonic() - 0.01)
        pause = due - time.monotonic()
        if pause > 0:
            time.sleep(pause)
        step(time.monotonic())
        if not select.select([0], [], [], 0)[0]:
            continue
        read = os.read(0, 1 << 16)
        if not read:
            return
        *lines, typed = (typed + read).split(b"\n")
        if b"quit" in lines:
            return
        for line in lines:
            obey(line.decode())
