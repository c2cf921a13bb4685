"""Reading GIfTI surfaces (`.surf.gii`): one set of points and one of triangles."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from meshes import xmlfile
from meshes.content import Content, check_unpacked, checked, cut_off
from meshes.errors import MeshError
from meshes.formats import text
from meshes.packed import base64_bytes, inflated

_TYPES = {
    "NIFTI_TYPE_UINT8": "u1", "NIFTI_TYPE_INT16": "i2", "NIFTI_TYPE_INT32": "i4",
    "NIFTI_TYPE_UINT32": "u4", "NIFTI_TYPE_INT64": "i8", "NIFTI_TYPE_FLOAT32": "f4",
    "NIFTI_TYPE_FLOAT64": "f8",
    # The numeric codes of older programs.
    "2": "u1", "4": "i2", "8": "i4", "16": "f4", "64": "f8", "768": "u4", "1024": "i8",
}  # fmt: skip
# Each also with the name that older programs write.
_TEXT = ("ascii", "gifti_encoding_ascii")
_PLAIN = ("base64binary", "gifti_encoding_b64bin")
_PACKED = ("gzipbase64binary", "gifti_encoding_b64gz")
_ELSEWHERE = ("externalfilebinary", "gifti_encoding_extbin")
_POINTS = ("NIFTI_INTENT_POINTSET", "1008")
_TRIANGLES = ("NIFTI_INTENT_TRIANGLE", "1009")
# All of them are RAS; they differ in the origin.
_SPACES = {
    "NIFTI_XFORM_UNKNOWN": "a space that the file does not name",
    "NIFTI_XFORM_SCANNER_ANAT": "the scanner's space",
    "NIFTI_XFORM_ALIGNED_ANAT": "the space of another scan",
    "NIFTI_XFORM_TALAIRACH": "Talairach space",
    "NIFTI_XFORM_MNI_152": "MNI 152 space",
}


@dataclass
class _Array:
    attributes: dict[str, str]
    words: dict[str, list[str]] = field(default_factory=dict)


def read(data: bytes) -> Content:
    """The surface of a GIfTI file, in millimetres, x to the right and y to the front (RAS).

    Raises:
        MeshError: cut off, damaged, or not exactly one surface.
    """
    arrays: list[_Array] = []
    path: list[str] = []

    def start(name: str, attributes: dict[str, str]) -> None:
        if not path and name != "GIFTI":
            raise MeshError(f"its XML is of {name[:40]!r}, not of GIFTI")
        path.append(name)
        if name == "DataArray":
            arrays.append(_Array(attributes))

    def end(_name: str) -> None:
        path.pop()

    def words(found: str) -> None:
        if arrays and path[-1] in ("Data", "DataSpace"):
            arrays[-1].words.setdefault(path[-1], []).append(found)

    xmlfile.parse(data, start, end, words)
    points = [a for a in arrays if a.attributes.get("Intent") in _POINTS]
    faces = [a for a in arrays if a.attributes.get("Intent") in _TRIANGLES]
    if len(points) != 1 or len(faces) != 1:
        raise MeshError(
            f"GIfTI with {len(points)} sets of points and {len(faces)} of triangles:"
            " a surface has one of each"
        )
    # The limit holds for the sum, before anything is decompressed.
    check_unpacked(sum(_bytes(array) for array in (points[0], faces[0])), len(data))
    vertices = _table(points[0]).astype(np.float64)
    corners = text.whole(_table(faces[0]).astype(np.float64), "a corner")
    space = "".join(points[0].words.get("DataSpace", [])).strip() or "NIFTI_XFORM_UNKNOWN"
    where = _SPACES.get(space, space[:40])
    return Content([checked(vertices, corners)], "mm", "RAS", (f"Its coordinates are in {where}.",))


def _shape(array: _Array) -> tuple[int, int]:
    sizes = [array.attributes.get(f"Dim{k}", "") for k in range(2)]
    rows = sizes[0].isdecimal() and len(sizes[0]) < 12
    if array.attributes.get("Dimensionality") != "2" or not rows or sizes[1] != "3":
        raise MeshError(f"an array of {' × '.join(s[:20] for s in sizes)} is no table of threes")
    return int(sizes[0]), 3


def _kind(array: _Array) -> np.dtype[np.generic]:
    name = array.attributes.get("DataType", "")
    if name not in _TYPES:
        raise MeshError(f"numbers of unknown type {name[:40]!r}")
    order = {"LittleEndian": "<", "BigEndian": ">", "1": ">", "2": "<"}
    return np.dtype(order.get(array.attributes.get("Endian", ""), "=") + _TYPES[name])


def _bytes(array: _Array) -> int:
    rows, columns = _shape(array)
    return rows * columns * _kind(array).itemsize


def _table(array: _Array) -> NDArray[np.generic]:
    shape, kind, size = _shape(array), _kind(array), _bytes(array)
    content = "".join(array.words.get("Data", [])).encode()
    form = array.attributes.get("Encoding", "").lower()
    if form in _TEXT:
        values: NDArray[np.generic] = text.numbers(content, "an array")
    elif form in (*_PLAIN, *_PACKED):
        packed = base64_bytes(content)
        raw = inflated(packed, size) if form in _PACKED else packed
        values = np.frombuffer(raw[: len(raw) // kind.itemsize * kind.itemsize], kind)
    elif form in _ELSEWHERE:
        raise MeshError("its numbers are in another file: convert it to one file")
    else:
        raise MeshError(f"unknown encoding {form[:40]!r}")
    if len(values) != shape[0] * shape[1]:
        raise cut_off(f"{shape[0] * shape[1]:,} numbers", f"{len(values):,}")
    column_major = "column" in array.attributes.get("ArrayIndexingOrder", "").lower()
    return values.reshape(shape, order="F" if column_major else "C")
