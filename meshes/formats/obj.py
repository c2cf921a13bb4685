"""Reading and writing Wavefront OBJ: positions and faces.

An own reader: trimesh splits positions with several normals or texture coordinates, drops unused
vertices, and takes index 0 for the first vertex. Material files are never opened.
"""

from __future__ import annotations

import re
from array import array

import numpy as np
from numpy.typing import NDArray

from meshes import frames
from meshes.content import Content, cut_off
from meshes.errors import MeshError
from meshes.formats import text
from meshes.polygons import body

# Statements without geometry.
_KNOWN = frozenset(
    b"vt vn vp l p g o s mg mtllib usemtl usemap maplib bevel c_interp d_interp lod"
    b" shadow_obj trace_obj cstype deg bmat step parm trim hole scrv sp end con ctech stech".split()
)
_SURFACES = frozenset(b"surf curv curv2 call csh".split())
# Comments with counts, as MeshLab and `meshes.save` write them above the vertices.
_PROMISE = re.compile(rb"#\s*(vertices|faces)\s*:\s*(\d+)\s*\Z", re.IGNORECASE)


def read(data: bytes) -> Content:
    """The one body of an OBJ file, its polygons cut into triangles.

    Raises:
        MeshError: names the line of what is no OBJ.
    """
    plain = text.required(data)
    if re.match(rb"P(\s+[-+.\deE]+){5}\s+\d+\s", plain):
        raise MeshError("an MNI object file (of CIVET or BrainSuite), not Wavefront OBJ")
    positions = array("d")
    corners = array("q")
    counts: list[int] = []
    notes: list[str] = []
    promised: dict[bytes, int] = {}
    unknown: tuple[int, bytes] | None = None
    vertices = 0
    for number, line in enumerate(_joined(plain).split(b"\n"), 1):
        words = line.split()
        if not words:
            continue
        kind = words[0].lower()
        if kind == b"v":
            if len(words) < 4:
                raise MeshError(f"line {number}: vertex with {len(words) - 1} coordinates")
            try:
                positions.extend(map(float, words[1:4]))
            except ValueError:
                for word in words[1:4]:
                    text.number(word, f"line {number}")
            vertices += 1
        elif kind in (b"f", b"fo"):
            counts.append(_polygon(words, vertices, corners, number))
        elif kind.startswith(b"#"):
            if not vertices and (found := _PROMISE.match(line.strip())):
                promised[found.group(1).lower()] = int(found.group(2))
        elif kind in _SURFACES:
            raise MeshError(f"line {number}: free-form surfaces ({kind.decode()}) are not read")
        elif kind not in _KNOWN and unknown is None:
            unknown = number, line
    if unknown is not None and not counts:
        raise MeshError(f"not Wavefront OBJ: line {unknown[0]} is {text.quoted(unknown[1])}")
    if unknown is not None:
        notes.append(f"Line {unknown[0]} is not understood: {text.quoted(unknown[1])}.")
    there = {b"vertices": vertices, b"faces": len(counts)}
    for what, count in promised.items():
        if there[what] < count:
            raise cut_off(f"{count:,} {what.decode()}", f"{there[what]:,}")
    thin = sum(count < 3 for count in counts)
    if thin:
        notes.append(f"{thin:,} of the faces have fewer than three corners: no surface.")
    points = np.array(positions, dtype=np.float64).reshape(-1, 3)
    polygons = np.array(corners, dtype=np.int64), np.array(counts, dtype=np.int64)
    comments = b"\n".join(x for x in plain[:10_000].split(b"\n") if x.lstrip().startswith(b"#"))
    return Content(
        [body(points, polygons)],
        frame=frames.in_text(comments),
        notes=(*notes, *text.open_end(plain)),
    )


def _joined(plain: bytes) -> bytes:
    """Lines continued by a backslash joined; line numbers stay."""
    if b"\\\n" not in plain:
        return plain
    parts = re.split(rb"((?:[^\n]*\\\n)+)", plain)
    for k in range(1, len(parts), 2):
        head, parts[k] = parts[k], b""
        carried = head.count(b"\\\n")
        line, end, rest = parts[k + 1].partition(b"\n")
        parts[k + 1] = head.replace(b"\\\n", b" ") + line + b"\n" * carried + end + rest
    return b"".join(parts)


def _polygon(words: list[bytes], vertices: int, corners: array[int], line: int) -> int:
    """Append the zero-based corners of one face; return their number.

    Negative indices count back from the latest vertex.
    """
    count = 0
    for word in words[1:]:
        if word.startswith(b"#"):
            break
        try:
            index = int(word.partition(b"/")[0])
            corners.append(index - 1 if index > 0 else vertices + index)
        except (ValueError, OverflowError):
            raise MeshError(f"line {line}: {text.quoted(word)} is no corner of a face") from None
        if index == 0:
            raise MeshError(f"line {line}: a face refers to vertex 0; OBJ counts from 1")
        if index < -vertices:
            raise MeshError(
                f"line {line}: a face refers to vertex {index}, {vertices} are above it"
            )
        count += 1
    return count


def write(v: NDArray[np.float64], f: NDArray[np.int64], comment: str) -> bytes:
    """The bytes of an OBJ file, text, in double precision; see `meshes.formats.Format`."""
    # OBJ has no counts; with these comments, as MeshLab writes them, a truncated file is detected.
    lines = [f"# {comment}", f"# Vertices: {len(v)}", f"# Faces: {len(f)}"]
    lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in v.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (f + 1).tolist()]
    return "\n".join([*lines, ""]).encode()
