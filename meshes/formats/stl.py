"""Reading and writing STL, text and binary, with the deviations of common programs.

These are counts of zero, bytes after the last triangle, attributes followed by data, "solid" at the
start of a binary file, names with keywords, and any white space. Truncated files are refused.
"""

from __future__ import annotations

import re
import struct
from array import array

import numpy as np
from numpy.typing import NDArray

from meshes import frames
from meshes.content import Content, checked, cut_off
from meshes.errors import MeshError
from meshes.formats import text

_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_HEAD = 84  # [byte] before the first triangle

_NUMBER = rb"\s+(\S+)\s+(\S+)\s+(\S+)\s+"
_FACET = re.compile(
    rb"\s*facet(?:\s+normal\s+\S+\s+\S+\s+\S+)?\s+outer\s*loop\s+"
    + (rb"vertex" + _NUMBER) * 3
    + rb"end\s*loop\s+end\s*facet(?!\S)",
    re.IGNORECASE,
)
_SOLID = re.compile(rb"\s*solid(?!\S)", re.IGNORECASE)
_END = re.compile(rb"\s*end\s*solid(?!\S)", re.IGNORECASE)
_FIRST_FACET = re.compile(rb"\sfacet\s+normal\s", re.IGNORECASE)


def read(data: bytes) -> Content:
    """The triangles of an STL file, each with corners of its own.

    Raises:
        MeshError: cut off, damaged or no STL.
    """
    plain = text.plain(data)
    if plain is not None and re.match(rb"\s*solid(?!\S)", plain, re.IGNORECASE):
        return _text(plain)
    if len(data) < _HEAD:
        raise MeshError(f"{len(data)} bytes are too few for an STL file")
    if plain is not None:
        line = text.quoted(plain.lstrip().partition(b"\n")[0])
        raise MeshError(f"text that does not begin with 'solid' but with {line}: not STL")
    return _binary(data)


def _text(plain: bytes) -> Content:
    numbers = array("d")
    names = []
    place, inside = 0, False
    while found := (_END if inside else _SOLID).match(plain, place):
        inside = not inside
        place = _name_end(plain, found.end(), inside)
        names.append(plain[found.end() : place])
        if not inside:
            continue
        facets = _FACET.scanner(plain, place)  # type: ignore[attr-defined]
        for facet in iter(facets.match, None):
            try:
                numbers.extend(map(float, facet.groups()))
            except ValueError:
                for word in facet.groups():
                    text.number(word, f"line {_line(plain, facet.start(1))}")
            place = facet.end()
    rest = plain[place:].lstrip()
    where = f"line {_line(plain, len(plain) - len(rest))}"
    if rest and inside and re.match(rb"facet\s", rest + b"\n", re.IGNORECASE):
        if re.search(rb"end\s*facet", rest, re.IGNORECASE):
            raise MeshError(f"{where}: a facet that is not three vertices of three numbers each")
        rest = b""  # the last facet is truncated
    if rest:
        wanted = "'facet' or 'endsolid'" if inside else "'solid'"
        line = text.quoted(rest.partition(b"\n")[0])
        raise MeshError(f"{where}: {line} where {wanted} should be")
    if inside:
        raise cut_off("to go on until 'endsolid'")
    corners = np.array(numbers, dtype=np.float64).reshape(-1, 3)
    return Content(
        [checked(corners, np.arange(len(corners), dtype=np.int64).reshape(-1, 3))],
        frame=frames.in_text(b"\n".join(names)),
    )


def _name_end(plain: bytes, start: int, begins: bool) -> int:
    """The end of a solid's name, after 'solid' or 'endsolid': its line's end, or the first facet.

    In a file without line breaks, facets or another solid follow the name.
    """
    end = plain.find(b"\n", start)
    end = len(plain) if end < 0 else end
    facet = _FIRST_FACET.search(plain, start, end)
    if facet is None:
        return end
    if begins:
        return facet.start()
    another = plain.lower().rfind(b"solid", start, facet.start())
    return end if another < 0 else another


def _line(plain: bytes, place: int) -> int:
    return plain.count(b"\n", 0, place) + 1


def _binary(data: bytes) -> Content:
    count = int.from_bytes(data[80:_HEAD], "little")
    room = len(data) - _HEAD
    notes: list[str] = []
    rows: NDArray[np.void] | None = None
    if count == 0 and room:
        # Some programs never write the count; the file's length gives it.
        if room % _RECORD.itemsize:
            raise MeshError(
                f"its header counts 0 triangles and its length fits none"
                f" ({len(data):,} bytes): cut off or not STL"
            )
        count = room // _RECORD.itemsize
        notes.append(f"The header counts 0 triangles: all {count:,} that the file has room for.")
    if room < count * _RECORD.itemsize:
        raise cut_off(f"{count:,} triangles", f"{room // _RECORD.itemsize:,}")
    extra = room - count * _RECORD.itemsize
    if extra:
        rows = _with_data(data, count)
        if rows is None and extra % _RECORD.itemsize == 0:
            both = np.frombuffer(data, _RECORD, offset=_HEAD)
            if _plausible(both[:count], both[count:]):
                rows = both
                notes.append(f"The header counts {count:,} triangles, the file has {len(both):,}.")
        if rows is None and data[_HEAD + count * _RECORD.itemsize :].strip(b"\0 \t\r\n\x1a"):
            notes.append(f"{extra:,} bytes after the last triangle are not looked at.")
    if rows is None:
        rows = np.frombuffer(data, _RECORD, count=count, offset=_HEAD)
    corners = rows["corners"].astype(np.float64).reshape(-1, 3)
    faces = np.arange(len(corners), dtype=np.int64).reshape(-1, 3)
    return Content([checked(corners, faces)], None, frames.in_text(data[:80]), tuple(notes))


def _with_data(data: bytes, count: int) -> NDArray[np.void] | None:
    """The triangles of a file whose attributes give the number of bytes after each of them."""
    places = []
    place = _HEAD
    for _ in range(count):
        if place + _RECORD.itemsize > len(data):
            return None
        places.append(place)
        place += _RECORD.itemsize + struct.unpack_from("<H", data, place + 48)[0]
    if place > len(data) or (place < len(data) and data[place:].strip(b"\0 \t\r\n\x1a")):
        return None
    raw = np.frombuffer(data, dtype=np.uint8)
    table = raw[np.array(places, dtype=np.int64)[:, None] + np.arange(_RECORD.itemsize)]
    return table.view(_RECORD)[:, 0]


def _plausible(known: NDArray[np.void], more: NDArray[np.void]) -> bool:
    """Whether data after the counted triangles can be triangles: near them, with unit normals."""
    with np.errstate(all="ignore"):
        corners = more["corners"].astype(np.float64)
        low, high = known["corners"].min(axis=(0, 1)), known["corners"].max(axis=(0, 1))
        size = float(np.linalg.norm(high - low))
        near = (corners > low - size) & (corners < high + size)
        lengths = np.linalg.norm(more["normal"], axis=1)
    return bool(near.all() and ((lengths == 0) | (np.abs(lengths - 1) < 0.01)).all())


def write(v: NDArray[np.float64], f: NDArray[np.int64], comment: str) -> bytes:
    """The bytes of an STL file, binary; see `meshes.formats.Format`."""
    corners = v[f]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    rows = np.zeros(
        len(f), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]
    )
    rows["normal"] = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
    rows["corners"] = corners
    return comment.encode().ljust(80) + len(f).to_bytes(4, "little") + rows.tobytes()
