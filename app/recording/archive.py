"""Reads recordings of version 1, a zip archive of JSON and arrays; new ones are append-only.

``header.json`` has format, version, package versions, state, scenes, plants, the number of orders
and of rows in each chunk, and why the recording ended; ``orders/<column>.npy`` and
``rows/<chunk>/<column>.npy`` are the columns of `ORDERS` and `ROWS`.
"""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from app.recording import entries
from app.recording.checks import check
from app.recording.format import (
    MAX_HEADER,
    MAX_ROWS,
    ORDERS,
    ROWS,
    Recording,
    RecordingError,
    blank,
    columns,
)

VERSION = 1


def read(file: BinaryIO) -> Recording:
    """A recording from an untrusted archive.

    Raises:
        RecordingError: not a recording, damaged, of another version, or too large; one line.
        OSError: it cannot be read.
    """
    try:
        with zipfile.ZipFile(file) as archive:
            return _Reader(archive).recording()
    except (
        zipfile.BadZipFile,
        zlib.error,
        NotImplementedError,  # an unsupported compression
        RuntimeError,  # encrypted
        EOFError,
        struct.error,
    ) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise RecordingError(f"not a readable recording ({reason})") from None


class _Reader:
    """Reads one archive; sizes are checked before memory is allocated for them."""

    def __init__(self, archive: zipfile.ZipFile) -> None:
        self._archive = archive
        self._members = {info.filename: info for info in archive.infolist()}
        if len(self._members) != len(archive.infolist()):
            raise RecordingError("a member is there twice")

    def recording(self) -> Recording:
        if "header.json" not in self._members:
            raise RecordingError("not a recording: header.json is missing")
        header = entries.header(self._bytes("header.json", MAX_HEADER), entries.Archive, VERSION)
        places = entries.places(header.places, VERSION)
        plants, courses = entries.plants(header.plants, places, VERSION)
        chunks = header.chunks
        if sum(chunks) > MAX_ROWS:
            raise RecordingError(f"{sum(chunks):,} rows: at most {MAX_ROWS:,} are read")
        orders = self._table("orders", ORDERS, header.orders)
        rows = np.zeros(sum(chunks), dtype=ROWS)
        at = 0
        for k, n in enumerate(chunks):
            rows[at : at + n] = self._table(f"rows/{k:05d}", ROWS, n)
            at += n
        each = len(columns(ROWS, VERSION))
        expected = 1 + len(columns(ORDERS, VERSION)) + len(chunks) * each
        if len(self._members) != expected:
            raise RecordingError("it has members that a recording does not have")
        recording = Recording(
            places=places,
            plants=plants,
            courses=courses,
            state=entries.state(header.state, len(places[plants[0][0]].start)),
            orders=orders,
            rows=rows,
            note=entries.text(header.note, "note"),
            packages=entries.packages(header),
        )
        check(recording)
        return recording

    def _bytes(self, name: str, limit: int) -> bytes:
        info = self._members.get(name)
        if info is None:
            raise RecordingError(f"the member {name} is missing")
        if info.file_size > limit:
            raise RecordingError(f"{name} unpacks to {info.file_size:,} bytes, {limit:,} allowed")
        return self._archive.read(info)

    def _table(self, folder: str, dtype: np.dtype[Any], n: int) -> NDArray[Any]:
        table = blank(dtype, VERSION, n)
        for name in columns(dtype, VERSION):
            column = dtype[name]
            member = f"{folder}/{name}.npy"
            data = self._bytes(member, n * column.itemsize + 1024)
            try:
                array = np.load(io.BytesIO(data), allow_pickle=False)
            except (ValueError, OSError, EOFError, SyntaxError) as error:
                reason = " ".join(str(error).split())[:120]
                raise RecordingError(f"{member} is damaged ({reason})") from None
            wanted = (n, *column.shape)
            if array.dtype != column.base or array.shape != wanted:
                raise RecordingError(
                    f"{member} is {array.dtype} {array.shape}, not {column.base} {wanted}"
                )
            table[name] = array
        return table
