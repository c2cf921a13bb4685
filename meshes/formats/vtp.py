"""Reading VTP, VTK's XML polydata: text, base64 and appended data, plain or packed.

Packed with zlib, LZ4 or LZMA, all that VTK writes.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from meshes import frames, xmlfile
from meshes.content import Content, check_unpacked, cut_off
from meshes.errors import MeshError
from meshes.formats import text
from meshes.packed import base64_bytes, inflated, lz4_block, unxz
from meshes.polygons import Lists, body

_TYPES = {
    "Int8": "i1", "UInt8": "u1", "Int16": "i2", "UInt16": "u2", "Int32": "i4", "UInt32": "u4",
    "Int64": "i8", "UInt64": "u8", "Float32": "f4", "Float64": "f8", "String": "i1",
}  # fmt: skip
_ORDERS = {"LittleEndian": "<", "BigEndian": ">"}
_PACKERS = {
    "vtkZLibDataCompressor": inflated,
    "vtkLZ4DataCompressor": lz4_block,
    "vtkLZMADataCompressor": unxz,
}
_PARTS = ("Points", "Polys", "Strips", "FieldData")


@dataclass
class _Array:
    """A DataArray element: its attributes, and its text where it is not appended."""

    attributes: dict[str, str]
    text: list[str] = field(default_factory=list)


@dataclass
class _Piece:
    counts: dict[str, str]
    arrays: dict[tuple[str, str], _Array] = field(default_factory=dict)


def read(data: bytes) -> Content:
    """The polygons and strips of every piece of a VTP file, in the file's unit.

    Raises:
        MeshError: cut off, damaged, of another kind, or packed in a way that is not read.
    """
    file = _File(data)
    bodies = []
    for piece in file.pieces:
        points = file.array(piece, "Points", "", 3 * _count(piece, "NumberOfPoints"))
        vertices = points.astype(np.float64).reshape(-1, 3)
        bodies.append(body(vertices, file.cells(piece, "Polys"), file.cells(piece, "Strips")))
    return Content(bodies, None, file.frame())


def _count(piece: _Piece, name: str) -> int:
    value = piece.counts.get(name, "0")
    if not value.isdecimal() or len(value) > 18:
        raise MeshError(f"{name} is {value[:40]!r}: damaged")
    return int(value)


class _File:
    """The elements of a VTP file, and their numbers."""

    def __init__(self, data: bytes) -> None:
        self.pieces: list[_Piece] = []
        self._field: dict[str, _Array] = {}
        self._head: dict[str, str] = {}
        self._path: list[str] = []
        self._open: _Array | None = None
        self._size = len(data)
        self._unpacked = 0
        # Raw bytes are not XML: they are removed before it is parsed.
        start = re.search(rb"<AppendedData[^>]*>\s*_", data)
        self._appended = b""
        self._raw = False
        if start is not None:
            self._raw = b"raw" in start.group(0)
            end = data.rfind(b"</AppendedData>")
            if end < start.end():
                raise cut_off("to go on until </AppendedData>")
            self._appended = data[start.end() : end]
            if not self._raw:
                self._appended = b"".join(self._appended.split())
            data = data[: start.end()] + data[end:]
        xmlfile.parse(data, self._start, self._end, self._text)
        kind = self._head.get("type", "none")
        if kind != "PolyData":
            raise MeshError(f"VTK data of type {kind[:40]}, not PolyData: extract the surface")
        packer = self._head.get("compressor", "")
        if packer and packer not in _PACKERS:
            raise MeshError(f"packed with {packer[:60]}: zlib, LZ4 and LZMA are read")
        self._unpack = _PACKERS.get(packer)
        self._order = _ORDERS.get(self._head.get("byte_order", "LittleEndian"), "<")
        wide = self._head.get("header_type", "UInt32")
        self._word = np.dtype(self._order + ("u8" if wide == "UInt64" else "u4"))

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        parent = self._path[-1] if self._path else ""
        if not self._path and name != "VTKFile":
            raise MeshError(f"its XML is of {name[:40]!r}, not of VTKFile")
        self._path.append(name)
        if name == "VTKFile":
            self._head = attributes
        elif name == "Piece":
            self.pieces.append(_Piece(attributes))
        elif name in ("DataArray", "Array") and parent in _PARTS:
            self._open = _Array(attributes)
            key = attributes.get("Name", "")
            if parent == "FieldData":
                self._field[key] = self._open
            elif self.pieces:
                self.pieces[-1].arrays[parent, "" if parent == "Points" else key] = self._open

    def _end(self, name: str) -> None:
        self._path.pop()
        if name in ("DataArray", "Array"):
            self._open = None

    def _text(self, words: str) -> None:
        if self._open is not None and self._path[-1] in ("DataArray", "Array"):
            self._open.text.append(words)

    def array(self, piece: _Piece, part: str, name: str, count: int) -> NDArray[np.generic]:
        """The ``count`` numbers of an array that a piece must have."""
        if count == 0:
            return np.empty(0)
        if (part, name) not in piece.arrays:
            raise cut_off(f"{count:,} numbers in {part} {name}".rstrip(), "no such array")
        values = self._numbers(piece.arrays[part, name], f"{part} {name}".strip())
        if len(values) < count:
            raise cut_off(f"{count:,} numbers in {part} {name}".rstrip(), f"{len(values):,}")
        return values[:count]

    def cells(self, piece: _Piece, part: str) -> Lists:
        """Corners of a piece's polygons or strips, and how many each has."""
        count = _count(piece, f"NumberOf{part}")
        ends = self.array(piece, part, "offsets", count).astype(np.int64)
        if count == 0:
            return ends, ends
        counts = np.diff(ends, prepend=0)
        if (counts < 0).any():
            raise MeshError(f"offsets of {part} go down: damaged")
        return self.array(piece, part, "connectivity", int(ends[-1])).astype(np.int64), counts

    def frame(self) -> str | None:
        """The frame in the field data "SPACE", as 3D Slicer writes it."""
        if "SPACE" not in self._field:
            return None
        letters = self._numbers(self._field["SPACE"], "SPACE").astype(np.int64)
        word = bytes(int(c) for c in letters[:20] if 0 < c < 128).decode().strip()
        return frames.in_text(f"SPACE={word}")

    def _numbers(self, array: _Array, what: str) -> NDArray[np.generic]:
        kind = array.attributes.get("type", "")
        if kind not in _TYPES:
            raise MeshError(f"{what}: numbers of unknown type {kind[:40]!r}")
        form = array.attributes.get("format", "ascii").lower()
        if form == "ascii":
            return text.numbers("".join(array.text).encode(), what)
        if form == "binary":
            content = self._binary("".join(array.text).encode(), 0, what, raw=False)
        elif form == "appended":
            offset = array.attributes.get("offset", "")
            if not offset.isdecimal() or len(offset) > 18:
                raise MeshError(f"{what}: its offset is {offset[:40]!r}")
            content = self._binary(self._appended, int(offset), what, raw=self._raw)
        else:
            raise MeshError(f"{what}: unknown format {form[:40]!r}")
        dtype = np.dtype(self._order + _TYPES[kind])
        return np.frombuffer(content, dtype, count=len(content) // dtype.itemsize)

    def _binary(self, source: bytes, offset: int, what: str, raw: bool) -> bytes:
        """The bytes of an array: a header of sizes, then one plain or several compressed blocks."""
        if not raw and offset == 0 and source and source is not self._appended:
            source = b"".join(source.split())

        def piece(start: int, size: int) -> bytes:
            """``size`` bytes, from ``start`` of the source on."""
            length = size if raw else -(-size // 3) * 4
            found = source[start : start + length]
            found = found if raw else base64_bytes(found)[:size]
            if len(found) < size:
                raise cut_off(f"{size:,} bytes of {what}", f"{len(found):,}")
            return found

        def width(size: int) -> int:
            return size if raw else -(-size // 3) * 4

        word = self._word.itemsize
        if self._unpack is None:
            # Header and data may be encoded together or separately.
            apart = raw or source[offset : offset + width(word)].endswith(b"=")
            size = int(np.frombuffer(piece(offset, word), self._word)[0])
            self._add(size)
            if apart:
                return piece(offset + width(word), size)
            return piece(offset, word + size)[word:]
        blocks = int(np.frombuffer(piece(offset, word), self._word)[0])
        if blocks == 0:
            return b""
        if blocks > len(source):
            raise cut_off(f"{blocks:,} packed blocks of {what}", "fewer")
        head = np.frombuffer(piece(offset, word * (3 + blocks)), self._word).astype(np.int64)
        each, last, sizes = int(head[1]), int(head[2]), head[3:]
        if each < 0 or last < 0 or (sizes < 0).any() or int(sizes.max()) > len(source):
            raise MeshError(f"{what}: sizes of packed blocks make no sense: damaged")
        wanted = [each] * (blocks - 1) + [last or each]
        self._add(sum(wanted))
        packed = piece(offset + width(word * (3 + blocks)), int(sizes.sum()))
        ends = np.cumsum(sizes)
        return b"".join(
            self._unpack(packed[end - size : end], most)
            for end, size, most in zip(ends, sizes, wanted, strict=True)
        )

    def _add(self, size: int) -> None:
        """Check the sum of all array sizes; several arrays may use the same data."""
        self._unpacked += size
        check_unpacked(self._unpacked, self._size)
