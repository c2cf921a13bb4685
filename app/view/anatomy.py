"""Layer: the anatomical mesh."""

from __future__ import annotations

import numpy as np
import viser
from numpy.typing import NDArray

from app.scene import Scene
from app.view import palette
from app.view.units import to_buffer

TRANSLUCENT = 0.45


class Anatomy:
    """The mesh as drawn (possibly decimated), opaque or translucent."""

    def __init__(self, api: viser.SceneApi) -> None:
        self._api = api
        self._scene: Scene | None = None
        self._mesh: viser.MeshHandle | None = None
        self._visible = True
        self._translucent = False

    def set_scene(self, scene: Scene) -> None:
        """Draw another mesh in place of the old one."""
        self._scene = scene
        self.cut(None)

    def cut(self, part: tuple[NDArray[np.float64], NDArray[np.int64]] | None) -> None:
        """Draw this part of the mesh, vertices (n, 3) [m] and faces (m, 3); None: all of it."""
        scene = self._scene
        if scene is None:
            return
        vertices, faces = (scene.vertices_shown, scene.faces_shown) if part is None else part
        # A back that nobody sees is a third of the time of a picture without a graphics card.
        fronts_only = scene.fronts_only and part is None
        self._mesh = self._api.add_mesh_simple(
            "/anatomy/mesh",
            vertices=to_buffer(vertices),
            faces=faces.astype(np.uint32),
            color=palette.BONE,
            flat_shading=True,
            side="front" if fronts_only else "double",
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
