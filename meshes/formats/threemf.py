"""Reading 3MF: the meshes, components and build items of its model parts.

An own reader on the standard library: nested components can place an object any number of times,
and data can decompress to any size, so both are counted before anything is built.
"""

from __future__ import annotations

import io
import posixpath
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from meshes import xmlfile
from meshes.content import Arrays, Content, check_placed, check_unpacked, checked, moved
from meshes.errors import MeshError
from meshes.formats import text

MOST_BODIES = 100_000
DEPTH = 32  # of components in components

# The standard's units in those of `meshes.UNITS`, with a factor.
_UNITS = {
    "micron": ("mm", 1e-3),
    "millimeter": ("mm", 1.0),
    "centimeter": ("cm", 1.0),
    "inch": ("in", 1.0),
    "foot": ("in", 12.0),
    "meter": ("m", 1.0),
}
# Required extensions that do not change the triangles.
_HARMLESS = ("/material/", "/production/", "/trianglesets/", "/securecontent/", "/core/")
Matrix = NDArray[np.float64]
Key = tuple[str, str]  # model part, object id


@dataclass
class _Model:
    """The objects of an archive's parts, their components, and the build items."""

    meshes: dict[Key, Arrays] = field(default_factory=dict)
    components: dict[Key, list[tuple[Key, Matrix]]] = field(default_factory=dict)
    build: list[tuple[Key, Matrix]] = field(default_factory=list)
    unit: str = "millimeter"


def read(data: bytes) -> Content:
    """Every placed body of a 3MF, in its unit.

    Raises:
        MeshError: damaged, no model in it, an unknown unit, object or required extension, or too
            much of something.
    """
    try:
        model = _model(data)
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError) as error:
        raise MeshError(f"its zip archive is damaged or cut off ({error})") from None
    if model.unit not in _UNITS:
        raise MeshError(f"unknown unit {model.unit[:40]!r}: 3MF has {', '.join(_UNITS)}")
    unit, scale = _UNITS[model.unit]
    known: dict[Key, tuple[int, int]] = {}
    costs = [_cost(model, key, DEPTH, known) for key, _ in model.build]
    triangles, bodies = (sum(cost[k] for cost in costs) for k in range(2))
    check_placed(triangles, sum(len(faces) for _, faces in model.meshes.values()))
    if bodies > MOST_BODIES:
        raise MeshError(f"places {bodies:,} bodies, more than the {MOST_BODIES:,} allowed")
    placed: list[Arrays] = []
    for key, T in model.build:
        _place(model, key, T, placed)
    return Content([checked(v * scale, faces) for v, faces in placed], unit)


def _model(data: bytes) -> _Model:
    """The archive's model parts."""
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
        check_unpacked(size, len(data))
        model = _Model()
        for name in (root, *(name for name in parts if name != root)):
            # The size limits the read: without it, zipfile decompresses everything.
            with archive.open(parts[name]) as stream:
                content = stream.read(parts[name].file_size)
            try:
                _parse(content, name, model, name == root)
            except KeyError as error:
                raise MeshError(f"not as 3MF says: {str(error)[:60]} is missing") from None
    return model


def _parse(content: bytes, part: str, model: _Model, root: bool) -> None:
    """Add a part's objects, and of the root part the unit and the build, to the model."""
    here: Key = (part, "")
    vertices: list[tuple[str, str, str]] = []
    triangles: list[tuple[str, str, str]] = []

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal here
        if name == "vertex":
            vertices.append((attributes["x"], attributes["y"], attributes["z"]))
        elif name == "triangle":
            triangles.append((attributes["v1"], attributes["v2"], attributes["v3"]))
        elif name == "model":
            _check_extensions(attributes)
            if root:
                model.unit = attributes.get("unit", "millimeter")
        elif name == "object":
            here = (part, attributes["id"])
            vertices.clear()
            triangles.clear()
        elif name == "component":
            model.components.setdefault(here, []).append(_reference(attributes, part))
        elif name == "item" and root:
            model.build.append(_reference(attributes, part))

    def end(name: str) -> None:
        if name == "object" and (vertices or triangles):
            model.meshes[here] = checked(
                _numbers(vertices).reshape(-1, 3),
                text.whole(_numbers(triangles).reshape(-1, 3), "a corner"),
            )

    xmlfile.parse(content, start, end)


def _check_extensions(attributes: dict[str, str]) -> None:
    """Raise `MeshError` for a required extension that is not supported."""
    for prefix in attributes.get("requiredextensions", "").split():
        name = attributes.get(f"xmlns:{prefix}", prefix)
        if not any(part in name for part in _HARMLESS):
            raise MeshError(f"needs an extension that is not read: {name[:100]}")


def _numbers(rows: Sequence[tuple[str, ...]]) -> NDArray[np.float64]:
    """Words of rows as numbers, flat."""
    words = [word for row in rows for word in row]
    try:
        return np.array(list(map(float, words)))
    except ValueError:
        return np.array([text.number(word.encode(), "3D model") for word in words])


def _reference(attributes: dict[str, str], part: str) -> tuple[Key, Matrix]:
    """The object of a component or item, also in another part, and its transform."""
    path = next((v for k, v in attributes.items() if k.rpartition(":")[2] == "path"), part)
    T = np.eye(4)
    if "transform" in attributes:
        # Row vectors times a 4 × 3 matrix, row by row.
        numbers = _numbers([tuple(attributes["transform"].split())])
        if numbers.size != 12:
            raise MeshError(f"a transform of {numbers.size} numbers, not 12")
        T[:3] = numbers.reshape(4, 3).T
    return (posixpath.normpath("/" + path.lstrip("/")), attributes["objectid"]), T


def _cost(
    model: _Model, key: Key, depth: int, known: dict[Key, tuple[int, int]]
) -> tuple[int, int]:
    """Numbers of triangles and bodies of one placed object."""
    if key not in known:
        if depth == 0:
            raise MeshError(f"components nested deeper than {DEPTH}, or in a circle")
        if key not in model.meshes and key not in model.components:
            raise MeshError(f"object {key[1][:40]!r} is referred to, but not in the file")
        inner = [_cost(model, part, depth - 1, known) for part, _ in model.components.get(key, [])]
        own = len(model.meshes[key][1]) if key in model.meshes else 0
        # Empty objects count as bodies: placing them takes time too.
        known[key] = own + sum(a for a, _ in inner), 1 + sum(b for _, b in inner)
    return known[key]


def _place(model: _Model, key: Key, T: Matrix, bodies: list[Arrays]) -> None:
    if key in model.meshes:
        bodies.append(moved(*model.meshes[key], T))
    for part, T_key_part in model.components.get(key, []):
        _place(model, part, T @ T_key_part, bodies)
