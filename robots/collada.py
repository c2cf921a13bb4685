"""Reading Collada (.dae) as used by example-robot-data.

Supported are node matrices, indexed triangles, and one diffuse colour per material.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

Part = tuple[tuple[float, float, float], NDArray[np.float64], NDArray[np.int64]]
"""Diffuse colour (0–1, as written in the file), vertices (n, 3) [m], faces (m, 3)."""

_NS = {"c": "http://www.collada.org/2005/11/COLLADASchema"}


def read(path: Path) -> list[Part]:
    """All triangles in the file's scene, one part for each geometry and material.

    Raises `ValueError` for polygons other than indexed triangles or an up axis other than z.
    """
    root = ElementTree.parse(path).getroot()
    if root.findtext("c:asset/c:up_axis", "Y_UP", _NS) != "Z_UP":
        raise ValueError(f"{path}: only Collada files with z up are supported")
    unit = root.find("c:asset/c:unit", _NS)
    scale = 1.0 if unit is None else float(unit.get("meter", "1"))
    by_id = {"#" + e.get("id", ""): e for e in root.iter() if e.get("id")}
    parts: list[Part] = []
    for scene in root.iterfind("c:library_visual_scenes/c:visual_scene", _NS):
        for instance, T in _instances(scene, np.diag([scale, scale, scale, 1.0])):
            colors = {
                bound.get("symbol", ""): _diffuse(by_id, by_id[bound.get("target", "")])
                for bound in instance.iterfind(".//c:instance_material", _NS)
            }
            mesh = by_id[instance.get("url", "")].find("c:mesh", _NS)
            if mesh is None or mesh.find("c:polylist", _NS) is not None:
                raise ValueError(f"{path}: only Collada meshes of triangles are supported")
            for triangles in mesh.iterfind("c:triangles", _NS):
                vertices, faces = _triangles(by_id, triangles)
                color = colors.get(triangles.get("material", ""), (0.7, 0.7, 0.7))
                parts.append((color, vertices @ T[:3, :3].T + T[:3, 3], faces))
    return parts


def _instances(
    node: ElementTree.Element, T: NDArray[np.float64]
) -> Iterator[tuple[ElementTree.Element, NDArray[np.float64]]]:
    """Every geometry below a node with its transform into the scene."""
    matrix = node.find("c:matrix", _NS)
    if matrix is not None:
        T = T @ _numbers(matrix).reshape(4, 4)
    for instance in node.iterfind("c:instance_geometry", _NS):
        yield instance, T
    for child in node.iterfind("c:node", _NS):
        yield from _instances(child, T)


def _triangles(
    by_id: dict[str, ElementTree.Element], triangles: ElementTree.Element
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    inputs = triangles.findall("c:input", _NS)
    stride = 1 + max(int(i.get("offset", "0")) for i in inputs)
    corner = next(i for i in inputs if i.get("semantic") == "VERTEX")
    positions = by_id[corner.get("source", "")].find("c:input[@semantic='POSITION']", _NS)
    source = by_id["" if positions is None else positions.get("source", "")]
    vertices = _numbers(source.find("c:float_array", _NS)).reshape(-1, 3)
    indices = _numbers(triangles.find("c:p", _NS)).astype(np.int64)
    faces = indices.reshape(-1, stride)[:, int(corner.get("offset", "0"))].reshape(-1, 3)
    used, faces = np.unique(faces, return_inverse=True)
    return vertices[used], faces.reshape(-1, 3).astype(np.int64)


def _diffuse(
    by_id: dict[str, ElementTree.Element], material: ElementTree.Element
) -> tuple[float, float, float]:
    effect = material.find("c:instance_effect", _NS)
    url = "" if effect is None else effect.get("url", "")
    red, green, blue = _numbers(by_id[url].find(".//c:diffuse/c:color", _NS))[:3]
    return float(red), float(green), float(blue)


def _numbers(element: ElementTree.Element | None) -> NDArray[np.float64]:
    text = "" if element is None else element.text
    return np.array((text or "").split(), dtype=np.float64)
