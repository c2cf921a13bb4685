"""What a glTF or GLB file may ask for, looked at before a reader obeys it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from trimesh.resolvers import Resolver

from meshes.errors import MeshError

MOST_NODES = 100_000
MOST_ITEMS = 60_000_000  # numbers of corners and vertices, each as often as it is used
COMPRESSED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression")


class Beside(Resolver):
    """Gives a reader files that lie beside (or below) the one it reads, and no others."""

    def __init__(self, folder: Path, limit: int) -> None:
        self._folder = folder.resolve()
        self._left = limit

    def get(self, key: str) -> bytes:
        """The content of a file named relative to the folder.

        Raises:
            MeshError: the name leads elsewhere, there is no such file, or it is too large.
        """
        name = unquote(str(key))
        shown = name[:60]
        # Links are followed first, so that they cannot lead out either.
        file = (self._folder / name).resolve() if "\0" not in name else self._folder
        if "://" in name or not file.is_relative_to(self._folder):
            raise MeshError(f"refers to {shown!r}, which is not beside it: not opened")
        if not file.is_file():
            raise MeshError(f"refers to {shown!r}, which is missing")
        self._left -= file.stat().st_size
        if self._left < 0:
            raise MeshError(f"refers to {shown!r}, too large")
        return file.read_bytes()

    def keys(self) -> list[str]:
        return []

    def write(self, name: str, data: bytes) -> None:
        raise MeshError("nothing is written")

    def namespaced(self, namespace: str) -> Resolver:
        return self


def check(data: bytes, kind: str) -> None:
    """Refuse a "glb" or "gltf" that claims more than a file of its kind should.

    Raises:
        MeshError: compressed geometry, or more vertices and corners than any mesh we load; data
            that is shared, or not there at all, is counted as often as it is claimed.
        Exception: what a damaged header makes the parser raise.
    """
    if kind == "glb":
        if data[:4] != b"glTF":
            raise MeshError("cannot be read as GLB: it does not begin with glTF")
        length = int.from_bytes(data[12:16], "little")
        if 20 + length > len(data):
            raise MeshError("cannot be read as GLB: it is cut off")
        header: dict[str, Any] = json.loads(data[20 : 20 + length])
    else:
        header = json.loads(data)
    if packed := set(COMPRESSED) & set(header.get("extensionsRequired", [])):
        raise MeshError(f"compressed ({', '.join(sorted(packed))}): save it without compression")
    accessors = header.get("accessors", [])
    items = sum(int(a["count"]) for a in accessors if "bufferView" not in a)
    cost = []
    for mesh in header.get("meshes", []):
        used = [
            accessors[index]["count"]
            for primitive in mesh["primitives"]
            for index in (*primitive["attributes"].values(), primitive.get("indices"))
            if index is not None
        ]
        cost.append(sum(map(int, used)))
    if len(header.get("nodes", [])) > MOST_NODES:
        raise MeshError(f"{len(header['nodes']):,} nodes are more than the {MOST_NODES:,} allowed")
    nodes = [node["mesh"] for node in header.get("nodes", []) if "mesh" in node]
    items += sum(cost) + sum(cost[mesh] for mesh in nodes)
    if items > MOST_ITEMS:
        raise MeshError(f"claims {items:,} vertices and corners, more than {MOST_ITEMS:,}")
