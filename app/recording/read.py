"""Reads a recording from an untrusted file, which may be truncated."""

from __future__ import annotations

import fcntl
import os
import zlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from app.motion.stream import FARTHEST, FIRST, MOST, Frame
from app.recording import archive, entries
from app.recording.checks import check
from app.recording.format import (
    BLOCK,
    CHUNK,
    FORMAT,
    HEAD,
    LAST,
    LENGTH,
    MAGIC,
    MAGICS,
    MAX_BLOCK,
    MAX_ORDERS,
    MAX_PLANTS,
    MAX_ROWS,
    MAX_SHAPES,
    ORDERS,
    PART,
    ROWS,
    SHAP,
    SHAPE,
    VERSION,
    Recording,
    RecordingError,
    blank,
    chained,
    columns,
)


def read(path: Path | str) -> Recording:
    """A recording from an untrusted file.

    A truncated or damaged file is read up to the first incomplete or damaged block, and
    `Recording.cut` says how much that is.

    Raises:
        RecordingError: not a recording, of another version, too large, damaged from its beginning,
            or unreadable; one line.
    """
    try:
        with open(path, "rb") as file:
            begins = file.read(len(MAGIC))
            if begins in MAGICS:
                return _recording(file, begins, under_way(path))
            if any(magic.startswith(begins) for magic in MAGICS):
                raise RecordingError("it was cut off before its first tick: there is nothing in it")
            if begins.startswith(FORMAT.encode()):
                raise RecordingError(
                    "it is of another version of the format: this program reads versions 1 to "
                    f"{VERSION}"
                )
            return archive.read(file)
    except RecordingError as error:
        raise RecordingError(f"{path}: {error}") from None
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror or error})") from None


def under_way(path: Path | str) -> bool:
    """Whether a session is recording into this file now."""
    try:
        with open(path, "rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False  # no such file, or a file system without locks
    return False


@dataclass(frozen=True)
class Block:
    """The header of a block, not validated."""

    kind: bytes
    at: int  # where its content begins [byte]
    size: int  # of the content [byte]
    rows: int
    crc: int


def blocks(file: BinaryIO, size: int) -> list[Block]:
    """The headers of all blocks; the last block may reach beyond the file's end."""
    found: list[Block] = []
    at = len(MAGIC)
    while at + BLOCK.size <= size:
        file.seek(at)
        kind, length, rows, crc = BLOCK.unpack(file.read(BLOCK.size))
        most = CHUNK if kind == PART else MAX_ROWS
        if kind not in (HEAD, PART, SHAP, LAST) or length > MAX_BLOCK or rows > most:
            break
        at += BLOCK.size
        found.append(Block(kind, at, length, rows, crc))
        at += length
    return found


def _recording(file: BinaryIO, magic: bytes, going: bool) -> Recording:
    size = os.fstat(file.fileno()).st_size
    listed = blocks(file, size)
    due = sum(block.rows for block in listed if block.kind == PART)
    reader = _Reader(np.zeros(min(due, MAX_ROWS), dtype=ROWS), MAGICS[magic])
    crc, end = zlib.crc32(magic), len(magic)
    invalid = None
    for block in listed:
        file.seek(block.at)
        content = file.read(block.size)
        crc = chained(crc, block.kind, block.rows, content)
        if len(content) != block.size or crc != block.crc:
            invalid = block
            break
        reader.take(block, content)
        end = block.at + block.size
    recording = reader.recording()
    if reader.ended:
        if end != size:
            raise RecordingError(f"{size - end:,} bytes follow its end")
        return recording
    there = f"{len(recording.rows) * recording.dt:.2f}"
    if going:
        return replace(recording, cut=f"The recording is still going on: {there} s so far.")
    # An incomplete last block means truncation, a complete but invalid one means damage.
    damaged = end + BLOCK.size <= size if invalid is None else invalid.at + invalid.size <= size
    what = f"is damaged from byte {end:,} on" if damaged else "was cut off"
    all_known = any(block.kind == LAST for block in listed)
    due = max([due, *(block.rows for block in listed if block.kind == LAST)])
    if due > len(recording.rows):
        there += f" of {'' if all_known else 'at least '}{due * recording.dt:.2f}"
    return replace(recording, cut=f"The recording {what}: {there} s are readable.")


class _Reader:
    """Assembles a recording from blocks with valid checksums, whose content is still untrusted.

    Sizes are checked before memory is allocated for them.
    """

    def __init__(self, rows: NDArray[Any], version: int) -> None:
        """`rows` is a buffer large enough for all rows; `version` is the file's."""
        self._version = version
        self._rows = rows
        self._filled = 0
        self._head: entries.Head | None = None
        self._places: list[Any] = []
        self._plants: list[Any] = []
        self._courses: list[Any] = []
        self._orders: list[NDArray[Any]] = []
        self._shapes: list[tuple[int, Frame]] = []
        self._shaped = 0  # numbers in them
        self._note = ""
        self.ended = False

    def take(self, block: Block, content: bytes) -> None:
        if self.ended or (block.kind == HEAD) != (self._head is None):
            raise RecordingError(f"a block {block.kind.decode()} is out of place")
        if block.kind == HEAD:
            self._head = entries.header(content, entries.Head, self._version)
        elif block.kind == PART:
            self._part(block.rows, content)
        elif block.kind == SHAP:
            self._shape(content)
        else:
            if block.rows != self._filled:
                raise RecordingError(f"it has {self._filled:,} rows, not {block.rows:,}")
            self._note = entries.text(entries.read(content, entries.End, "the end").note, "note")
            self.ended = True

    def recording(self) -> Recording:
        if self._head is None or not self._plants:
            raise RecordingError(
                "it was cut off or is damaged before its first tick: nothing of it is readable"
            )
        recording = Recording(
            places=tuple(self._places),
            plants=tuple(self._plants),
            courses=tuple(self._courses),
            state=entries.state(self._head.state, len(self._places[self._plants[0][0]].start)),
            orders=np.concatenate(self._orders),
            rows=self._rows[: self._filled],
            note=self._note,
            packages=entries.packages(self._head),
            # Those of a scene whose part is missing matter to no row.
            shapes=tuple(one for one in self._shapes if one[0] < len(self._places)),
        )
        check(recording)
        return recording

    def _shape(self, content: bytes) -> None:
        """A shape that came from elsewhere."""
        if len(content) < SHAPE.size:
            raise RecordingError("a shape in it is damaged")
        place, number, shape, seen, count = SHAPE.unpack(content[: SHAPE.size])
        self._shaped += 3 * count
        if not 1 <= count <= MOST or self._shaped > MAX_SHAPES:
            raise RecordingError(f"the shapes in it have more than {MAX_SHAPES:,} numbers")
        if shape < FIRST or not 0.0 <= seen <= 1e9:
            raise RecordingError("a shape in it has no possible time")
        unpacking = zlib.decompressobj()
        try:
            data = unpacking.decompress(content[SHAPE.size :], 12 * count)
        except zlib.error as error:
            raise RecordingError(f"a shape in it is damaged ({error})") from None
        if len(data) != 12 * count:
            raise RecordingError(f"a shape in it has {len(data):,} bytes, not {12 * count:,}")
        vertices = np.frombuffer(data, "<f4").reshape(-1, 3).astype(np.float32)
        if not (np.abs(vertices) <= FARTHEST).all():
            raise RecordingError("a vertex of a shape in it is out of range")
        self._shapes.append((place, Frame(number, shape, seen, vertices)))

    def _part(self, n: int, packed: bytes) -> None:
        unpacking = zlib.decompressobj()
        try:
            content = unpacking.decompress(packed, MAX_BLOCK)
        except zlib.error as error:
            raise RecordingError(f"a part of it is damaged ({error})") from None
        if not unpacking.eof:
            raise RecordingError(f"a part of it unpacks to more than {MAX_BLOCK:,} bytes")
        most = min(CHUNK, len(self._rows) - self._filled)
        if n > most:
            raise RecordingError(f"the rows of a part are {n:,}, at most {most:,}")
        if len(content) < LENGTH.size:
            raise RecordingError("a part of it is empty")
        (length,) = LENGTH.unpack(content[: LENGTH.size])
        at = LENGTH.size + length
        about = entries.read(content[LENGTH.size : at], entries.Part, "a part of it")
        noted = self._size(ORDERS, about.orders)
        due = noted + self._size(ROWS, n)
        if len(content) - at != due:
            raise RecordingError(f"a part of it has {len(content) - at:,} bytes, not {due:,}")
        self._places += entries.places(about.places, self._version)
        plants, courses = entries.plants(about.plants, self._places, self._version)
        self._plants += plants
        self._courses += courses
        if len(self._plants) > MAX_PLANTS:
            raise RecordingError(f"there are more than {MAX_PLANTS:,} changes of settings")
        self._orders.append(_table(content, at, ORDERS, about.orders, self._version))
        if sum(map(len, self._orders)) > MAX_ORDERS:
            raise RecordingError(f"there are more than {MAX_ORDERS:,} orders")
        self._rows[self._filled : self._filled + n] = _table(
            content, at + noted, ROWS, n, self._version
        )
        self._filled += n

    def _size(self, table: np.dtype[Any], n: int) -> int:
        """Of n rows of a table [byte]."""
        return n * sum(table[name].itemsize for name in columns(table, self._version))


def _table(content: bytes, at: int, dtype: np.dtype[Any], n: int, version: int) -> NDArray[Any]:
    """A table (n,) from its columns, stored one after another from byte `at` on."""
    table = blank(dtype, version, n)
    for name in columns(dtype, version):
        column = dtype[name]
        count = n * (column.itemsize // column.base.itemsize)
        found = np.frombuffer(content, column.base, count, at)
        table[name] = found.reshape(n, *column.shape)
        at += n * column.itemsize
    return table
