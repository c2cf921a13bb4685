"""The anatomy cut open through the tip: what is between the tip and the eye is not drawn."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
import viser
from numpy.typing import NDArray
from trimesh import intersections

from app.recording.playback import Moment
from app.scene.scene import Scene
from app.view.anatomy import Anatomy
from app.view.part import Clients, Part
from app.view.units import to_view
from app.view.worker import Worker

FloatArray = NDArray[np.float64]

PERIOD = 0.4  # shortest time between two cuts: each is sent to the browsers anew [s]
SHIFT = 1e-4  # a plane that moved by less is left where it is [m]
TURN = np.cos(np.deg2rad(2.0))  # and one that turned by less, as a cosine


@dataclass(frozen=True)
class Cut:
    """A plane through `point` (3,) [m]; `normal` (3,) points to the side that is left out."""

    scene: Scene
    point: FloatArray
    normal: FloatArray

    def near(self, other: Cut | None) -> bool:
        """Whether another cut looks the same."""
        return (
            other is not None
            and other.scene is self.scene
            and abs(float((other.point - self.point) @ self.normal)) < SHIFT
            and float(other.normal @ self.normal) > TURN
        )


@dataclass(frozen=True)
class Remainder:
    """What a cut leaves of what is drawn: vertices (n, 3) [m], faces (m, 3)."""

    cut: Cut
    vertices: FloatArray
    faces: NDArray[np.int64]


class Section(Part):
    """Cuts for one client's eye, on a thread of its own; everybody sees them.

    `toggle` comes from the hand's worker and changes one attribute; the rest is the view thread's.
    """

    def __init__(self, anatomy: Anatomy) -> None:
        self._anatomy = anatomy
        self._worker: Worker[Cut, Remainder] = Worker("section", make)
        self._client_id: int | None = None  # whose eye it is; None: there is no section
        self._requested: Cut | None = None
        self._requested_at = 0.0  # monotonic time of the last question [s]
        self._drawn: Remainder | None = None

    @property
    def on(self) -> bool:
        """Whether the anatomy is cut."""
        return self._client_id is not None

    def toggle(self, client: viser.ClientHandle) -> None:
        """Cut the anatomy for this client's eye; or, cut already, make it whole."""
        self._client_id = None if self.on else client.client_id

    def frame(self, shown: Moment, clients: Clients) -> None:
        """Keep the cut at the tip."""
        self.update(shown.scene, clients, np.array(shown.tip.translation))

    def update(
        self, scene: Scene, clients: dict[int, viser.ClientHandle], p_tip: FloatArray
    ) -> None:
        """Keep the cut at the tip, (3,) [m], facing the eye."""
        client = None if self._client_id is None else clients.get(self._client_id)
        if client is None:
            self._client_id = self._requested = None
            if self._drawn is not None:
                self._drawn = None
                self._anatomy.cut(None)
            return
        now = time.monotonic()
        away = client.camera.position - to_view(p_tip)
        length = float(np.linalg.norm(away))
        if now > self._requested_at + PERIOD and length > 0.0:
            cut = Cut(scene, np.array(p_tip), away / length)
            if not cut.near(self._requested):
                self._requested_at, self._requested = now, cut
                self._worker.request(cut)
        part = self._worker.latest()
        if part is None or self._requested is None or part is self._drawn:
            return
        # An answer from before the section was last switched off is an older one's.
        if part.cut.scene is scene and part.cut.near(self._requested):
            self._drawn = part
            self._anatomy.cut((part.vertices, part.faces))


def make(cut: Cut) -> Remainder:
    """The part of what is drawn of a scene that lies behind a plane."""
    vertices, faces = cut.scene.vertices_shown, cut.scene.faces_shown
    kept, corners, _ = intersections.slice_faces_plane(vertices, faces, -cut.normal, cut.point)
    if len(corners) == 0:  # a node of the scene has a triangle at least
        kept, corners = np.tile(cut.point, (3, 1)), np.array([[0, 1, 2]])
    return Remainder(cut, np.asarray(kept, dtype=np.float64), np.asarray(corners, dtype=np.int64))
