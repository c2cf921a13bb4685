"""Reading and writing GLB: a glTF with its buffer in one binary file."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.content import Content, cut_off
from meshes.errors import MeshError
from meshes.formats.gltf import header_of, read_parts


def read(data: bytes, folder: Path) -> Content:
    """Every placed body, in metres; see `meshes.formats.gltf.read`."""
    return read_parts(*_parts(data), len(data), folder)


def _parts(data: bytes) -> tuple[dict[str, Any], bytes | None]:
    """The JSON and the binary chunk of a GLB."""
    if data[:4] != b"glTF":
        raise MeshError("not GLB: it does not begin with 'glTF'")
    if len(data) >= 8 and (version := int.from_bytes(data[4:8], "little")) != 2:
        raise MeshError(f"glTF {version}: only version 2 is read; export it again")
    total = int.from_bytes(data[8:12], "little")
    if len(data) < 20 or len(data) < total:
        raise cut_off(f"{max(total, 20):,} bytes", f"{len(data):,}")
    place = 12
    chunks: dict[bytes, bytes] = {}
    while place + 8 <= total:
        size, name = int.from_bytes(data[place : place + 4], "little"), data[place + 4 : place + 8]
        if place + 8 + size > len(data):
            raise cut_off(f"a part of {size:,} bytes", f"{len(data) - place - 8:,}")
        chunks.setdefault(name, data[place + 8 : place + 8 + size])
        place += 8 + size
    if b"JSON" not in chunks:
        raise MeshError("a GLB without its JSON part: damaged")
    return header_of(chunks[b"JSON"]), chunks.get(b"BIN\0")


def write(v: NDArray[np.float64], f: NDArray[np.int64], comment: str) -> bytes:
    """The bytes of a GLB file, one body in single precision; see `meshes.formats.Format`."""
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
