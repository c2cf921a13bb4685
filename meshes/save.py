"""Writing mesh files in the highest precision of their format."""

from __future__ import annotations

import json
import os
import struct
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from meshes import frames
from meshes.atomic import replacing
from meshes.checks.health import FloatArray, IntArray, checked_mesh
from meshes.errors import MeshError
from meshes.units import UNITS

WRITABLE = ("stl", "obj", "ply", "off", "glb")


def save(
    path: str | os.PathLike[str],
    vertices: ArrayLike,
    faces: ArrayLike,
    *,
    unit: str = "mm",
    frame: str | None = None,
    overwrite: bool = False,
) -> None:
    """Write vertices ``(n, 3)`` [m] and faces ``(m, 3)`` to a file in a unit of `meshes.UNITS`.

    The suffix chooses the format. PLY, OBJ and OFF hold double precision; STL and GLB single, and
    STL corners instead of vertices. GLB is always in metres, as its standard says. ``frame``, the
    patient frame that the vertices are in ("RAS", "LPS", or None where it is not known), is written
    as 3D Slicer reads it (`SPACE=RAS`); nothing is transformed. The file is put in place when it is
    complete.

    Raises:
        MeshError: unknown format, unit or frame, an existing file unless ``overwrite``, a folder
            that cannot be written to, or arrays that are no mesh.
    """
    file = Path(path)
    kind = file.suffix[1:].lower()
    check_writable(file, overwrite)
    if unit not in UNITS:
        raise MeshError(f"unknown unit {unit!r}: choose one of {', '.join(UNITS)}")
    frame = frames.chosen(frame)
    v, f = checked_mesh(vertices, faces)
    comment = "vf-sandbox" + (f" {frames.tag(frame)}" if frame else "")
    content = _WRITERS[kind](v / (1.0 if kind == "glb" else UNITS[unit]), f, comment)
    try:
        with replacing(file) as stream:
            stream.write(content)
    except OSError as error:
        raise MeshError(f"{file}: cannot be written ({error.strerror or error})") from None


def check_writable(path: str | os.PathLike[str], overwrite: bool = False) -> None:
    """Raise the `MeshError` that `save` would raise for this path, before long work."""
    file = Path(path)
    if file.suffix[1:].lower() not in WRITABLE:
        choices = ", ".join(f".{kind}" for kind in WRITABLE)
        raise MeshError(f"{file}: unknown format {file.suffix!r}; choose one of {choices}")
    if not file.parent.is_dir():
        raise MeshError(f"{file}: there is no folder {file.parent}")
    if file.is_dir() or (file.exists() and not overwrite):
        raise MeshError(f"{file}: exists already; choose another name, or say to overwrite it")


def _stl(v: FloatArray, f: IntArray, comment: str) -> bytes:
    corners = v[f]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    rows = np.zeros(
        len(f), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]
    )
    rows["normal"] = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
    rows["corners"] = corners
    return comment.encode().ljust(80) + len(f).to_bytes(4, "little") + rows.tobytes()


def _ply(v: FloatArray, f: IntArray, comment: str) -> bytes:
    header = (
        f"ply\nformat binary_little_endian 1.0\ncomment {comment}\n"
        f"element vertex {len(v)}\nproperty double x\nproperty double y\nproperty double z\n"
        f"element face {len(f)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = np.empty(len(f), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    rows["count"], rows["corners"] = 3, f
    return header.encode() + v.astype("<f8").tobytes() + rows.tobytes()


def _obj(v: FloatArray, f: IntArray, comment: str) -> bytes:
    # OBJ has no counts; with these comments, as MeshLab writes them, a truncated file is detected.
    lines = [f"# {comment}", f"# Vertices: {len(v)}", f"# Faces: {len(f)}"]
    lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in v.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (f + 1).tolist()]
    return "\n".join([*lines, ""]).encode()


def _off(v: FloatArray, f: IntArray, comment: str) -> bytes:
    lines = ["OFF", f"# {comment}", f"{len(v)} {len(f)} 0"]
    lines += [f"{x!r} {y!r} {z!r}" for x, y, z in v.tolist()]
    lines += [f"3 {a} {b} {c}" for a, b, c in f.tolist()]
    return "\n".join([*lines, ""]).encode()


def _glb(v: FloatArray, f: IntArray, comment: str) -> bytes:
    corners, points = f.astype("<u4").tobytes(), v.astype("<f4")
    low, high = points.min(axis=0, initial=np.inf), points.max(axis=0, initial=-np.inf)
    views = [
        {"buffer": 0, "byteLength": points.nbytes, "target": 34962},
        {"buffer": 0, "byteOffset": points.nbytes, "byteLength": len(corners), "target": 34963},
    ]
    accessors = [
        {"bufferView": 0, "componentType": 5126, "count": len(v), "type": "VEC3",
         "min": low.tolist(), "max": high.tolist()},
        {"bufferView": 1, "componentType": 5125, "count": f.size, "type": "SCALAR"},
    ]  # fmt: skip
    header = json.dumps(
        {
            "asset": {"version": "2.0", "generator": comment},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
            "buffers": [{"byteLength": points.nbytes + len(corners)}],
            "bufferViews": views,
            "accessors": accessors,
        }
    ).encode()
    header += b" " * (-len(header) % 4)
    body = points.tobytes() + corners
    chunks = struct.pack("<2I", len(header), 0x4E4F534A) + header
    chunks += struct.pack("<2I", len(body), 0x004E4942) + body
    return b"glTF" + struct.pack("<2I", 2, 12 + len(chunks)) + chunks


_WRITERS = {"stl": _stl, "ply": _ply, "obj": _obj, "off": _off, "glb": _glb}
