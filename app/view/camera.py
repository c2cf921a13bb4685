"""Camera views of a scene, and motion of a client's camera."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin
import viser
from numpy.typing import NDArray

import vf
from app.scene.scene import Scene
from app.view.units import to_view

FloatArray = NDArray[np.float64]

FIELD_OF_VIEW = np.deg2rad(40.0)  # vertical [rad]
# viser has no orthographic camera. This narrow one, 20 times as far away, approximates it: what is
# half a picture's height nearer than the centre is drawn 1.8 % larger.
PARALLEL = np.deg2rad(2.0)
NEAR_PLANE = 0.02  # clipping distance, 0.2 mm [scene units]
FAR_PLANE = 2000.0  # 20 m [scene units]
# To the first view's camera: front right and above, where no arm's body hides the mesh.
DIRECTION = np.array([0.55, 0.62, 0.56]) / np.linalg.norm([0.55, 0.62, 0.56])


# Directions of the axis views' cameras, and of up in their pictures.
AXES: dict[str, tuple[FloatArray, FloatArray]] = {
    "Side": (np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])),
    "Front": (np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])),
    "Top": (np.array([0.0, 0.0, 1.0]), np.array([0.0, -1.0, 0.0])),
}


@dataclass(frozen=True)
class View:
    """Position of the eye, centre and up direction, (3,) each, arm base frame [m].

    The eye's distance is for the field of view `FIELD_OF_VIEW`.
    """

    eye: FloatArray
    look_at: FloatArray
    up: FloatArray = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))


def site_view(scene: Scene, p_tip: FloatArray) -> View:
    """The first view: wrist, tip p_tip (3,) [m], motion sphere and the surface below.

    The tip is in the upper half, which the panels leave free on an upright phone.
    """
    half_height = site_half_height(scene)
    return _framing(p_tip - np.array([0.0, 0.0, 0.55 * half_height]), half_height)


def site_half_height(scene: Scene) -> float:
    """Half the height of the region that `site_view` shows [m]."""
    # At most 34 mm, so that a motion sphere of 5 mm is larger than the gizmo.
    half_height = float(np.clip(0.25 * scene.surface.size, 8e-3, 0.034))
    return max(half_height, 2.0 * _width_at_tip(scene))


def axis_view(scene: Scene, p_tip: FloatArray, name: str) -> View:
    """The region of `site_view` along an axis of the arm's base frame; `name`: of `AXES`."""
    direction, up = AXES[name]
    view = site_view(scene, p_tip)
    distance = float(np.linalg.norm(view.eye - view.look_at))
    return View(view.look_at + distance * direction, view.look_at, up)


def anatomy_view(scene: Scene) -> View:
    """The mesh with the tool above it."""
    low, high = scene.vertices_shown.min(axis=0), scene.vertices_shown.max(axis=0)
    p_tip = scene.T_base_start.translation
    centre = 0.5 * (low + high)
    centre[2] = 0.35 * low[2] + 0.65 * max(high[2], p_tip[2])
    return _framing(centre, 0.58 * float(np.linalg.norm(high - low)))


def arm_view(scene: Scene, q: FloatArray) -> View:
    """The whole arm and the mesh."""
    placements = scene.arm.placements(q)
    corners = [scene.vertices_shown.min(axis=0), scene.vertices_shown.max(axis=0)]
    for body, row in zip(scene.arm.bodies, placements, strict=True):
        reach = float(np.linalg.norm(body.vertices, axis=1).max()) if len(body.vertices) else 0.0
        middle = _rotated(row[:4], 0.5 * (body.vertices.min(axis=0) + body.vertices.max(axis=0)))
        half = 0.5 * float(np.linalg.norm(np.ptp(body.vertices, axis=0))) if reach else 0.0
        corners += [row[4:] + middle - 0.7 * half, row[4:] + middle + 0.7 * half]
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    return _framing(0.5 * (low + high), 0.46 * float(np.linalg.norm(high - low)))


def tool_view(step: vf.Step) -> View:
    """The tip and its motion sphere, from above the nearest surface."""
    p_tip = np.array(step.tip.translation)
    view = _framing(p_tip, 1.6 * max(step.radius, 5e-4))
    if len(step.planes) == 0:
        return view
    foremost = np.lexsort((step.planes.slack(p_tip), -step.multipliers))[0]
    normal = step.planes.normals[foremost]
    along = DIRECTION - (DIRECTION @ normal) * normal
    if np.linalg.norm(along) < 1e-3:
        return view
    # 35° above the surface: at smaller angles a curved one hides the tip.
    direction = 0.57 * normal + 0.82 * along / np.linalg.norm(along)
    return View(p_tip + np.linalg.norm(view.eye - p_tip) * direction, p_tip)


def named_view(name: str, scene: Scene, step: vf.Step | None) -> View:
    """The view of that name; `site_view` for an unknown one.

    Args:
        step: the last step; None: the tool is at its start.
    """
    if name == "Arm":
        return arm_view(scene, scene.start)
    if name == "Anatomy":
        return anatomy_view(scene)
    p_tip = np.array((scene.T_base_start if step is None else step.tip).translation)
    if name in AXES:
        return axis_view(scene, p_tip, name)
    if name in ("Tool", "Follow") and step is not None:
        return tool_view(step)
    if name == "Surgeon" and step is not None:
        return surgeon_view(step)
    return site_view(scene, p_tip)


def surgeon_view(step: vf.Step) -> View:
    """Along the instrument to the tip, as through an endoscope beside it."""
    p_tip = np.array(step.tip.translation)
    towards_wrist = -np.array(step.tip.rotation[:, 2])
    # 35° off the instrument's axis, on the side of the first view.
    aside = DIRECTION - (DIRECTION @ towards_wrist) * towards_wrist
    length = float(np.linalg.norm(aside))
    aside = aside / length if length > 1e-6 else np.array([1.0, 0.0, 0.0])
    direction = np.cos(np.deg2rad(35.0)) * towards_wrist + np.sin(np.deg2rad(35.0)) * aside
    # A vertical direction would leave the camera's up direction undefined.
    if np.linalg.norm(direction[:2]) < 0.1:
        direction = direction + 0.1 * np.array([*DIRECTION[:2], 0.0])
        direction = direction / np.linalg.norm(direction)
    return View(p_tip + 0.07 * direction, p_tip)


class Following:
    """Cameras that keep the tool centred; clients can still rotate and zoom them."""

    def __init__(self) -> None:
        self._last: dict[int, FloatArray] = {}  # tip position at the last motion [m], by client

    @property
    def clients(self) -> tuple[int, ...]:
        """Clients whose cameras follow."""
        return tuple(self._last)

    def start(self, client_id: int, p_tip: FloatArray) -> None:
        """Follow from here; p_tip (3,) [m]."""
        self._last[client_id] = np.array(p_tip)

    def stop(self, client_id: int) -> None:
        """Do not follow any more."""
        self._last.pop(client_id, None)

    def update(self, clients: dict[int, viser.ClientHandle], p_tip: FloatArray) -> None:
        """Move the cameras after the tool; p_tip (3,) [m]."""
        for client_id, last in tuple(self._last.items()):
            client = clients.get(client_id)
            if client is None:
                self.stop(client_id)
                continue
            # The reported position may be older than the last motion set here; the offset from the
            # centre, which only the client changes, is right nevertheless.
            away = client.camera.position - client.camera.look_at
            # Motions of less than about two pixels are not sent.
            moved = np.linalg.norm(to_view(p_tip - last))
            if moved < 2e-3 * np.linalg.norm(away) or client_id not in self._last:
                continue
            self._last[client_id] = np.array(p_tip)
            with client.atomic():
                client.camera.position = to_view(p_tip) + away
                client.camera.look_at = to_view(p_tip)


def set_initial_camera(server: viser.ViserServer, view: View) -> None:
    """Set the camera of new clients and of "reset view"."""
    camera = server.initial_camera
    camera.up = (0.0, 0.0, 1.0)
    camera.fov = FIELD_OF_VIEW
    camera.near = NEAR_PLANE
    camera.far = FAR_PLANE
    camera.position = to_view(view.eye)
    camera.look_at = to_view(view.look_at)


def move(client: viser.ClientHandle, view: View) -> None:
    """Move a client's camera; its field of view stays."""
    away = _rescaled(to_view(view.eye - view.look_at), FIELD_OF_VIEW, client.camera.fov)
    with client.atomic():
        client.camera.up_direction = view.up
        client.camera.position = to_view(view.look_at) + away
        client.camera.look_at = to_view(view.look_at)


def set_lens(client: viser.ClientHandle, fov: float) -> None:
    """Set a client's field of view [rad]; objects at the centre keep their size."""
    camera = client.camera
    look_at = np.array(camera.look_at)
    away = _rescaled(camera.position - look_at, camera.fov, fov)
    with client.atomic():
        camera.fov = fov
        camera.position = look_at + away
        camera.look_at = look_at
    update_clipping(client)


def is_parallel(client: viser.ClientHandle) -> bool:
    """Whether a client's field of view is `PARALLEL`."""
    return bool(client.camera.fov < 0.5 * (PARALLEL + FIELD_OF_VIEW))


def update_clipping(client: viser.ClientHandle) -> None:
    """Adapt the clipping planes to the camera's distance, to keep the depth precision."""
    camera = client.camera
    near, far = NEAR_PLANE, FAR_PLANE
    if is_parallel(client):
        distance = float(np.linalg.norm(camera.position - camera.look_at))
        near, far = 0.5 * distance, distance + FAR_PLANE
    # Small changes are not sent.
    if not 0.8 < camera.near / near < 1.25:
        camera.near, camera.far = near, far


def _rescaled(away: FloatArray, before: float, after: float) -> FloatArray:
    """Offset of the eye from the centre that shows the same region with another field of view."""
    return away * np.tan(0.5 * before) / np.tan(0.5 * after)


def _framing(centre: FloatArray, half_height: float) -> View:
    """The view in which a ball of radius `half_height` [m] fills the picture's height."""
    distance = half_height / np.sin(FIELD_OF_VIEW / 2.0)
    return View(centre + distance * DIRECTION, centre)


def _width_at_tip(scene: Scene) -> float:
    """Largest horizontal distance from the tip to the arm's bodies within 6 cm [m]."""
    p_tip = scene.T_base_start.translation
    widest = 0.0
    placements = scene.arm.placements(scene.start)
    for body, row in zip(scene.arm.bodies, placements, strict=True):
        away = row[4:] + _rotated(row[:4], body.vertices.astype(np.float64)) - p_tip
        near = np.linalg.norm(away, axis=1) < 0.06
        widest = max(widest, float(np.linalg.norm(away[near, :2], axis=1).max(initial=0.0)))
    return widest


def _rotated(wxyz: FloatArray, p: FloatArray) -> FloatArray:
    w, v = wxyz[0], wxyz[1:]
    return np.asarray(p + 2.0 * np.cross(v, np.cross(v, p) + w * p))


def axes_of(wxyz: FloatArray) -> FloatArray:
    """A camera's axes right, down and away, as columns (3, 3)."""
    w, x, y, z = wxyz
    return np.array(pin.Quaternion(w, x, y, z).normalized().matrix())


def viewer_axes(wxyz: FloatArray) -> FloatArray:
    """The level axes right, away and up (+z) of a viewer, as columns (3, 3).

    Args:
        wxyz: (4,) the camera's orientation, +z forward and +x right as in viser.
    """
    w, x, y, z = np.asarray(wxyz, dtype=np.float64)
    right = np.array([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 0.0])
    # The camera's +x axis, projected to the horizontal plane.
    length = np.linalg.norm(right)
    right = right / length if length > 1e-6 else np.array([1.0, 0.0, 0.0])
    up = np.array([0.0, 0.0, 1.0])
    return np.column_stack([right, np.cross(up, right), up])
