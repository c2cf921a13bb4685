"""Layer: the anatomical mesh."""

from __future__ import annotations

import time
from collections.abc import Iterable

import numpy as np
import viser
from numpy.typing import NDArray

from app.judges.meeting import sees
from app.recording.playback import Moment
from app.scene.scene import Scene
from app.view import palette
from app.view.part import Clients, Part
from app.view.units import VIEW_SCALE, to_buffer

TRANSLUCENT = 0.3
HOLD = 1.0  # the mesh stays translucent so long after it last hid the tip [s]


class Anatomy(Part):
    """The drawn mesh (possibly decimated), opaque or translucent."""

    def __init__(self, api: viser.SceneApi) -> None:
        self._api = api
        self._scene: Scene | None = None
        self._mesh: viser.MeshHandle | None = None
        self._visible = True
        self._translucent = False  # by the layer switch
        self._hidden_at = -np.inf  # monotonic time when it last hid the tip [s]
        self._whole = True  # not cut

    def set_scene(self, scene: Scene) -> None:
        self._scene = scene
        self._hidden_at = -np.inf
        self.cut(None)

    def cut(self, part: tuple[NDArray[np.float64], NDArray[np.int64]] | None) -> None:
        """Draw this part of the mesh, vertices (n, 3) [m] and faces (m, 3); None: all of it."""
        scene = self._scene
        if scene is None:
            return
        self._whole = part is None
        vertices, faces = (scene.vertices_shown, scene.faces_shown) if part is None else part
        # Without a graphics card the back faces take a third of the rendering time.
        fronts_only = scene.fronts_only and part is None
        self._mesh = self._api.add_mesh_simple(
            "/anatomy/mesh",
            vertices=to_buffer(vertices),
            faces=faces.astype(np.uint32),
            color=palette.BONE,
            flat_shading=True,
            side="front" if fronts_only else "double",
            opacity=self._opacity,
            cast_shadow=False,
            visible=self._visible,
        )

    def show(self, visible: bool) -> None:
        """Layer switch."""
        self._visible = visible
        if self._mesh is not None:
            self._mesh.visible = visible

    def set_translucent(self, on: bool) -> None:
        """Layer switch of the translucency."""
        self._translucent = on
        self._draw()

    def frame(self, shown: Moment, clients: Clients) -> None:
        eyes = [np.asarray(client.camera.position) for client in clients.values()]
        self.keep_tip_visible(eyes, np.array(shown.tip.translation))

    def keep_tip_visible(
        self, eyes: Iterable[NDArray[np.float64]], p_tip: NDArray[np.float64]
    ) -> None:
        """Make the mesh translucent while it hides p_tip (3,) [m] from an eye (3,), scene units."""
        scene = self._scene
        if (
            scene is not None
            and self._whole
            and any(
                np.isfinite(eye).all() and not sees(scene.surface, eye / VIEW_SCALE, p_tip)
                for eye in eyes
            )
        ):
            self._hidden_at = time.monotonic()
        self._draw()

    @property
    def _opacity(self) -> float | None:
        hides = time.monotonic() < self._hidden_at + HOLD
        return TRANSLUCENT if self._translucent or hides else None

    def _draw(self) -> None:
        if self._mesh is not None and self._mesh.opacity != self._opacity:
            self._mesh.opacity = self._opacity
