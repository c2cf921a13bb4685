"""Messages between two processes that may carry a descriptor, over a socket."""

from __future__ import annotations

import pickle
import socket
import threading
from typing import Any

_LENGTH = 8  # of a message's length [byte]


class Channel:
    """One end of a socket. Whatever comes from the other end is trusted: it is ours."""

    def __init__(self, end: socket.socket) -> None:
        self._socket = end
        self._sending = threading.Lock()  # several threads do

    @staticmethod
    def pair() -> tuple[Channel, Channel]:
        """Two ends of a new connection."""
        ours, theirs = socket.socketpair()
        return Channel(ours), Channel(theirs)

    def fileno(self) -> int:
        """The descriptor, to wait for a message or to hand to another process."""
        return self._socket.fileno()

    def send(self, *content: Any, fd: int | None = None) -> None:
        """Send a message, and a descriptor with it.

        Raises:
            OSError: the other end is closed.
        """
        data = pickle.dumps(content, protocol=5)
        head = len(data).to_bytes(_LENGTH, "little")
        with self._sending:
            if fd is None:
                self._socket.sendall(head)
            else:
                socket.send_fds(self._socket, [head], [fd])
            self._socket.sendall(data)

    def receive(self) -> tuple[tuple[Any, ...], int | None]:
        """The next message and the descriptor that came with it; waits for it.

        Raises:
            EOFError: the other end is closed.
        """
        try:
            head, fds, _flags, _address = socket.recv_fds(self._socket, _LENGTH, 1)
            head += self._exactly(_LENGTH - len(head))
            content = pickle.loads(self._exactly(int.from_bytes(head, "little")))
        except OSError:  # such as a reset
            raise EOFError from None
        return content, fds[0] if fds else None

    def close(self) -> None:
        """Close this end. Safe to call twice."""
        self._socket.close()

    def _exactly(self, size: int) -> bytes:
        parts = []
        while size:
            part = self._socket.recv(min(size, 1 << 20))
            if not part:
                raise EOFError
            parts.append(part)
            size -= len(part)
        return b"".join(parts)
