"""Layer: the arm, with one frame per link."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from app.scene.moment import Moment
from app.scene.scene import Scene
from app.view.part import Clients, Part
from app.view.units import to_buffer, to_view
from robots import Arm

MIN_CHANGE = 1e-7  # smaller changes of a pose are not sent [m], [quaternion units]


class ArmDrawing(Part):
    """The arm's bodies; moving them takes up to two messages per link, not per body."""

    def __init__(self, api: viser.SceneApi, attach: Callable[[Any], None]) -> None:
        """`attach`: called with every node of a body of the tool, which can be grabbed."""
        self._api = api
        self._attach = attach
        self._arm: Arm | None = None
        self._root: viser.FrameHandle | None = None
        self._links: list[tuple[int, viser.FrameHandle]] = []  # row of placements, node
        self._shown: NDArray[np.float64] | None = None
        self._visible = True

    def set_scene(self, scene: Scene) -> None:
        """Draw the scene's arm, unless it is drawn already."""
        if self._arm is not None and self._arm.name == scene.arm.name:
            self._arm = scene.arm
            return
        if self._root is not None:
            self._root.remove()
        self._arm, self._links, self._shown = scene.arm, [], None
        self._root = self._api.add_frame("/arm", show_axes=False, visible=self._visible)
        links: dict[str, str] = {}
        tool = {capsule.frames[1] for capsule in scene.arm.capsules}
        for row, body in enumerate(scene.arm.bodies):
            if body.frame not in links:
                links[body.frame] = f"/arm/link{len(links)}"
                node = self._api.add_frame(links[body.frame], show_axes=False)
                self._links.append((row, node))
            drawn = self._api.add_mesh_simple(
                f"{links[body.frame]}/body{row}",
                vertices=to_buffer(body.vertices),
                faces=body.faces,
                color=body.color,
                cast_shadow=False,
                receive_shadow=False,
            )
            if body.frame in tool:
                self._attach(drawn)

    def show(self, visible: bool) -> None:
        """Layer switch."""
        self._visible = visible
        if self._root is not None:
            self._root.visible = visible

    def frame(self, shown: Moment, clients: Clients) -> None:
        q = shown.telemetry.q
        if self._arm is None or len(q) != len(self._arm.lower):
            return  # telemetry of the previous scene
        placements = self._arm.placements(q)  # (bodies, 7): wxyz, position [m]
        for row, node in self._links:
            changed = (
                np.full(7, np.inf) if self._shown is None else placements[row] - self._shown[row]
            )
            # Separately, as many links only rotate or only translate.
            if np.abs(changed[:4]).max() > MIN_CHANGE:
                node.wxyz = placements[row, :4]
            if np.abs(changed[4:]).max() > MIN_CHANGE:
                node.position = to_view(placements[row, 4:])
        self._shown = placements
