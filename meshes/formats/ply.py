"""Reading and writing PLY: text and binary, any properties, polygons and triangle strips.

An own reader: trimesh accepts a truncated text file as a smaller mesh, and reads neither strips nor
binary polygons of several sizes.
"""

from __future__ import annotations

import codecs
import re
import struct
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from meshes import frames
from meshes.content import Content, cut_off
from meshes.errors import MeshError
from meshes.formats import text
from meshes.polygons import NO_LISTS, Lists, body

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8", "int64": "i8", "uint64": "u8",
}  # fmt: skip
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_HEADER_LIMIT = 100_000  # [byte]
_CORNERS = ("vertex_indices", "vertex_index")


@dataclass(frozen=True)
class _Property:
    name: str
    type: str
    count: str | None = None  # type of a list's length


@dataclass
class _Element:
    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)


def read(data: bytes) -> Content:
    """The one body of a PLY file, its polygons and strips cut into triangles.

    Raises:
        MeshError: cut off, damaged or no PLY.
    """
    if data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        data = text.required(data)
    order, elements, comments, start = _header(data)
    notes: tuple[str, ...] = ()
    if order == "":
        notes = text.open_end(data)
        # Converted to binary of one type.
        plain = text.required(data[start:])
        numbers = text.numbers(plain, "after the header")
        if not _fits(numbers, elements):
            numbers = _rows(plain, elements)
        content, order = numbers.astype("<f8").tobytes(), "<"
        for element in elements:
            element.properties = [
                _Property(p.name, "f8", "f8" if p.count else None) for p in element.properties
            ]
    else:
        content = data[start:]
    points: NDArray[np.float64] | None = None
    lists: dict[str, list[Lists]] = {"face": [NO_LISTS], "tristrips": [NO_LISTS]}
    place = 0
    for element in elements:
        columns, place = _columns(content, place, element, order)
        if element.name == "vertex":
            if not {"x", "y", "z"} <= columns.keys():
                raise MeshError("its vertices have no x, y and z")
            axes = [columns[axis] for axis in "xyz"]
            if any(isinstance(axis, tuple) for axis in axes):
                raise MeshError("its vertices have lists for x, y or z")
            points = np.column_stack([np.asarray(axis, dtype=np.float64) for axis in axes])
        elif element.name in lists and element.count:
            found = [columns[name] for name in _CORNERS if name in columns]
            if not found or not isinstance(found[0], tuple):
                raise MeshError(f"its element {element.name} has no list vertex_indices")
            flat, counts = found[0]
            flat = text.whole(flat.astype(np.float64), f"a corner in {element.name}")
            lists[element.name].append((flat, counts))
    if points is None:
        raise MeshError("no element vertex in its header")
    polygons, strips = (
        (np.concatenate([flat for flat, _ in some]), np.concatenate([n for _, n in some]))
        for some in lists.values()
    )
    if place < len(content):
        notes = ("What comes after the last element is not looked at.",)
    return Content([body(points, polygons, strips)], None, frames.in_text(comments), notes)


def _header(data: bytes) -> tuple[str, list[_Element], str, int]:
    """Byte order ("" of text), elements, comments, and where the data begins."""
    first = re.match(rb"(?:\xef\xbb\xbf)?\s*ply[ \t]*(\r\n|\n|\r)", data[:100], re.IGNORECASE)
    if first is None:
        raise MeshError("does not begin with a line 'ply'")
    # The header's own line end: the data may begin with bytes that look like one.
    end = re.escape(first.group(1))
    odd = rb"\r?" if first.group(1) == b"\n" else b""
    last = end + rb"[ \t]*end_header[ \t]*" + odd + end
    found = re.search(last, data[:_HEADER_LIMIT], re.IGNORECASE)
    if found is None:
        raise MeshError("its header has no end ('end_header'): cut off or damaged")
    lines = data[: found.start()].decode("latin-1").replace("\r\n", "\n").replace("\r", "\n")
    order = None
    elements: list[_Element] = []
    comments = []
    for line in lines.split("\n")[1:]:
        words = line.split()
        kind = words[0].lower() if words else "comment"
        try:
            if kind in ("comment", "obj_info"):
                comments.append(line)
            elif kind == "format":
                if words[1].lower() not in _ORDERS:
                    choices = ", ".join(_ORDERS)
                    raise MeshError(f"unknown format {words[1][:40]!r}; PLY has {choices}")
                order = _ORDERS[words[1].lower()]
            elif kind == "element":
                elements.append(_Element(words[1], int(words[2])))
                if elements[-1].count < 0:
                    raise ValueError
            elif kind == "property":
                elements[-1].properties.append(_property(words[1:]))
            # Other lines are ignored: some programs break comments into two lines.
        except (IndexError, ValueError, KeyError) as error:
            if isinstance(error, MeshError):
                raise
            raise MeshError(f"not understood in its header: {line.strip()[:60]!r}") from None
    if order is None:
        raise MeshError("its header does not say the format")
    return order, elements, "\n".join(comments), found.end()


def _property(words: list[str]) -> _Property:
    if words[0] == "list":
        count, kind, name = words[1:4]
        return _Property(name, _TYPES[kind], _TYPES[count])
    return _Property(words[1], _TYPES[words[0]])


def _fits(numbers: NDArray[np.float64], elements: list[_Element]) -> bool:
    """Whether a text has no more numbers than its header says."""
    place, end = 0, len(numbers)
    for element in elements:
        lists = [p.count is not None for p in element.properties]
        if not any(lists):
            place += element.count * len(lists)
            continue
        for _ in range(element.count):
            for is_list in lists:
                if place >= end:
                    return True  # truncated: `_columns` raises
                length = numbers[place] if is_list else 0.0
                if not (length >= 0 and length == int(length)):
                    return False
                place += 1 + int(length)
    return place >= end


def _rows(plain: bytes, elements: list[_Element]) -> NDArray[np.float64]:
    """The numbers of the needed properties, from lines with more numbers than the header says.

    Properties after the last needed one are removed from each element.
    """
    lines = [line for line in plain.split(b"\n") if line.strip()]
    if len(lines) < sum(element.count for element in elements):
        raise cut_off(f"{sum(element.count for element in elements):,} rows", f"{len(lines):,}")
    parts, first = [np.empty(0)], 0
    for element in elements:
        wanted = [
            k for k, p in enumerate(element.properties) if p.name in ("x", "y", "z", *_CORNERS)
        ]
        element.properties = element.properties[: max(wanted, default=-1) + 1]
        for line in lines[first : first + element.count] if wanted else ():
            row, place = text.numbers(line, f"of element '{element.name}'"), 0
            for p in element.properties:
                if place >= len(row) or (p.count and not 0 <= row[place] < len(row) - place):
                    raise MeshError(f"a row of its element '{element.name}' is too short: damaged")
                place += 1 + (int(row[place]) if p.count else 0)
            parts.append(row[:place])
        first += element.count
    return np.concatenate(parts)


Column = NDArray[np.generic] | tuple[NDArray[np.generic], NDArray[np.int64]]


def _columns(
    body: bytes, place: int, element: _Element, order: str
) -> tuple[dict[str, Column], int]:
    """The properties of an element's rows, lists as ``(values, lengths)``; where the next begins.

    Raises:
        MeshError: fewer rows than the header promises.
    """
    count, properties = element.count, element.properties
    if count == 0 or not properties:
        empty = np.empty(0)
        none = np.empty(0, dtype=np.int64)
        return {p.name: (empty, none) if p.count else empty for p in properties}, place
    row, lengths = _row(body, place, properties, order)
    short = cut_off(f"{count:,} of its element '{element.name}'")
    least = sum(np.dtype(p.count or p.type).itemsize for p in properties)
    if row is None or count * least > len(body) - place:
        raise short
    if count * row.itemsize <= len(body) - place:
        table = np.frombuffer(body, row, count=count, offset=place)
        heads = [k for k, p in enumerate(properties) if p.count]
        if all((table[f"n{k}"] == lengths[k]).all() for k in heads):
            return {
                p.name: (
                    (table[f"p{k}"].reshape(-1), np.full(count, lengths[k], dtype=np.int64))
                    if p.count
                    else table[f"p{k}"]
                )
                for k, p in enumerate(properties)
            }, place + count * row.itemsize
    return _walked(body, place, element, order, short)


def _row(
    body: bytes, place: int, properties: list[_Property], order: str
) -> tuple[np.dtype[np.void] | None, dict[int, int]]:
    """The dtype of the first row, None where it is truncated, and the lengths of its lists."""
    fields: list[tuple[str, str] | tuple[str, str, tuple[int]]] = []
    lengths: dict[int, int] = {}
    for k, p in enumerate(properties):
        if p.count:
            at = place + np.dtype(fields).itemsize
            length = _length(body, at, order + p.count)
            if length is None or length * np.dtype(p.type).itemsize > len(body) - at:
                return None, lengths
            lengths[k] = length
            fields += [(f"n{k}", order + p.count), (f"p{k}", order + p.type, (length,))]
        else:
            fields.append((f"p{k}", order + p.type))
    return np.dtype(fields), lengths


def _length(body: bytes, place: int, kind: str) -> int | None:
    """A list's length; None where the data ends before."""
    if place + np.dtype(kind).itemsize > len(body):
        return None
    length = float(np.frombuffer(body, kind, count=1, offset=place)[0])
    if not 0 <= length < 2**53 or length != int(length):
        raise MeshError(f"a list of {length:g} items: damaged")
    return int(length)


def _walked(
    body: bytes, place: int, element: _Element, order: str, short: MeshError
) -> tuple[dict[str, Column], int]:
    """`_columns` row by row, for lists of different lengths."""
    letters = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "f4": "f",
               "f8": "d", "i8": "q", "u8": "Q"}  # fmt: skip
    places: list[list[int]] = [[] for _ in element.properties]
    lengths: list[list[int]] = [[] for _ in element.properties]
    plan = [
        (
            struct.Struct(order + letters[p.count]) if p.count else None,
            np.dtype(p.type).itemsize,
            places[k],
            lengths[k],
        )
        for k, p in enumerate(element.properties)
    ]
    end = len(body)
    for _ in range(element.count):
        for head, size, where, long in plan:
            length = 1
            if head is not None:
                if place + head.size > end:
                    raise short
                (length,) = head.unpack_from(body, place)
                if not 0 <= length <= end or length != int(length):
                    raise MeshError(f"a list of {length:g} items: damaged")
                place += head.size
            where.append(place)
            long.append(int(length))
            place += int(length) * size
            if place > end:
                raise short
    raw = np.frombuffer(body, dtype=np.uint8)
    columns: dict[str, Column] = {}
    for p, where, long in zip(element.properties, places, lengths, strict=True):
        kind = np.dtype(order + p.type)
        counts = np.array(long, dtype=np.int64)
        sizes = counts * kind.itemsize
        starts = np.repeat(np.array(where, dtype=np.int64) - (np.cumsum(sizes) - sizes), sizes)
        values = raw[starts + np.arange(int(sizes.sum()))].view(kind)
        columns[p.name] = (values, counts) if p.count else values
    return columns, place


def write(v: NDArray[np.float64], f: NDArray[np.int64], comment: str) -> bytes:
    """The bytes of a PLY file, binary, in double precision; see `meshes.formats.Format`."""
    header = (
        f"ply\nformat binary_little_endian 1.0\ncomment {comment}\n"
        f"element vertex {len(v)}\nproperty double x\nproperty double y\nproperty double z\n"
        f"element face {len(f)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = np.empty(len(f), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    rows["count"], rows["corners"] = 3, f
    return header.encode() + v.astype("<f8").tobytes() + rows.tobytes()
