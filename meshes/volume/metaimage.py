"""MetaImage volumes of ITK: .mha, and .mhd with a data file beside it.

An own reader: SimpleITK, which reads it, is a large dependency.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np

from meshes.errors import MeshError
from meshes.volume.grid import GUESS, LPS_TO_RAS, Stored, one_of
from meshes.volume.payload import beside, required, text_voxels, voxels

_MOST_HEADER = 1 << 20  # [bytes]
_TYPES = {
    "CHAR": "i1",
    "UCHAR": "u1",
    "SHORT": "i2",
    "USHORT": "u2",
    "INT": "i4",
    "UINT": "u4",
    "LONG": "i4",
    "ULONG": "u4",
    "LONG_LONG": "i8",
    "ULONG_LONG": "u8",
    "FLOAT": "f4",
    "DOUBLE": "f8",
}
_DIRECTIONS = ("transformmatrix", "rotation", "orientation")
_ORIGINS = ("offset", "position", "origin")


def is_metaimage(start: bytes) -> bool:
    """Whether the first bytes are those of a MetaImage's header."""
    return bool(re.match(rb"\s*(ObjectType|Comment|NDims|ObjectSubType)\s*=", start))


def read(file: Path, volume: int | None) -> Stored:
    """A MetaImage; its coordinates are LPS and become RAS.

    Raises:
        MeshError: in one line.
    """
    fields, start = _header(file)
    sizes = [int(word) for word in required(fields, "dimsize").split()]
    dimension = int(required(fields, "ndims"))
    if len(sizes) != dimension or dimension not in (3, 4):
        raise MeshError(
            f"its size is {' × '.join(map(str, sizes))} in {dimension} dimensions: "
            "three are needed, or four for a series"
        )
    shape = (sizes[0], sizes[1], sizes[2])
    series = sizes[3] if dimension == 4 else 1
    channels = int(fields.get("elementnumberofchannels", "1"))
    if channels in (3, 4) and fields["elementtype"].upper().startswith("MET_UCHAR"):
        raise MeshError("it is a colour image (red, green, blue): a level needs one value a voxel")
    if channels > 1 and series > 1:
        raise MeshError(f"it is a series of {series} volumes with {channels} values a voxel")
    element = required(fields, "elementtype").upper().removeprefix("MET_").removesuffix("_ARRAY")
    if element not in _TYPES:
        raise MeshError(f"its values are of type {element!r}: choose one of {', '.join(_TYPES)}")
    order = ">" if _yes(fields, "binarydatabyteordermsb", "elementbyteordermsb") else "<"
    dtype = np.dtype(order + _TYPES[element])
    count = max(series, channels)
    chosen = one_of(count, volume, "volumes" if channels == 1 else "values a voxel")
    data, start = _data(file, fields, start)
    skip = int(fields.get("headersize", "0"))
    packed = "gzip" if _yes(fields, "compresseddata") else ""
    promised = math.prod(sizes) * channels * dtype.itemsize
    which: dict[str, Any] = {"volumes": count, "volume": chosen, "interleaved": channels > 1}
    if skip == -1:
        start = max(start, data.stat().st_size - promised)
    else:
        start += max(skip, 0)
    if fields.get("binarydata", "true").lower() in ("false", "0"):
        values = text_voxels(data, start, dtype, shape, **which)
    else:
        values = voxels(data, start, dtype, shape, packed=packed, **which)
    T = np.eye(4)
    directions = next((fields[name] for name in _DIRECTIONS if name in fields), "")
    if directions:
        axes = np.array(_numbers(directions, dimension * dimension)).reshape(dimension, dimension)
        T[:3, :3] = axes[:3, :3].T  # stored axis by axis
    spacing = fields.get("elementspacing", fields.get("elementsize", ""))
    notes = () if spacing else ("the file does not say how large its voxels are: 1 mm is taken",)
    if spacing:
        T[:3, :3] *= _numbers(spacing, dimension)[:3]
    if origin := next((fields[name] for name in _ORIGINS if name in fields), ""):
        T[:3, 3] = _numbers(origin, dimension)[:3]
    # RAI: the axes run from right, anterior and inferior, as in LPS.
    known = directions or fields.get("anatomicalorientation", "").upper() == "RAI"
    if not known:
        notes = (*notes, GUESS.format("the file"))
    return Stored(values, LPS_TO_RAS @ T, "RAS" if known else None, notes)


def _header(file: Path) -> tuple[dict[str, str], int]:
    """Fields by name in lower case, and the header's length."""
    with open(file, "rb") as stream:
        text = stream.read(_MOST_HEADER)
    last = re.search(rb"^[ \t]*ElementDataFile[ \t]*=[^\n]*(\n|\Z)", text, re.M | re.I)
    if last is None:
        raise MeshError("it is cut off in its header: ElementDataFile is missing")
    lines = text[: last.end()].decode("utf-8", "replace").splitlines()
    parts = (line.partition("=") for line in lines)
    return {name.strip().lower(): value.strip() for name, _sign, value in parts}, last.end()


def _data(file: Path, fields: dict[str, str], start: int) -> tuple[Path, int]:
    name = fields["elementdatafile"]
    if name.upper() == "LOCAL":
        return file, start
    return beside(file, name), 0


def _yes(fields: dict[str, str], *names: str) -> bool:
    return any(fields.get(name, "").lower() in ("true", "1") for name in names)


def _numbers(text: str, count: int) -> list[float]:
    found = [float(word) for word in text.split()]
    if len(found) != count:
        raise MeshError(f"its header has {len(found)} numbers where {count} belong: {text[:80]!r}")
    return found
