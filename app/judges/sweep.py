"""First contact of an instrument's capsules with a mesh on the true path of a tick.

The joints move in proportion from q to q′; where the axes of the capsules are on the way is told by
`screws`, whether they touch anything there by `motion`, candidates come from `boxes`, distances
from `nearest`. Nothing of this is shared with `vf`. And the capsules' leaks: parts of a mesh near
an axis that no plane cuts off.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import robots
import vf
from app.judges import boxes, screws
from app.judges.boxes import ROOM, Boxes
from app.judges.motion import TOLERANCE, first_contacts
from app.judges.nearest import nearest
from app.judges.oracles import OVERLAP_TOLERANCE, distance, touches
from vf.kernels import njit

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Pieces of a triangle that is partly in the trocar zone are cut until they are this small, as a
# share of the zone's radius; those that are not wholly outside it are left out.
FINE = 0.05


@dataclass(frozen=True)
class Touch:
    """A capsule that comes nearer to a triangle than its radius.

    Attributes:
        capsule: its number.
        triangle: number of the nearest triangle then, or −1 for one that is partly in the trocar
            zone.
        share: of the motion that was made [0, 1].
        gap: clearance there [m], about zero where the contact begins; minus the radius where the
            axis crosses the triangle.
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
        arm: with `capsules`, `axes` and `kinematics`; asked once.
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
        ball = tip_radius > 0.0
        self.screws = screws.of(arm, ball)
        radii = [capsule.radius for capsule in arm.capsules]
        self.radii = np.array(radii + [tip_radius] * ball)
        self._count = len(radii)
        self.mesh = boxes.build(vertices, faces)
        self._outside: dict[int, tuple[Boxes, IntArray]] = {}
        axes = arm.axes(arm.neutral)
        for k, capsule in enumerate(arm.capsules):
            if capsule.port and trocar > 0.0:
                corners, origin = outside_ball(vertices[faces], axes[k, 0], trocar)
                rows = np.arange(3 * len(corners)).reshape(-1, 3)
                self._outside[k] = boxes.build(corners.reshape(-1, 3), rows), origin
        whole = [k for k in range(len(self.radii)) if k not in self._outside]
        groups = [(self.mesh, np.array(whole, dtype=np.int64))]
        groups += [(tree, np.array([k])) for k, (tree, _) in self._outside.items()]
        # Each with the ways of its vertices, which rest.
        self._groups = [(tree, np.zeros_like(tree.vertices), chosen) for tree, chosen in groups]
        self._found = np.empty(ROOM, dtype=np.int64)
        self._shares = np.empty(len(self.radii))
        self._triangles = np.empty(len(self.radii), dtype=np.int64)

    def clearance(self, q: FloatArray) -> FloatArray:
        """Distance of each capsule (c,) from the mesh [m], 0 or less where it overlaps it."""
        found = np.array([self._gap(k, axis)[0] for k, axis in enumerate(self.axes(q))])
        found[0] = min(found[0], found[-1] if len(found) > self._count else np.inf)
        return found[: self._count]

    def clear(self, q: FloatArray, gap: float) -> bool:
        """Whether every capsule is at least `gap` [m] away from the mesh."""
        for k, axis in enumerate(self.axes(q)):
            tree, _origin = self._tree(k)
            reach = float(self.radii[k]) + gap
            if nearest(tree, axis, reach)[0] < reach:
                return False
        return True

    def fastest(self, q: FloatArray, dq: FloatArray) -> float:
        """Bound on how far any end of an axis moves while the joints go from q to q + dq [m]."""
        return max(screws.fastest(*self.screws, i, q, dq)[0] for i in range(len(self.screws.ends)))

    def touches(self, q: FloatArray, q_new: FloatArray) -> list[Touch]:
        """The first contact of every capsule that has one, while the joints move from q to q_new.

        Overlaps of less than `motion.TOLERANCE` do not count; a body of no radius touches where it
        comes within a few nanometres of a triangle. A capsule that overlaps at the start is
        reported for that.
        """
        dq = q_new - q
        for tree, ways, chosen in self._groups:
            while True:
                room = first_contacts(
                    *tree, tree.vertices, ways, tree.faces, 0.0, 0.0, *self.screws, self.radii,
                    chosen, q, dq, self._found, self._shares, self._triangles,
                )  # fmt: skip
                if room == 0:
                    break
                self._found = np.empty(room, dtype=np.int64)
        found = []
        for k in map(int, np.flatnonzero(self._triangles >= 0)):
            share = float(self._shares[k])
            gap, triangle = self._gap(k, self.axes(q + share * dq)[k])
            number = k if k < self._count else 0
            before = share == 0.0 and gap <= -TOLERANCE
            found.append(Touch(number, triangle, share, gap, before))
        return found

    def axes(self, q: FloatArray) -> FloatArray:
        """Those of the capsules, and of the ball at the tip as the last (c, 2, 3) [m]."""
        return screws.place(self.screws, q)

    def _tree(self, k: int) -> tuple[Boxes, IntArray | None]:
        return self._outside.get(k, (self.mesh, None))

    def _gap(self, k: int, axis: FloatArray) -> tuple[float, int]:
        """Clearance of capsule k with that axis (2, 3) [m], and the nearest triangle."""
        tree, origin = self._tree(k)
        gap, triangle = nearest(tree, axis)
        return gap - float(self.radii[k]), triangle if origin is None else int(origin[triangle])


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
        clear = _distances_to(waiting, centre) >= radius
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


@njit(cache=True, nogil=True)
def _point_distances(vertices, faces, x):  # type: ignore[no-untyped-def]
    found = np.empty(faces.shape[0])
    for i in range(faces.shape[0]):
        f = faces[i]
        found[i] = distance(x, x, vertices[f[0]], vertices[f[1]], vertices[f[2]])
    return found


def apart(surface: vf.Surface, ends: FloatArray, radius: float) -> bool:
    """Whether a capsule with axis `ends` (2, 3) neither meets nor overlaps a mesh."""
    reach = radius + OVERLAP_TOLERANCE
    return nearest(boxes.of(surface), ends, reach)[0] > reach


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
