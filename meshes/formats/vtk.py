"""Reading legacy VTK polydata (`.vtk`), text and binary, up to version 5.1 of the format."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from meshes import frames
from meshes.content import Content, cut_off
from meshes.errors import MeshError
from meshes.formats import text
from meshes.polygons import NO_LISTS, Lists, body, unpacked

_TYPES = {
    "char": "i1", "signed_char": "i1", "unsigned_char": "u1", "short": "i2", "unsigned_short": "u2",
    "int": "i4", "unsigned_int": "u4", "long": "i8", "unsigned_long": "u8", "vtkidtype": "i4",
    "vtktypeint64": "i8", "vtktypeuint64": "u8", "vtktypeint32": "i4", "float": "f4",
    "double": "f8",
}  # fmt: skip
_CELLS = ("vertices", "lines", "polygons", "triangle_strips")
_END = ("point_data", "cell_data")


def read(data: bytes) -> Content:
    """The polygons and strips of a legacy VTK file, in the file's unit.

    Raises:
        MeshError: cut off, damaged, or another kind of data than polydata.
    """
    file = _File(data)
    points: NDArray[np.float64] | None = None
    cells: dict[str, Lists] = {}
    space = frames.in_text(file.title)
    while words := file.line():
        kind = words[0].lower().decode("latin-1")
        if kind == "points":
            count = file.count(words, 1)
            values = file.numbers(3 * count, file.type(words, 2), "points")
            points = values.astype(np.float64).reshape(-1, 3)
        elif kind in _CELLS:
            cells[kind] = file.cells(words, kind)
        elif kind == "field":
            space = file.field(file.count(words, 2)) or space
        elif kind == "metadata":
            file.skip_metadata()
        elif kind in _END:
            break
        else:
            raise MeshError(f"{text.quoted(b' '.join(words))} is not understood")
    if points is None:
        raise cut_off("points")
    polygons, strips = (cells.get(kind, NO_LISTS) for kind in ("polygons", "triangle_strips"))
    return Content([body(points, polygons, strips)], None, space, file.notes())


class _File:
    """The file's data and the position of the reader."""

    def __init__(self, data: bytes) -> None:
        lines = re.match(
            rb"# vtk DataFile Version\s+(\d+)\.\d+[^\n\r]*(\r\n|\n|\r)([^\n\r]*)(?:\r\n|\n|\r)"
            rb"\s*(ASCII|BINARY)\s+DATASET\s+(\w+)[ \t]*(?:\r\n|\n|\r|\Z)",
            data, re.IGNORECASE,
        )  # fmt: skip
        if lines is None:
            raise MeshError("does not begin as legacy VTK files do ('# vtk DataFile Version …')")
        kind = lines.group(5).decode("latin-1").upper()
        if kind != "POLYDATA":
            raise MeshError(f"VTK data of type {kind[:40]}, not POLYDATA: extract the surface")
        self.title = lines.group(3)
        self._offsets = int(lines.group(1)) >= 5  # cells as offsets and corners
        self._text = lines.group(4).upper() == b"ASCII"
        self._data = data
        self._place = lines.end()
        if self._text:
            self._data = text.required(data[lines.end() :])
            self._place = 0

    def line(self) -> list[bytes]:
        """The words of the next line that is not blank; [] at the end of the file."""
        while (words := self._next_line()) is not None:
            if words:
                return words
        return []

    def _next_line(self) -> list[bytes] | None:
        if self._place >= len(self._data):
            return None
        end = self._data.find(b"\n", self._place)
        end = len(self._data) if end < 0 else end
        words = self._data[self._place : end].split()
        self._place = end + 1
        return words

    def count(self, words: list[bytes], k: int) -> int:
        if len(words) <= k or not words[k].isdigit() or len(words[k]) > 18:
            raise MeshError(f"{text.quoted(b' '.join(words))}: a count is missing: damaged")
        return int(words[k])

    def type(self, words: list[bytes], k: int) -> str:
        name = words[k].decode("latin-1").lower() if len(words) > k else ""
        if name not in _TYPES:
            raise MeshError(f"{text.quoted(b' '.join(words))}: unknown type of numbers")
        return _TYPES[name]

    def numbers(self, count: int, kind: str, what: str) -> NDArray[np.generic]:
        """The next ``count`` numbers."""
        short = cut_off(f"{count:,} numbers of its {what}")
        if not self._text:
            dtype = np.dtype(">" + kind)
            if count * dtype.itemsize > len(self._data) - self._place:
                raise short
            values = np.frombuffer(self._data, dtype, count=count, offset=self._place)
            self._place += count * dtype.itemsize
            return values
        if 2 * count - 1 > len(self._data) - self._place:
            raise short
        # Up to the next word that begins with a letter, as no number does.
        end = re.compile(rb"(?<!\S)(?!nan|inf)[A-Za-z]", re.IGNORECASE).search(
            self._data, self._place
        )
        stop = end.start() if end else len(self._data)
        values = text.numbers(self._data[self._place : stop], what)
        if len(values) < count:
            raise short
        if len(values) > count:
            raise MeshError(f"its {what} are {len(values):,} numbers, not {count:,}: damaged")
        self._place = stop
        return values

    def cells(self, words: list[bytes], kind: str) -> Lists:
        count, size = self.count(words, 1), self.count(words, 2)
        if not self._offsets:
            flat = self._whole(self.numbers(size, "i4", kind), kind)
            corners, counts, used = unpacked(flat, count, kind)
            if used != len(flat):
                raise MeshError(f"its {kind} are {used:,} numbers, not {size:,}: damaged")
            return corners, counts
        ends = self._part(b"offsets", count, kind)
        corners = self._part(b"connectivity", size, kind)
        counts = np.diff(ends)
        if (counts < 0).any() or (len(ends) and (ends[0] != 0 or ends[-1] != size)):
            raise MeshError(f"offsets of its {kind} make no sense: damaged")
        return corners, counts

    def _part(self, name: bytes, count: int, kind: str) -> NDArray[np.int64]:
        words = self.line()
        if not words or words[0].lower() != name:
            raise cut_off(f"{name.decode()} of its {kind}")
        return self._whole(self.numbers(count, self.type(words, 1), kind), kind)

    @staticmethod
    def _whole(values: NDArray[np.generic], kind: str) -> NDArray[np.int64]:
        if values.dtype.kind == "f":
            return text.whole(values.astype(np.float64), f"a corner of its {kind}")
        return values.astype(np.int64)

    def field(self, arrays: int) -> str | None:
        """Skip the arrays of field data; return the frame if one is called SPACE."""
        space = None
        for _ in range(arrays):
            words = self.line()
            if words and words[0].lower() == b"metadata":
                self.skip_metadata()
                words = self.line()
            if len(words) < 4:
                raise cut_off(f"{arrays} arrays of field data")
            count = self.count(words, 1) * self.count(words, 2)
            if words[3].lower() != b"string":
                self.numbers(count, self.type(words, 3), "field data")
                continue
            for _ in range(count):
                word = self._string()
                if words[0] == b"SPACE":
                    space = frames.in_text(b"SPACE=" + word.strip())
        return space

    def _string(self) -> bytes:
        if self._text:
            return b" ".join(self.line())
        # The two highest bits of the first byte say how many bytes the length takes.
        if self._place >= len(self._data):
            raise cut_off("a word of field data")
        size = {3: 1, 2: 2, 1: 4, 0: 8}[self._data[self._place] >> 6]
        length = int.from_bytes(self._data[self._place : self._place + size], "big")
        length &= (1 << (8 * size - 2)) - 1
        self._place += size + length
        return self._data[self._place - length : self._place]

    def skip_metadata(self) -> None:
        """Skip all lines up to and including the next blank one."""
        while self._next_line():
            pass

    def notes(self) -> tuple[str, ...]:
        """A note where a text ends with its last number."""
        at_end = self._text and not self._data[self._place :].strip()
        return text.open_end(self._data) if at_end else ()
