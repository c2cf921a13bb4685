"""Summary of a recording for a list of files, without decoding its tables."""

from __future__ import annotations

import contextlib
import json
import os
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path

from app.recording.format import LAST, LENGTH, MAGIC, MAGICS, MAX_BLOCK, MAX_HEADER, PART
from app.recording.read import blocks


@dataclass(frozen=True)
class Outline:
    """Summary of a file, not validated.

    Attributes:
        rows: number of rows.
        ended: whether the file is complete.
        meshes: the files of its scenes' meshes and structures, as their options name them.
    """

    rows: int
    ended: bool
    meshes: frozenset[str]


def outline(path: Path) -> Outline:
    """The outline of a recording of any version; an empty one if the file is not a recording."""
    try:
        with path.open("rb") as file:
            if file.read(len(MAGIC)) not in MAGICS:
                return _archived(path)
            rows, ended, found = 0, False, set()
            size = os.fstat(file.fileno()).st_size
            for block in blocks(file, size):
                if block.kind == PART and block.at + block.size <= size:
                    rows += block.rows
                    file.seek(block.at)
                    found |= _named(_about(file.read(block.size)))
                ended = ended or block.kind == LAST
            return Outline(rows, ended, frozenset(found))
    except (OSError, ValueError, LookupError, TypeError, zipfile.BadZipFile):
        return Outline(0, False, frozenset())


def _about(content: bytes) -> object:
    """The JSON of a part; the tables behind it are not unpacked."""
    with contextlib.suppress(zlib.error):
        unpacking = zlib.decompressobj()
        (length,) = LENGTH.unpack(unpacking.decompress(content, LENGTH.size))
        rest = unpacking.unconsumed_tail
        return json.loads(unpacking.decompress(rest, min(length, MAX_BLOCK)))
    return None


def _named(about: object) -> set[str]:
    places = about.get("places", []) if isinstance(about, dict) else []
    options = [place["options"] for place in places]
    further = {str(one["file"]) for own in options for one in own.get("structures", ())}
    return {str(own["mesh"]) for own in options} | further


def _archived(path: Path) -> Outline:
    with zipfile.ZipFile(path) as archive:
        info = archive.getinfo("header.json")
        if info.file_size > MAX_HEADER:
            return Outline(0, False, frozenset())
        header = json.loads(archive.read(info))
    return Outline(sum(map(int, header["chunks"])), True, frozenset(_named(header)))
