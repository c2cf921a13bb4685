"""Layer: the gizmo, the proxy that it moves, and the tether to the tool."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import viser

from app.scene.moment import Moment
from app.view import palette
from app.view.drawing import nodes
from app.view.drawing.labels import Labels
from app.view.part import Clients, Part
from app.view.units import pose_to_view, to_buffer, to_view, turn_z_to

GIZMO_SIZE = 62.0  # length of its arrows [px]
MIN_TETHER = 5e-5  # shorter ones are not drawn [m]
# The tether is drawn as a spring: a helix along z from 0 to 1 with its ends on the axis.
_TURN = np.linspace(0.0, 2.0 * np.pi * 8, 97)
_COIL = np.column_stack([np.cos(_TURN), np.sin(_TURN), np.linspace(0.1, 0.9, len(_TURN))])
_COIL = np.vstack([[0.0, 0.0, 0.0], [0.0, 0.0, 0.1], _COIL, [0.0, 0.0, 0.9], [0.0, 0.0, 1.0]])
COIL = 8e-4, 0.15  # its radius at most [m], and of its length


class Proxy(Part):
    """The gizmo is the master's handle; a proxy in another place is drawn as a ball."""

    def __init__(self, api: viser.SceneApi, labels: Labels, handle: pin.SE3) -> None:
        wxyz, position = pose_to_view(handle)
        self.gizmo = api.add_transform_controls(
            "/proxy/gizmo",
            scale=GIZMO_SIZE,
            fixed=True,  # size in pixels, at any distance
            line_width=3.5,
            depth_test=False,
            opacity=0.8,
            wxyz=wxyz,
            position=position,
        )
        self._name = labels.add("/proxy/gizmo_name", anchor="top-right")
        self._ball = nodes.dot(api, "/proxy/ball", palette.PROXY, 0.12)
        self._ball_name = labels.add("/proxy/ball_name", "proxy", anchor="bottom-right")
        self._tether = nodes.lines(api, "/proxy/tether", 2.5, palette.PROXY)
        self.show_tether = True
        self.show_labels = True
        self.holder = ""
        """Name of the client that drags the gizmo, for its label; may be empty."""
        self.suppressed = False
        """Draw nothing: the inspector's probe is shown instead."""

    def place(self, handle: pin.SE3) -> None:
        """Move the gizmo; not during a drag."""
        self.gizmo.wxyz, self.gizmo.position = pose_to_view(handle)

    def frame(self, shown: Moment, clients: Clients) -> None:
        """Without a target the handle is the proxy; without a handle only the target is drawn."""
        handle, target = shown.handle, shown.telemetry.target
        p_tip = shown.tip.translation
        locked = shown.options.lock_orientation
        if self.gizmo.disable_rotations != locked:
            self.gizmo.disable_rotations = locked
        suppressed = self.suppressed or (handle is None and target is None)
        by_hand = handle is not None and not suppressed
        if handle is None:
            handle = pin.SE3(np.eye(3), p_tip) if target is None else target
            apart = target is not None
        else:
            apart = target is not None and bool(
                np.abs(target.translation - handle.translation).max() > MIN_TETHER
            )
        self._name.position = to_view(handle.translation)
        self._name.text = ("handle" if apart else "proxy") + (
            f" · {self.holder}" if self.holder else ""
        )
        self.gizmo.visible = by_hand
        self._name.visible = self.show_labels and by_hand
        goal = handle if target is None else target
        self._ball.visible = apart and not suppressed
        self._ball_name.visible = self._ball.visible and self.show_labels
        if apart:
            self._ball.position = to_view(goal.translation)
            self._ball_name.position = to_view(goal.translation)
        offset = goal.translation - p_tip
        taut = self.show_tether and not suppressed and bool(np.linalg.norm(offset) > MIN_TETHER)
        if taut:
            self._tether.position = to_view(p_tip)
            self._tether.points = to_buffer(spring(offset))
        self._tether.visible = taut


def spring(offset: np.ndarray) -> np.ndarray:
    """Pieces (m, 2, 3) of a spring from the origin to an offset (3,) [m]."""
    length = float(np.linalg.norm(offset))
    radius = min(COIL[0], COIL[1] * length)
    wxyz = turn_z_to(offset[None] / length)[0]
    turn = pin.Quaternion(*wxyz.tolist()).matrix()
    points = (_COIL * [radius, radius, length]) @ turn.T
    return np.stack([points[:-1], points[1:]], axis=1)
