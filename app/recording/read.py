"""Reads a recording from a file that nobody vouches for: its members, and the rows in them."""

from __future__ import annotations

import io
import json
import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import vf
from app.recording import entries
from app.recording.format import (
    CHUNK,
    FORMAT,
    MAX_HEADER,
    MAX_ORDERS,
    MAX_PLANTS,
    MAX_ROWS,
    ORDERS,
    ROWS,
    VERSION,
    Recording,
    RecordingError,
)


def read(path: Path | str) -> Recording:
    """A recording from a file that nobody vouches for.

    Raises:
        RecordingError: it is no recording, damaged, of another version, or larger than any; the
            message is one line.
        OSError: it cannot be read.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            return _Reader(archive).recording()
    except RecordingError as error:
        raise RecordingError(f"{path}: {error}") from None
    except (
        zipfile.BadZipFile,
        zlib.error,
        NotImplementedError,  # a compression of another kind
        RuntimeError,  # encrypted
        EOFError,
        struct.error,
    ) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise RecordingError(f"{path}: not a readable recording ({reason})") from None


class _Reader:
    """Reads one archive; no size is believed before it is compared with what it must be."""

    def __init__(self, archive: zipfile.ZipFile) -> None:
        self._archive = archive
        self._members = {info.filename: info for info in archive.infolist()}
        if len(self._members) != len(archive.infolist()):
            raise RecordingError("a member is there twice")

    def recording(self) -> Recording:
        if "header.json" not in self._members:
            raise RecordingError("not a recording: header.json is missing")
        try:
            header = json.loads(
                self._bytes("header.json", MAX_HEADER), parse_constant=entries.no_constant
            )
        except RecordingError:
            raise
        except (ValueError, RecursionError) as error:
            raise RecordingError(f"header.json is damaged ({str(error)[:120]})") from None
        if not isinstance(header, dict) or header.get("format") != FORMAT:
            raise RecordingError(f"not a recording: the format is not '{FORMAT}'")
        if header.get("version") != VERSION:
            raise RecordingError(
                f"version {str(header.get('version'))[:20]} of the format: "
                f"this program reads version {VERSION}"
            )
        places = tuple(
            entries.place(entry) for entry in entries.items(header, "places", MAX_PLANTS)
        )
        plants = tuple(
            entries.plant(entry, len(places))
            for entry in entries.items(header, "plants", MAX_PLANTS)
        )
        courses = tuple(entries.course(entry.get("course")) for entry in header["plants"])
        if len({options.rate for _, options in plants}) != 1:
            raise RecordingError("the rate changes within the recording")
        chunks = [
            entries.whole(n, "the rows of a chunk", 1, CHUNK)
            for n in entries.items(header, "chunks", MAX_ROWS, least=0)
        ]
        if sum(chunks) > MAX_ROWS:
            raise RecordingError(f"{sum(chunks):,} rows: at most {MAX_ROWS:,} are read")
        count = entries.whole(header.get("orders"), "the number of orders", 1, MAX_ORDERS)
        orders = self._table("orders", ORDERS, count)
        rows = np.zeros(sum(chunks), dtype=ROWS)
        at = 0
        for k, n in enumerate(chunks):
            rows[at : at + n] = self._table(f"rows/{k:05d}", ROWS, n)
            at += n
        expected = 1 + len(ORDERS.names or ()) + len(chunks) * len(ROWS.names or ())
        if len(self._members) != expected:
            raise RecordingError("there are members that do not belong into a recording")
        recording = Recording(
            places=places,
            plants=plants,
            courses=courses,
            state=entries.state(header.get("state"), len(places[plants[0][0]].start)),
            orders=orders,
            rows=rows,
            note=entries.text(header.get("note"), "note"),
            packages={
                entries.text(name, "package"): entries.text(version, "version")
                for name, version in entries.mapping(header, "packages").items()
            },
        )
        _check(recording)
        return recording

    def _bytes(self, name: str, limit: int) -> bytes:
        info = self._members.get(name)
        if info is None:
            raise RecordingError(f"the member {name} is missing")
        if info.file_size > limit:
            raise RecordingError(f"{name} unpacks to {info.file_size:,} bytes, {limit:,} allowed")
        return self._archive.read(info)

    def _table(self, folder: str, dtype: np.dtype[Any], n: int) -> NDArray[Any]:
        table = np.zeros(n, dtype=dtype)
        for name in dtype.names or ():
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


def _check(recording: Recording) -> None:
    """Refuse what no recorder writes."""
    orders, rows = recording.orders, recording.rows
    for name in ("target", "rotation", "stamp", "scale"):
        _all(np.isfinite(orders[name]), f"orders/{name}", "is not finite")
    _all(orders["plant"] < len(recording.plants), "orders/plant", "is not one of the plants")
    _all(np.diff(orders["plant"].astype(np.int64)) >= 0, "orders/plant", "goes back")
    turned = orders["rotation"][orders["driven"] != 0]
    off = np.abs(np.einsum("kij,klj->kil", turned, turned) - np.eye(3)).max(axis=(1, 2), initial=0)
    _all(off < 1e-3, "orders/rotation", "is not a rotation")
    for name in ("q", "target", "tip", "force", "radius", "spent"):
        _all(np.isfinite(rows[name]), f"rows/{name}", "is not finite")
    _all(~np.isnan(rows["distance"]), "rows/distance", "is not a number")
    _all(rows["status"] <= max(vf.Status), "rows/status", "is not a status")
    order = rows["order"].astype(np.int64)
    _all(order < len(orders), "rows/order", "is not one of the orders")
    _all(np.diff(order, prepend=0) >= 0, "rows/order", "goes back")
    ticks = np.diff(rows["tick"], prepend=recording.state.tick)
    _all(ticks == (rows["ticked"] != 0), "rows/tick", "does not count on")


def _all(good: NDArray[np.bool_], column: str, what: str) -> None:
    if not good.all():
        row = int(np.argmin(good.reshape(len(good), -1).all(axis=1)))
        raise RecordingError(f"{column} of row {row} {what}")
