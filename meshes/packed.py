"""Decompression and base64 of mesh files, with limited output."""

from __future__ import annotations

import base64
import binascii
import lzma
import re
import zlib

import numpy as np

from meshes.content import cut_off
from meshes.errors import MeshError
from vf.kernels import njit

_GZIP, _EITHER = 31, 47  # zlib's window bits: gzip only; zlib or gzip
_XZ_MEMORY = 256 << 20  # [byte]
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
    return _of_size(_decompressed(zlib.decompressobj(_EITHER), data, size + 1), size)


def unxz(data: bytes, size: int) -> bytes:
    """The ``size`` bytes of xz data (LZMA); raises as `inflated`."""
    try:
        return _of_size(
            lzma.LZMADecompressor(lzma.FORMAT_XZ, _XZ_MEMORY).decompress(data, size + 1), size
        )
    except (lzma.LZMAError, EOFError) as error:
        raise MeshError(f"packed data is damaged ({error})") from None


def lz4_block(data: bytes, size: int) -> bytes:
    """The ``size`` bytes of one LZ4 block, without the frame of a file; raises as `inflated`."""
    out = np.zeros(size, dtype=np.uint8)
    written = _lz4(np.frombuffer(data, dtype=np.uint8), out)
    if written < 0:
        raise MeshError("packed data is damaged (LZ4)")
    return _of_size(out[:written].tobytes(), size)


def _of_size(part: bytes, size: int) -> bytes:
    if len(part) != size:
        raise cut_off(
            f"{size:,} bytes of a packed array", f"another number ({len(part):,} or more)"
        )
    return part


# Our own, as the package lz4 takes a match at distance 0, which the format forbids, for zeros.
@njit(cache=True, nogil=True)
def _lz4(source, out):  # type: ignore[no-untyped-def]
    """How many bytes were written; −1 where the block is damaged or holds more than fits."""
    place, written = 0, 0
    while place < len(source):
        token = source[place]
        place += 1
        literals = np.int64(token >> 4)
        if literals == 15:
            more = np.int64(255)
            while more == 255:
                if place >= len(source):
                    return -1
                more = np.int64(source[place])
                place += 1
                literals += more
        if place + literals > len(source) or written + literals > len(out):
            return -1
        out[written : written + literals] = source[place : place + literals]
        place += literals
        written += literals
        if place == len(source):  # the last sequence has literals only
            return written
        if place + 2 > len(source):
            return -1
        back = np.int64(source[place]) | np.int64(source[place + 1]) << 8
        place += 2
        length = np.int64(token & 15)
        if length == 15:
            more = np.int64(255)
            while more == 255:
                if place >= len(source):
                    return -1
                more = np.int64(source[place])
                place += 1
                length += more
        length += 4
        if back == 0 or back > written or written + length > len(out):
            return -1
        for k in range(length):  # may overlap what it copies from
            out[written + k] = out[written - back + k]
        written += length
    return -1


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
