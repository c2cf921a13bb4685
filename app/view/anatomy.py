"""Layer: the anatomical mesh and a scale bar beside it."""

from __future__ import annotations

import numpy as np
import viser

from app.scene import Scene
from app.view import palette
from app.view.camera import DIRECTION
from app.view.units import to_buffer, to_view

TRANSLUCENT = 0.45


class Anatomy:
    """The mesh as drawn (possibly decimated), opaque or translucent, and the scale bar."""

    def __init__(self, api: viser.SceneApi) -> None:
        self._api = api
        self._mesh: viser.MeshHandle | None = None
        self._ruler: viser.LineSegmentsHandle | None = None
        self._ruler_label: viser.LabelHandle | None = None
        self._visible = True
        self._translucent = False

    def set_scene(self, scene: Scene) -> None:
        """Draw another mesh in place of the old one."""
        self._mesh = self._api.add_mesh_simple(
            "/anatomy/mesh",
            vertices=to_buffer(scene.vertices_shown),
            faces=scene.faces_shown.astype(np.uint32),
            color=palette.BONE,
            flat_shading=True,
            side="double",
            opacity=TRANSLUCENT if self._translucent else None,
            cast_shadow=False,
            visible=self._visible,
        )
        self._draw_ruler(scene)

    def show(self, visible: bool) -> None:
        """Layer switch; the scale bar stays."""
        self._visible = visible
        if self._mesh is not None:
            self._mesh.visible = visible

    def set_translucent(self, on: bool) -> None:
        """Let one look through the bone."""
        self._translucent = on
        if self._mesh is not None:
            self._mesh.opacity = TRANSLUCENT if on else None

    def show_ruler(self, visible: bool) -> None:
        """Layer switch of the scale bar."""
        for node in (self._ruler, self._ruler_label):
            if node is not None:
                node.visible = visible

    def _draw_ruler(self, scene: Scene) -> None:
        low, high = scene.vertices_shown.min(axis=0), scene.vertices_shown.max(axis=0)
        length = nice_length(0.5 * float(np.ptp(scene.vertices_shown[:, :2], axis=0).max()))
        # Below the mesh, on the side that the first view is taken from and across that view.
        toward = np.array([*DIRECTION[:2], 0.0]) / np.linalg.norm(DIRECTION[:2])
        across = np.array([-toward[1], toward[0], 0.0])
        middle = np.array([*(0.5 * (low + high)[:2]), low[2]])
        foot = middle + 0.33 * scene.surface.size * toward
        up = np.array([0.0, 0.0, 0.03 * length])
        along = np.linspace(-0.5, 0.5, 11)[:, None] * length * across + foot  # (11, 3)
        heights = np.where(np.arange(11) % 5 == 0, 2.0, 1.0)[:, None] * up
        ticks = np.stack([along, along + heights], axis=1)  # (11, 2, 3)
        self._ruler = self._api.add_line_segments(
            "/ruler/bar",
            points=to_buffer(np.concatenate([along[None, [0, -1]], ticks])),
            colors=palette.BLACK,
            thickness=2.0,
            thickness_units="screen",
        )
        self._ruler_label = self._api.add_label(
            "/ruler/label",
            f"{length * 1e3:g} mm",
            position=to_view(foot - up),
            anchor="top-center",
            font_screen_scale=0.8,
        )


def nice_length(most: float) -> float:
    """The longest of 1, 2, 5 × 10^k that is not longer than `most` [m]."""
    power = 10.0 ** np.floor(np.log10(most))
    return float(power * max(m for m in (1.0, 2.0, 5.0) if m * power <= most * (1 + 1e-9)))
