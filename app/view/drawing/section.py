"""Section: the anatomy cut by a plane through the tip, facing the eye."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
import viser
from numpy.typing import NDArray
from trimesh import intersections

from app.scene.moment import Moment, seen_from
from app.scene.scene import Scene
from app.view.drawing.anatomy import Anatomy
from app.view.part import Clients, Part
from app.view.units import to_view
from app.view.worker import Worker

FloatArray = NDArray[np.float64]

PERIOD = 0.4  # shortest time between two cuts, as each is sent to all browsers [s]
# Smaller motions of the plane make no new cut.
SHIFT = 1e-4  # [m]
TURN = np.cos(np.deg2rad(2.0))  # as a cosine


@dataclass(frozen=True)
class Cut:
    """A plane through a structure; the side that the normal points to is removed.

    Attributes:
        point, normal: (3,) of the plane, where the structure rests [m].
        number: of the structure, 0 is the mesh.
        vertices: (n, 3) of what is drawn of it, in the shape that it has [m]; None: it keeps its.
        phase: of that shape [s].
    """

    scene: Scene
    point: FloatArray
    normal: FloatArray
    number: int = 0
    vertices: FloatArray | None = None
    phase: float = 0.0

    def near(self, other: Cut | None) -> bool:
        """Whether another cut is nearly the same."""
        return (
            other is not None
            and other.scene is self.scene
            and other.number == self.number
            and other.phase == self.phase
            and abs(float((other.point - self.point) @ self.normal)) < SHIFT
            and float(other.normal @ self.normal) > TURN
        )


@dataclass(frozen=True)
class Remainder:
    """The rest of the drawn mesh: vertices (n, 3) [m], faces (m, 3)."""

    cut: Cut
    vertices: FloatArray
    faces: NDArray[np.int64]


class Section(Part):
    """Cuts the chosen structure facing one client's eye, on a thread of its own, for all clients.

    `toggle` is called on the input worker and changes one attribute; all else is the view thread's.
    """

    def __init__(self, anatomy: Anatomy) -> None:
        self._anatomy = anatomy
        self._worker: Worker[Cut, Remainder] = Worker("section", make)
        self._client_id: int | None = None  # the client that the cut faces; None: no section
        self._requested: Cut | None = None
        self._requested_at = 0.0  # monotonic time [s]
        self._drawn: Remainder | None = None
        self._number = 0  # of the structure that is cut

    @property
    def on(self) -> bool:
        """Whether the anatomy is cut."""
        return self._client_id is not None

    def toggle(self, client: viser.ClientHandle) -> None:
        """Cut the anatomy facing this client's eye, or end the section."""
        self._client_id = None if self.on else client.client_id

    def frame(self, shown: Moment, clients: Clients) -> None:
        k = self._anatomy.chosen
        deforms = shown.shape(k) is not None
        self.update(
            shown.scene, clients, np.array(shown.tip.translation), shown.pose(k), k,
            shown.telemetry.phase if deforms else 0.0,
            lambda: self._anatomy.looks(shown, k) if deforms else None,
        )  # fmt: skip

    def update(
        self,
        scene: Scene,
        clients: dict[int, viser.ClientHandle],
        p_tip: FloatArray,
        pose: pin.SE3 | None = None,
        number: int = 0,
        phase: float = 0.0,
        looks: Callable[[], FloatArray | None] = lambda: None,
    ) -> None:
        """Keep the cut at the tip, (3,) [m], facing the eye.

        The cut is in the frame in which the structure rests; its pose is where it is now, and its
        looks the vertices of what is drawn of it, at the phase of its shape.
        """
        if number != self._number:
            if self._drawn is not None:
                self._drawn = None
                self._anatomy.cut(None, self._number)
            self._number, self._requested = number, None
        client = None if self._client_id is None else clients.get(self._client_id)
        if client is None:
            self._client_id = self._requested = None
            if self._drawn is not None:
                self._drawn = None
                self._anatomy.cut(None, number)
            return
        now = time.monotonic()
        away = client.camera.position - to_view(p_tip)
        length = float(np.linalg.norm(away))
        if now > self._requested_at + PERIOD and length > 0.0:
            normal = away / length if pose is None else (away / length) @ pose.rotation
            cut = Cut(scene, np.array(seen_from(pose, p_tip)), normal, number, phase=phase)
            if not cut.near(self._requested):
                cut = replace(cut, vertices=looks())
                self._requested_at, self._requested = now, cut
                self._worker.request(cut)
        part = self._worker.latest()
        if part is None or self._requested is None or part is self._drawn:
            return
        # A result from before the section was last switched off is of another cut.
        if part.cut.scene is scene and part.cut.near(self._requested):
            self._drawn = part
            self._anatomy.cut((part.vertices, part.faces), number)


def make(cut: Cut) -> Remainder:
    """Cut the drawn mesh of a scene."""
    vertices, faces, _ = cut.scene.looks(cut.number)
    vertices = vertices if cut.vertices is None else cut.vertices
    kept, corners, _ = intersections.slice_faces_plane(vertices, faces, -cut.normal, cut.point)
    if len(corners) == 0:  # a node needs a triangle
        kept, corners = np.tile(cut.point, (3, 1)), np.array([[0, 1, 2]])
    return Remainder(cut, np.asarray(kept, dtype=np.float64), np.asarray(corners, dtype=np.int64))
