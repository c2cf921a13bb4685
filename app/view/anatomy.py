"""Layer: the anatomical mesh."""

from __future__ import annotations

import numpy as np
import viser

from app.scene import Scene
from app.view import palette
from app.view.units import to_buffer

TRANSLUCENT = 0.45


class Anatomy:
    """The mesh as drawn (possibly decimated), opaque or translucent."""

    def __init__(self, api: viser.SceneApi) -> None:
        self._api = api
        self._mesh: viser.MeshHandle | None = None
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

    def show(self, visible: bool) -> None:
        """Layer switch."""
        self._visible = visible
        if self._mesh is not None:
            self._mesh.visible = visible

    def set_translucent(self, on: bool) -> None:
        """Let one look through the bone."""
        self._translucent = on
        if self._mesh is not None:
            self._mesh.opacity = TRANSLUCENT if on else None
