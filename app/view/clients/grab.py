"""Dragging the tool itself: onto the surface and along it, in depth, and turning."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin
import viser
from numpy.typing import NDArray

from app.scene.picking import along, pick
from app.session import Session
from app.view.camera import axes_of
from app.view.clients.client_input import ClientInput, Notify
from app.view.source import Source
from app.view.units import VIEW_SCALE

FloatArray = NDArray[np.float64]

TOOL = "tool"  # what is dragged
# What a drag with the left button does, by the keys that are held.
PLANE, DEPTH, TURN, SURFACE = None, "shift", "cmd/ctrl", "cmd/ctrl+shift"
TURN_RATE = np.pi  # by a drag across the whole view [rad]
PRESSED = 5e-4  # of a proxy that slides on a surface, how far behind it [m]
# The plane of a drag is not seen more nearly edge-on than this, or its points are too far apart on
# the screen.
EDGE_ON = np.sin(np.deg2rad(30.0))
GRAZING = np.sin(np.deg2rad(10.0))  # a pointer's ray that meets the plane at less is not followed
NOTCH = 5e-4  # in depth, by a notch of the wheel [m]
# Another key pressed during a drag ends it and begins another, which goes on from there. One that
# begins later begins at the tool.
SAME_GESTURE = 0.5  # [s]
HINT = (
    "You hold the tool: drag it onto the surface, along it and off again. The wheel, or Shift "
    "while dragging, moves it nearer and farther; Ctrl turns it; with Ctrl and Shift it slides "
    "along the surface below the pointer. On a touch screen two fingers move it in depth and turn "
    "it."
)


class Grab:
    """Makes bodies of the tool draggable. The proxy starts at the tool and moves with the pointer.

    The gizmo leaves the proxy where it was dragged to; so does this, until the tool is grabbed
    again.
    """

    def __init__(
        self,
        session: Session,
        source: Source,
        client_input: ClientInput,
        notify: Notify,
        available: Callable[[], bool],
    ) -> None:
        """`available`: whether there is a proxy to be moved: not in a replay, for instance."""
        self._session = session
        self._available = available
        self._source = source
        self._input = client_input
        self._notify = notify
        self._told: set[int] = set()  # clients that have seen the hint
        # Of the drag that goes on; written by the worker.
        self._start: pin.SE3 | None = None
        self._facing = np.zeros(3)  # unit normal of the drag's plane, away from the viewer
        self._pointer = np.zeros(3)
        self._screen = np.zeros(2)
        self._ended = -np.inf
        self._reached: dict[int, tuple[float, float]] = {}  # what clients last said of their wheel

    @property
    def holds(self) -> bool:
        """Whether a client holds the tool."""
        return self._start is not None

    def attach(self, node: Any) -> None:
        """Let a body be dragged."""
        for keys in (PLANE, DEPTH, TURN, SURFACE):
            node.on_drag("left", modifier=keys)(self._moved)

    async def _moved(self, event: viser.SceneNodeDragEvent[Any]) -> None:
        if event.client is None:
            return
        # Copied on the event loop, so that all are of one moment.
        camera = event.client.camera
        self._input.submit(
            self._drag, event.client, event.phase, event.modifier,
            np.array(event.end_position), np.array(event.end_screen_pos),
            np.array(camera.wxyz), np.array(camera.position),
        )  # fmt: skip

    def _drag(
        self,
        client: viser.ClientHandle,
        phase: str,
        keys: str | None,
        pointer: FloatArray,
        screen: FloatArray,
        wxyz: FloatArray,
        eye: FloatArray,
    ) -> None:
        if phase == "start" and not self._available():
            self._notify(client, "The proxy is not shown, so the tool cannot be dragged.")
            return
        read = partial(self._read, phase, keys, pointer, screen, wxyz, eye)
        counts = self._input.drag(TOOL, client, client.client_id, phase, read)
        if counts and phase == "start" and client.client_id not in self._told:
            self._told.add(client.client_id)
            self._notify(client, HINT)

    def _read(
        self,
        phase: str,
        keys: str | None,
        pointer: FloatArray,
        screen: FloatArray,
        wxyz: FloatArray,
        eye: FloatArray,
    ) -> pin.SE3:
        """The handle's pose for a place of the pointer, on the plane of the drag and on screen."""
        session = self._session
        if phase == "start" or self._start is None:
            if time.monotonic() - self._ended > SAME_GESTURE:
                session.recall()
            self._start, self._pointer, self._screen = session.handle, pointer, screen
            self._facing = self._plane(session.handle.translation, pointer / VIEW_SCALE, eye)
        start = self._start
        if phase == "end":
            self._start, self._ended = None, time.monotonic()
        axes = axes_of(wxyz)
        if keys == TURN:
            return turned(start, axes, screen - self._screen)
        if keys == SURFACE:
            return self._on_surface(session.handle, eye, pointer)
        if keys == DEPTH:
            up = -axes[:, 1] @ (pointer - self._pointer) / VIEW_SCALE
            return pin.SE3(start.rotation, start.translation + up * axes[:, 2])
        held, origin = self._pointer / VIEW_SCALE, eye / VIEW_SCALE
        shift = on_plane(held, self._facing, origin, pointer / VIEW_SCALE - origin)
        if shift is None:
            return session.handle
        return pin.SE3(start.rotation, start.translation + shift)

    def _plane(self, p_tip: FloatArray, pointer: FloatArray, eye: FloatArray) -> FloatArray:
        """Unit normal of the plane in which a drag moves the tool, away from the viewer.

        Dragged towards the anatomy on the screen, the tool is to come onto it and not in front of
        it, so the plane contains the direction to the nearest surface.
        """
        view = pointer - eye / VIEW_SCALE
        view = view / float(np.linalg.norm(view))
        shown, nearest, down = self._source.now(), np.inf, np.zeros(3)
        for k, surface in enumerate(shown.scene.surfaces):
            pose = shown.pose(k) or pin.SE3.Identity()
            seen = pose.actInv(p_tip)
            distance, face, point = surface.nearest(seen)
            if distance < nearest:
                nearest = distance
                # On the surface it is that of its triangle.
                way = point - seen if distance > PRESSED else surface.normals[face]
                down = pose.rotation @ way
        return facing(view, down)

    def reach(self, client: viser.ClientHandle, depth: float, turn: float) -> None:
        """On the worker: what a client's wheel and fingers add up to since its page was loaded.

        Args:
            depth: notches of the wheel, away from the viewer.
            turn: of two fingers, clockwise on the screen [rad].
        """
        if not np.isfinite([depth, turn]).all():
            return
        before = self._reached.get(client.client_id, (0.0, 0.0))
        self._reached[client.client_id] = depth, turn
        if not self.holds:
            return
        away = axes_of(np.array(client.camera.wxyz))[:, 2]
        shift = np.clip(depth - before[0], -20.0, 20.0) * NOTCH * away
        spin = pin.exp3(np.clip(turn - before[1], -1.0, 1.0) * away)
        self._input.drag(
            TOOL, client, client.client_id, "update", partial(self._shifted, shift, spin)
        )

    def _shifted(self, shift: FloatArray, spin: FloatArray) -> pin.SE3:
        """The handle moved on, and the drag's start with it: the drag goes on from there."""
        before, start = self._session.handle, self._start
        assert start is not None
        self._start = pin.SE3(spin @ start.rotation, start.translation + shift)
        return pin.SE3(spin @ before.rotation, before.translation + shift)

    def _on_surface(self, present: pin.SE3, eye: FloatArray, pointer: FloatArray) -> pin.SE3:
        """The present pose at what is below the pointer; as it is where there is no anatomy."""
        shown = self._source.now()
        origin = eye / VIEW_SCALE
        way = pointer / VIEW_SCALE - origin
        nearest = np.inf
        for k, surface in enumerate(shown.scene.surfaces):
            pose = shown.pose(k) or pin.SE3.Identity()
            p, d = pose.actInv(origin), pose.rotation.T @ way
            hit = pick(surface, p, d)
            if hit >= 0:
                nearest = min(nearest, along(surface, hit, p, d))
        if not np.isfinite(nearest):
            return pin.SE3(present)
        behind = PRESSED / float(np.linalg.norm(way))
        return pin.SE3(present.rotation, origin + (nearest + behind) * way)


def facing(view: FloatArray, down: FloatArray) -> FloatArray:
    """Unit normal of a plane that contains a direction and is seen as little edge-on as that lets.

    Args:
        view: unit direction of the view; the normal where the plane would be seen edge-on.
        down: the direction, of any length.
    """
    length = float(np.linalg.norm(down))
    normal = view if length == 0.0 else view - (view @ down) * down / length**2
    tilt = float(np.linalg.norm(normal))
    return view if tilt < EDGE_ON else np.asarray(normal / tilt)


def on_plane(
    p: FloatArray, normal: FloatArray, origin: FloatArray, way: FloatArray
) -> FloatArray | None:
    """From p to where a ray meets the plane through p; None: it does not, or at a grazing angle."""
    slope = float(normal @ way)
    if slope < GRAZING * float(np.linalg.norm(way)):
        return None
    return np.asarray(origin + (normal @ (p - origin)) / slope * way - p)


def turned(pose: pin.SE3, axes: FloatArray, moved: FloatArray) -> pin.SE3:
    """A pose turned about its origin as if the pointer held its near side.

    Args:
        axes: of the camera, see `axes_of`.
        moved: (2,) of the pointer, to the right and down, in widths and heights of the view.
    """
    about = TURN_RATE * (moved[1] * axes[:, 0] - moved[0] * axes[:, 1])
    return pin.SE3(pin.exp3(about) @ pose.rotation, np.array(pose.translation))
