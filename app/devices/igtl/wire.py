"""Messages of OpenIGTLink: what is needed of its versions 1 to 3, read and written.

A message is a header of 58 bytes, and a body whose CRC-64 the header has; all is big-endian.
Versions 2 and 3 have a further header before the content and metadata behind it, which are skipped.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import cache

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

HEADER = struct.Struct(">H12s20sQQQ")
_EXTENDED = struct.Struct(">HHII")
LARGEST = 1 << 16  # of a body that is read [byte]
_POLYNOMIAL = 0x42F0E1EBA9EA3693  # of ECMA-182
_ASCII = 3


class Unreadable(ValueError):
    """What is not OpenIGTLink; the message says why."""


@dataclass(frozen=True)
class Received:
    """A message that arrived.

    Attributes:
        kind: its type, such as "TRANSFORM".
        name: of the device.
        content: its body, without further headers and metadata.
    """

    kind: str
    name: str
    content: bytes

    @property
    def transform(self) -> NDArray[np.float64]:
        """(4, 4) of a TRANSFORM, its translation in metres; not checked.

        Raises:
            Unreadable: it is of another length.
        """
        if len(self.content) != 48:
            raise Unreadable(f"a transform has 48 byte, not {len(self.content)}")
        columns = np.frombuffer(self.content, ">f4").astype(np.float64).reshape(4, 3)
        T = np.eye(4)
        T[:3, :] = columns.T
        T[:3, 3] *= 1e-3
        return T

    @property
    def text(self) -> str:
        """Of a STRING.

        Raises:
            Unreadable: it is cut off.
        """
        if len(self.content) < 4:
            raise Unreadable("a string has at least 4 byte")
        (length,) = struct.unpack_from(">H", self.content, 2)
        return self.content[4 : 4 + length].decode("utf-8", "replace")


def split(buffer: bytes) -> tuple[Received | None, bytes]:
    """The first message of a stream, None if it is not complete yet, and what follows it.

    Raises:
        Unreadable: it is none, or too long.
    """
    if len(buffer) < HEADER.size:
        return None, buffer
    version, kind, name, _stamp, size, crc = HEADER.unpack_from(buffer)
    if not 1 <= version <= 3:
        raise Unreadable(f"version {version} of OpenIGTLink is not known")
    if size > LARGEST:
        raise Unreadable(f"a body of {size} byte, at most {LARGEST} are read")
    end = HEADER.size + size
    if len(buffer) < end:
        return None, buffer
    body = buffer[HEADER.size : end]
    if crc64(body) != crc:
        raise Unreadable("the CRC of a body is wrong")
    if version > 1:
        if size < _EXTENDED.size:
            raise Unreadable("no extended header")
        head, index, metadata, _number = _EXTENDED.unpack_from(body)
        if not _EXTENDED.size <= head <= size - index - metadata:
            raise Unreadable("an extended header that is longer than the body")
        body = body[head : size - index - metadata]
    return Received(_word(kind), _word(name), body), buffer[end:]


def transform(name: str, T: ArrayLike) -> bytes:
    """A TRANSFORM of a pose (4, 4) with its translation in metres."""
    columns = np.array(T, dtype=np.float64)[:3, :].T.copy()
    columns[3] *= 1e3
    return _message("TRANSFORM", name, columns.astype(">f4").tobytes())


def string(name: str, text: str) -> bytes:
    """A STRING."""
    data = text.encode("ascii", "replace")
    return _message("STRING", name, struct.pack(">HH", _ASCII, len(data)) + data)


def polydata(name: str, vertices: ArrayLike, faces: ArrayLike) -> bytes:
    """A POLYDATA of triangles: vertices (n, 3) [m], faces (m, 3)."""
    points = 1e3 * np.asarray(vertices, dtype=np.float64)
    triangles = np.asarray(faces)
    cells = np.empty((len(triangles), 4), dtype=">u4")
    cells[:, 0], cells[:, 1:] = 3, triangles
    head = struct.pack(">10I", len(points), 0, 0, 0, 0, len(cells), cells.nbytes, 0, 0, 0)
    return _message("POLYDATA", name, head + points.astype(">f4").tobytes() + cells.tobytes())


def crc64(data: bytes) -> int:
    """The CRC-64 of ECMA-182."""
    return int(_crc(np.frombuffer(bytearray(data), np.uint8), _table()))


def _message(kind: str, name: str, body: bytes) -> bytes:
    device = name.encode("ascii", "replace")[:20]
    return HEADER.pack(1, kind.encode(), device, 0, len(body), crc64(body)) + body


def _word(field: bytes) -> str:
    return field.partition(b"\0")[0].decode("ascii", "replace")


@cache
def _table() -> NDArray[np.uint64]:
    table = np.zeros(256, dtype=np.uint64)
    for k in range(256):
        value = k << 56
        for _ in range(8):
            value = (value << 1) ^ (_POLYNOMIAL if value >> 63 else 0)
            value &= (1 << 64) - 1
        table[k] = value
    return table


@numba.njit("u8(u1[::1], u8[::1])", nogil=True)
def _crc(data: NDArray[np.uint8], table: NDArray[np.uint64]) -> int:
    crc = np.uint64(0)
    for byte in data:
        crc = table[np.uint64(byte) ^ (crc >> np.uint64(56))] ^ (crc << np.uint64(8))
    return crc  # type: ignore[return-value]
