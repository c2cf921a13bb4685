"""A corridor along a planned path: the tool may leave the path sideways by no more than a width."""

from __future__ import annotations

from math import cos, radians

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vf.kernels import njit
from vf.layout import (
    BUMP,
    CAPSULE,
    FIXTURE,
    FLOOR,
    FOOT,
    LIMIT,
    NORMAL,
    OFFSET,
    PLANE,
    POINT,
    PUSH,
    RULE,
    TRIANGLE,
    WALLED,
)
from vf.planes import FloatArray, IntArray, Planes, Rule, checked_length, planes_of
from vf.rules.certified import BUDGET, CORNERS, FAINT, HEAP, walk
from vf.surface import ROUND, Edge
from vf.tick.block import Search
from vf.tree import pdtree

FAR = 1.0  # the walls go on straight by this much before and after the path [m]
STRAIGHT = 1e-9  # a point this near to the straight line of its neighbours is no bend [m]
ON_WALL = 1e-12  # walls this near to each other meet, and on a wall within rounding [m]
# How far a tool outside is led back in a tick [m]: 10 mm/s at 1 kHz.
LED_BACK = 1e-5
CORRIDOR = int(Rule.CORRIDOR)
# A row of the walls: start (2), end (2), normal into the corridor (2), on which side of the path.
END, ACROSS, ON, WALL = 2, 4, 6, 7
FLATTEN = cos(radians(30.0))


class CorridorFixture:
    """Keeps the tool within a width of a path, seen along the direction of the cut.

    The corridor is all points whose distance from the path is at most `width` when both are
    projected along `direction`: how deep the tool is does not matter, and beyond its ends the path
    goes on straight. A path in one plane that contains `direction` (a sagittal cut) has two
    parallel walls; any other has a wall of flat pieces on either side, cut across on the outside of
    a bend, so that what is between the walls is never farther from the path than `width`.

    The planes are those of the certified rule, with the pieces of the walls for triangles, so they
    carry the same certificate: a step that obeys them stays between the walls. A tool that is
    outside (the path was moved, or the corridor was switched on) is led back gently and may not go
    farther out.

    Args:
        path: (k, 3) the planned path, k ≥ 2, arm base frame [m].
        direction: (3,) in which the tool cuts; its length and sign do not matter.
        width: how far the tool may leave the path on either side [m].
        radius: of the motion sphere [m]; None: as far as the arm can go in a tick.

    Raises:
        ValueError: not finite; the path runs along `direction`, turns back on itself, turns more
            tightly than a corridor of this width can follow, or comes so near to itself, carried on
            beyond its ends, that the walls would meet: which side of them is free is then open.
    """

    certified = True

    def __init__(
        self,
        path: ArrayLike,
        direction: ArrayLike,
        width: float = 1e-3,
        radius: float | None = None,
    ) -> None:
        self.path = _checked_path(path)
        self.direction = _checked_direction(direction)
        self.width = checked_length("corridor's width", width, positive=True)
        self.radius = radius if radius is None else checked_length("radius", radius, positive=True)
        self.axes = _across(self.direction)  # (2, 3): the plane in which the walls are lines
        self.walls = _walls(_bends(self.path @ self.axes.T), self.width)  # (k, WALL) [m]
        self.tree, self.edges = _tree(self.walls)
        # Nearer to a wall no plane separates the tip from it: it counts as being on the wall [m].
        self.hair = max(ON_WALL, 2.0 * FAINT * ROUND * float(np.abs(self.walls[:, :ACROSS]).max()))
        frame = np.array([*self.axes.ravel(), self.width, self.hair])
        self.search = Search(WALLED, self.tree, self.edges, self.walls, frame)
        for array in (
            self.path, self.direction, self.axes, self.walls, self.edges, frame, *self.tree
        ):  # fmt: skip
            array.flags.writeable = False

    def inside(self, x: FloatArray) -> bool:
        """Never: outside the corridor is not inside an anatomy, and `planes` leads back."""
        return False

    def leads_out(self, x: FloatArray, y: FloatArray) -> bool:
        return True

    def planes(
        self, x: FloatArray, radius: float, standoff: float, tip_radius: float, inside: bool
    ) -> Planes:
        planes = np.empty((BUDGET, PLANE))
        m, reach = _between_alone(
            self.walls, self.axes, self.width, self.hair, *self.tree, self.edges, x, radius,
            standoff, tip_radius, planes,
        )  # fmt: skip
        return planes_of(planes[:m], reach)

    def room(self, x: ArrayLike) -> float:
        """Distance of x (3,) to the nearest wall [m], negative outside the corridor."""
        flat = self.axes @ np.asarray(x, dtype=np.float64)
        return float(_room(self.walls, flat[0], flat[1])[0])

    def ribbons(self, half_height: float, beyond: float = 0.0) -> tuple[FloatArray, FloatArray]:
        """The two walls as strips of quadrangles to draw, each (k, 4, 3) [m].

        Args:
            half_height: how far they go up and down from the path along `direction` [m].
            beyond: how far they go on before and after the path [m].
        """
        starts, ends, sides = self.walls[:, :END], self.walls[:, END:ACROSS], self.walls[:, ON]
        flat, along = self.path @ self.axes.T, self.path @ self.direction
        found = []
        for side in (0, 1):
            pieces = np.flatnonzero(sides == side)
            corners = []
            for i in pieces:
                a, b = starts[i], ends[i]
                forward = (b - a) / np.linalg.norm(b - a)
                a = a + (FAR - beyond) * forward * (i == pieces[0])
                b = b - (FAR - beyond) * forward * (i == pieces[-1])
                count = max(int(np.ceil(np.linalg.norm(b - a) / 1e-3)), 1)
                marks = a + np.linspace(0.0, 1.0, count + 1)[:, None] * (b - a)
                nearest = np.linalg.norm(marks[:, None] - flat, axis=2).argmin(axis=1)
                middle = marks @ self.axes + along[nearest, None] * self.direction
                rise = half_height * self.direction
                corners.append(
                    np.stack(
                        [middle[:-1] + rise, middle[1:] + rise, middle[1:] - rise,
                         middle[:-1] - rise],
                        axis=1,
                    )
                )  # fmt: skip
            found.append(np.concatenate(corners))
        return found[0], found[1]


def cutting_direction(path: ArrayLike, normals: ArrayLike) -> FloatArray:
    """Direction (3,) of a cut along a path (k, 3) on a surface with these normals (k, 3).

    The mean of the normals, turned into the surface; for a path that bends in one plane, and a mean
    within 30° of that plane, the direction in the plane: the cut is then that plane.

    Raises:
        ValueError: the normals cancel each other.
    """
    points, outward = np.asarray(path, dtype=np.float64), np.asarray(normals, dtype=np.float64)
    mean = -outward.sum(axis=0)
    if not np.linalg.norm(mean) > 1e-6 * len(outward):
        raise ValueError("the surface turns so far along the path that no direction is its depth")
    mean /= np.linalg.norm(mean)
    _, sizes, axes = np.linalg.svd(points - points.mean(axis=0))
    if len(sizes) == 3 and sizes[1] > 1e-6 >= sizes[2]:
        flat = mean - (mean @ axes[2]) * axes[2]
        if np.linalg.norm(flat) > FLATTEN:
            mean = flat / np.linalg.norm(flat)
    return mean


def _checked_path(path: ArrayLike) -> FloatArray:
    points = np.array(path, dtype=np.float64)
    if points.ndim != 2 or points.shape[1:] != (3,) or len(points) < 2:
        raise ValueError(f"a path must be two or more points (k, 3), got shape {points.shape}")
    if not np.isfinite(points).all():
        raise ValueError("the points of a path must be finite numbers")
    return points


def _checked_direction(direction: ArrayLike) -> FloatArray:
    d = np.array(direction, dtype=np.float64)
    if d.shape != (3,) or not np.isfinite(d).all() or not np.linalg.norm(d) > 0.0:
        raise ValueError(f"the direction of a cut must be three numbers, not {direction!r}")
    return np.asarray(d / np.linalg.norm(d))


def _across(direction: FloatArray) -> FloatArray:
    """Two unit vectors (2, 3) across a unit vector (3,)."""
    start = np.zeros(3)
    start[np.abs(direction).argmin()] = 1.0
    first = np.cross(direction, start)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(direction, first)])


def _bends(points: FloatArray) -> FloatArray:
    """The ends and bends (k, 2) of a flat polyline: no repeated points, none on a straight line."""
    distinct = [points[0]]
    for p in points[1:]:
        if np.linalg.norm(p - distinct[-1]) > STRAIGHT:
            distinct.append(p)
    if len(distinct) < 2:
        raise ValueError("the path has no length across the direction of the cut")
    kept = [0]
    for i in range(1, len(distinct) - 1):
        start = distinct[kept[-1]]
        chord = distinct[i + 1] - start
        length = float(np.linalg.norm(chord))
        between = np.array(distinct[kept[-1] + 1 : i + 1]) - start
        off = np.abs(between[:, 0] * chord[1] - between[:, 1] * chord[0])
        ahead = np.append(between @ chord, length**2)
        if (off > STRAIGHT * length).any() or ahead[0] < 0.0 or (np.diff(ahead) < 0.0).any():
            kept.append(i)
    return np.array([distinct[i] for i in (*kept, len(distinct) - 1)])


def _walls(points: FloatArray, width: float) -> FloatArray:
    """Pieces (k, WALL) of both walls, those of side 0 first, each side along the path."""
    steps = np.diff(points, axis=0)
    forward = steps / np.linalg.norm(steps, axis=1, keepdims=True)
    left = np.stack([-forward[:, 1], forward[:, 0]], axis=1)
    points = points.copy()
    points[0] -= FAR * forward[0]
    points[-1] += FAR * forward[-1]
    starts, ends, normals, sides, legs = [], [], [], [], []
    for side, sign in enumerate((1.0, -1.0)):
        across = sign * width * left
        corner = points[0] + across[0]
        for i in range(len(forward)):
            a = corner
            bridge = None
            if i + 1 == len(forward):
                b = points[i + 1] + across[i]
            else:
                turn = forward[i, 0] * forward[i + 1, 1] - forward[i, 1] * forward[i + 1, 0]
                cosine = float(forward[i] @ forward[i + 1])
                if cosine < -0.999:
                    raise ValueError(f"the path turns back on itself at its bend {i + 1}")
                if sign * turn > 0.0:  # the inside of the bend: the walls meet
                    b = corner = points[i + 1] + (across[i] + across[i + 1]) / (1.0 + cosine)
                else:
                    b, corner = points[i + 1] + across[i], points[i + 1] + across[i + 1]
                    bridge = corner
            if not (b - a) @ forward[i] > 0.0:
                raise ValueError(
                    f"the path bends too tightly for a corridor of ±{width * 1e3:g} mm at its "
                    f"bend {i + 1}: smooth it, or take a narrower corridor"
                )
            starts.append(a)
            ends.append(b)
            normals.append(-sign * left[i])
            sides.append(side)
            legs.append(i)
            if bridge is not None and np.linalg.norm(bridge - b) > STRAIGHT:
                along = (bridge - b) / np.linalg.norm(bridge - b)
                starts.append(b)
                ends.append(bridge)
                normals.append(-sign * np.array([-along[1], along[0]]))
                sides.append(side)
                legs.append(i)
    walls = np.column_stack([starts, ends, normals, sides])
    _check_apart(walls, np.array(legs), width)
    return walls


def _tree(walls: FloatArray) -> tuple[pdtree.Tree, NDArray[np.int8]]:
    """The walls for `cover.walk`: triangles (a, b, b) in the plane, and kinds (k, 3) of edges.

    Edge 2 speaks for the bend at a and edge 1 for that at b: a valley where the wall goes on
    towards the corridor.
    """
    k = len(walls)
    corners = np.zeros((3 * k, 3))
    corners[0::3, :2] = walls[:, :END]
    corners[1::3, :2] = corners[2::3, :2] = walls[:, END:ACROSS]
    tree = pdtree.build(corners, np.arange(3 * k).reshape(k, 3))
    edges = np.full((k, 3), int(Edge.RIDGE), dtype=np.int8)
    for i in range(k):
        for edge, j, far in ((2, i - 1, 0), (1, i + 1, END)):
            if 0 <= j < k and walls[j, ON] == walls[i, ON]:
                ahead = walls[j, far : far + 2] - walls[i, :END]
                if walls[i, ACROSS:ON] @ ahead > 0.0:
                    edges[i, edge] = Edge.VALLEY
    # What `pdtree.build` says of slivers does not hold for what is a line: its distance is exact.
    return tree._replace(errors=np.zeros(k)), edges


def _check_apart(walls: FloatArray, legs: IntArray, width: float) -> None:
    """Refuse walls that meet: which side of them is free would then be open.

    Args:
        legs: (k,) from which leg of the path each piece comes.
    """
    i, j = _meeting(walls[:, :END].copy(), walls[:, END:ACROSS].copy(), walls[:, ON].copy())
    if i >= 0:
        raise ValueError(
            f"the path comes too near to itself for a corridor of ±{width * 1e3:g} mm: the walls "
            f"along its legs {legs[i] + 1} and {legs[j] + 1} meet, its ends carried on straight by "
            f"{FAR:g} m; take a part of the path, or a narrower corridor"
        )


@njit(cache=True)
def _meeting(starts, ends, sides):  # type: ignore[no-untyped-def]
    """Two pieces of the walls that touch though neither follows the other, or −1, −1."""
    for i in range(len(sides)):
        for j in range(i + 1, len(sides)):
            if j == i + 1 and sides[i] == sides[j]:
                continue
            apart = False
            for k in range(2):
                apart |= max(starts[i, k], ends[i, k]) < min(starts[j, k], ends[j, k]) - ON_WALL
                apart |= max(starts[j, k], ends[j, k]) < min(starts[i, k], ends[i, k]) - ON_WALL
            if (
                not apart
                and _distance2(starts[i], ends[i], starts[j], ends[j]) <= ON_WALL * ON_WALL
            ):
                return i, j
    return -1, -1


@njit(cache=True)
def _distance2(a, b, c, d):  # type: ignore[no-untyped-def]
    """Squared distance of the segments ab and cd in the plane: 0 where they cross."""
    c_left = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) > 0.0
    d_left = (b[0] - a[0]) * (d[1] - a[1]) - (b[1] - a[1]) * (d[0] - a[0]) > 0.0
    a_left = (d[0] - c[0]) * (a[1] - c[1]) - (d[1] - c[1]) * (a[0] - c[0]) > 0.0
    b_left = (d[0] - c[0]) * (b[1] - c[1]) - (d[1] - c[1]) * (b[0] - c[0]) > 0.0
    if c_left != d_left and a_left != b_left:
        return 0.0
    return min(
        _closest(a[0], a[1], b[0], b[1], c[0], c[1])[3],
        _closest(a[0], a[1], b[0], b[1], d[0], d[1])[3],
        _closest(c[0], c[1], d[0], d[1], a[0], a[1])[3],
        _closest(c[0], c[1], d[0], d[1], b[0], b[1])[3],
    )


@njit(cache=True)
def _closest(ax, ay, bx, by, x, y):  # type: ignore[no-untyped-def]
    """Closest point of a segment: its share of the way from a to b, itself, squared distance."""
    ux, uy = bx - ax, by - ay
    uu = ux * ux + uy * uy
    t = ((x - ax) * ux + (y - ay) * uy) / uu if uu > 0.0 else 0.0
    t = min(max(t, 0.0), 1.0)
    px, py = ax + t * ux, ay + t * uy
    return t, px, py, (x - px) ** 2 + (y - py) ** 2


@njit(cache=True)
def _room(walls, x, y):  # type: ignore[no-untyped-def]
    """Signed distance to the nearest wall, the nearest point, and the normal that gave the sign."""
    best = np.inf
    nearest = 0
    at = 0.0
    px = py = 0.0
    for i in range(walls.shape[0]):
        t, cx, cy, d2 = _closest(walls[i, 0], walls[i, 1], walls[i, 2], walls[i, 3], x, y)
        if d2 < best:
            best, nearest, at, px, py = d2, i, t, cx, cy
    nx, ny = walls[nearest, ACROSS], walls[nearest, ACROSS + 1]
    other = nearest - 1 if at == 0.0 else nearest + 1
    ends = (at == 0.0 or at == 1.0) and 0 <= other < walls.shape[0]
    if ends and walls[other, ON] == walls[nearest, ON]:
        nx += walls[other, ACROSS]
        ny += walls[other, ACROSS + 1]
    distance = np.sqrt(best)
    if nx * (x - px) + ny * (y - py) < 0.0:
        distance = -distance
    size = np.sqrt(nx * nx + ny * ny)
    return distance, px, py, nx / size, ny / size


@njit(cache=True)
def between(  # type: ignore[no-untyped-def]
    walls, axes, width, hair, nodes, corners, order, slivers, edges, p, radius, standoff,
    tip_radius, planes, first, queue, polygons,
):  # fmt: skip
    """Planes of a corridor for a tip at p (3,): as `cover.walk`, which does it in the plane.

    What separates x from a piece there separates the tip from the whole wall, which stands on it
    along the direction of the cut.

    Args:
        walls, axes: (k, WALL) pieces in the plane of the axes (2, 3).
        hair: a tip nearer to a wall than this is on it or outside [m].
        nodes, corners, order, slivers, edges: of them.
    """
    x = axes[0, 0] * p[0] + axes[0, 1] * p[1] + axes[0, 2] * p[2]
    y = axes[1, 0] * p[0] + axes[1, 1] * p[1] + axes[1, 2] * p[2]
    room, px, py, nx, ny = _room(walls, x, y)
    if room < hair:
        if room < -hair:
            nx, ny = (px - x) / -room, (py - y) / -room
        # The controller asks to be at the standoff from this foot, in one tick by half.
        back = min(2.0 * LED_BACK, max(-room, 0.0) + standoff + tip_radius) - standoff - tip_radius
        plane = planes[first]
        plane[NORMAL], plane[NORMAL + 1] = nx, ny
        plane[OFFSET] = nx * x + ny * y
        plane[FOOT], plane[FOOT + 1] = x + back * nx, y + back * ny
        plane[FLOOR] = plane[LIMIT] = -np.inf
        plane[FIXTURE] = plane[CAPSULE] = plane[POINT] = plane[PUSH] = plane[BUMP] = 0.0
        m = 1
        valid = min(radius, max(-room, 0.0) + width)
    else:
        flat = np.zeros(3)
        flat[0], flat[1] = x, y
        m, valid = walk(
            nodes, corners, order, slivers, edges, True, flat, radius, standoff, tip_radius, 0.0,
            planes, first, queue, polygons,
        )  # fmt: skip
    for i in range(first, first + m):
        plane = planes[i]
        nx, ny = plane[NORMAL], plane[NORMAL + 1]
        fx, fy = plane[FOOT] - x, plane[FOOT + 1] - y
        for c in range(3):
            plane[NORMAL + c] = nx * axes[0, c] + ny * axes[1, c]
            plane[FOOT + c] = p[c] + (fx * axes[0, c] + fy * axes[1, c])
        plane[TRIANGLE] = -1.0
        plane[RULE] = CORRIDOR
    return m, valid


@njit(cache=True)
def _between_alone(  # type: ignore[no-untyped-def]
    walls, axes, width, hair, nodes, corners, order, slivers, edges, p, radius, standoff,
    tip_radius, planes,
):  # fmt: skip
    """`between` with room of its own to work in, for a single call from Python."""
    return between(
        walls, axes, width, hair, nodes, corners, order, slivers, edges, p, radius, standoff,
        tip_radius, planes, 0, np.empty((HEAP, 3)), np.empty((2, CORNERS, 3)),
    )  # fmt: skip
