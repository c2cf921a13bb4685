"""Layer: the instrument as the whole-tool guard sees it, its capsules and the trocar zone."""

from __future__ import annotations

import numpy as np
import viser
from numpy.typing import NDArray

from app.scene.moment import Moment
from app.scene.scene import Scene
from app.view import palette
from app.view.drawing import nodes
from app.view.drawing.fixture import MIN_PUSH
from app.view.part import Clients, Part
from app.view.units import to_buffer, to_view, turn_z_to
from robots import Arm

FloatArray = NDArray[np.float64]

SEGMENTS = 20  # of a capsule's circumference
MIN_CHANGE = 2e-5  # a capsule whose axis is longer or shorter by less is not made anew [m]
MAX_PARTS = 8
OPACITY = 0.45
LIFT = 3e-4  # capsules are drawn larger by this: their surface is that of the arm's drawing [m]


class Instrument(Part):
    """The capsules of the arm, coloured by what holds them, and the ball of the trocar zone."""

    def __init__(self, api: viser.SceneApi) -> None:
        self._capsules = [
            nodes.mesh(api, f"/instrument/capsule{k}", palette.PART, opacity=OPACITY)
            for k in range(MAX_PARTS)
        ]
        self._zone = api.add_icosphere(
            "/instrument/trocar",
            radius=1.0,
            color=palette.TROCAR,
            opacity=0.25,
            cast_shadow=False,
            receive_shadow=False,
            visible=False,
        )
        self._arm: Arm | None = None
        self._lengths = np.full(MAX_PARTS, np.nan)
        self.show = False
        """Layer switch of the capsules. The trocar zone is drawn whenever there is one."""

    def set_scene(self, scene: Scene) -> None:
        self._arm = scene.arm
        self._lengths[:] = np.nan
        for node in self._capsules:
            node.visible = False

    def frame(self, shown: Moment, clients: Clients) -> None:
        arm, options, q = self._arm, shown.options, shown.telemetry.q
        if arm is None or len(q) != len(arm.lower):
            return  # telemetry of the previous scene
        ports = [k for k, capsule in enumerate(arm.capsules) if capsule.port]
        zone = options.guards_tool and options.trocar > 0.0 and len(ports) > 0
        axes = arm.axes(q) if self.show or zone else None
        self._zone.visible = zone
        if zone and axes is not None:
            self._zone.position = to_view(axes[ports[0], 0])
            self._zone.scale = float(to_view(options.trocar))
        parts = list(zip(self._capsules, arm.capsules, strict=False))
        for node, _ in parts:
            node.visible = self.show
        if axes is None or not self.show:
            return
        held = part_states(shown)
        for k, (node, capsule) in enumerate(parts):
            start, way = axes[k, 0], axes[k, 1] - axes[k, 0]
            length = float(np.linalg.norm(way))
            if not abs(length - self._lengths[k]) < MIN_CHANGE:
                self._lengths[k] = length
                vertices, faces = solid(capsule.radius + LIFT, length)
                node.vertices, node.faces = to_buffer(vertices), faces
            node.position = to_view(start)
            if length > 0.0:
                node.wxyz = turn_z_to(way[None] / length)[0]
            if node.color != held[k]:
                node.color = held[k]


def part_states(shown: Moment) -> list[palette.Rgb]:
    """The colour of each part: held back, with planes but not held, or neither."""
    step, count = shown.telemetry.step, len(shown.scene.arm.capsules)
    colors = [palette.PART] * count
    if step is None or step.planes.capsules is None:
        return colors
    for k, push in zip(step.planes.capsules.tolist(), step.multipliers, strict=True):
        if k < count and push > MIN_PUSH:
            colors[k] = palette.PART_HELD
        elif k < count and colors[k] != palette.PART_HELD:
            colors[k] = palette.PART_NEAR
    return colors


def solid(radius: float, length: float) -> tuple[FloatArray, NDArray[np.uint32]]:
    """A capsule around the axis from the origin along z: vertices (n, 3) [m], faces (m, 3)."""
    bend = np.linspace(0.0, np.pi / 2, SEGMENTS // 4 + 1)
    # From the lower pole to the upper: distance from the axis, and height.
    rho = radius * np.concatenate([np.sin(bend), np.cos(bend)])
    z = np.concatenate([-radius * np.cos(bend), length + radius * np.sin(bend)])
    angle = np.linspace(0.0, 2.0 * np.pi, SEGMENTS, endpoint=False)
    vertices = np.stack(
        [
            rho[:, None] * np.cos(angle),
            rho[:, None] * np.sin(angle),
            np.repeat(z[:, None], SEGMENTS, axis=1),
        ],
        axis=2,
    ).reshape(-1, 3)
    ring, k = np.meshgrid(np.arange(len(z) - 1), np.arange(SEGMENTS), indexing="ij")
    following = (k + 1) % SEGMENTS
    a, b = ring * SEGMENTS + k, ring * SEGMENTS + following
    c, d = a + SEGMENTS, b + SEGMENTS
    faces = np.concatenate([np.stack([a, b, d], axis=2), np.stack([a, d, c], axis=2)])
    return vertices, faces.reshape(-1, 3).astype(np.uint32)
