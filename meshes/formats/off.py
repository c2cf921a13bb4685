"""Reading and writing OFF: with or without colours and normals, with any line breaks."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from meshes import frames
from meshes.content import Content, cut_off
from meshes.errors import MeshError
from meshes.formats import text
from meshes.polygons import body, unpacked

_KEYWORD = re.compile(rb"\s*(ST)?(C)?(N)?(4)?(n)?OFF(?![A-Za-z])([ \t]*BINARY)?", re.IGNORECASE)
# Two counts alone on a line, or three anywhere: vertices, faces, edges.
_COUNTS = re.compile(rb"\s*(-?\d+)(?:[ \t]+(-?\d+)[ \t]*(?=\n|\Z)|\s+(-?\d+)\s+(-?\d+)(?!\S))")


def read(data: bytes) -> Content:
    """The one body of an OFF file, its polygons cut into triangles.

    Raises:
        MeshError: cut off, damaged or no OFF.
    """
    start = data[:20].lstrip().upper()
    if start.startswith(b"OFF BINARY"):
        raise MeshError("binary OFF is not read: save it as text, or as PLY")
    plain = text.required(data)
    comments = b"\n".join(re.findall(rb"#[^\n]*", plain[:10_000]))
    if b"#" in plain:
        plain = re.sub(rb"#[^\n]*", b"", plain)
    keyword = _KEYWORD.match(plain)
    if keyword is None and not re.match(rb"\s*\d", plain):
        line = text.quoted(plain.lstrip().partition(b"\n")[0])
        raise MeshError(f"does not begin with 'OFF' but with {line}")
    if keyword is not None and (keyword.group(4) or keyword.group(5)):
        raise MeshError("four or more dimensions: only OFF in three is a surface")
    start_of_counts = keyword.end() if keyword else 0
    found = _COUNTS.match(plain, start_of_counts)
    if found is None:
        raise MeshError("the numbers of vertices and faces are missing after 'OFF'")
    vertices, faces = int(found.group(1)), int(found.group(2) or found.group(3))
    if min(vertices, faces) < 0:
        raise MeshError(f"counts {vertices} vertices and {faces} faces")
    if 2 * (3 * vertices + faces) > len(plain):
        raise cut_off(f"{vertices:,} vertices and {faces:,} faces", f"{len(plain):,} bytes")
    rest = plain[found.end() :]
    points, corners, counts, notes = _free(rest, vertices, faces) or _lines(rest, vertices, faces)
    return Content(
        [body(points, (corners, counts))],
        frame=frames.in_text(comments),
        notes=(*notes, *text.open_end(plain)),
    )


Parts = tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64], tuple[str, ...]]


def _free(body: bytes, vertices: int, faces: int) -> Parts | None:
    """Numbers with any line breaks; None if there are more or fewer than the counts need."""
    numbers = text.numbers(body, "among vertices and faces")
    try:
        flat = text.whole(numbers[3 * vertices :], "a face")
        corners, counts, used = unpacked(flat, faces, "faces")
    except MeshError:
        return None
    if 3 * vertices > len(numbers) or used != len(flat):
        return None
    return numbers[: 3 * vertices].reshape(-1, 3), corners, counts, ()


def _lines(body: bytes, vertices: int, faces: int) -> Parts:
    """A vertex or a face on each line, with or without further numbers after it."""
    lines = [line for line in body.split(b"\n") if line.strip()]
    promised = f"{vertices:,} vertices and {faces:,} faces"
    if len(lines) < vertices + faces:
        raise cut_off(promised, f"{len(lines):,} lines")
    points = np.empty((vertices, 3))
    for row, line in enumerate(lines[:vertices]):
        words = line.split(None, 3)
        if len(words) < 3:
            raise MeshError(f"vertex {row} has {len(words)} coordinates: {text.quoted(line)}")
        points[row] = [text.number(word, f"vertex {row}") for word in words[:3]]
    corners: list[int] = []
    counts = np.empty(faces, dtype=np.int64)
    for row, line in enumerate(lines[vertices : vertices + faces]):
        numbers = text.numbers(line, f"face {row}")
        count = int(text.whole(numbers[:1], f"face {row}")[0])
        if not 0 <= count < len(numbers):
            raise cut_off(promised, f"a face {row} of fewer corners than it says")
        corners.extend(text.whole(numbers[1 : count + 1], f"face {row}").tolist())
        counts[row] = count
    more = len(lines) - vertices - faces
    notes = (f"{more:,} lines after the last face are not looked at.",) if more else ()
    return points, np.array(corners, dtype=np.int64), counts, notes


def write(v: NDArray[np.float64], f: NDArray[np.int64], comment: str) -> bytes:
    """The bytes of an OFF file, text, in double precision; see `meshes.formats.Format`."""
    lines = ["OFF", f"# {comment}", f"{len(v)} {len(f)} 0"]
    lines += [f"{x!r} {y!r} {z!r}" for x, y, z in v.tolist()]
    lines += [f"3 {a} {b} {c}" for a, b, c in f.tolist()]
    return "\n".join([*lines, ""]).encode()
