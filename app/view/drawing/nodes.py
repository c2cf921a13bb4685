"""Lights of the scene, and nodes, mostly created hidden; their geometry or place follows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import viser
from numpy.typing import NDArray

from app.view.camera import DIRECTION
from app.view.palette import Rgb
from app.view.units import pose_to_view

FloatArray = NDArray[np.float64]


def mesh(api: viser.SceneApi, name: str, color: Rgb, **more: Any) -> viser.MeshHandle:
    """A hidden two-sided mesh without shadows; a node needs at least one triangle."""
    shape = {"vertices": np.zeros((3, 3)), "faces": np.array([[0, 1, 2]], dtype=np.uint32)}
    return api.add_mesh_simple(
        name,
        **{**shape, **more},
        color=color,
        side="double",
        cast_shadow=False,
        receive_shadow=False,
        visible=False,
    )


def lines(
    api: viser.SceneApi, name: str, thickness: float, color: Rgb | None = None, count: int = 1
) -> viser.LineSegmentsHandle:
    """`count` hidden segments, `thickness` [px]; without a color each has one of its own."""
    return api.add_line_segments(
        name,
        points=np.zeros((count, 2, 3), dtype=np.float32),
        colors=np.zeros((count, 2, 3), dtype=np.uint8) if color is None else color,
        thickness=thickness,
        thickness_units="screen",
        visible=False,
    )


def dot(
    api: viser.SceneApi, name: str, color: Rgb, size: float, visible: bool = False
) -> viser.PointCloudHandle:
    """A round point; `size` [scene units]."""
    return api.add_point_cloud(
        name,
        points=np.zeros((1, 3), dtype=np.float32),
        colors=np.array([color], dtype=np.uint8),
        point_size=size,
        point_shape="circle",
        visible=visible,
    )


def ball(api: viser.SceneApi, name: str, color: Rgb) -> viser.IcosphereHandle:
    """A hidden ball of radius 1 [scene units] without shadows."""
    return api.add_icosphere(
        name, radius=1.0, color=color, cast_shadow=False, receive_shadow=False, visible=False
    )


def place(node: viser.SceneNodeHandle | None, pose: pin.SE3 | None) -> None:
    """Put a node whose geometry is in the base frame where a pose takes it; None: where it is."""
    if node is not None:
        node.wxyz, node.position = pose_to_view(pin.SE3.Identity() if pose is None else pose)


def add_lights(api: viser.SceneApi) -> None:
    """Hemisphere light and one directional light, without shadows."""
    # viser's own lights wash out light colours such as bone.
    api.configure_default_lights(False, cast_shadow=False)
    # Without a graphics card an environment map takes some hundred times the time of all the rest.
    api.configure_environment_map(None)
    api.add_light_hemisphere(
        "/light/sky", sky_color=(255, 255, 255), ground_color=(150, 140, 130), intensity=1.7
    )
    api.add_light_directional("/light/sun", intensity=1.9, position=(60.0, 10.0, 60.0))


def towards_viewer(normals: FloatArray) -> FloatArray:
    """Unit vectors (m, 3) in the planes, towards the camera of the first view."""
    along = DIRECTION - (normals @ DIRECTION)[:, None] * normals
    length = np.linalg.norm(along, axis=1, keepdims=True)
    return np.asarray(along / np.maximum(length, 1e-6))
