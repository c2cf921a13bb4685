"""Layer: structures in the colours of their margins, where a registration makes these differ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin
import viser
from numpy.typing import NDArray

from app.scene.scene import Scene
from app.structure import Structure
from app.view.drawing.heat.bands import Piece, Scale, pieces, scale
from app.view.drawing.nodes import place
from app.view.units import to_buffer

FloatArray = NDArray[np.float64]


@dataclass
class _Shape:
    """What is drawn of a structure, and in which nodes, one a band."""

    vertices: FloatArray
    faces: NDArray[np.int64]
    side: str
    nodes: list[viser.MeshHandle] = field(default_factory=list)
    pieces: list[Piece] = field(default_factory=list)  # one a node
    pose: pin.SE3 | None = None


class Heat:
    """The bands of all structures that are guarded; those that are not have none.

    Nothing is computed while the layer is off or the scene has no registration.
    """

    def __init__(self, api: viser.SceneApi) -> None:
        self._api = api
        self._scene: Scene | None = None
        self._shapes: list[_Shape] = []
        self._margins: list[float | None] = []  # what the bands are of; None: not guarded
        self.on = True
        self.scale: Scale | None = None
        """Of the bands that are drawn; None: there are none."""

    def set_scene(self, scene: Scene) -> None:
        """Drop all bands; `set_shape` follows for each structure of the scene."""
        for shape in self._shapes:
            _clear(shape)
        self._scene, self._margins, self.scale = scene, [], None
        none = np.empty((0, 3)), np.empty((0, 3), dtype=np.int64)
        self._shapes = [_Shape(*none, "double") for _ in scene.surfaces]

    def set_shape(
        self, number: int, vertices: FloatArray, faces: NDArray[np.int64], fronts_only: bool
    ) -> None:
        """What is drawn of a structure: vertices (n, 3) [m], base frame, and faces (m, 3)."""
        shape = self._shapes[number]
        shape.vertices, shape.faces = vertices, faces
        shape.side = "front" if fronts_only else "double"
        if self.scale is not None and self._margins[number] is not None:
            self._make(number)

    def set_margins(self, structures: Sequence[Structure]) -> None:
        """The settings in force, in the order of `Options.anatomy`."""
        scene = self._scene
        if scene is None or scene.added is None or len(structures) != len(self._shapes):
            return
        margins = [own.margin or 0.0 if own.guarded else None for own in structures]
        if not self.on or margins == self._margins:
            return
        self._margins = margins
        ranges = [
            (margin + least, margin + most)
            for margin, (least, most) in zip(margins, scene.added_range, strict=True)
            if margin is not None
        ]
        for shape in self._shapes:
            _clear(shape)
        self.scale = None
        if ranges:
            self.scale = scale(min(low for low, _ in ranges), max(high for _, high in ranges))
            for number, margin in enumerate(margins):
                if margin is not None:
                    self._make(number)

    def covers(self, number: int) -> bool:
        """Whether bands are drawn in place of a structure."""
        return self.on and bool(self._shapes) and bool(self._shapes[number].nodes)

    def draw(self, number: int, visible: bool, opacity: float | None) -> None:
        """Show or hide the bands of a structure."""
        visible = visible and self.on
        for node in self._shapes[number].nodes:
            if node.opacity != opacity:
                node.opacity = opacity
            if node.visible != visible:
                node.visible = visible

    def move(self, number: int, pose: pin.SE3 | None) -> None:
        """Put the bands of a structure where it is."""
        self._shapes[number].pose = pose
        for node in self._shapes[number].nodes:
            place(node, pose)

    def deform(self, number: int, vertices: FloatArray) -> None:
        """Give the bands of a structure its shape: what is drawn of it (n, 3) [m]."""
        shape = self._shapes[number]
        for node, piece in zip(shape.nodes, shape.pieces, strict=True):
            node.vertices = to_buffer(piece.vertices(vertices))

    def _make(self, number: int) -> None:
        shape, margin = self._shapes[number], self._margins[number]
        assert self._scene is not None
        assert self._scene.added is not None
        assert self.scale is not None
        assert margin is not None
        _clear(shape)
        values = margin + self._scene.added.at(shape.vertices)
        parts = pieces(shape.faces, values, self.scale)
        for k, (piece, color) in enumerate(zip(parts, self.scale.colors, strict=True)):
            if len(piece.faces) == 0:
                continue
            node = self._api.add_mesh_simple(
                f"/anatomy/margin{number}/{k}",
                vertices=to_buffer(piece.vertices(shape.vertices)),
                faces=piece.faces.astype(np.uint32),
                color=color,
                flat_shading=True,
                side=shape.side,  # type: ignore[arg-type]
                cast_shadow=False,
                visible=False,
            )
            if shape.pose is not None:
                place(node, shape.pose)
            shape.nodes.append(node)
            shape.pieces.append(piece)


def _clear(shape: _Shape) -> None:
    for node in shape.nodes:
        node.remove()
    shape.nodes, shape.pieces = [], []
