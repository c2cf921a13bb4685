"""Where to look from: composed views of a scene."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import viser
from numpy.typing import NDArray

import vf
from app.scene.scene import Scene
from app.view.units import to_view

FloatArray = NDArray[np.float64]

FIELD_OF_VIEW = np.deg2rad(40.0)  # vertical [rad]
# viser has no orthographic camera. A lens this narrow, 20 times as far away, comes near one: what
# is half a picture's height nearer than the middle is drawn 1.8 % larger.
PARALLEL = np.deg2rad(2.0)
NEAR_PLANE = 0.02  # clipping plane in scene units: 0.2 mm, to look at a sphere of that size
FAR_PLANE = 2000.0  # 20 m
# From the front right and above, the side of the mesh that the arms' bodies do not hide.
DIRECTION = np.array([0.55, 0.62, 0.56]) / np.linalg.norm([0.55, 0.62, 0.56])


# Where axis views look from, and what is up in them. The page's first view is from +x, +y and +z.
AXES: dict[str, tuple[FloatArray, FloatArray]] = {
    "Side": (np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])),
    "Front": (np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])),
    "Top": (np.array([0.0, 0.0, 1.0]), np.array([0.0, -1.0, 0.0])),
}


@dataclass(frozen=True)
class View:
    """Eye, what it looks at and what is up, (3,) each, arm base frame [m].

    The eye's distance is for a lens of `FIELD_OF_VIEW`.
    """

    eye: FloatArray
    look_at: FloatArray
    up: FloatArray = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))


def site_view(scene: Scene, p_tip: FloatArray) -> View:
    """Wrist, tip, motion sphere and what lies under them: the first sight; p_tip (3,) [m].

    The tip is in the upper half, which a phone held upright leaves free.
    """
    half_height = site_half_height(scene)
    return _framing(p_tip - np.array([0.0, 0.0, 0.55 * half_height]), half_height)


def site_half_height(scene: Scene) -> float:
    """Half of what `site_view` shows from top to bottom [m]."""
    # A motion sphere of 5 mm is then larger than the gizmo.
    half_height = float(np.clip(0.25 * scene.surface.size, 8e-3, 0.034))
    return max(half_height, 2.0 * _width_at_tip(scene))


def axis_view(scene: Scene, p_tip: FloatArray, name: str) -> View:
    """As much as `site_view` shows, along an axis of the arm's base frame: a name of `AXES`."""
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
    """The tip and its motion sphere, seen from above the surface it is at."""
    p_tip = np.array(step.tip.translation)
    view = _framing(p_tip, 1.6 * max(step.radius, 5e-4))
    if len(step.planes) == 0:
        return view
    foremost = np.lexsort((step.planes.slack(p_tip), -step.multipliers))[0]
    normal = step.planes.normals[foremost]
    along = DIRECTION - (DIRECTION @ normal) * normal
    if np.linalg.norm(along) < 1e-3:
        return view
    # Thirty-five degrees above the surface: lower, and a curved one hides the tip.
    direction = 0.57 * normal + 0.82 * along / np.linalg.norm(along)
    return View(p_tip + np.linalg.norm(view.eye - p_tip) * direction, p_tip)


def named_view(name: str, scene: Scene, step: vf.Step | None) -> View:
    """The view of that name, of the tool where it is; an unknown one is the site's.

    Args:
        step: what the tool did last; None: it is at its start.
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
    """As through an endoscope beside the instrument: down along it, from its back, at the tip."""
    p_tip = np.array(step.tip.translation)
    towards_wrist = -np.array(step.tip.rotation[:, 2])
    # An endoscope stands beside the instrument on the side the page looks from, 35° off its axis.
    aside = DIRECTION - (DIRECTION @ towards_wrist) * towards_wrist
    length = float(np.linalg.norm(aside))
    aside = aside / length if length > 1e-6 else np.array([1.0, 0.0, 0.0])
    direction = np.cos(np.deg2rad(35.0)) * towards_wrist + np.sin(np.deg2rad(35.0)) * aside
    # Straight up and down there is no level horizon to hold the camera by.
    if np.linalg.norm(direction[:2]) < 0.1:
        direction = direction + 0.1 * np.array([*DIRECTION[:2], 0.0])
        direction = direction / np.linalg.norm(direction)
    return View(p_tip + 0.07 * direction, p_tip)


class Following:
    """Cameras that keep the tool in their middle, and are still turned and zoomed by hand."""

    def __init__(self) -> None:
        self._last: dict[int, FloatArray] = {}  # by client: the tip when last moved [m]

    @property
    def clients(self) -> tuple[int, ...]:
        """Whose cameras follow."""
        return tuple(self._last)

    def start(self, client_id: int, p_tip: FloatArray) -> None:
        """Follow from here; p_tip (3,) [m]."""
        self._last[client_id] = np.array(p_tip)

    def stop(self, client_id: int) -> None:
        """Let the camera stand."""
        self._last.pop(client_id, None)

    def update(self, clients: dict[int, viser.ClientHandle], p_tip: FloatArray) -> None:
        """Move the cameras after the tool; p_tip (3,) [m]."""
        for client_id, last in tuple(self._last.items()):
            client = clients.get(client_id)
            if client is None:
                self.stop(client_id)
                continue
            # Where a client says its camera is may be older than what it was told last; from where
            # to where it looks, the one thing that is its own, is right all the same.
            away = client.camera.position - client.camera.look_at
            # What is less than a pixel or two is not worth a message.
            moved = np.linalg.norm(to_view(p_tip - last))
            if moved < 2e-3 * np.linalg.norm(away) or client_id not in self._last:
                continue
            self._last[client_id] = np.array(p_tip)
            with client.atomic():
                client.camera.position = to_view(p_tip) + away
                client.camera.look_at = to_view(p_tip)


def set_initial_camera(server: viser.ViserServer, view: View) -> None:
    """What new clients start with, and where "reset view" goes."""
    camera = server.initial_camera
    camera.up = (0.0, 0.0, 1.0)
    camera.fov = FIELD_OF_VIEW
    camera.near = NEAR_PLANE
    camera.far = FAR_PLANE
    camera.position = to_view(view.eye)
    camera.look_at = to_view(view.look_at)


def move(client: viser.ClientHandle, view: View) -> None:
    """Put one client's camera there; its lens stays what it is."""
    away = _rescaled(to_view(view.eye - view.look_at), FIELD_OF_VIEW, client.camera.fov)
    with client.atomic():
        client.camera.up_direction = view.up
        client.camera.position = to_view(view.look_at) + away
        client.camera.look_at = to_view(view.look_at)


def set_lens(client: viser.ClientHandle, fov: float) -> None:
    """Give one client another field of view [rad]; what it looks at keeps its size."""
    camera = client.camera
    look_at = np.array(camera.look_at)
    away = _rescaled(camera.position - look_at, camera.fov, fov)
    with client.atomic():
        camera.fov = fov
        camera.position = look_at + away
        camera.look_at = look_at
    update_clipping(client)


def is_parallel(client: viser.ClientHandle) -> bool:
    """Whether a client looks through the lens of `PARALLEL`."""
    return bool(client.camera.fov < 0.5 * (PARALLEL + FIELD_OF_VIEW))


def update_clipping(client: viser.ClientHandle) -> None:
    """Have a far camera tell near from far: its clipping planes go along with its distance."""
    camera = client.camera
    near, far = NEAR_PLANE, FAR_PLANE
    if is_parallel(client):
        distance = float(np.linalg.norm(camera.position - camera.look_at))
        near, far = 0.5 * distance, distance + FAR_PLANE
    # What changes little is not worth a message.
    if not 0.8 < camera.near / near < 1.25:
        camera.near, camera.far = near, far


def _rescaled(away: FloatArray, before: float, after: float) -> FloatArray:
    """From what is looked at to the eye, so that another field of view [rad] shows as much."""
    return away * np.tan(0.5 * before) / np.tan(0.5 * after)


def _framing(centre: FloatArray, half_height: float) -> View:
    """A ball of that radius [m] just fills the picture's height."""
    distance = half_height / np.sin(FIELD_OF_VIEW / 2.0)
    return View(centre + distance * DIRECTION, centre)


def _width_at_tip(scene: Scene) -> float:
    """How far the arm reaches sideways around its tip [m]: a thick hand needs a wider view."""
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
