"""First contact of capsules with a mesh that moves and deforms during a tick, from its true motion.

Seen from the structure it is the instrument that moves. A twist of the structure is a turn about an
axis and a slide along it, and so it is two more joints in front of those of the arm, which go the
other way; an origin that goes straight while the axes turn is two such joints as well. What
`screws` bounds of a chain of joints holds for this longer one, and `motion` judges it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import robots
from app.judges import boxes, screws
from app.judges.boxes import ROOM, Boxes
from app.judges.motion import first_contacts
from app.judges.screws import fastest
from vf.kernels import njit

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# The axis of a screw that turns by less is too far away to compute with [rad]. Its points go
# straight but for an eighth of that times their way, and end where the screw does.
FAINT = 1e-7


class Frame(NamedTuple):
    """Where a structure is when a tick begins, and how it moves in it.

    Attributes:
        rotation, translation: (3, 3) and (3,) [m] of T_base_structure at the start.
        turn: (3,) rotation vector of the tick, in the structure's frame at the start [rad].
        way: (3,) [m]: of a `screw` the linear part of the twist, in the structure's frame; else the
            way of the origin, in the base frame.
        screw: whether it moves with a constant twist, or its origin straight and its axes at a
            constant rate.
    """

    rotation: FloatArray
    translation: FloatArray
    turn: FloatArray
    way: FloatArray
    screw: bool = True

    @property
    def joints(self) -> tuple[FloatArray, FloatArray]:
        """Two joints (2, 7), see `screws.Screws.lines`, structure frame, and how far they go (2,).

        They take a point from where the structure sees it at the start to where it sees it at the
        end, if it rests in the base frame: the second one first.
        """
        lines = np.zeros((2, 7))
        lines[0, 6] = 1.0
        far = np.zeros(2)
        slide = self.way if self.screw else self.rotation.T @ self.way
        angle = float(np.linalg.norm(self.turn))
        axis = self.turn / angle if angle > 0.0 else np.array([1.0, 0.0, 0.0])
        lines[0, :3], far[0] = axis, -angle
        if self.screw and angle > FAINT:
            # v = −ω × c + h ω: the axis passes through c, and the structure slides along it.
            lines[0, 3:6] = np.cross(axis, self.way) / angle
            slide = (axis @ self.way) * axis
        elif self.screw:
            slide = self.way + 0.5 * np.cross(self.turn, self.way)
        length = float(np.linalg.norm(slide))
        lines[1, :3] = slide / length if length > 0.0 else (1.0, 0.0, 0.0)
        far[1] = -length
        return lines, far


class Shapes(NamedTuple):
    """A mesh between two shapes, and boxes that hold both.

    Attributes:
        vertices, ways: (n, 3) the first shape and from there to the second [m].
        faces: (m, 3).
        boxes: of triangles that are as large as what each triangle passes through.
    """

    vertices: FloatArray
    ways: FloatArray
    faces: IntArray
    boxes: Boxes

    def at(self, share: float) -> FloatArray:
        """Vertices (n, 3) at a share of the way from the first shape to the second [m]."""
        return self.vertices + share * self.ways


def shapes(
    vertices: FloatArray,
    faces: IntArray,
    after: FloatArray | None = None,
    like: Shapes | None = None,
    room: tuple[FloatArray, FloatArray, FloatArray] | None = None,
) -> Shapes:
    """A mesh (n, 3) [m] and (m, 3) that keeps its shape, or goes to that of the vertices `after`.

    Args:
        like: of the same faces: its boxes are adapted, which is faster than to build others.
        room: arrays to be written, as large as the `ways`, the vertices of the boxes and the boxes
            of `like`; None: new ones.
    """
    vertices = np.ascontiguousarray(vertices, dtype=np.float64)
    faces = np.ascontiguousarray(faces, dtype=np.int64)
    if after is None:
        return Shapes(vertices, np.zeros_like(vertices), faces, boxes.build(vertices, faces))
    ways, corners, around = room or (None, np.empty((2 * len(faces), 3)), None)
    ways = np.subtract(after, vertices, out=ways)
    _enclose(vertices, ways, faces, corners)
    if like is not None and len(like.boxes.vertices) == len(corners):
        around = np.empty_like(like.boxes.boxes) if around is None else around
        return Shapes(vertices, ways, faces, boxes.refitted(like.boxes, corners, around))
    rows = np.arange(len(faces))
    rows = np.stack([2 * rows, 2 * rows + 1, 2 * rows], axis=1)
    return Shapes(vertices, ways, faces, boxes.build(corners, rows))


class Contact(NamedTuple):
    """A capsule's first contact: its number, the triangle's, and the share of the tick."""

    capsule: int
    triangle: int
    share: float


class Judge:
    """Judges the motions of an arm beside meshes that move.

    Args:
        arm: with `capsules`, `axes` and `kinematics`; asked once.
        tip_radius: of the ball at the tip [m], which is judged beside the capsules where it has a
            radius.
        tip_alone: judge the ball at the tip and no capsule; without a radius it is a point.
    """

    def __init__(self, arm: robots.Arm, tip_radius: float = 0.0, tip_alone: bool = False) -> None:
        ball = tip_radius > 0.0 or tip_alone
        self.screws = screws.of(arm, ball)
        self.radii = np.array([capsule.radius for capsule in arm.capsules] + [tip_radius] * ball)
        self.names = [capsule.name for capsule in arm.capsules] + ["tip"] * ball
        chosen = [len(self.radii) - 1] if tip_alone else range(len(self.radii))
        self.chosen = np.array(chosen, dtype=np.int64)
        self._found = np.empty(ROOM, dtype=np.int64)
        self._shares = np.empty(len(self.radii))
        self._triangles = np.empty(len(self.radii), dtype=np.int64)

    def contacts(
        self,
        mesh: Shapes,
        frame: Frame,
        q: FloatArray,
        q_new: FloatArray,
        blend: tuple[float, float] = (0.0, 0.0),
    ) -> list[Contact]:
        """The first contact of every capsule that has one, in a tick.

        The joints go from q to q_new (n,) in proportion, the structure as `frame` says, and its
        shape from one share of the way between the two `mesh` has to another. Overlaps of less than
        `motion.TOLERANCE` do not count.
        """
        lines, far = frame.joints
        R, t = frame.rotation, frame.translation
        known = self.screws
        own = known.lines.copy()
        own[:, :3] = known.lines[:, :3] @ R
        turns = own[:, 6] > 0.0
        own[turns, 3:6] = (known.lines[turns, 3:6] - t) @ R
        count = len(far)
        before = np.zeros(count)
        while True:
            room = first_contacts(
                *mesh.boxes, mesh.vertices, mesh.ways, mesh.faces, blend[0], blend[1],
                np.concatenate([lines, own]), np.concatenate([before, known.posture]),
                (known.ends - t) @ R, known.carried + count, self.radii, self.chosen,
                np.concatenate([before, q]), np.concatenate([far, q_new - q]),
                self._found, self._shares, self._triangles,
            )  # fmt: skip
            if room == 0:
                break
            self._found = np.empty(room, dtype=np.int64)
        met = [int(k) for k in self.chosen if self._triangles[k] >= 0]
        return [Contact(k, int(self._triangles[k]), float(self._shares[k])) for k in met]

    def fastest(self, q: FloatArray, dq: FloatArray) -> float:
        """Bound on how far any end of an axis moves while the joints go from q to q + dq [m]."""
        return max(fastest(*self.screws, i, q, dq)[0] for i in range(len(self.screws.ends)))

    def axes(self, q: FloatArray) -> FloatArray:
        """Those of the capsules, and of a ball at the tip as the last (c, 2, 3), base frame [m]."""
        return screws.place(self.screws, q)


def first_touch(
    mesh: Shapes,
    start: FloatArray,
    end: FloatArray,
    radius: float,
    blend: tuple[float, float],
) -> tuple[int, float] | None:
    """Where a ball first touches a mesh that deforms: triangle and share of the way.

    Its centre goes straight from start to end (3,), frame of the mesh, while the mesh goes from one
    share of the way between its shapes to another. A ball without a radius [m] is a point.
    """
    way = end - start
    length = float(np.linalg.norm(way))
    line = np.zeros((1, 7))
    line[0, :3] = way / length if length > 0.0 else (1.0, 0.0, 0.0)
    one, ends = np.zeros(1), np.stack([start, start])
    shares, triangles = np.empty(1), np.empty(1, dtype=np.int64)
    found = np.empty(ROOM, dtype=np.int64)
    while True:
        room = first_contacts(
            *mesh.boxes, mesh.vertices, mesh.ways, mesh.faces, blend[0], blend[1], line, one, ends,
            np.ones(2, dtype=np.int64), np.array([radius]), np.zeros(1, dtype=np.int64), one,
            np.array([length]), found, shares, triangles,
        )  # fmt: skip
        if room == 0:
            return (int(triangles[0]), float(shares[0])) if triangles[0] >= 0 else None
        found = np.empty(room, dtype=np.int64)


@njit(cache=True, nogil=True)
def _enclose(vertices, ways, faces, corners):  # type: ignore[no-untyped-def]
    """Lowest and highest corner of what every triangle passes through, into (2m, 3)."""
    for t in range(faces.shape[0]):
        for axis in range(3):
            low, high = np.inf, -np.inf
            for c in range(3):
                start = vertices[faces[t, c], axis]
                end = start + ways[faces[t, c], axis]
                low, high = min(low, min(start, end)), max(high, max(start, end))
            # For the rounding of what is between the two.
            corners[2 * t, axis] = low - 1e-15 * abs(low)
            corners[2 * t + 1, axis] = high + 1e-15 * abs(high)
