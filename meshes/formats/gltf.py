"""Reading glTF 2.0: the triangles of the default scene.

An own reader: trimesh does not scale normalized integers, and ignores triangle fans, sparse
accessors and required extensions. A file with a feature that is not supported is refused by the
name of that feature. Textures are never opened.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from urllib.parse import unquote, unquote_to_bytes

import numpy as np
from numpy.typing import NDArray

from meshes import frames
from meshes.content import (
    PLACED,
    SIZE_LIMIT,
    Arrays,
    Content,
    allowed_placed,
    check_placed,
    checked,
    cut_off,
    moved,
)
from meshes.errors import MeshError
from meshes.packed import base64_piece
from meshes.polygons import strips

MOST_NODES = 100_000
COMPRESSED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression")
# Required extensions that do not move a vertex: materials, lights, metadata.
HARMLESS = (
    "KHR_mesh_quantization", "KHR_materials_", "KHR_texture_", "KHR_lights_", "KHR_xmp",
    "EXT_texture_", "EXT_lights_", "EXT_mesh_features", "EXT_structural_metadata", "MSFT_texture_",
    "KHR_node_visibility", "KHR_technique", "KHR_animation_", "EXT_materials_",
)  # fmt: skip
PLACES_MORE = ("EXT_mesh_gpu_instancing",)  # refused also where it is not required

_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_POINTS_AND_LINES, _TRIANGLES, _STRIP, _FAN = (0, 1, 2, 3), 4, 5, 6


def read(data: bytes, folder: Path) -> Content:
    """Every placed body of a glTF, in metres.

    Buffers in other files are opened beside or below ``folder``, and nowhere else.

    Raises:
        MeshError: cut off, damaged, with a feature that is not supported, or too many nodes,
            vertices or triangles, each counted as often as it is placed.
    """
    return read_parts(header_of(data), None, len(data), folder)


def read_parts(header: dict[str, Any], chunk: bytes | None, size: int, folder: Path) -> Content:
    """The same of the parsed header and the binary part of a file of ``size`` bytes."""
    try:
        return _content(header, chunk, size, folder)
    except MeshError:
        raise
    except KeyError as error:
        raise MeshError(f"not as glTF 2.0 says: {str(error)[:60]} is missing") from None
    except (TypeError, IndexError, AttributeError, ValueError) as error:
        raise MeshError("not as glTF 2.0 says: a value of another kind, damaged") from error


def header_of(text: bytes) -> dict[str, Any]:
    """The parsed JSON; raises `MeshError`."""
    try:
        header = json.loads(text.decode("utf-8-sig"))
    except RecursionError:
        raise MeshError("its JSON is nested too deeply: damaged") from None
    except json.JSONDecodeError as error:
        where = f"line {error.lineno}, column {error.colno}"
        raise MeshError(f"its JSON cannot be read ({where}): cut off or damaged") from None
    except ValueError:  # not UTF-8, or a number of thousands of digits
        raise MeshError("its JSON cannot be read: damaged") from None
    if not isinstance(header, dict):
        raise MeshError("its JSON is not an object: no glTF")
    return header


def _content(header: dict[str, Any], chunk: bytes | None, size: int, folder: Path) -> Content:
    version = str(header.get("asset", {}).get("version", ""))
    if not version.startswith("2."):
        said = f"glTF {version}" if version else "it does not say its version"
        raise MeshError(f"{said}: only version 2 is read; export it again")
    _check_extensions(header)
    file = _File(header, chunk, size, folder)
    placed, notes = _placed(header)
    meshes = header.get("meshes", [])
    if not meshes:
        raise MeshError("no meshes in it")
    if not placed:
        raise MeshError("its scene places no mesh")
    costs = [[file.cost(primitive) for primitive in mesh["primitives"]] for mesh in meshes]
    totals = [(len(cost), sum(a for a, _ in cost), sum(b for _, b in cost)) for cost in costs]
    parts, triangles, items = (sum(totals[mesh][k] for mesh, _T in placed) for k in range(3))
    # A triangle takes at least two bytes: one more index of a strip.
    check_placed(triangles, file.size // 2)
    if items > 4 * allowed_placed(file.size // 2):
        raise MeshError(f"claims {items:,} vertices and corners, more than is allowed")
    if parts > MOST_NODES:
        raise MeshError(f"places {parts:,} parts, more than the {MOST_NODES:,} allowed")
    known: dict[int, list[Arrays]] = {}
    bodies: list[Arrays] = []
    for mesh, T in placed:
        if mesh not in known:
            known[mesh] = [file.body(primitive) for primitive in meshes[mesh]["primitives"]]
        bodies += [moved(vertices, faces, T) for vertices, faces in known[mesh]]
    if file.left_out:
        notes.append(f"{file.left_out:,} of its parts are points or lines: no surface.")
    comment = header["asset"].get("generator", "")
    return Content(bodies, "m", frames.in_text(str(comment)), tuple(notes))


def _check_extensions(header: dict[str, Any]) -> None:
    required = [str(name)[:60] for name in header.get("extensionsRequired", [])]
    packed = [name for name in required if name in COMPRESSED]
    if packed:
        raise MeshError(f"compressed ({', '.join(packed)}): save it without compression")
    strange = [name for name in required if not name.startswith(HARMLESS)]
    strange += [name for name in header.get("extensionsUsed", []) if name in PLACES_MORE]
    if strange:
        raise MeshError(f"needs an extension that is not read: {', '.join(strange)}")


def _placed(header: dict[str, Any]) -> tuple[list[tuple[int, NDArray[np.float64]]], list[str]]:
    """Each placed mesh with its ``T_scene_node``, and notes."""
    nodes, notes = header.get("nodes", []), []
    if len(nodes) > MOST_NODES:
        raise MeshError(f"{len(nodes):,} nodes are more than the {MOST_NODES:,} allowed")
    if header.get("scenes"):
        scene = header["scenes"][_index(header.get("scene", 0), header["scenes"], "scene")]
        waiting = [(root, np.eye(4)) for root in scene.get("nodes", [])]
    else:
        children = {child for node in nodes for child in node.get("children", [])}
        waiting = [(k, np.eye(4)) for k in range(len(nodes)) if k not in children]
        if not nodes:
            notes.append("It has no scene: every mesh is taken as it stands.")
            return [(k, np.eye(4)) for k in range(len(header.get("meshes", [])))], notes
    placed, seen = [], set()
    while waiting:
        index, T_scene_parent = waiting.pop()
        index = _index(index, nodes, "node")
        if index in seen:
            raise MeshError(f"node {index} is placed twice, or in a circle: not glTF")
        seen.add(index)
        node = nodes[index]
        T = T_scene_parent @ _transform(node)
        waiting += [(child, T) for child in reversed(node.get("children", []))]
        if "mesh" not in node:
            continue
        if "skin" in node:
            raise MeshError("its surface is moved by bones (a skin): apply them, then export it")
        mesh = _index(node["mesh"], header.get("meshes", []), "mesh")
        weights = node.get("weights", header["meshes"][mesh].get("weights", []))
        if any(weights):
            raise MeshError("its surface is morphed (weights): apply that, then export it")
        placed.append((mesh, T))
    hidden = sum("mesh" in node for node in nodes) - len(placed)
    if hidden:
        notes.append(f"{hidden:,} of its meshes are in no scene that it shows: left out.")
    return placed, notes


def _transform(node: dict[str, Any]) -> NDArray[np.float64]:
    """``T_parent_node``, from a matrix (column by column) or from place, turn and scale."""
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    T = np.eye(4)
    T[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    x, y, z, w = (float(part) for part in node.get("rotation", (0.0, 0.0, 0.0, 1.0)))
    length = x * x + y * y + z * z + w * w
    if not length > 0.0:
        raise MeshError("a node turns by a quaternion of no length: damaged")
    s = 2.0 / length
    R = [
        [1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
        [s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w)],
        [s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y)],
    ]
    T[:3, :3] = np.array(R) * np.array(node.get("scale", (1.0, 1.0, 1.0)), dtype=np.float64)
    return T


def _index(value: Any, among: list[Any], what: str) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < len(among):
        raise MeshError(f"refers to {what} {str(value)[:20]}, of {len(among)}")
    return value


def _count(value: Any, what: str) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise MeshError(f"{what} of {str(value)[:20]}: damaged")
    return value


class _File:
    """Buffers and the arrays in them; sizes are checked before arrays are allocated."""

    def __init__(
        self, header: dict[str, Any], chunk: bytes | None, size: int, folder: Path
    ) -> None:
        self._header = header
        self._chunk = chunk
        self._folder = folder.resolve()
        self._buffers: dict[int, bytes] = {}
        self.size = size
        self.left_out = 0

    def cost(self, primitive: dict[str, Any]) -> tuple[int, int]:
        """Numbers of triangles and of values of a primitive, from its counts alone."""
        accessors = self._header.get("accessors", [])
        mode = primitive.get("mode", _TRIANGLES)
        if mode in _POINTS_AND_LINES or "POSITION" not in primitive["attributes"]:
            return 0, 1
        used = [primitive["attributes"]["POSITION"]]
        if "indices" in primitive:
            used.append(primitive["indices"])
        counts = [
            _count(accessors[_index(k, accessors, "accessor")]["count"], "a count") for k in used
        ]
        corners = counts[-1]
        return corners // 3 if mode == _TRIANGLES else corners, sum(counts)

    def body(self, primitive: dict[str, Any]) -> Arrays:
        """Vertices and triangles of a primitive, in its node's frame."""
        mode = primitive.get("mode", _TRIANGLES)
        none = np.empty((0, 3)), np.empty((0, 3), dtype=np.int64)
        if any(name in primitive.get("extensions", {}) for name in COMPRESSED):
            fallback = primitive["attributes"].get("POSITION")
            accessors = self._header.get("accessors", [])
            if fallback is None or "bufferView" not in accessors[fallback]:
                raise MeshError("compressed: save it without compression")
        if mode in _POINTS_AND_LINES or "POSITION" not in primitive["attributes"]:
            self.left_out += 1
            return none
        points = self._array(primitive["attributes"]["POSITION"], "VEC3")
        if "indices" in primitive:
            corners = self._array(primitive["indices"], "SCALAR").astype(np.int64).ravel()
        else:
            corners = np.arange(len(points), dtype=np.int64)
        return checked(points.astype(np.float64), self._faces(corners, mode))

    @staticmethod
    def _faces(corners: NDArray[np.int64], mode: Any) -> NDArray[np.int64]:
        if mode == _TRIANGLES:
            if len(corners) % 3:
                raise MeshError(f"{len(corners):,} corners are no whole triangles: damaged")
            return corners.reshape(-1, 3)
        if mode == _STRIP:
            return strips(corners)
        if mode == _FAN:
            first = np.broadcast_to(corners[:1], (max(len(corners) - 2, 0),))
            return np.column_stack([first, corners[1:-1], corners[2:]])
        raise MeshError(f"a primitive of unknown mode {str(mode)[:20]}")

    def _array(self, index: Any, wanted: str) -> NDArray[np.generic]:
        """The values of an accessor, ``(count, width)``; normalized integers are scaled."""
        accessors = self._header.get("accessors", [])
        accessor = accessors[_index(index, accessors, "accessor")]
        if accessor["type"] != wanted:
            raise MeshError(f"an accessor of type {str(accessor['type'])[:20]!r}, not {wanted}")
        kind = self._kind(accessor["componentType"])
        count = _count(accessor["count"], "a count")
        width = _WIDTHS[wanted]
        if "bufferView" in accessor:
            values = self._view(accessor["bufferView"], accessor, kind, count, width)
        elif "sparse" in accessor:
            if count > PLACED:
                raise MeshError(f"claims {count:,} vertices without data, more than is allowed")
            values = np.zeros((count, width), dtype=kind)
        else:
            raise MeshError("an accessor without data (compressed?): save it without compression")
        if "sparse" in accessor:
            values = self._changed(values, accessor["sparse"])
        if accessor.get("normalized") and kind.kind in "iu":
            most = np.iinfo(kind).max
            values = np.maximum(values.astype(np.float64) / most, -1.0)
        return values

    def _changed(self, values: NDArray[Any], sparse: dict[str, Any]) -> NDArray[np.generic]:
        """A copy with the rows of a sparse accessor replaced."""
        count, width = values.shape
        rows = _count(sparse["count"], "a count")
        where, what = sparse["indices"], sparse["values"]
        index = self._view(
            where["bufferView"], where, self._kind(where["componentType"]), rows, 1
        ).ravel()
        if len(index) and int(index.max()) >= count:
            raise MeshError(f"a sparse accessor changes row {int(index.max())}, of {count}")
        values = values.copy()
        values[index.astype(np.int64)] = self._view(
            what["bufferView"], what, values.dtype, rows, width
        )
        return values

    @staticmethod
    def _kind(code: Any) -> np.dtype[Any]:
        if code not in _COMPONENTS:
            raise MeshError(f"numbers of unknown kind {str(code)[:20]}")
        return np.dtype(_COMPONENTS[code])

    def _view(
        self, index: Any, part: dict[str, Any], kind: np.dtype[Any], count: int, width: int
    ) -> NDArray[np.generic]:
        """``count`` rows of ``width`` numbers of a buffer view, not copied."""
        views = self._header.get("bufferViews", [])
        view = views[_index(index, views, "bufferView")]
        if any(name in view.get("extensions", {}) for name in COMPRESSED):
            raise MeshError("compressed: save it without compression")
        buffer = self._buffer(view["buffer"])
        start = _count(view.get("byteOffset", 0), "an offset")
        length = _count(view["byteLength"], "a length")
        if start + length > len(buffer):
            raise cut_off(f"a view of {start + length:,} bytes", f"{len(buffer):,}")
        row = width * kind.itemsize
        step = _count(view.get("byteStride", row), "a stride") or row
        offset = _count(part.get("byteOffset", 0), "an offset")
        if count and (step < row or offset + (count - 1) * step + row > length):
            raise cut_off(f"{count:,} rows of {row} bytes", f"{max(length - offset, 0):,} bytes")
        shape, strides = (count, width), (step, kind.itemsize)
        return np.ndarray(shape, kind, buffer, start + offset if count else 0, strides)

    def _buffer(self, index: Any) -> bytes:
        buffers = self._header.get("buffers", [])
        index = _index(index, buffers, "buffer")
        if index not in self._buffers:
            buffer = buffers[index]
            uri = buffer.get("uri")
            if uri is None:
                if self._chunk is None or index != 0:
                    raise MeshError("a buffer without data (compressed?): save it uncompressed")
                content = self._chunk
            else:
                content = self._from(str(uri))
            length = _count(buffer["byteLength"], "a length")
            if len(content) < length:
                raise cut_off(f"a buffer of {length:,} bytes", f"{len(content):,}")
            self._buffers[index] = content
        return self._buffers[index]

    def _from(self, uri: str) -> bytes:
        """The bytes that a data URI holds, or of a file in or below the mesh file's folder."""
        if uri.startswith("data:"):
            kind, _, body = uri.partition(",")
            content = unquote_to_bytes(body)
            return base64_piece(content) if kind.endswith(";base64") else content
        name = unquote(uri)
        shown = name[:60]
        # Symbolic links are resolved before the check.
        file = (self._folder / name).resolve() if "\0" not in name else self._folder
        if "://" in name or not file.is_relative_to(self._folder):
            raise MeshError(f"refers to {shown!r}, which is not beside it: not opened")
        if not file.is_file():
            raise MeshError(f"refers to {shown!r}, which is missing")
        self.size += file.stat().st_size
        if self.size > SIZE_LIMIT:
            raise MeshError(f"refers to {shown!r}, too large")
        return file.read_bytes()
