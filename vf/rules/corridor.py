"""A corridor along a planned path: the tool may leave the path sideways by no more than a width."""

from __future__ import annotations

from math import cos, radians

import numpy as np
from numpy.typing import ArrayLike

from vf import layout as at
from vf.kernels import njit
from vf.planes import ROUND, FloatArray, Planes, Rule, checked_length, planes_of
from vf.rules.certified import BUDGET, CORNERS, FAINT, HEAP, walk
from vf.rules.search import Search
from vf.rules.walls import (
    ACROSS,
    END,
    FAR,
    ON,
    ON_WALL,
    bends,
    room_between,
    tree_of,
    walls_along,
)
from vf.tree.shapes import RIGID

# A tool outside is moved back by at most this in a tick [m]: 10 mm/s at 1 kHz.
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
        self.walls = walls_along(bends(self.path @ self.axes.T), self.width)  # (k, WALL) [m]
        self.tree, self.edges = tree_of(self.walls)
        # A tip closer to a wall than this counts as on it: no plane separates the two [m].
        self.hair = max(ON_WALL, 2.0 * FAINT * ROUND * float(np.abs(self.walls[:, :ACROSS]).max()))
        frame = np.array([*self.axes.ravel(), self.width, self.hair])
        self.search = Search(at.WALLED, self.tree, self.edges, self.walls, frame)
        for array in (
            self.path, self.direction, self.axes, self.walls, self.edges, frame, *self.tree
        ):  # fmt: skip
            array.flags.writeable = False

    def inside(self, x: FloatArray) -> bool:
        """Always False: `planes` leads a tool outside the corridor back, it is not inside."""
        return False

    def leads_out(self, x: FloatArray, y: FloatArray) -> bool:
        return True

    def planes(
        self, x: FloatArray, radius: float, standoff: float, tip_radius: float, inside: bool
    ) -> Planes:
        planes = np.empty((BUDGET, at.PLANE))
        m, reach = _between_alone(
            self.walls, self.axes, self.width, self.hair, *self.tree, self.edges, x, radius,
            standoff, tip_radius, planes,
        )  # fmt: skip
        return planes_of(planes[:m], reach)

    def room(self, x: ArrayLike) -> float:
        """Distance of x (3,) to the nearest wall [m], negative outside the corridor."""
        flat = self.axes @ np.asarray(x, dtype=np.float64)
        return float(room_between(self.walls, flat[0], flat[1])[0])

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


@njit(cache=True)
def between(  # type: ignore[no-untyped-def]
    walls, axes, width, hair, nodes, corners, order, slivers, edges, p, radius, standoff,
    tip_radius, planes, first, queue, polygons,
):  # fmt: skip
    """Planes of a corridor for a tip at p (3,): from `certified.walk` in the plane of the axes.

    A line that separates x from a piece of the wall in that plane gives a plane, along the
    direction of the cut, that separates the tip from the whole wall.

    Args:
        walls, axes: (k, WALL) pieces in the plane of the axes (2, 3).
        hair: a tip closer to a wall than this counts as on it or outside [m].
        nodes, corners, order, slivers, edges: of them.
    """
    x = axes[0, 0] * p[0] + axes[0, 1] * p[1] + axes[0, 2] * p[2]
    y = axes[1, 0] * p[0] + axes[1, 1] * p[1] + axes[1, 2] * p[2]
    room, px, py, nx, ny = room_between(walls, x, y)
    if room < hair:
        if room < -hair:
            nx, ny = (px - x) / -room, (py - y) / -room
        # The controller recovers half of what is missing to the standoff from this foot in a tick.
        back = min(2.0 * LED_BACK, max(-room, 0.0) + standoff + tip_radius) - standoff - tip_radius
        plane = planes[first]
        plane[at.NORMAL], plane[at.NORMAL + 1] = nx, ny
        plane[at.OFFSET] = nx * x + ny * y
        plane[at.FOOT], plane[at.FOOT + 1] = x + back * nx, y + back * ny
        plane[at.FLOOR] = plane[at.LIMIT] = -np.inf
        plane[at.FIXTURE] = plane[at.CAPSULE] = plane[at.POINT] = 0.0
        plane[at.PUSH] = plane[at.BUMP] = 0.0
        m = 1
        valid = min(radius, max(-room, 0.0) + width)
    else:
        none = slivers[:0]  # margins: there are none
        m, valid, _lowered = walk(
            nodes, corners, order, slivers, edges, RIGID, 0.0, none, none, 0.0, True, (x, y, 0.0),
            radius, standoff, tip_radius, 0.0, planes, first, queue, polygons,
        )  # fmt: skip
    for i in range(first, first + m):
        plane = planes[i]
        nx, ny = plane[at.NORMAL], plane[at.NORMAL + 1]
        fx, fy = plane[at.FOOT] - x, plane[at.FOOT + 1] - y
        for c in range(3):
            plane[at.NORMAL + c] = nx * axes[0, c] + ny * axes[1, c]
            plane[at.FOOT + c] = p[c] + (fx * axes[0, c] + fy * axes[1, c])
        plane[at.TRIANGLE] = -1.0
        plane[at.RULE] = CORRIDOR
    return m, valid


@njit(cache=True)
def _between_alone(  # type: ignore[no-untyped-def]
    walls, axes, width, hair, nodes, corners, order, slivers, edges, p, radius, standoff,
    tip_radius, planes,
):  # fmt: skip
    """`between` with its own working memory, for a single call from Python."""
    return between(
        walls, axes, width, hair, nodes, corners, order, slivers, edges, p, radius, standoff,
        tip_radius, planes, 0, np.empty((HEAP, 3)), np.empty((2, CORNERS, 3)),
    )  # fmt: skip
