"""Layer: the tool tip and the simulated force on the operator's hand."""

from __future__ import annotations

import numpy as np
import viser

from app.scene.moment import Moment
from app.view import palette
from app.view.camera import DIRECTION
from app.view.drawing import nodes
from app.view.drawing.labels import Labels
from app.view.part import Clients, Part
from app.view.units import to_buffer, to_view

FORCE_LENGTH = 0.005  # of the arrow [m/N]: at 3 N it is shorter than the scale bar
MIN_FORCE = 0.02  # a weaker force is not drawn [N]
# The arrow starts so far beside the tip, across the first view [m]: the force mostly points along
# the instrument, which would hide the arrow.
ARROW_OFFSET = 0.0065


class Tool(Part):
    """A dot at the tip, the tip's ball if it has a radius, and the force arrow."""

    def __init__(self, api: viser.SceneApi, labels: Labels) -> None:
        self._dot = nodes.dot(api, "/tool/dot", palette.TOOL, 0.02, visible=True)
        self._ball = api.add_icosphere(
            "/tool/ball", radius=1.0, color=(60, 60, 70), cast_shadow=False, visible=False
        )
        self._arrow = api.add_arrows(
            "/tool/force",
            points=np.zeros((1, 2, 3), dtype=np.float32),
            colors=palette.linear(np.array(palette.FORCE)),
            shaft_radius=0.03,
            head_radius=0.09,
            head_length=0.25,
            visible=False,
        )
        self._label = labels.add("/tool/force_label", anchor="bottom-right")
        self.show_force = True

    def frame(self, shown: Moment, clients: Clients) -> None:
        p_tip, tip_radius, force = shown.tip.translation, shown.options.tip_radius, shown.force
        self._dot.position = to_view(p_tip)
        self._ball.visible = tip_radius > 0.0
        if tip_radius > 0.0:
            self._ball.position = to_view(p_tip)
            self._ball.scale = float(to_view(tip_radius))
        strength = float(np.linalg.norm(force))
        drawn = self.show_force and strength > MIN_FORCE
        if drawn:
            arrow = FORCE_LENGTH * force
            side = np.cross(force, DIRECTION)
            foot = p_tip - ARROW_OFFSET * side / max(float(np.linalg.norm(side)), 1e-9)
            self._arrow.points = to_buffer(np.array([[[0.0, 0.0, 0.0], arrow]]))
            self._arrow.position = to_view(foot)
            self._label.position = to_view(foot + arrow)
            self._label.text = f"{palette.FORCE_NAME} {strength:.1f} N"
        self._arrow.visible = drawn
        self._label.visible = drawn
