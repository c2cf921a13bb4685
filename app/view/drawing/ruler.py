"""Layer: scale bars in millimetres, one below the anatomy and one beside the tool's start."""

from __future__ import annotations

import numpy as np
import viser
from numpy.typing import NDArray

from app.scene.scene import Scene
from app.view import palette
from app.view.camera import DIRECTION, site_half_height
from app.view.drawing.labels import Labels
from app.view.part import Part
from app.view.units import to_buffer, to_view

FloatArray = NDArray[np.float64]

DIVISIONS = 10


class Rulers(Part):
    """Two scale bars, perpendicular to the first view's direction."""

    def __init__(self, api: viser.SceneApi, labels: Labels) -> None:
        self._api = api
        self._bars: list[viser.SceneNodeHandle] = []
        self._lengths = {
            name: labels.add(f"/ruler/{name}/label", anchor="top-center")
            for name in ("anatomy", "site")
        }
        self._visible = True

    def set_scene(self, scene: Scene) -> None:
        """Draw the bars, in lengths for the scene's first view."""
        half_height = site_half_height(scene)
        size = scene.vertices_shown
        low, high = size.min(axis=0), size.max(axis=0)
        # Below the mesh, on the side of the first view's camera.
        toward = np.array([*DIRECTION[:2], 0.0]) / np.linalg.norm(DIRECTION[:2])
        across = np.array([-toward[1], toward[0], 0.0])
        foot = np.array([*(0.5 * (low + high)[:2]), low[2]]) + 0.33 * scene.surface.size * toward
        widest = float(np.ptp(size[:, :2], axis=0).max())
        anatomy = self._draw("anatomy", foot, across, nice_length(0.5 * widest))
        # Left of the wrist in the first view, inside the picture of an upright phone.
        up = np.cross(across, DIRECTION)
        up = up if up[2] > 0.0 else -up
        left = np.cross(up, DIRECTION)
        site = scene.T_base_start.translation - half_height * (0.27 * left - 0.25 * up)
        self._bars = [anatomy, self._draw("site", site, left, nice_length(0.3 * half_height))]
        self.show(self._visible)

    def show(self, visible: bool) -> None:
        """Layer switch."""
        self._visible = visible
        for bar in self._bars:
            bar.visible = visible
        for length in self._lengths.values():
            length.visible = visible

    def _draw(
        self, name: str, middle: FloatArray, across: FloatArray, length: float
    ) -> viser.SceneNodeHandle:
        up = np.array([0.0, 0.0, 0.03 * length])
        along = np.linspace(-0.5, 0.5, DIVISIONS + 1)[:, None] * length * across + middle
        heights = np.where(np.arange(DIVISIONS + 1) % 5 == 0, 2.0, 1.0)[:, None] * up
        ticks = np.stack([along, along + heights], axis=1)  # (11, 2, 3)
        bar = self._api.add_line_segments(
            f"/ruler/{name}/bar",
            points=to_buffer(np.concatenate([along[None, [0, -1]], ticks])),
            colors=palette.BLACK,
            thickness=2.0,
            thickness_units="screen",
        )
        label = self._lengths[name]
        label.text, label.position = f"{length * 1e3:g} mm", to_view(middle - up)
        return bar


def nice_length(most: float) -> float:
    """The largest of 1, 2, 5 × 10^k up to `most` [m]."""
    power = 10.0 ** np.floor(np.log10(most))
    return float(power * max(m for m in (1.0, 2.0, 5.0) if m * power <= most * (1 + 1e-9)))
