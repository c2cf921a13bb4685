"""The voxels of a file: raw, compressed or text, one volume of several."""

from __future__ import annotations

import bz2
import math
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.errors import MeshError
from meshes.volume.grid import MOST_BYTES, MOST_VOXELS, check_size

_CHUNK = 1 << 20
_MOST_AFTER = 16 << 20  # [byte] decompressed after the voxels at most, to reach the checksum
_MAGIC = {"gzip": b"\x1f\x8b", "bzip2": b"BZh"}


def compression(file: Path) -> str:
    """ "gzip" or "", by the file's first bytes."""
    with open(file, "rb") as stream:
        return "gzip" if stream.read(2) == _MAGIC["gzip"] else ""


def head(file: Path, length: int) -> bytes:
    """The first ``length`` bytes of a file or fewer, decompressed if it is gzipped."""
    found = b""
    for piece in chunks(file, 0, compression(file)):
        found += piece
        if len(found) >= length:
            break
    return found[:length]


def chunks(file: Path, start: int, packed: str) -> Iterator[bytes]:
    """The bytes from ``start`` on, decompressed, at most 1 MiB at a time.

    ``packed`` is "", "gzip" (zlib data is recognised) or "bzip2".

    Raises:
        MeshError: the compressed bytes are damaged or end early.
    """
    with open(file, "rb") as stream:
        stream.seek(start)
        if not packed:
            while piece := stream.read(_CHUNK):
                yield piece
            return
        magic = _MAGIC[packed]
        rest = stream.read(_CHUNK)
        while rest:
            engine: Any = bz2.BZ2Decompressor() if packed == "bzip2" else _Inflate()
            try:
                while not engine.eof:
                    if engine.needs_input and not rest:
                        raise MeshError("it is cut off: what is compressed in it ends early")
                    piece = engine.decompress(rest, _CHUNK)
                    rest = stream.read(_CHUNK) if engine.needs_input and not engine.eof else b""
                    yield piece
            except (zlib.error, OSError, EOFError):
                raise MeshError("what is compressed in it is damaged") from None
            # Another member may follow, or other bytes.
            rest = engine.unused_data + stream.read(_CHUNK)
            if not rest.startswith(magic):
                return


class _Inflate:
    """zlib with the interface of `bz2.BZ2Decompressor`."""

    def __init__(self) -> None:
        self._engine = zlib.decompressobj(wbits=47)  # gzip or zlib, with its checksum

    def decompress(self, data: bytes, most: int) -> bytes:
        return self._engine.decompress(self._engine.unconsumed_tail + data, most)

    @property
    def eof(self) -> bool:
        return self._engine.eof

    @property
    def needs_input(self) -> bool:
        return not self._engine.unconsumed_tail

    @property
    def unused_data(self) -> bytes:
        return self._engine.unused_data


def voxels(
    file: Path,
    start: int,
    dtype: np.dtype[Any],
    shape: tuple[int, ...],
    *,
    packed: str = "",
    skip: int = 0,
    volumes: int = 1,
    volume: int | None = 0,
    interleaved: bool = False,
) -> NDArray[Any]:
    """One volume ``shape`` of three dimensions, first index fastest in the file.

    Or all volumes of the file, ``(volumes, *shape)``, where ``volume`` is None.

    Args:
        start: offset [byte] of the stored data in the file.
        skip: bytes before the voxels in that data, once it is inflated.
        volumes, volume: their number in the file, and the index of the one to read, or None.
        interleaved: the volumes' values follow each other at each voxel.

    Raises:
        MeshError: too large, damaged, or fewer bytes than promised.
    """
    check_size(shape)
    if volume is None:
        _check_all(shape, volumes)
    if not packed:
        start, skip = start + skip, 0
    each = math.prod(shape) * dtype.itemsize
    promised = each * volumes
    if promised > MOST_BYTES:
        raise MeshError(
            f"its header promises {promised / 1e9:,.1f} GB of voxels, "
            f"more than the {MOST_BYTES / 1e9:g} GB allowed"
        )
    if min(start, skip) < 0 or start > file.stat().st_size:
        raise MeshError(f"its header puts its voxels at byte {start + skip:,}, which is not there")
    first, length = (0, promised)
    if volume is not None and not interleaved:
        first, length = volume * each, each
    first += skip
    found = np.empty(length, dtype=np.uint8)
    end = skip + promised
    position = 0
    for piece in chunks(file, start, packed):
        low, high = max(position, first), min(position + len(piece), first + length)
        if low < high:
            found[low - first : high - first] = np.frombuffer(
                piece, np.uint8, high - low, low - position
            )
        position += len(piece)
        # On to the end of the compressed data, where its checksum is.
        if position >= end + (_MOST_AFTER if packed else 0):
            break
    if position < end:
        raise MeshError(
            f"it is cut off: its header promises {promised:,} bytes of voxels, "
            f"{max(position - skip, 0):,} are there"
        )
    values = found.view(dtype)
    if volume is None:
        return _every(values, shape, volumes, interleaved)
    if interleaved:
        values = values.reshape(-1, volumes)[:, volume]
    return values.reshape(shape, order="F")


def _every(
    flat: NDArray[Any], shape: tuple[int, ...], volumes: int, interleaved: bool
) -> NDArray[Any]:
    """All volumes ``(volumes, *shape)`` of values in the order of the file."""
    table = flat.reshape(-1, volumes).T if interleaved else flat.reshape(volumes, -1)
    return table.reshape(volumes, *shape[::-1]).transpose(0, 3, 2, 1)


def _check_all(shape: tuple[int, ...], volumes: int) -> None:
    """Raise `MeshError` where all volumes together have more voxels than one may have."""
    if (count := math.prod(shape) * volumes) > MOST_VOXELS:
        raise MeshError(
            f"its {volumes} volumes are {count:,} voxels, more than the {MOST_VOXELS:,} allowed"
        )


def text_voxels(
    file: Path,
    start: int,
    dtype: np.dtype[Any],
    shape: tuple[int, ...],
    *,
    volumes: int,
    volume: int | None,
    interleaved: bool,
) -> NDArray[Any]:
    """`voxels` of numbers written as text.

    Raises:
        MeshError: too large, not numbers, or fewer than promised.
    """
    check_size(shape)
    if volume is None:
        _check_all(shape, volumes)
    wanted = math.prod(shape) * volumes
    with open(file, "rb") as stream:
        stream.seek(start)
        words = stream.read().replace(b",", b" ").split()
    if len(words) < wanted:
        raise MeshError(
            f"it is cut off: its header promises {wanted:,} values, {len(words):,} are there"
        )
    try:
        flat = np.array(words[:wanted], dtype=np.float64).astype(dtype)
    except ValueError as error:
        raise MeshError(f"its voxels are not numbers ({error})") from None
    every = _every(flat, shape, volumes, interleaved)
    return every if volume is None else every[volume]


def required(fields: dict[str, str], name: str) -> str:
    """A field of a header.

    Raises:
        MeshError: it is missing or empty.
    """
    if not fields.get(name):
        raise MeshError(f"its header has no field {name!r}")
    return fields[name]


def beside(file: Path, name: str) -> Path:
    """The file with the voxels that a header in ``file`` names.

    Raises:
        MeshError: it names several, or one that is not there.
    """
    if name.split()[:1] == ["LIST"] or "%" in name:
        raise MeshError("its voxels are in several files: save header and voxels as one file")
    if not name or not (file.parent / name).is_file():
        raise MeshError(f"its voxels are in {name!r}, which is not beside it")
    return file.parent / name
