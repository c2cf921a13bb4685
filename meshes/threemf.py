"""Reading 3MF: the meshes, components and build items of its model parts.

An own reader on the standard library: a 3MF may place one object a billion times through nested
components, or unpack to any size, and has to be counted before it is built.
"""

from __future__ import annotations

import io
import posixpath
import zipfile
from dataclasses import dataclass, field
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from meshes.errors import MeshError
from meshes.shapes import Arrays

UNPACKED_LIMIT = 400_000_000  # [byte] of all model parts: some three million triangles
MOST_FACES = 20_000_000
DEPTH = 32  # of components in components

# The standard's units in ours; what we have no name for is scaled to millimetres.
_UNITS = {
    "micron": ("mm", 1e-3),
    "millimeter": ("mm", 1.0),
    "centimeter": ("cm", 1.0),
    "inch": ("in", 1.0),
    "foot": ("in", 12.0),
    "meter": ("m", 1.0),
}
Matrix = NDArray[np.float64]
Key = tuple[str, str]  # model part, object id


@dataclass
class _Model:
    """All objects of an archive's parts read so far, and how they are put together."""

    meshes: dict[Key, Arrays] = field(default_factory=dict)
    components: dict[Key, list[tuple[Key, Matrix]]] = field(default_factory=dict)
    build: list[tuple[Key, Matrix]] = field(default_factory=list)
    unit: str = "millimeter"


def read(data: bytes) -> tuple[list[Arrays], str]:
    """Every placed body (vertices in the unit returned, faces), and the unit: m, cm, mm or in.

    Raises:
        MeshError: no model in it, an unknown unit or object, or too much of something.
        Exception: what zipfile and the XML parser raise on damaged content.
    """
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        parts = {
            "/" + info.filename.lstrip("/"): info
            for info in archive.infolist()
            if info.filename.lower().endswith(".model")
        }
        root = next((name for name in parts if name.lower() == "/3d/3dmodel.model"), None)
        if root is None:
            raise MeshError("no 3D/3dmodel.model in it")
        size = sum(info.file_size for info in parts.values())
        if size > UNPACKED_LIMIT:
            raise MeshError(
                f"unpacks to {size / 1e6:.0f} MB, more than the {UNPACKED_LIMIT / 1e6:.0f} allowed"
            )
        model = _Model()
        for name in (root, *(name for name in parts if name != root)):
            # So many and no more, so that the sum above holds: without a number the reader unpacks
            # what there is and only then looks at what the directory says.
            with archive.open(parts[name]) as stream:
                content = stream.read(parts[name].file_size)
            _parse(io.BytesIO(content), name, model, name == root)
    if model.unit not in _UNITS:
        raise MeshError(f"unknown unit {model.unit!r}: 3MF has {', '.join(_UNITS)}")
    unit, scale = _UNITS[model.unit]
    faces = sum(_count(model, key, DEPTH, {}) for key, _ in model.build)
    if faces > MOST_FACES:
        raise MeshError(f"places {faces:,} triangles, more than the {MOST_FACES:,} allowed")
    bodies: list[Arrays] = []
    for key, T in model.build:
        _place(model, key, T, bodies)
    return [(vertices * scale, triangles) for vertices, triangles in bodies], unit


def _parse(stream: io.BytesIO, part: str, model: _Model, root: bool) -> None:
    """Add a part's objects, and of the root part the unit and the build, to the model."""
    here: Key = (part, "")
    vertices: list[tuple[str, str, str]] = []
    triangles: list[tuple[str, str, str]] = []
    for event, element in ElementTree.iterparse(stream, events=("start", "end")):
        name = element.tag.rpartition("}")[2]
        if event == "start":
            if name == "model" and root:
                model.unit = element.get("unit", "millimeter")
            elif name == "object":
                here = (part, element.attrib["id"])
                vertices, triangles = [], []
            continue
        attributes = element.attrib
        if name == "vertex":
            vertices.append((attributes["x"], attributes["y"], attributes["z"]))
        elif name == "triangle":
            triangles.append((attributes["v1"], attributes["v2"], attributes["v3"]))
        elif name == "component":
            model.components.setdefault(here, []).append(_reference(attributes, part))
        elif name == "item" and root:
            model.build.append(_reference(attributes, part))
        elif name == "object" and triangles:
            model.meshes[here] = (
                np.array(vertices, dtype=np.float64).reshape(-1, 3),
                np.array(triangles, dtype=np.int64).reshape(-1, 3),
            )
        element.clear()


def _reference(attributes: dict[str, str], part: str) -> tuple[Key, Matrix]:
    """The object that a component or item names, maybe in another part, and its transform."""
    path = next((v for k, v in attributes.items() if k.rpartition("}")[2] == "path"), part)
    T = np.eye(4)
    if "transform" in attributes:
        # Row vectors times a 4 × 3 matrix, row by row.
        numbers = np.array(attributes["transform"].split(), dtype=np.float64)
        T[:3] = numbers.reshape(4, 3).T
    return (posixpath.normpath("/" + path.lstrip("/")), attributes["objectid"]), T


def _count(model: _Model, key: Key, depth: int, known: dict[Key, int]) -> int:
    """Triangles that placing an object once makes, without placing it."""
    if key not in known:
        if depth == 0:
            raise MeshError(f"components nested deeper than {DEPTH}, or in a circle")
        if key not in model.meshes and key not in model.components:
            raise MeshError(f"object {key[1][:40]!r} is referred to, but not in the file")
        inner = sum(
            _count(model, part, depth - 1, known) for part, _ in model.components.get(key, [])
        )
        known[key] = inner + (len(model.meshes[key][1]) if key in model.meshes else 0)
        # An object with nothing in it, placed often, costs time as well.
        known[key] = max(known[key], 1)
    return known[key]


def _place(model: _Model, key: Key, T: Matrix, bodies: list[Arrays]) -> None:
    if key in model.meshes:
        vertices, faces = model.meshes[key]
        if not np.array_equal(T, np.eye(4)):  # moving by nothing would still round
            vertices = vertices @ T[:3, :3].T + T[:3, 3]
            if np.linalg.det(T[:3, :3]) < 0:  # a mirror turns the winding inside out
                faces = faces[:, ::-1]
        bodies.append((vertices, faces))
    for part, T_key_part in model.components.get(key, []):
        _place(model, part, T @ T_key_part, bodies)
