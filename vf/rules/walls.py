"""The walls of a corridor: pieces of lines in the plane across the direction of the cut."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vf.adjacency import Edge
from vf.kernels import njit
from vf.planes import FloatArray, IntArray
from vf.tree.build import build
from vf.tree.pdtree import Tree

FAR = 1.0  # the walls go on straight by this much before and after the path [m]
STRAIGHT = 1e-9  # a point this near to the straight line of its neighbours is no bend [m]
ON_WALL = 1e-12  # walls this near to each other meet, and on a wall within rounding [m]
# A row of the walls: start (2), end (2), normal into the corridor (2), on which side of the path.
END, ACROSS, ON, WALL = 2, 4, 6, 7


def bends(points: FloatArray) -> FloatArray:
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


def walls_along(points: FloatArray, width: float) -> FloatArray:
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


def tree_of(walls: FloatArray) -> tuple[Tree, NDArray[np.int8]]:
    """The walls for `certified.walk`: triangles (a, b, b) in the plane, and kinds (k, 3) of edges.

    Edge 2 stands for the bend at a and edge 1 for that at b: a valley where the next piece of the
    wall turns towards the corridor.
    """
    k = len(walls)
    corners = np.zeros((3 * k, 3))
    corners[0::3, :2] = walls[:, :END]
    corners[1::3, :2] = corners[2::3, :2] = walls[:, END:ACROSS]
    tree = build(corners, np.arange(3 * k).reshape(k, 3))
    edges = np.full((k, 3), int(Edge.RIDGE), dtype=np.int8)
    for i in range(k):
        for edge, j, far in ((2, i - 1, 0), (1, i + 1, END)):
            if 0 <= j < k and walls[j, ON] == walls[i, ON]:
                ahead = walls[j, far : far + 2] - walls[i, :END]
                if walls[i, ACROSS:ON] @ ahead > 0.0:
                    edges[i, edge] = Edge.VALLEY
    # The error bounds of `build` are for triangles: the distance to a line segment is exact.
    return tree._replace(errors=np.zeros(k)), edges


def _check_apart(walls: FloatArray, legs: IntArray, width: float) -> None:
    """Refuse walls that meet: which side of them is free would then be undefined.

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
def room_between(walls, x, y):  # type: ignore[no-untyped-def]
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
