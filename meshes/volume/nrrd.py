"""NRRD volumes (.nrrd, .nhdr with a data file beside it) and 3D Slicer's segmentations in them.

An own reader: pynrrd decompresses without a limit and drops non-ASCII letters of segment names.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from meshes.errors import MeshError
from meshes.volume.grid import GUESS, FloatArray, Segment, Stored, one_of, printable
from meshes.volume.payload import beside, required, text_voxels, voxels

_MOST_HEADER = 4 << 20  # [bytes]
_TYPES = {
    "i1": "signed char, int8, int8_t",
    "u1": "uchar, unsigned char, uint8, uint8_t",
    "i2": "short, short int, signed short, signed short int, int16, int16_t",
    "u2": "ushort, unsigned short, unsigned short int, uint16, uint16_t",
    "i4": "int, signed int, int32, int32_t",
    "u4": "uint, unsigned int, uint32, uint32_t",
    "i8": "longlong, long long, long long int, signed long long, signed long long int, int64, "
    "int64_t",
    "u8": "ulonglong, unsigned long long, unsigned long long int, uint64, uint64_t",
    "f4": "float",
    "f8": "double",
}
_CODES = {name: code for code, names in _TYPES.items() for name in names.split(", ")}
_PACKED = {"raw": "", "gzip": "gzip", "gz": "gzip", "bzip2": "bzip2", "bz2": "bzip2"}
_TEXT = ("txt", "text", "ascii")
_SIGNS = {
    **dict.fromkeys(("right-anterior-superior", "ras"), (1.0, 1.0, 1.0)),
    **dict.fromkeys(("left-anterior-superior", "las"), (-1.0, 1.0, 1.0)),
    **dict.fromkeys(("left-posterior-superior", "lps"), (-1.0, -1.0, 1.0)),
}
_NO_PATIENT = ("", "scanner-xyz", "3d-right-handed", "3d-left-handed")
_TIME = ("-time", "rast", "last", "lpst")  # with a fourth axis
_MM = {
    **dict.fromkeys(("", "mm", "millimeter", "millimeters", "millimetre", "millimetres"), 1.0),
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), 1e3),
    **dict.fromkeys(("cm", "centimeter", "centimeters"), 10.0),
    **dict.fromkeys(("um", "µm", "μm", "micron", "microns", "micrometer", "micrometers"), 1e-3),
}
_COLOURS = ("rgb-color", "rgba-color", "hsv-color", "xyz-color", "3-color", "4-color")
_SEVERAL = "volumes, or layers of a segmentation,"
_SPACE_KINDS = ("domain", "space", "???", "none", "")


def read(file: Path, volume: int | None) -> Stored:
    """An NRRD file.

    Raises:
        MeshError: in one line.
    """
    return _read(file, lambda count: one_of(count, volume, _SEVERAL))


def layers(file: Path) -> tuple[Stored, tuple[Segment, ...]]:
    """All layers of a segmentation, ``(layer, i, j, k)`` in `Stored.values`, and its segments.

    Raises:
        MeshError: in one line; also several volumes that are no segmentation of 3D Slicer.
    """
    segments = _segments(_header(file)[1])
    return _read(file, lambda count: None if segments else one_of(count, None, _SEVERAL)), segments


def _read(file: Path, choose: Callable[[int], int | None]) -> Stored:
    """The volume that is chosen by the number of them; None: all."""
    fields, keys, start = _header(file)
    sizes = [int(size) for size in required(fields, "sizes").split()]
    kind = required(fields, "type").lower()
    if kind not in _CODES:
        raise MeshError(f"its values are of type {kind!r}: choose a number")
    directions = _directions(fields, len(sizes))
    axes = _space_axes(fields, directions, sizes)
    others = [axis for axis in range(len(sizes)) if axis not in axes and sizes[axis] != 1]
    if len(axes) != 3 or len(others) > 1:
        raise MeshError(
            f"its size is {' × '.join(map(str, sizes))}: three axes in space are needed, and one "
            "more at most for a series"
        )
    place = others[0] if others else len(sizes) - 1
    if others and axes[0] < place < axes[2]:
        raise MeshError("the axis of its series lies between those of space: put it first or last")
    volumes = sizes[others[0]] if others else 1
    kinds = fields.get("kinds", "").lower().split()
    if others and len(kinds) == len(sizes) and kinds[place] in _COLOURS:
        raise MeshError("it is a colour image (red, green, blue): a level needs one value a voxel")
    chosen = choose(volumes)
    data, start = _data(file, fields, start)
    dtype = np.dtype(_CODES[kind])
    if dtype.itemsize > 1 and fields["encoding"].lower() not in _TEXT:
        order = fields.get("endian", "").lower()
        if order not in ("little", "big"):
            raise MeshError("it does not say in which order the bytes of its values are (endian)")
        dtype = dtype.newbyteorder("<" if order == "little" else ">")
    shape = (sizes[axes[0]], sizes[axes[1]], sizes[axes[2]])
    first = bool(others) and place < axes[0]
    which: dict[str, Any] = {"volumes": volumes, "volume": chosen, "interleaved": first}
    encoding = fields["encoding"].lower()
    skip = int(fields.get("byteskip", 0))
    if skip < -1 or (skip == -1 and encoding != "raw"):
        raise MeshError(f"its voxels, encoded as {encoding}, cannot begin at byte {skip}")
    if encoding in _TEXT:
        values = text_voxels(data, start + skip, dtype, shape, **which)
    else:
        packed = _PACKED[encoding]
        if skip == -1:  # at the end of the file
            promised = math.prod(sizes) * dtype.itemsize
            start, skip = max(start, data.stat().st_size - promised), 0
        values = voxels(data, start, dtype, shape, packed=packed, skip=skip, **which)
    T, notes = _placed(fields, directions, axes)
    space = fields.get("space", "").strip().lower()
    if not (space in _SIGNS or space in _NO_PATIENT or space.endswith(_TIME)):
        raise MeshError(f"its space is {space!r}: understood are RAS, LAS and LPS")
    signs = _SIGNS.get(space)
    if signs is None or directions is None:
        return Stored(values, T, None, (*notes, GUESS.format("the file")))
    layer = chosen or 0 if first else 0
    names = tuple(
        (one.value, one.name) for one in _segments(keys) if one.layer == layer and one.name
    )
    return Stored(values, np.diag([*signs, 1.0]) @ T, "RAS", notes, names)


def _header(file: Path) -> tuple[dict[str, str], dict[str, str], int]:
    """Fields (lower case, without spaces), keys, and the header's length."""
    with open(file, "rb") as stream:
        text = stream.read(_MOST_HEADER)
    end = re.search(rb"\r?\n\r?\n", text)
    fields: dict[str, str] = {}
    keys: dict[str, str] = {}
    for line in text[: end.start() if end else None].decode("utf-8", "replace").splitlines()[1:]:
        key, colon, value = line.partition(":")
        if line.startswith("#") or not colon:
            continue
        if value.startswith("="):
            keys[key] = value[1:].strip()
        else:
            fields[key.lower().replace(" ", "")] = value.strip()
    if end is None and "datafile" not in fields:
        raise MeshError("it is cut off in its header")
    return fields, keys, end.end() if end else len(text)


def _data(file: Path, fields: dict[str, str], start: int) -> tuple[Path, int]:
    """The file with the voxels, and their offset before ``byteskip``."""
    encoding = required(fields, "encoding").lower()
    if encoding not in (*_PACKED, *_TEXT):
        choices = ", ".join((*_PACKED, *_TEXT))
        raise MeshError(f"its voxels are encoded as {encoding!r}: choose one of {choices}")
    data = file
    if name := fields.get("datafile"):
        data, start = beside(file, name), 0
    if lines := int(fields.get("lineskip", 0)):
        with open(data, "rb") as stream:
            stream.seek(start)
            for _ in range(lines):
                stream.readline(_MOST_HEADER)
            start = stream.tell()
    return data, start


def _directions(fields: dict[str, str], dimension: int) -> list[list[float] | None] | None:
    """A vector for each axis in space, None for the others."""
    if "spacedirections" not in fields:
        return None
    found: list[list[float] | None] = []
    for word in re.findall(r"\([^)]*\)|none", fields["spacedirections"]):
        found.append(None if word == "none" else _vector(word))
    if len(found) != dimension:
        raise MeshError(f"its header has {len(found)} space directions for {dimension} axes")
    return found


def _vector(word: str) -> list[float]:
    numbers = [float(part) for part in word.strip("() ").split(",")]
    if len(numbers) != 3:
        raise MeshError(f"its space has {len(numbers)} dimensions, three are needed")
    return numbers


def _space_axes(
    fields: dict[str, str], directions: list[list[float] | None] | None, sizes: list[int]
) -> list[int]:
    if directions is not None:
        return [axis for axis, vector in enumerate(directions) if vector is not None]
    kinds = fields.get("kinds", "").lower().split()
    if len(kinds) == len(sizes):
        found = [axis for axis, kind in enumerate(kinds) if kind in _SPACE_KINDS]
        if len(found) == 3:
            return found
    return [0, 1, 2][: len(sizes)]  # by default a series is the last axis


def _placed(
    fields: dict[str, str], directions: list[list[float] | None] | None, axes: list[int]
) -> tuple[FloatArray, tuple[str, ...]]:
    """The affine [mm] in the file's own space."""
    T = np.eye(4)
    notes: tuple[str, ...] = ()
    units = re.findall(r'"([^"]*)"', fields.get("spaceunits", fields.get("units", "")))
    if directions is not None:
        T[:3, :3] = np.array([directions[axis] for axis in axes]).T
        if "spaceorigin" in fields:
            T[:3, 3] = _vector(fields["spaceorigin"])
    elif "spacings" in fields:
        spacings = [float(word) for word in fields["spacings"].split()]
        T[:3, :3] = np.diag([spacings[axis] for axis in axes])
    else:
        notes = ("the file does not say how large its voxels are: 1 mm is taken",)
    unit = units[0].lower() if units else ""
    if unit not in _MM:
        raise MeshError(f"its lengths are in {unit!r}: choose one of mm, cm, m, um")
    T[:3] *= _MM[unit]
    return T, notes


def _segments(keys: dict[str, str]) -> tuple[Segment, ...]:
    """The segments of a 3D Slicer segmentation, in their order; () for another file.

    Slicer 4.10 and earlier wrote no label values: each segment is a layer of its own, of ones.
    """
    numbers = {
        int(match[1])
        for key in keys
        if (match := re.fullmatch(r"Segment(\d+)_(LabelValue|ID|Name)", key))
    }
    found = []
    for number in sorted(numbers):
        part = f"Segment{number}"
        value = keys.get(f"{part}_LabelValue")
        layer = int(keys.get(f"{part}_Layer", 0 if value else number))
        colour = [float(word) for word in keys.get(f"{part}_Color", "").split()]
        rgb = [round(255 * min(max(share, 0.0), 1.0)) for share in colour]
        found.append(
            Segment(
                int(value or 1),
                layer,
                printable(keys.get(f"{part}_Name", "")),
                (rgb[0], rgb[1], rgb[2]) if len(rgb) == 3 else None,
            )
        )
    return tuple(found)
