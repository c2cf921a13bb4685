"""Memory that two processes share: a slot for the newest message, and a queue of all messages.

One process writes and another reads; neither waits for the other, and each may end at any moment.
What is read was written as a whole: every message has a checksum, which also holds where a
processor lets another see what it wrote in another order.
"""

from __future__ import annotations

import mmap
import os
import struct
import tempfile
import zlib
from collections.abc import Iterator

_WORD = 8  # [byte]
_MESSAGE = struct.Struct("<IIQ")  # length, checksum, number of a message
ROOM = 1 << 26  # of a queue [byte]; what is not used takes no memory
LOW = 1 << 20  # a queue that is empty begins anew when it is this far [byte]


class Memory:
    """A block of memory without a name: it is gone when no process has it any more.

    Attributes:
        fd: its descriptor, for another process.
        data: its bytes.
    """

    def __init__(self, fd: int, write: bool) -> None:
        """Map the memory of a descriptor, which belongs to this object from here on."""
        self.fd = fd
        protection = mmap.PROT_READ | mmap.PROT_WRITE if write else mmap.PROT_READ
        self.data = memoryview(mmap.mmap(fd, os.fstat(fd).st_size, prot=protection))

    @staticmethod
    def create(size: int) -> Memory:
        """New memory of this size [byte], all zero.

        Raises:
            OSError: there is none.
        """
        if hasattr(os, "memfd_create"):
            fd = os.memfd_create("vf-sandbox", os.MFD_CLOEXEC)
        else:
            with tempfile.TemporaryFile() as file:  # which has no name either
                fd = os.dup(file.fileno())
        try:
            os.ftruncate(fd, size)
            return Memory(fd, write=True)
        except BaseException:
            os.close(fd)
            raise

    def forget(self) -> None:
        """Close the descriptor; what is mapped stays."""
        if self.fd >= 0:
            os.close(self.fd)
            self.fd = -1


def _checksum(message: bytes | memoryview, number: int) -> int:
    return zlib.crc32(message, number & 0xFFFFFFFF)


class Slot:
    """Holds the newest message. Written into one of two places in turn, so that one is whole."""

    SIZE = 1024  # [byte]

    def __init__(self, data: memoryview) -> None:
        """On `SIZE` bytes that are zero at first."""
        self._count = data[:_WORD].cast("Q")
        half = (self.SIZE - _WORD) // 2
        self._places = data[_WORD : _WORD + half], data[_WORD + half : _WORD + 2 * half]

    @property
    def count(self) -> int:
        """How many messages were written."""
        return self._count[0]

    def write(self, message: bytes) -> None:
        """Replace the message."""
        number = self._count[0] + 1
        place = self._places[number & 1]
        _MESSAGE.pack_into(place, 0, len(message), _checksum(message, number), number)
        place[_MESSAGE.size : _MESSAGE.size + len(message)] = message
        self._count[0] = number

    def read(self) -> bytes | None:
        """The newest message; None: there is none, or it is being replaced."""
        number = self._count[0]
        if number == 0:
            return None
        place = self._places[number & 1]
        length, checksum, written = _MESSAGE.unpack_from(place)
        message = bytes(place[_MESSAGE.size : _MESSAGE.size + length])
        return message if written == number and _checksum(message, number) == checksum else None


class Queue:
    """Messages of any length, in order. What there is no room for is left out, and counted.

    A message stands in one piece: where it does not fit before the end it begins at the start. So
    does the next one of an empty queue that is far from it: as long as the reader keeps up, little
    of the memory is used.
    """

    HEAD = 64  # [byte]

    def __init__(self, data: memoryview) -> None:
        """On `HEAD` bytes and the room behind them, all zero at first."""
        words = data[: self.HEAD].cast("Q")
        # Positions count all bytes ever passed: written up to, read up to, of the newest message.
        self._written, self._read, self._newest = (words[k : k + 1] for k in range(3))
        self._count = words[3:4]
        self._room = data[self.HEAD :]
        self._size = len(self._room) // _WORD * _WORD
        self._doubt = -1  # position at which the reader met what was no message

    @property
    def count(self) -> int:
        """How many messages were offered, with those that were left out."""
        return self._count[0]

    def put(self, message: bytes) -> bool:
        """Append a message; whether there was room for it."""
        number = self._count[0] + 1
        self._count[0] = number
        length = len(message)
        whole = (_MESSAGE.size + length + _WORD - 1) // _WORD * _WORD
        at, tail, size = self._written[0], self._read[0], self._size
        place = at % size
        end = size - place
        if whole > end or (at == tail and place >= max(LOW, whole)):
            if at + end + whole - tail > size:
                return False
            _MESSAGE.pack_into(self._room, place, 0, 0, 0) if end >= _MESSAGE.size else None
            at, place = at + end, 0
        elif at + whole - tail > size:
            return False
        room = self._room
        begin = place + _MESSAGE.size
        _MESSAGE.pack_into(room, place, length, _checksum(message, number), number)
        room[begin : begin + length] = message
        self._newest[0] = at
        self._written[0] = at + whole
        return True

    def take(self) -> Iterator[tuple[int, bytes]]:
        """Messages that were not taken before, each with its number, counted from 1."""
        end = self._written[0]
        at = self._read[0]
        while at < end:
            place = at % self._size
            left = self._size - place
            length, number, message = self._message(place) if left > _MESSAGE.size else (0, 0, b"")
            if message is None:
                # Not to be seen yet; whoever looks a second time and sees no more gives it up.
                if self._doubt == at:
                    self._read[0] = end
                self._doubt = at
                return
            if length == 0:
                at += left
                self._read[0] = at
                continue
            at += (_MESSAGE.size + length + _WORD - 1) // _WORD * _WORD
            self._read[0] = at
            yield number, message

    def newest(self) -> tuple[int, bytes] | None:
        """The newest message and its number, taken or not; None: there is none."""
        for _ in range(100):
            if self._written[0] == 0:
                return None
            _, number, message = self._message(self._newest[0] % self._size)
            if message:
                return number, message
        return None

    def _message(self, place: int) -> tuple[int, int, bytes | None]:
        """Length, number and content at a place; no content: it is not whole."""
        length, checksum, number = _MESSAGE.unpack_from(self._room, place)
        begin = place + _MESSAGE.size
        if length == 0:
            return 0, 0, b""
        if begin + length > self._size:
            return length, number, None
        message = bytes(self._room[begin : begin + length])
        return length, number, message if _checksum(message, number) == checksum else None
