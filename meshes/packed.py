"""Decompression and base64 of mesh files, with limited output."""

from __future__ import annotations

import base64
import binascii
import re
import zlib

from meshes.content import cut_off
from meshes.errors import MeshError

_GZIP, _EITHER = 31, 47  # zlib's window bits: gzip only; zlib or gzip
MAGIC = b"\x1f\x8b"  # of gzip


def gunzip(data: bytes, most: int) -> bytes:
    """All members of a gzip file; slightly more than ``most`` bytes if it holds more than that.

    Raises:
        MeshError: damaged or cut off.
    """
    parts, size = [], 0
    while data and size <= most:
        unpacker = zlib.decompressobj(_GZIP)
        part = _decompressed(unpacker, data, most + 1 - size)
        parts.append(part)
        size += len(part)
        if size > most:
            break
        if not unpacker.eof:
            raise cut_off("to be a whole gzip file")
        data = unpacker.unused_data.lstrip(b"\0")
    return b"".join(parts)


def inflated(data: bytes, size: int) -> bytes:
    """The ``size`` bytes of zlib or gzip data.

    Raises:
        MeshError: damaged, or another number of bytes.
    """
    part = _decompressed(zlib.decompressobj(_EITHER), data, size + 1)
    if len(part) != size:
        raise cut_off(
            f"{size:,} bytes of a packed array", f"another number ({len(part):,} or more)"
        )
    return part


def _decompressed(unpacker: zlib._Decompress, data: bytes, most: int) -> bytes:
    try:
        return unpacker.decompress(data, most)
    except zlib.error as error:
        reason = re.sub(r"^Error -?\d+ while decompressing data: ", "", str(error))
        raise MeshError(f"packed data is damaged ({reason})") from None


def base64_bytes(data: bytes) -> bytes:
    """Bytes of base64 text, also of several pieces with padding each.

    Raises:
        MeshError: other characters, or cut off.
    """
    pieces = re.findall(rb"[^=]+={0,2}", b"".join(data.split()))
    return b"".join(base64_piece(piece) for piece in pieces)


def base64_piece(data: bytes) -> bytes:
    """Bytes written as one piece of base64 without white space; raises as `base64_bytes`."""
    try:
        return base64.b64decode(data, validate=True)
    except binascii.Error as error:
        raise MeshError(f"its base64 data is damaged or cut off ({error})") from None
