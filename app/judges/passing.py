"""First contact of capsules with a mesh that moves and deforms during a tick, from its true motion.

Seen from the structure it is the instrument that moves. A twist of the structure is a turn about an
axis and a slide along it, and so it is two more joints in front of those of the arm, which go the
other way; an origin that goes straight while the axes turn is two such joints as well. What
`screws` bounds of a chain of joints holds for this longer one.

The corners of a triangle go straight from one shape to the other. A plane that has, both at the
start and at the end of a piece of the motion, the triangle on one side and the ends of an axis on
the other, farther than the radius and the bend, has them so at every time of it: on its straight
way the farthest corner along the normal is no farther than in proportion between the two, and the
nearest end is no nearer. As in `motion`, a piece without such a plane is halved until the capsule
overlaps the triangle, or nothing moves farther than `FINEST` on it: what is not proved is a
contact.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import robots
from app.judges import boxes, screws
from app.judges.boxes import ROOM, Boxes, list_near
from app.judges.motion import DEEPEST, FINEST, ROUNDING, TOLERANCE, apart, overlaps
from app.judges.screws import fastest, place_end
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
) -> Shapes:
    """A mesh (n, 3) [m] and (m, 3) that keeps its shape, or goes to that of the vertices `after`.

    Args:
        like: of the same faces: its boxes are adapted, which is faster than to build others.
    """
    vertices = np.ascontiguousarray(vertices, dtype=np.float64)
    faces = np.ascontiguousarray(faces, dtype=np.int64)
    if after is None:
        return Shapes(vertices, np.zeros_like(vertices), faces, boxes.build(vertices, faces))
    ways = after - vertices
    corners = np.empty((2 * len(faces), 3))
    _enclose(vertices, ways, faces, corners)
    if like is not None and len(like.boxes.vertices) == len(corners):
        return Shapes(vertices, ways, faces, boxes.refitted(like.boxes, corners))
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
            room = first_passes(
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
        room = first_passes(
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


@njit(cache=True, nogil=True)
def first_passes(  # type: ignore[no-untyped-def]
    box_vertices, box_faces, order, levels_boxes, levels, vertices, ways, faces, first, last,
    lines, posture, ends, carried, radii, chosen, q, dq, found, shares, triangles,
):  # fmt: skip
    """For each chosen capsule the share of the tick at which it first touches a triangle.

    Args:
        box_vertices, …, levels: see `boxes.Boxes`; around all shapes of the tick.
        vertices, ways, faces: see `Shapes`.
        first, last: share of the ways at the start and at the end of the tick.
        lines, …, carried: see `screws.Screws`, in the structure's frame.
        radii: (c,) of the capsules [m].
        chosen: numbers of the capsules to look at.
        q, dq: the joints go from q to q + dq in proportion.
        found: room for the triangles near one capsule's motion.
        shares, triangles: (c,) written for the chosen: inf and −1 where nothing is touched.

    Returns:
        0, or the size that `found` needs.
    """
    n = q.shape[0]
    there = np.empty(n)
    stack = np.empty((DEEPEST, 2))
    whole = np.empty((3, 2, 3))
    piece = np.empty((3, 2, 3))
    corners = np.empty((3, 3, 3))
    for k in chosen:
        shares[k], triangles[k] = np.inf, -1
        speed = 0.0
        bend = 0.0
        for e in range(2):
            way, curve = fastest(lines, posture, ends, carried, 2 * k + e, q, dq)
            speed, bend = max(speed, way), max(bend, curve)
        _place(lines, posture, ends, carried, k, q, dq, 0.0, 1.0, there, whole)
        radius = max(radii[k] - TOLERANCE, 0.0)
        reach = radius + speed + 2.0 * FINEST
        near = list_near(
            box_vertices, box_faces, order, levels_boxes, levels, whole[0, 0], whole[0, 1], reach,
            found,
        )  # fmt: skip
        if near > found.shape[0]:
            return near
        for i in range(near):
            t = found[i]
            _corners(vertices, ways, faces, t, first, last, 0.0, 1.0, corners)
            if clear(whole, corners, radius + 0.125 * bend):
                continue
            pace = speed
            for c in range(3):
                gone = 0.0
                for axis in range(3):
                    gone += (corners[2, c, axis] - corners[0, c, axis]) ** 2
                pace = max(pace, speed + np.sqrt(gone))
            # The pieces that are left, from the last to the first.
            stack[0, 0], stack[0, 1] = 0.0, 1.0
            count = 1
            while count > 0:
                count -= 1
                low, high = stack[count, 0], stack[count, 1]
                if low >= shares[k]:
                    break
                _place(lines, posture, ends, carried, k, q, dq, low, high, there, piece)
                _corners(vertices, ways, faces, t, first, last, low, high, corners)
                length = high - low
                if clear(piece, corners, radius + 0.125 * bend * length * length):
                    continue
                small = pace * length <= FINEST or count + 2 > DEEPEST
                x = corners[0]
                if small or overlaps(piece[0, 0], piece[0, 1], x[0], x[1], x[2], radius):
                    shares[k], triangles[k] = low, t
                    break
                middle = low + 0.5 * length
                stack[count, 0], stack[count, 1] = middle, high
                stack[count + 1, 0], stack[count + 1, 1] = low, middle
                count += 2
    return 0


@njit(cache=True, nogil=True)
def _place(lines, posture, ends, carried, k, q, dq, low, high, there, piece):  # type: ignore[no-untyped-def]
    """Ends of axis k at the beginning, the middle and the end of a piece, into (3, 2, 3)."""
    for m in range(3):
        share = low + 0.5 * m * (high - low)
        for j in range(q.shape[0]):
            there[j] = q[j] + share * dq[j]
        for e in range(2):
            place_end(lines, posture, ends, carried, 2 * k + e, there, piece[m, e])


@njit(cache=True, nogil=True)
def _corners(vertices, ways, faces, t, first, last, low, high, corners):  # type: ignore[no-untyped-def]
    """Those of triangle t at the beginning, the middle and the end of a piece, into (3, 3, 3)."""
    for m in range(3):
        share = first + (low + 0.5 * m * (high - low)) * (last - first)
        for c in range(3):
            v = faces[t, c]
            for axis in range(3):
                corners[m, c, axis] = vertices[v, axis] + share * ways[v, axis]


@njit(cache=True, nogil=True)
def clear(piece, corners, room):  # type: ignore[no-untyped-def]
    """Whether a plane is found that has a triangle farther than `room` from an axis all the way.

    Args:
        piece: (3, 2, 3) ends of the axis at the beginning, the middle and the end of a motion.
        corners: (3, 3, 3) of the triangle then.
    """
    p, q, r = corners[1, 0], corners[1, 1], corners[1, 2]
    nx, ny, nz, _d2 = apart(piece[1, 0], piece[1, 1], p, q, r)
    if _separates(piece, corners, nx, ny, nz, room):
        return True
    # The triangle's own plane is more accurate than a way that is hardly longer than its rounding.
    ux, uy, uz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    vx, vy, vz = r[0] - p[0], r[1] - p[1], r[2] - p[2]
    fx, fy, fz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    x = piece[1, 0]
    if fx * (x[0] - p[0]) + fy * (x[1] - p[1]) + fz * (x[2] - p[2]) < 0.0:
        fx, fy, fz = -fx, -fy, -fz
    return _separates(piece, corners, fx, fy, fz, room)


@njit(cache=True, nogil=True)
def _separates(piece, corners, nx, ny, nz, room):  # type: ignore[no-untyped-def]
    """Whether the ends are more than `room` farther along n than the triangle, first and last."""
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    # A way to nowhere is infinite.
    if not (length > 0.0 and length < np.inf):
        return False
    nx, ny, nz = nx / length, ny / length, nz / length
    for m in (0, 2):
        base = -np.inf
        for c in range(3):
            x = corners[m, c]
            base = max(base, nx * x[0] + ny * x[1] + nz * x[2])
        for e in range(2):
            x = piece[m, e]
            if not nx * x[0] + ny * x[1] + nz * x[2] - base > room + ROUNDING:
                return False
    return True
