"""First contact of an instrument's capsules with a mesh on the true path of a tick.

The joints move in proportion from q to q′; Pinocchio says where the axes of the capsules are on the
way. A capsule is advanced by no more than its clearance, divided by a bound on how fast the ends of
its axis move: it cannot pass anything in between (conservative advancement). Candidates come from
`boxes`, distances from `oracles`. Nothing of this is shared with `vf`.

B. Mirtich, "Impulse-based dynamic simulation of rigid body systems", PhD thesis, Berkeley 1996.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import robots
import vf
from app.judges import boxes, exact
from app.judges.boxes import Boxes
from app.judges.nearest import nearest
from app.judges.oracles import OVERLAP_TOLERANCE, distance, touches
from vf.kernels import njit

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# A motion is cut into this many pieces at most: an overlap shorter than one may be missed, and so
# may one that is no deeper than what the capsule moves in it.
PIECES = 4096
# Pieces of a triangle that is partly in the trocar zone are cut until they are this small, as a
# share of the zone's radius; those that are not wholly outside it are left out.
FINE = 0.05


@dataclass(frozen=True)
class Touch:
    """A capsule that comes nearer to a triangle than its radius.

    Attributes:
        capsule: its number.
        triangle: number of the triangle, or −1 for one that is partly in the trocar zone.
        share: of the motion that was made [0, 1].
        gap: clearance there, less than zero [m]; minus the radius where the axis crosses it.
        before: whether it already overlapped at the start of the motion.
    """

    capsule: int
    triangle: int
    share: float
    gap: float
    before: bool


class Judge:
    """Judges the motions of an arm's instrument beside one mesh.

    Args:
        arm: with `capsules`, `axes` and `axis_jacobians`; used by this judge alone.
        vertices, faces: (n, 3) [m], arm base frame, and (m, 3).
        tip_radius: of the spherical cutter around the tip [m]. The ball at the tip is judged
            beside the capsules, under the number of the first, where it has a radius.
        trocar: the mesh is exempt for the shaft in a ball of this radius around where it enters
            [m]; 0: nowhere.
    """

    def __init__(
        self,
        arm: robots.Arm,
        vertices: FloatArray,
        faces: IntArray,
        tip_radius: float = 0.0,
        trocar: float = 0.0,
    ) -> None:
        self.arm = arm
        self.radii = [capsule.radius for capsule in arm.capsules]
        self._ball = tip_radius > 0.0
        if self._ball:
            self.radii.append(tip_radius)
        self.mesh = boxes.build(vertices, faces)
        self._outside: dict[int, tuple[Boxes, IntArray]] = {}
        axes = arm.axes(arm.neutral)
        for k, capsule in enumerate(arm.capsules):
            if capsule.port and trocar > 0.0:
                corners, origin = outside_ball(vertices[faces], axes[k, 0], trocar)
                rows = np.arange(3 * len(corners)).reshape(-1, 3)
                self._outside[k] = boxes.build(corners.reshape(-1, 3), rows), origin

    def clearance(self, q: FloatArray) -> FloatArray:
        """Distance of each capsule (c,) from the mesh [m], 0 or less where it overlaps it."""
        found = np.array(
            [
                nearest(self._tree(k)[0], axis)[0] - self.radii[k]
                for k, axis in enumerate(self._axes(q))
            ]
        )
        if self._ball:
            found[0] = min(found[0], found[-1])
        return found[: len(self.arm.capsules)]

    def clear(self, q: FloatArray, gap: float) -> bool:
        """Whether every capsule is at least `gap` [m] away from the mesh."""
        for k, axis in enumerate(self._axes(q)):
            tree, _origin = self._tree(k)
            reach = self.radii[k] + gap
            near = boxes.near(tree, axis[0], axis[1], reach)
            if len(near) and _nearest(tree, near, axis)[0] < reach:
                return False
        return True

    def fastest(self, q: FloatArray, dq: FloatArray) -> float:
        """Bound on how far any end of an axis moves while the joints go from q to q + dq [m]."""
        return float(self._speeds(q, dq).max())

    def touches(self, q: FloatArray, q_new: FloatArray) -> list[Touch]:
        """The first contact of every capsule that has one, while the joints move from q to q_new.

        Overlaps of at most `OVERLAP_TOLERANCE` do not count. A capsule that overlaps at the start
        is reported for that.
        """
        found = []
        axes, speeds = self._axes(q), self._speeds(q, q_new - q)
        for k, axis in enumerate(axes):
            touch = self._first(k, axis, speeds[k], q, q_new)
            if touch is not None:
                found.append(touch)
        return found

    def _tree(self, k: int) -> tuple[Boxes, IntArray | None]:
        return self._outside.get(k, (self.mesh, None))

    def _axes(self, q: FloatArray) -> FloatArray:
        """Those of the capsules, and of the ball at the tip as the last."""
        axes = self.arm.axes(q)
        if not self._ball:
            return axes
        tip = self.arm.tip(q).translation
        return np.concatenate([axes, [[tip, tip]]])

    def _first(
        self, k: int, axis: FloatArray, speed: float, q: FloatArray, q_new: FloatArray
    ) -> Touch | None:
        tree, origin = self._tree(k)
        radius = self.radii[k]
        number = k if k < len(self.arm.capsules) else 0
        # What the whole motion can reach, from where the axis starts.
        near = boxes.near(tree, axis[0], axis[1], radius + speed)
        share = 0.0
        while len(near):
            gaps = np.empty(len(near))
            gap, triangle = _nearest(tree, near, axis, gaps)
            near = near[gaps <= radius + speed * (1.0 - share)]  # what the rest of it can reach
            gap -= radius
            if gap < -OVERLAP_TOLERANCE:
                name = triangle if origin is None else int(origin[triangle])
                return Touch(number, name, share, gap, share == 0.0)
            if share >= 1.0 or speed * (1.0 - share) < gap:
                return None
            share = min(share + max(gap / max(speed, 1e-300), 1.0 / PIECES), 1.0)
            q_there = q_new if share >= 1.0 else q + share * (q_new - q)
            axis = self._axes(q_there)[k]
        return None

    def _speeds(self, q: FloatArray, dq: FloatArray) -> FloatArray:
        """Bounds (c,) on how far an axis' ends move per unit of the motion, anywhere on it [m].

        A column of an end's Jacobian is as long as the end is far from the joint's axis, or one for
        a joint that slides; on the way that changes by what the later joints move the end.
        """
        columns = np.linalg.norm(self.arm.axis_jacobians(q), axis=2)  # (c, 2, n)
        if self._ball:
            tip = np.linalg.norm(self.arm.jacobian(q)[:3], axis=0)
            columns = np.concatenate([columns, [[tip, tip]]])
        total = np.zeros(columns.shape[:2])
        for j in range(len(dq) - 1, -1, -1):
            total += abs(dq[j]) * (columns[:, :, j] + self.arm.revolute[j] * total)
        return np.asarray(total.max(axis=1) * (1.0 + 1e-9))


def outside_ball(
    triangles: FloatArray, centre: FloatArray, radius: float
) -> tuple[FloatArray, IntArray]:
    """Triangles (k, 3, 3) [m] without what is in a ball, and which of the given each is part of.

    What is outside by less than `FINE` radii may be left out.
    """
    kept, numbers = [], []
    waiting = np.asarray(triangles, dtype=np.float64)
    origin = np.arange(len(waiting))
    while len(waiting):
        farthest = np.linalg.norm(waiting - centre, axis=2).max(axis=1)
        nearest = _distances_to(waiting, centre)
        clear = nearest >= radius
        kept.append(waiting[clear])
        numbers.append(origin[clear])
        edges = np.linalg.norm(waiting - np.roll(waiting, 1, axis=1), axis=2).max(axis=1)
        split = ~clear & (farthest > radius) & (edges > FINE * radius)
        a, b, c = (waiting[split, i] for i in range(3))
        ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        waiting = np.concatenate(
            [np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
        )
        origin = np.tile(origin[split], 4)
    if not kept or not sum(map(len, kept)):
        # Boxes need a triangle: one that is out of every arm's reach.
        return np.full((1, 3, 3), 1e6), np.array([-1])
    return np.concatenate(kept), np.concatenate(numbers)


def _distances_to(triangles: FloatArray, p: FloatArray) -> FloatArray:
    flat = triangles.reshape(-1, 3)
    rows = np.arange(len(flat)).reshape(-1, 3)
    return np.asarray(_point_distances(flat, rows, p))


def _nearest(
    tree: Boxes, near: IntArray, axis: FloatArray, gaps: FloatArray | None = None
) -> tuple[float, int]:
    """Distance of an axis (2, 3) from the nearest of some triangles (k,), and its number.

    Zero where they meet, which is decided in rational arithmetic where rounding leaves it open. The
    distances of all of them are left in `gaps` (k,), unless one is met.
    """
    doubtful = np.empty(len(near), dtype=np.int64)
    gap, triangle, doubts = _least(
        tree.vertices, tree.faces, near, axis[0], axis[1], doubtful,
        np.empty(len(near)) if gaps is None else gaps,
    )  # fmt: skip
    for i in doubtful[:doubts]:
        if gap > 0.0 and exact.meets(axis[0], axis[1], tree.vertices[tree.faces[i]]):
            gap, triangle = 0.0, i
    return float(gap), int(triangle)


@njit(cache=True, nogil=True)
def _least(vertices, faces, rows, a, b, doubtful, gaps):  # type: ignore[no-untyped-def]
    """Least distance of the segment ab from triangles, whose, and how many may be met."""
    best = np.inf
    nearest = -1
    doubts = 0
    for k in range(rows.shape[0]):
        i = rows[k]
        p, q, r = vertices[faces[i, 0]], vertices[faces[i, 1]], vertices[faces[i, 2]]
        verdict = touches(a, b, p, q, r)
        if verdict > 0:
            return 0.0, i, 0
        if verdict < 0:
            doubtful[doubts] = i
            doubts += 1
        gap = gaps[k] = distance(a, b, p, q, r)
        if gap < best:
            best = gap
            nearest = i
    return best, nearest, doubts


@njit(cache=True, nogil=True)
def _point_distances(vertices, faces, x):  # type: ignore[no-untyped-def]
    found = np.empty(faces.shape[0])
    for i in range(faces.shape[0]):
        f = faces[i]
        found[i] = distance(x, x, vertices[f[0]], vertices[f[1]], vertices[f[2]])
    return found


def apart(surface: vf.Surface, ends: FloatArray, radius: float) -> bool:
    """Whether a capsule with axis `ends` (2, 3) neither meets nor overlaps a mesh."""
    tree = boxes.of(surface)
    near = boxes.near(tree, ends[0], ends[1], radius)
    return not len(near) or _nearest(tree, near, ends)[0] > radius + OVERLAP_TOLERANCE


def leaks(
    surface: vf.Surface,
    planes: vf.Planes,
    ends: FloatArray,
    radius: float,
    tip_radius: float = 0.0,
    tolerance: float = 1e-11,
) -> int:
    """Number of triangles with a point near an axis and strictly in front of every plane.

    The planes are moved back by `tip_radius` [m]. "Near" is within `radius` + `tip_radius` of the
    axis `ends` (2, 3), and both words mean by more than `tolerance` [m].
    """
    tree = boxes.of(surface)
    reach = radius + tip_radius
    near = boxes.near(tree, ends[0], ends[1], reach)
    offsets = planes.offsets - tip_radius
    return int(
        _count_leaks(
            tree.vertices, tree.faces, near, planes.normals, offsets, ends[0], ends[1], reach,
            tolerance,
        )
    )  # fmt: skip


@njit(cache=True, nogil=True)
def _count_leaks(vertices, faces, rows, normals, offsets, a, b, reach, tolerance):  # type: ignore[no-untyped-def]
    """Cut each triangle by every half-space; what is left is looked at triangle by triangle."""
    m = offsets.shape[0]
    part, other = np.empty((m + 4, 3)), np.empty((m + 4, 3))
    count = 0
    for i in rows:
        for c in range(3):
            part[c] = vertices[faces[i, c]]
        k = 3
        for j in range(m):
            kept = 0
            for c in range(k):
                p, q = part[c], part[(c + 1) % k]
                hp = normals[j] @ p - offsets[j] - tolerance
                hq = normals[j] @ q - offsets[j] - tolerance
                if hp > 0.0:
                    other[kept] = p
                    kept += 1
                if (hp > 0.0) != (hq > 0.0):
                    other[kept] = p + hp / (hp - hq) * (q - p)
                    kept += 1
            part, other = other, part
            k = kept
            if k == 0:
                break
        for c in range(1, max(k - 1, min(k, 2))):
            p, q, r = part[0], part[c], part[min(c + 1, k - 1)]
            if touches(a, b, p, q, r) > 0 or distance(a, b, p, q, r) < reach - tolerance:
                count += 1
                break
    return count
