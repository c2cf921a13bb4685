"""Layer: defects of the mesh, drawn where they are; and the health report as HTML."""

from __future__ import annotations

import html
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import viser
from numpy.typing import NDArray

import vf
from app.view import palette
from app.view.drawing import nodes
from app.view.palette import Rgb
from app.view.units import to_buffer
from meshes import Finding, Health

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

MAX_DRAWN = 20_000  # faces, edges or vertices drawn per finding, evenly sampled

# Distinct from bone.
DEFECT: Rgb = palette.VERMILION
NOTE: Rgb = palette.YELLOW
EDGES: dict[str, Rgb] = {"boundary loops": palette.BLUE, "non-manifold edges": palette.PURPLE}
VERTICES: Rgb = palette.BLACK


def color(finding: Finding) -> Rgb:
    """Colour of a finding, in the scene and in the report."""
    if finding.of == "faces":
        return DEFECT if finding.defect else NOTE
    return EDGES.get(finding.kind, DEFECT) if finding.of == "edges" else VERTICES


@dataclass(frozen=True)
class Marks:
    """Geometry of a report's findings, arm base frame [m].

    Attributes:
        defects, notes: corners (k, 3, 3) of faces.
        edges: end points (k, 2, 3) for each kind of `EDGES`.
        vertices: points (k, 3).
    """

    defects: FloatArray
    notes: FloatArray
    edges: dict[str, FloatArray]
    vertices: FloatArray


def marks(report: Health, surface: vf.Surface) -> Marks:
    """Geometry of the findings; a face with a defect is not marked for a note as well."""
    v, f = surface.vertices, surface.faces
    faces: dict[bool, list[IntArray]] = {True: [], False: []}
    edges = {kind: np.empty((0, 2, 3)) for kind in EDGES}
    points: list[IntArray] = []
    for finding in report.findings:
        ids = _subset(finding.ids)
        if finding.of == "faces":
            faces[finding.defect].append(ids)
        elif finding.of == "edges":
            edges[finding.kind] = v[ids]
        else:
            points.append(ids)
    defects = _unique(faces[True])
    notes = np.setdiff1d(_unique(faces[False]), defects)
    return Marks(v[f[defects]], v[f[notes]], edges, v[_unique(points)])


class HealthDrawing:
    """Draws marks, each kind in its colour."""

    def __init__(self, api: viser.SceneApi) -> None:
        self._root = api.add_frame("/health", show_axes=False)
        self._faces = {
            name: nodes.mesh(api, f"/health/{name}", rgb, flat_shading=True)
            for name, rgb in (("defects", DEFECT), ("notes", NOTE))
        }
        self._edges = {
            kind: nodes.lines(api, f"/health/{kind.replace(' ', '_')}", 4.0, rgb)
            for kind, rgb in EDGES.items()
        }
        self._points = api.add_point_cloud(
            "/health/vertices",
            points=np.zeros((1, 3), dtype=np.float32),
            colors=VERTICES,
            point_size=0.03,
            visible=False,
        )
        self._marks: Marks | None = None
        self._shown = True

    def set(self, found: Marks | None, lift: float = 0.0) -> None:
        """Draw marks; None: nothing.

        Args:
            lift: offset of the faces on both sides, clear of the drawn mesh [m].
        """
        self._marks = found
        if found is not None:
            for name, corners in (("defects", found.defects), ("notes", found.notes)):
                if len(corners):
                    lifted = _both_sides(corners, lift)
                    node = self._faces[name]
                    node.vertices = to_buffer(lifted.reshape(-1, 3))
                    node.faces = np.arange(3 * len(lifted), dtype=np.uint32).reshape(-1, 3)
            for kind, ends in found.edges.items():
                if len(ends):
                    self._edges[kind].points = to_buffer(ends)
            if len(found.vertices):
                self._points.points = to_buffer(found.vertices)
        self._sync()

    def move(self, pose: pin.SE3 | None) -> None:
        """Put the marks where a pose takes the mesh; None: where it rests."""
        nodes.place(self._root, pose)

    def show(self, on: bool) -> None:
        """Layer switch."""
        self._shown = on
        self._sync()

    def _sync(self) -> None:
        found = self._marks if self._shown else None
        self._faces["defects"].visible = found is not None and len(found.defects) > 0
        self._faces["notes"].visible = found is not None and len(found.notes) > 0
        for kind, node in self._edges.items():
            node.visible = found is not None and len(found.edges[kind]) > 0
        self._points.visible = found is not None and len(found.vertices) > 0


def report(found: Health, name: str = "") -> str:
    """HTML report: facts about a mesh of this name, and each finding with its consequence."""

    def number(value: float | None, scale: float, unit: str) -> str:
        return "–" if value is None else f"{value * scale:.4g} {unit}"

    size = " × ".join(f"{1e3 * side:.3g}" for side in found.extents)
    facts = (
        *((("structure", name),) if name else ()),
        ("triangles", f"{found.triangles:,}"),
        ("size", f"{size} mm"),
        ("pieces", f"{found.components:,}, genus {'–' if found.genus is None else found.genus}"),
        ("watertight", "yes" if found.watertight else "no"),
        ("wound alike", "yes" if found.consistent else "no"),
        ("volume", number(found.volume, 1e6, "cm³")),
        ("thinnest wall", number(found.wall, 1e3, "mm")),
        ("examined", "all faces" if found.exact else f"{found.examined:,} faces"),
    )
    rows = "".join(
        f"<tr><td style='color:var(--vf-soft);padding-right:1em'>{name}</td>"
        f"<td>{html.escape(text)}</td></tr>"
        for name, text in facts
    )
    verdict = (
        f"<b style='color:{palette.css(palette.GREEN)}'>Sound: no defects.</b>"
        if found.sound
        else f"<b style='color:{palette.css(palette.VERMILION)}'>It has defects:</b>"
    )
    findings = "".join(_item(finding) for finding in found.findings)
    return (
        "<div style='margin:0 .75em .5em;font-size:12px;line-height:1.35;color:var(--vf-ink)'>"
        f"<table style='border-collapse:collapse;margin-bottom:4px'>{rows}</table>"
        f"{verdict}{findings}</div>"
    )


def _item(finding: Finding) -> str:
    more = f", {MAX_DRAWN:,} of them drawn" if len(finding.ids) > MAX_DRAWN else ""
    return (
        "<div style='display:flex;gap:7px;margin-top:5px'>"
        "<span style='flex:none;width:11px;height:11px;margin-top:3px;border-radius:2px;"
        f"border:1px solid var(--vf-faint);background:{palette.css(color(finding))}'></span>"
        f"<span>{html.escape(finding.text + more)}<br>"
        "<span style='color:var(--vf-faint);font-size:11px'>"
        f"{html.escape(finding.meaning)}</span></span></div>"
    )


def _subset(ids: IntArray) -> IntArray:
    if len(ids) <= MAX_DRAWN:
        return ids
    return ids[np.linspace(0, len(ids) - 1, MAX_DRAWN).astype(np.int64)]


def _unique(ids: list[IntArray]) -> IntArray:
    return np.unique(np.concatenate(ids)) if ids else np.empty(0, dtype=np.int64)


def _both_sides(corners: FloatArray, lift: float) -> FloatArray:
    """Faces (k, 3, 3) offset along their normals in both directions: (2k, 3, 3)."""
    a, b, c = corners.transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    offsets = (lift * normals / np.maximum(lengths, 1e-30))[:, None, :]
    return np.concatenate([corners + offsets, corners - offsets])
