"""Colour tables: the names and colours of a label map's numbers, in a text file.

Read are the forms of 3D Slicer (``.ctbl``) and FreeSurfer (``FreeSurferColorLUT.txt``), a line
``number name red green blue alpha``, and of ITK-SNAP (label descriptions), a line
``number red green blue alpha visible mesh "name"``. Lines that begin with ``#`` are comments.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from meshes.errors import MeshError
from meshes.volume.grid import printable

Colour = tuple[int, int, int]
"""Red, green, blue, 0 to 255."""

ENDINGS = (".ctbl", ".txt", ".label", ".lut")
_LARGEST_FILE = 16 << 20  # [byte]
_SLICER = re.compile(r"(-?\d+)\s+(\S.*?)\s+(\d+)\s+(\d+)\s+(\d+)(?:\s+(\d+))?\s*")
_SNAP = re.compile(
    r'(\d+)\s+(\d+)\s+(\d+)\s+(\d+)\s+([\d.]+)(?:\s+([01]))?(?:\s+([01]))?\s+"([^"]*)"\s*'
)


@dataclass(frozen=True)
class Named:
    """A row of a colour table."""

    name: str
    colour: Colour


def read(path: Path) -> Mapping[int, Named]:
    """The rows of a colour table by their numbers.

    Raises:
        MeshError: not there, not readable, or no colour table; in one line.
    """
    try:
        if path.stat().st_size > _LARGEST_FILE:
            raise MeshError(f"{path}: too large for a colour table")
        text = path.read_bytes().decode("utf-8-sig", "replace")
    except OSError as error:
        reason = error.strerror or error
        raise MeshError(f"{path}: the colour table cannot be read ({reason})") from None
    rows: dict[int, Named] = {}
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        row = _row(line.strip())
        if row is None:
            raise MeshError(
                f"{path}: line {number}, {printable(line.strip())[:60]!r}, is not a row of a "
                "colour table: number name red green blue alpha (3D Slicer, FreeSurfer), or "
                'number red green blue alpha visible mesh "name" (ITK-SNAP)'
            )
        label, named = row
        if label in rows:
            raise MeshError(f"{path}: line {number}: the number {label} has a row already")
        rows[label] = named
    if not rows:
        raise MeshError(f"{path}: a colour table without rows")
    return rows


def _row(line: str) -> tuple[int, Named] | None:
    if match := _SNAP.fullmatch(line):
        number, red, green, blue, *_, name = match.groups()
    elif match := _SLICER.fullmatch(line):
        number, name, red, green, blue, _alpha = match.groups()
        if len(name) > 1 and name[0] == name[-1] == '"':
            name = name[1:-1]
    else:
        return None
    colour = int(red), int(green), int(blue)
    if max(colour) > 255:
        return None
    return int(number), Named(printable(name).strip(), colour)


def beside(path: Path) -> Path | None:
    """The colour table of a label map's name, beside it: ``head.nii.gz`` has ``head.ctbl``.

    For a folder, the only colour table in it.
    """
    if path.is_dir():
        found = sorted(one for one in path.iterdir() if one.suffix.lower() in ENDINGS)
        return found[0] if len(found) == 1 else None
    stem = path.name
    for ending in (".gz", ".nii", ".img", ".hdr", ".mgz", ".mgh", ".nrrd", ".nhdr", ".mha", ".mhd"):
        if stem.lower().endswith(ending):
            stem = stem[: -len(ending)]
    for ending in ENDINGS:
        if (table := path.with_name(stem + ending)).is_file():
            return table
    return None
