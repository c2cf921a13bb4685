"""Layer: triangles in the sphere coloured by state, the chosen one, the allowed region."""

from __future__ import annotations

import numpy as np
import viser
from numpy.typing import NDArray

import vf
from app.view import palette
from app.view.drawing import nodes
from app.view.drawing.labels import Labels
from app.view.inspector.descriptions import states
from app.view.inspector.inspection import Inspection, Subject
from app.view.inspector.region import Region
from app.view.units import to_buffer, to_view

FloatArray = NDArray[np.float64]

# In radii of the motion sphere.
LIFT = 0.008  # offset along the normals, clear of the mesh's own triangles
DOT = 0.06  # diameter of the closest point's dot
NAME_SHIFT = 0.3  # of the chosen triangle's name from its closest point, at most


class NearDrawing:
    """What the inspector draws on the anatomy; only changes are sent."""

    def __init__(self, api: viser.SceneApi, labels: Labels) -> None:
        self._meshes = {
            state: nodes.mesh(
                api, f"/inspector/near/{state.name.lower()}", look.color, flat_shading=True
            )
            for state, look in palette.TRIANGLE_STATES.items()
        }
        self._grid = nodes.lines(api, "/inspector/near/grid", 1.0, (90, 90, 90))
        self._outline = nodes.lines(api, "/inspector/chosen/outline", 5.0, palette.BLACK)
        self._neighbours = nodes.lines(api, "/inspector/chosen/neighbours", 2.0, palette.BLACK)
        self._foot = nodes.lines(api, "/inspector/chosen/foot", 2.5, palette.BLACK)
        self._feet = nodes.lines(api, "/inspector/chosen/feet", 1.5, (90, 90, 90))
        self._dot = nodes.ball(api, "/inspector/chosen/point", palette.BLACK)
        self._name = labels.add("/inspector/chosen/name", anchor="bottom-left")
        self._region = nodes.mesh(
            api, "/inspector/region", palette.SPHERE, opacity=0.45, flat_shading=True
        )
        self._shown: dict[palette.TriangleState, bytes] = {}
        self._grid_shown = b""
        self._solid: Region | None = None
        self._surface: vf.Surface | None = None
        self._radius = 0.0

    def hide(self) -> None:
        """Hide everything until the next `draw`."""
        chosen = self._outline, self._neighbours, self._foot, self._feet, self._dot
        for node in (*self._meshes.values(), self._grid, *chosen, self._region):
            node.visible = False
        self._name.visible = False
        self._shown, self._grid_shown, self._solid = {}, b"", None

    def draw(self, inspection: Inspection, chosen: int) -> None:
        """Draw an inspection and the chosen triangle (−1: none)."""
        self._draw_near(inspection)
        self._draw_chosen(inspection.subject, inspection.explanation, chosen)
        solid = inspection.region
        self._region.visible = solid is not None and len(solid.faces) > 0
        if solid is not None and solid is not self._solid and len(solid.faces):
            self._region.vertices = to_buffer(solid.vertices)
            self._region.faces = solid.faces.astype(np.uint32)
        self._solid = solid

    def _draw_near(self, inspection: Inspection) -> None:
        explanation = inspection.explanation
        found = states(explanation.verdicts, explanation.covers)
        if self._surface is not explanation.surface or self._radius != explanation.radius:
            self._surface, self._radius = explanation.surface, explanation.radius
            self._shown, self._grid_shown = {}, b""
        for k, (state, node) in enumerate(self._meshes.items()):
            mine = np.sort(explanation.triangles[found == k])
            if len(mine):
                corners, sides = _lifted(explanation, mine, LIFT)
                key = mine.tobytes() + sides.tobytes()
                if self._shown.get(state) != key:
                    self._shown[state] = key
                    node.vertices = to_buffer(corners.reshape(-1, 3))
                    node.faces = np.arange(3 * len(corners), dtype=np.uint32).reshape(-1, 3)
            node.visible = len(mine) > 0
        every = np.sort(explanation.triangles)
        if len(every):
            corners, sides = _lifted(explanation, every, 1.2 * LIFT)
            if self._grid_shown != every.tobytes() + sides.tobytes():
                self._grid_shown = every.tobytes() + sides.tobytes()
                self._grid.points = to_buffer(_edges(corners))
        self._grid.visible = len(every) > 0

    def _draw_chosen(self, subject: Subject, explanation: vf.Explanation, chosen: int) -> None:
        if chosen < 0:
            for node in (self._outline, self._neighbours, self._foot, self._dot, self._feet):
                node.visible = False
            self._name.visible = False
            return
        report = explanation.of(chosen)
        self._outline.points = to_buffer(
            _edges(_lifted(explanation, np.array([chosen]), 2 * LIFT)[0])
        )
        across = np.array([a.neighbour for a in report.across if a.neighbour >= 0], dtype=np.int64)
        self._neighbours.visible = len(across) > 0
        if len(across):
            self._neighbours.points = to_buffer(_edges(_lifted(explanation, across, 1.6 * LIFT)[0]))
        self._foot.points = to_buffer(np.array([[subject.x, report.point]]))
        self._dot.position = to_view(report.point)
        self._dot.scale = float(to_view(0.5 * DOT * subject.radius))
        self._name.position = to_view(_name_point(explanation, chosen, report.point))
        self._name.text = subject.name(chosen)
        for node in (self._outline, self._foot, self._dot):
            node.visible = True
        self._name.visible = not subject.names  # those have labels of their own
        # In a case of the paper, the closest points of both triangles.
        self._feet.visible = bool(subject.names)
        if subject.names:
            x = np.broadcast_to(subject.x, explanation.points.shape)
            self._feet.points = to_buffer(np.stack([x, explanation.points], axis=1))


def _name_point(explanation: vf.Explanation, chosen: int, p_closest: FloatArray) -> FloatArray:
    """Where a triangle's name is (3,): in the triangle, near its closest point (3,), but not at it.

    At the closest point of a triangle that blocks, the label of its plane takes the room.
    """
    surface = explanation.surface
    shift = surface.vertices[surface.faces[chosen]].mean(axis=0) - p_closest
    length = max(float(np.linalg.norm(shift)), 1e-12)
    return np.asarray(p_closest + min(1.0, NAME_SHIFT * explanation.radius / length) * shift)


def _lifted(
    explanation: vf.Explanation, triangles: NDArray[np.int64], share: float
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Corners (k, 3, 3) of triangles offset outwards, and also inwards for those that x is behind.

    Also returns a mask of the latter. Both sides are drawn, as an outer face is seen from outside,
    an open sheet from behind.
    """
    surface = explanation.surface
    corners = surface.vertices[surface.faces[triangles]]
    normals = surface.normals[triangles]
    behind = np.einsum("ij,ij->i", normals, explanation.x - corners[:, 0]) < 0.0
    lift = (share * explanation.radius * normals)[:, None, :]
    return np.concatenate([corners + lift, (corners - lift)[behind]]), behind


def _edges(corners: FloatArray) -> FloatArray:
    """Edges (3k, 2, 3) of triangles (k, 3, 3)."""
    return np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2, 3)
