"""A tool that starts inside a closed mesh, or exactly on it: which steps lead it out.

Let the winding number w around x be 1 or −1. Call a triangle *passable* if x is strictly on its
inner side, and *guarded* otherwise. A segment from x crosses passable triangles from their inner to
their outer side only, and each that it crosses takes w one nearer to 0, then beyond. So a step may

- touch no guarded triangle, and of the passable ones none, or
- touch no guarded triangle, and the passable ones in a single point, if w is 0 where it ends.

`leads_out` decides about a step by exact arithmetic. `way_out` gives the planes for it: those of
the certified rule for the guarded triangles, which also hold on the tip's curved path, and one that
lets the tool go no deeper. All of this is about the tip's centre: a ball that comes out of a body
overlaps the wall. See docs/certified.md.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vf.kernels import njit
from vf.planes import FloatArray, IntArray, Planes, Rule
from vf.rules.certified import FAINT, cover
from vf.surface import Surface
from vf.tree.build import build
from vf.tree.nearest import nearest_face_facing
from vf.tree.pdtree import EXACT, Tree
from vf.tree.sides import inner_side, side

# Closer to the surface than this, inside and outside are not distinguished [m].
ON_SURFACE = 1e-9
LIFT = 1e-8  # [m], far above rounding and far below any standoff
# Inside, a step may cover this share of the distance to the nearest surface. Where that distance is
# at most `HOP`, a step may pass through the surface to the outside.
APPROACH = 0.75
HOP = 2e-5  # [m]
# A step that may pass a wall stays away from guarded triangles by this share of their distance, or
# by the standoff if that is less: behind the wall there may be less space than a standoff.
CLEAR = 0.1


class Part(NamedTuple):
    """Some triangles of a surface: what `cover` needs of one."""

    tree: Tree
    edges: NDArray[np.int8]


def way_out(
    surface: Surface, x: FloatArray, radius: float, standoff: float, tip_radius: float
) -> Planes:
    """Planes for a tip centre x (3,) inside a closed surface: no deeper, and off all guarded walls.

    The radius is 0, and the tool stays, where no triangle is passable.
    """
    distance = surface.nearest(x)[0]
    if distance <= touching_distance(surface):
        return on_surface(surface, x, radius, standoff, tip_radius) or Planes.none(0.0)
    turn = _turn(surface, x)
    depth, triangle, point = nearest_passable(surface, x, turn)
    if triangle < 0:
        return Planes.none(0.0)
    normal = (point - x) / depth
    planes = Planes(
        normal[None, :],
        np.array([normal @ x - surface.rounding]),
        point[None, :],
        np.array([triangle]),
        np.array([int(Rule.EXIT)]),
        min(radius, max(APPROACH * (distance - _blur(surface)), 0.0)),
    )
    return planes if distance > HOP else _guarded(surface, x, radius, standoff, turn, planes)


def _guarded(
    surface: Surface, x: FloatArray, radius: float, standoff: float, turn: float, out: Planes
) -> Planes:
    """The plane `out` and those of the guarded triangles, in a ball that extends past the wall."""
    distance = surface.nearest(x)[0]
    radius = min(radius, 2.0 * distance + 0.1 * HOP)
    found = surface.within(x, radius + _blur(surface))
    guarded = ~_passable(surface, found.triangles, x, turn) & ~surface.repeats[found.triangles]
    rows = found.triangles[guarded]
    out = replace(out, radius=radius, floors=np.array([-np.inf]))
    if not len(rows):
        return out
    part = Part(build(surface.vertices, surface.faces[rows]), surface.edges[rows])
    for array in (*part.tree, part.edges):
        array.flags.writeable = False  # as a surface's: kernels are compiled for one kind only
    kept = min(standoff, CLEAR * float(found.distances[guarded].min()))
    covering = cover(part, x, radius, kept, 0.0)
    return Planes(
        np.concatenate([out.normals, covering.normals]),
        np.concatenate([out.offsets, covering.offsets]),
        np.concatenate([out.points, covering.points]),
        np.concatenate([out.triangles, rows[covering.triangles]]),
        np.full(1 + len(covering), int(Rule.EXIT)),
        covering.radius,
        np.concatenate([out.floors, covering.floors]),
    )


def leads_out(surface: Surface, x: FloatArray, y: FloatArray) -> bool:
    """Whether the straight step from x to y (3,), x inside a closed surface, is allowed.

    It is if it meets no triangle and gets no deeper, or if it crosses one wall in one point and
    ends where the winding number is 0. It may not end on the surface, where no plane separates
    inside from outside.
    """
    clear = max(ON_SURFACE, 2.0 * touching_distance(surface))
    if surface.nearest(y)[0] < clear:
        return False
    start = surface.nearest(x)[0]
    if start <= touching_distance(surface):  # the planes of `on_surface` have settled the rest
        return _outside(surface, y)
    turn = _turn(surface, x)
    length = float(np.linalg.norm(y - x))
    if length > start - _blur(surface):
        near = surface.within(x, length * (1.0 + 1e-9) + _blur(surface)).triangles
        near = near[~surface.repeats[near]]
        near = near[_met(_corners(surface, near), x, y)]
        if not _passable(surface, near, x, turn).all():
            return False
        passages = [_passage(corners, x, y) for corners in surface.vertices[surface.faces[near]]]
        points = {point for point in passages if point is not None}
        if points:
            return len(points) == 1 and max(points) < 1 and _outside(surface, y)
    deepest = nearest_passable(surface, x, turn)[0] + surface.rounding
    return nearest_passable(surface, y, turn)[0] <= deepest


def on_surface(
    surface: Surface, x: FloatArray, radius: float, standoff: float, tip_radius: float
) -> Planes | None:
    """The planes for a tip exactly on a closed surface, where x is neither inside nor outside.

    They are those of a point up to `LIFT` outside, where the winding number is 0, relaxed so that x
    obeys them: the tip may stay on the surface or leave it, never enter. A step is shorter than the
    distance to any triangle that does not touch x, so it meets none. None: no outside was found.
    """
    touch = touching_distance(surface)
    touching = surface.within(x, touch).triangles
    free = _free(surface, x, touch, radius)
    lift = min(LIFT, 0.25 * free)
    normals = surface.normals[touching]
    for normal in (normals.sum(axis=0), *normals):
        size = float(np.linalg.norm(normal))
        for sign in (1.0, -1.0):
            lifted = x + sign * lift * normal / max(size, 1e-12)
            if surface.nearest(lifted)[0] < 0.1 * lift or not _outside(surface, lifted):
                continue
            planes = cover(surface, lifted, radius, standoff, tip_radius)
            offsets = np.minimum(planes.offsets, planes.normals @ x - surface.rounding)
            reach = max(min(planes.radius - lift, 0.5 * free), 0.0)
            # No floors: within this ball no path meets a triangle that x does not touch.
            return replace(planes, offsets=offsets, radius=reach, floors=None)
    return None


def touching_distance(surface: Surface) -> float:
    """A point closer to a triangle than this counts as on it: rounding allows no more [m]."""
    return 2.0 * FAINT * surface.rounding


def _free(surface: Surface, x: FloatArray, touch: float, radius: float) -> float:
    """Distance of x (3,) to the nearest triangle that does not touch it, at most `radius`."""
    reach = min(max(4.0 * touch, ON_SURFACE), radius)
    while True:
        distances = surface.within(x, reach).distances
        apart = distances[distances > touch]
        if len(apart) or reach >= radius:
            return float(apart.min(initial=radius))
        reach = min(4.0 * reach, radius)


def _blur(surface: Surface) -> float:
    """How much a computed distance to the surface can exceed the true one [m]."""
    return EXACT + surface.rounding + surface.distance_error


def _outside(surface: Surface, x: FloatArray) -> bool:
    """Whether the winding number around x (3,) is 0. Where it is 2, x is not inside either."""
    return abs(surface.winding(x)) < 0.5


def _turn(surface: Surface, x: FloatArray) -> float:
    """1 where the faces around x (3,) are wound with outward normals, −1 where with inward ones."""
    return 1.0 if surface.winding(x) > 0.0 else -1.0


def _corners(surface: Surface, triangles: IntArray) -> FloatArray:
    return surface.vertices[surface.faces[triangles]].reshape(-1, 9)


def _passable(
    surface: Surface, triangles: IntArray, x: FloatArray, turn: float
) -> NDArray[np.bool_]:
    """(k,) whether x (3,) is strictly on the inner side of each of these triangles (k,)."""
    return np.asarray(_inner_sides(_corners(surface, triangles), x, turn))


def nearest_passable(surface: Surface, x: FloatArray, turn: float) -> tuple[float, int, FloatArray]:
    """Distance [m], face and closest point (3,) of the nearest passable triangle; inf, −1: none."""
    tree = surface.tree
    point = np.array(x, dtype=np.float64)
    distance, row = nearest_face_facing(tree.nodes, tree.corners, point, turn)
    return distance, (int(tree.order[row]) if row >= 0 else -1), point


def _passage(triangle: FloatArray, x: FloatArray, y: FloatArray) -> Fraction | None:
    """Where on the segment from x (0) to y (1) it meets a triangle (3, 3); None: nowhere. Exact.

    x is not in the triangle's plane.
    """
    a, b, c, p, q = ([Fraction(float(v)) for v in point] for point in (*triangle, x, y))
    start, end = _volume(a, b, c, p), _volume(a, b, c, q)
    if start * end > 0:
        return None
    sides = [_volume(p, q, a, b), _volume(p, q, b, c), _volume(p, q, c, a)]
    if min(sides) < 0 < max(sides):
        return None
    return start / (start - end)


def _volume(a: list[Fraction], b: list[Fraction], c: list[Fraction], d: list[Fraction]) -> Fraction:
    """Six times the signed volume of a tetrahedron."""
    u, v, w = ([s - t for s, t in zip(point, a, strict=True)] for point in (b, c, d))
    return (
        (u[1] * v[2] - u[2] * v[1]) * w[0]
        + (u[2] * v[0] - u[0] * v[2]) * w[1]
        + (u[0] * v[1] - u[1] * v[0]) * w[2]
    )


@njit(cache=True, nogil=True)
def _inner_sides(corners, p, turn):  # type: ignore[no-untyped-def]
    found = np.empty(corners.shape[0], dtype=np.bool_)
    for t in range(corners.shape[0]):
        found[t] = inner_side(corners[t], p[0], p[1], p[2], turn)
    return found


@njit(cache=True, nogil=True)
def _met(corners, p, q):  # type: ignore[no-untyped-def]
    """(k,) whether the closed segment pq meets each triangle (k, 9), or rounding may hide it."""
    met = np.empty(corners.shape[0], dtype=np.bool_)
    for t in range(corners.shape[0]):
        c = corners[t]
        ax, ay, az, bx, by, bz, cx, cy, cz = c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8]
        start = side(ax, ay, az, bx, by, bz, cx, cy, cz, p[0], p[1], p[2])
        end = side(ax, ay, az, bx, by, bz, cx, cy, cz, q[0], q[1], q[2])
        met[t] = False
        if start * end > 0:
            continue
        one = side(p[0], p[1], p[2], q[0], q[1], q[2], ax, ay, az, bx, by, bz)
        two = side(p[0], p[1], p[2], q[0], q[1], q[2], bx, by, bz, cx, cy, cz)
        three = side(p[0], p[1], p[2], q[0], q[1], q[2], cx, cy, cz, ax, ay, az)
        met[t] = not (min(one, two, three) < 0 < max(one, two, three))
    return met
