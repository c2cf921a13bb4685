"""Layer: the inspector's probe with its gizmo and planes, and the surface of a case."""

from __future__ import annotations

import numpy as np
import viser
from numpy.typing import NDArray

from app.scene.scene import Scene
from app.view import palette
from app.view.camera import DIRECTION, FIELD_OF_VIEW, View
from app.view.drawing import nodes
from app.view.drawing.fixture import FixtureDrawing
from app.view.drawing.labels import Labels
from app.view.inspector import figures
from app.view.inspector.inspection import Inspection
from app.view.units import to_buffer, to_view

FloatArray = NDArray[np.float64]

GIZMO_SIZE = 60.0  # length of its arrows [px]: smaller than the proxy's
BALL = 0.05  # radius of the dot, in radii of the sphere
# Distance of the cases from the anatomy, which is then behind the camera [m].
CASE_OFFSET = 0.6


class Probe:
    """A yellow dot with a gizmo that moves only the dot."""

    def __init__(self, api: viser.SceneApi, labels: Labels) -> None:
        self.gizmo = api.add_transform_controls(
            "/probe/gizmo",
            scale=GIZMO_SIZE,
            fixed=True,
            line_width=2.0,
            disable_rotations=True,
            depth_test=False,
            opacity=0.9,
            visible=False,
        )
        self._ball = nodes.ball(api, "/probe/ball", palette.PROBE)
        self._name = labels.add("/probe/name", "probe", anchor="bottom-right")
        self._fixture = FixtureDrawing(api, labels, "/probe/fixture")
        self._fixture.show_triangles = False  # the inspector draws them
        self._fixture.inspected = True
        self._fixture.hide()
        self._case = nodes.mesh(api, "/probe/case", palette.BONE, flat_shading=True)
        self._case_names = [
            labels.add(f"/probe/{name}", name, anchor="center-center", scale=1.0)
            for name in figures.NAMES.values()
        ]

    def hide(self) -> None:
        """Hide everything."""
        for node in (self.gizmo, self._ball, self._case):
            node.visible = False
        for label in (self._name, *self._case_names):
            label.visible = False
        self._fixture.hide()

    def put(self, x: FloatArray) -> None:
        """Move the gizmo to x (3,) [m]."""
        self.gizmo.position = to_view(x)

    def show_case(self, case: figures.Case | None, R: FloatArray, origin: FloatArray) -> None:
        """Draw a case, rotated by R (3, 3) and moved to origin (3,) [m]; None: hide it."""
        self._case.visible = case is not None
        for name in self._case_names:
            name.visible = case is not None
        if case is None:
            return
        vertices, faces = figures.shape(case)
        self._case.vertices = to_buffer(vertices @ R.T + origin)
        self._case.faces = faces.astype(np.uint32)
        for name, face in zip(self._case_names, faces, strict=True):
            outer = vertices[next(v for v in face if v > 1)]
            place = 0.8 * outer - np.array([0.0, 0.1 * figures.LENGTH, 0.0])
            name.position = to_view(R @ place + origin)

    def draw(self, inspection: Inspection) -> None:
        """Draw the probe and the planes of its rule."""
        subject = inspection.subject
        self._ball.scale = float(to_view(BALL * subject.radius))
        self._ball.position = to_view(subject.x)
        self._name.position = to_view(subject.x)
        self.gizmo.visible = self._ball.visible = self._name.visible = True
        self._fixture.draw(
            subject.x, subject.radius, inspection.planes, inspection.multipliers, [subject.surface]
        )


def case_pose(scene: Scene) -> tuple[FloatArray, FloatArray]:
    """Pose of the cases in a scene: rotation (3, 3) and origin (3,) [m].

    The common edge (y) points away from the anatomy.
    """
    toward = np.array([*DIRECTION[:2], 0.0]) / np.linalg.norm(DIRECTION[:2])
    up = np.array([0.0, 0.0, 1.0])
    R = np.column_stack([np.cross(toward, up), toward, up])
    return R, scene.T_base_start.translation + CASE_OFFSET * toward


def case_view(R: FloatArray, origin: FloatArray) -> View:
    """Along the edge, slightly from above and from the right, similar to the paper's figures."""
    distance = 1.35 * figures.LENGTH / np.sin(FIELD_OF_VIEW / 2.0)
    away = np.array([0.14, -0.97, 0.2])
    centre = R @ np.array([0.0, 0.0, 0.1 * figures.LENGTH]) + origin
    return View(centre + distance * R @ (away / np.linalg.norm(away)), centre)
