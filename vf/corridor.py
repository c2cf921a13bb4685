"""A corridor along a planned path: the tool may leave the path sideways by no more than a width."""

from __future__ import annotations

from math import cos, radians

import numpy as np
from numpy.typing import ArrayLike

from vf.cover import VALLEY_ROOM, YIELD, YIELD_SHARE, Buffer
from vf.kernels import njit
from vf.planes import FloatArray, IntArray, Planes, Rule, checked_length

BUDGET = 32  # planes at most; a buffer has room for more
FAR = 1.0  # the walls go on straight by this much before and after the path [m]
STRAIGHT = 1e-9  # a point this near to the straight line of its neighbours is no bend [m]
ON_WALL = 1e-12  # on a wall within rounding [m]
# How far a tool outside is led back in a tick [m]: 10 mm/s at 1 kHz.
LED_BACK = 1e-5
CORRIDOR = int(Rule.CORRIDOR)
FLATTEN = cos(radians(30.0))


class CorridorFixture:
    """Keeps the tool within a width of a path, seen along the direction of the cut.

    The corridor is all points whose distance from the path is at most `width` when both are
    projected along `direction`: how deep the tool is does not matter, and beyond its ends the path
    goes on straight. A path in one plane that contains `direction` (a sagittal cut) has two
    parallel walls; any other has a wall of flat pieces on either side, cut across on the outside of
    a bend, so that what is between the walls is never farther from the path than `width`.

    The planes are chosen as by the certified rule, with the pieces of the walls for triangles, and
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
    fills = True

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
        self._axes = _across(self.direction)
        self._walls = _walls(_bends(self.path @ self._axes.T), self.width)
        for array in (self.path, self.direction, self._axes, *self._walls):
            array.flags.writeable = False

    def inside(self, x: FloatArray) -> bool:
        """Never: outside the corridor is not inside an anatomy, and `planes` leads back."""
        return False

    def leads_out(self, x: FloatArray, y: FloatArray) -> bool:
        return True

    def planes(
        self, x: FloatArray, radius: float, standoff: float, tip_radius: float, inside: bool
    ) -> Planes:
        buffer = Buffer()
        return buffer.cut(*self.fill(buffer, 0, x, radius, standoff, tip_radius))

    def fill(
        self,
        buffer: Buffer,
        first: int,
        x: FloatArray,
        radius: float,
        standoff: float,
        tip_radius: float,
    ) -> tuple[int, float]:
        m, reach = _planes(
            *self._walls, self._axes, x, radius, standoff, tip_radius, self.width,
            *buffer.rows(first),
        )  # fmt: skip
        return m, reach

    def room(self, x: ArrayLike) -> float:
        """Distance of x (3,) to the nearest wall [m], negative outside the corridor."""
        flat = self._axes @ np.asarray(x, dtype=np.float64)
        return float(_room(*self._walls, flat[0], flat[1])[0])

    def ribbons(self, half_height: float, beyond: float = 0.0) -> tuple[FloatArray, FloatArray]:
        """The two walls as strips of quadrangles to draw, each (k, 4, 3) [m].

        Args:
            half_height: how far they go up and down from the path along `direction` [m].
            beyond: how far they go on before and after the path [m].
        """
        starts, ends, _normals, sides = self._walls
        flat, along = self.path @ self._axes.T, self.path @ self.direction
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
                middle = marks @ self._axes + along[nearest, None] * self.direction
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


def _walls(points: FloatArray, width: float) -> tuple[FloatArray, FloatArray, FloatArray, IntArray]:
    """Pieces of both walls: starts (k, 2), ends (k, 2), normals into the corridor, side 0 or 1."""
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
    walls = np.array(starts), np.array(ends), np.array(normals), np.array(sides, dtype=np.int64)
    _check_apart(walls, np.array(legs), width)
    return walls


def _check_apart(
    walls: tuple[FloatArray, FloatArray, FloatArray, IntArray], legs: IntArray, width: float
) -> None:
    """Refuse walls that meet: which side of them is free would then be open.

    Args:
        legs: (k,) from which leg of the path each piece comes.
    """
    starts, ends, _, sides = walls
    i, j = _meeting(starts, ends, sides)
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
def _room(starts, ends, normals, sides, x, y):  # type: ignore[no-untyped-def]
    """Signed distance to the nearest wall, the nearest point, and the normal that gave the sign."""
    best = np.inf
    nearest = 0
    at = 0.0
    px = py = 0.0
    for i in range(len(sides)):
        t, cx, cy, d2 = _closest(starts[i, 0], starts[i, 1], ends[i, 0], ends[i, 1], x, y)
        if d2 < best:
            best, nearest, at, px, py = d2, i, t, cx, cy
    nx, ny = normals[nearest, 0], normals[nearest, 1]
    other = nearest - 1 if at == 0.0 else nearest + 1
    if (at == 0.0 or at == 1.0) and 0 <= other < len(sides) and sides[other] == sides[nearest]:
        nx += normals[other, 0]
        ny += normals[other, 1]
    distance = np.sqrt(best)
    if nx * (x - px) + ny * (y - py) < 0.0:
        distance = -distance
    size = np.sqrt(nx * nx + ny * ny)
    return distance, px, py, nx / size, ny / size


@njit(cache=True)
def _meets_at_valley(starts, ends, normals, sides, i, t):  # type: ignore[no-untyped-def]
    """Whether piece i goes on at the end t (0 or 1) with one that bends towards the corridor."""
    j = i - 1 if t == 0.0 else i + 1
    if j < 0 or j >= len(sides) or sides[j] != sides[i]:
        return False
    far = starts[j] if t == 0.0 else ends[j]
    return normals[i, 0] * (far[0] - starts[i, 0]) + normals[i, 1] * (far[1] - starts[i, 1]) > 0.0


@njit(cache=True)
def _planes(  # type: ignore[no-untyped-def]
    starts,
    ends,
    normals,
    sides,
    axes,
    p,
    radius,
    standoff,
    tip_radius,
    width,
    out_normals,
    out_offsets,
    out_points,
    out_triangles,
    out_rules,
    out_floors,
):
    """The planes into the fields of a buffer: the certified cover of `vf.cover`, of flat pieces
    instead of triangles. What is left of a piece behind a plane is a piece again, so t runs over
    [low, high].
    """
    x = axes[0, 0] * p[0] + axes[0, 1] * p[1] + axes[0, 2] * p[2]
    y = axes[1, 0] * p[0] + axes[1, 1] * p[1] + axes[1, 2] * p[2]
    k = len(sides)
    flat = np.empty((BUDGET, 2))
    offsets = np.empty(BUDGET)
    feet = np.empty((BUDGET, 2))
    limits = np.empty(BUDGET)
    floors = np.empty(BUDGET)
    m = 0
    valid = radius
    room, px, py, nx, ny = _room(starts, ends, normals, sides, x, y)
    if room < ON_WALL:
        if room < -ON_WALL:
            nx, ny = (px - x) / -room, (py - y) / -room
        flat[0, 0], flat[0, 1] = nx, ny
        offsets[0] = nx * x + ny * y
        # The controller asks to be at the standoff from this foot, in one tick by half.
        back = min(2.0 * LED_BACK, max(-room, 0.0) + standoff + tip_radius) - standoff - tip_radius
        feet[0, 0], feet[0, 1] = x + back * nx, y + back * ny
        floors[0] = -np.inf
        m = 1
        valid = min(radius, max(-room, 0.0) + width)
    else:
        reach2 = (radius + tip_radius) ** 2 * (1.0 + 1e-9)
        distances = np.empty(k)
        for i in range(k):
            distances[i] = _closest(
                starts[i, 0], starts[i, 1], ends[i, 0], ends[i, 1], x, y
            )[3]  # fmt: skip
        while True:
            i = np.argmin(distances)
            d2 = distances[i]
            if d2 > reach2:
                break
            distances[i] = np.inf
            ax, ay = starts[i, 0], starts[i, 1]
            ux, uy = ends[i, 0] - ax, ends[i, 1] - ay
            low, high = 0.0, 1.0
            for j in range(m):
                # Where along the piece it comes out from behind plane j.
                h0 = flat[j, 0] * ax + flat[j, 1] * ay - limits[j]
                slope = flat[j, 0] * ux + flat[j, 1] * uy
                if slope > 0.0:
                    low = max(low, -h0 / slope)
                elif slope < 0.0:
                    high = min(high, -h0 / slope)
                elif h0 < 0.0:
                    high = -1.0
            if low >= high:
                continue
            rx, ry, sx, sy = ax + low * ux, ay + low * uy, ax + high * ux, ay + high * uy
            _t, cx, cy, rest2 = _closest(rx, ry, sx, sy, x, y)
            if rest2 > reach2:
                continue
            if m == BUDGET:
                valid = max(np.sqrt(d2) * (1.0 - 1e-9) - tip_radius, 0.0)
                break
            t, qx, qy, _d2 = _closest(ax, ay, ends[i, 0], ends[i, 1], x, y)
            nx, ny = normals[i, 0], normals[i, 1]
            base = max(nx * ax + ny * ay, nx * ends[i, 0] + ny * ends[i, 1])
            space = nx * x + ny * y - base - tip_radius
            face = 0.0 < t < 1.0 or (
                _meets_at_valley(starts, ends, normals, sides, i, t)
                and space > VALLEY_ROOM * max(np.sqrt(d2) - tip_radius, 0.0)
            )
            if face and space > 0.0:
                cx, cy = qx, qy
            else:
                d = np.sqrt(rest2)
                nx, ny = (x - cx) / d, (y - cy) / d
                base = max(nx * rx + ny * ry, nx * sx + ny * sy)
                space = nx * x + ny * y - base - tip_radius
            # The tip overlaps the wall where there is no space: the claim is then about its centre.
            clear = space if space > ON_WALL else space + tip_radius
            stand = nx * x + ny * y - min(YIELD, YIELD_SHARE * max(clear, 0.0))
            kept = standoff
            if space < standoff and room - tip_radius > ON_WALL:
                kept = min(room - tip_radius, standoff)  # to the middle, as in `vf.cover`
            offsets[m] = min(base + tip_radius + max(kept, ON_WALL), stand)
            limits[m] = base + 1e-14
            floors[m] = limits[m] + (tip_radius if space > ON_WALL else 0.0)
            flat[m, 0], flat[m, 1] = nx, ny
            feet[m, 0], feet[m, 1] = cx, cy
            m += 1
    for i in range(m):
        for c in range(3):
            out_normals[i, c] = flat[i, 0] * axes[0, c] + flat[i, 1] * axes[1, c]
            out_points[i, c] = p[c] + (
                (feet[i, 0] - x) * axes[0, c] + (feet[i, 1] - y) * axes[1, c]
            )
        out_offsets[i] = offsets[i]
        out_triangles[i] = -1
        out_rules[i] = CORRIDOR
        out_floors[i] = floors[i]
    return m, valid
