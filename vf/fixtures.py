"""Fixtures: each turns the tool's position into planes."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from vf.conditions import every_plane, paper_planes
from vf.cover import FAINT, Buffer, cover
from vf.planes import FloatArray, IntArray, Planes, Rule, checked_length
from vf.surface import Contacts, Surface

# Nearer than this to the surface there is no telling the sides apart [m].
ON_SURFACE = 1e-9
# Left to x by the planes of the paper's rules, so that rounding cannot block sliding [m].
ROOM = 1e-11
LIFT = 1e-8  # [m], far above rounding and far below any standoff
# From inside, a step may go this share of the way to the nearest surface, until that is `HOP` away:
# then a step may pass it.
APPROACH = 0.75
HOP = 2e-5  # [m]
RULES = ("certified", "paper", "all", "off")


class Fixture(Protocol):
    """What the controller asks of a fixture. Answers depend on the arguments alone."""

    radius: float | None  # of the motion sphere [m]; None: as far as the arm can go in a tick
    certified: bool  # whether a verified step provably stays on its side

    def planes(
        self, x: FloatArray, radius: float, standoff: float, tip_radius: float, inside: bool
    ) -> Planes:
        """Planes with n·x ≥ o for a tip of `tip_radius` centred at x (3,), base frame [m]."""
        ...

    def inside(self, x: FloatArray) -> bool:
        """Whether x (3,) is where the tool must never be."""
        ...

    def depth(self, x: FloatArray) -> float:
        """Distance of x (3,) to the way out, asked only inside [m]."""
        ...


class Filling(Fixture, Protocol):
    """A fixture that can write its planes where the controller wants them: no arrays are made."""

    fills: bool  # whether it does

    def fill(
        self,
        buffer: Buffer,
        first: int,
        x: FloatArray,
        radius: float,
        standoff: float,
        tip_radius: float,
    ) -> tuple[int, float] | None:
        """`planes` for an x that is not inside, written to the buffer from row `first` on.

        Returns:
            How many, at most `vf.cover.BUDGET`, and the radius they are valid in [m]; None where
            only `planes` can answer.
        """
        ...


class MeshFixture:
    """Keeps the tool on its side of a mesh.

    Args:
        surface: the anatomy, in the arm's base frame.
        rule: "certified", "paper" (Conditions 1–3), "all" (every face plane) or "off".
        radius: of the motion sphere [m], None: as far as the arm can go in a tick.

    Raises:
        ValueError: unknown rule, or a radius that is not positive and finite.
    """

    def __init__(
        self, surface: Surface, rule: str = "certified", radius: float | None = 5e-3
    ) -> None:
        if rule not in RULES:
            raise ValueError(f"unknown rule {rule!r}: choose one of {', '.join(RULES)}")
        if radius is not None:
            radius = checked_length("radius", radius, positive=True)
        self.surface = surface
        self.rule = rule
        self.radius = radius
        self.certified = rule in ("certified", "off")
        self.fills = rule == "certified"

    def inside(self, x: FloatArray) -> bool:
        return self.rule != "off" and self.surface.inside(x)

    def depth(self, x: FloatArray) -> float:
        return self.surface.nearest(x)[0]

    def planes(
        self, x: FloatArray, radius: float, standoff: float, tip_radius: float, inside: bool
    ) -> Planes:
        if self.rule == "off":
            return Planes.none(radius)
        if self.rule == "certified":
            if inside:
                return self._way_out(x, radius, standoff, tip_radius)
            planes = cover(self.surface, x, radius, standoff, tip_radius)
            if planes.radius == 0.0 and self.surface.closed:
                return self._lifted(planes, x, radius, standoff, tip_radius)
            return planes
        choose = paper_planes if self.rule == "paper" else every_plane
        planes = choose(self.surface, x, radius + tip_radius)
        # Towards x by the standoff, but never past it: standing still stays allowed.
        offsets = np.minimum(planes.offsets + standoff + tip_radius, planes.normals @ x - ROOM)
        return replace(planes, offsets=offsets, radius=radius)

    def fill(
        self,
        buffer: Buffer,
        first: int,
        x: FloatArray,
        radius: float,
        standoff: float,
        tip_radius: float,
    ) -> tuple[int, float] | None:
        m, reach = buffer.fill(self.surface, x, radius, standoff, tip_radius, first)
        # On the surface itself one walk of the tree does not answer.
        return None if reach == 0.0 and self.surface.closed else (m, reach)

    def _way_out(self, x: FloatArray, radius: float, standoff: float, tip_radius: float) -> Planes:
        """From inside: one plane at x that lets only motion towards the nearest surface pass.

        While that is far, a step ends before it and can meet nothing. From near by a step may pass
        it, but is too short to meet anything else.
        """
        distance, triangle, point = self.surface.nearest(x)
        if distance <= 2.0 * FAINT * self.surface.rounding:
            return self._lifted(Planes.none(0.0), x, radius, standoff, tip_radius)
        normal = (point - x) / distance
        reach = APPROACH * distance if distance > HOP else self._hop(x, distance, triangle)
        return Planes(
            normal[None, :],
            np.array([normal @ x - self.surface.rounding]),
            point[None, :],
            np.array([triangle]),
            np.array([int(Rule.EXIT)]),
            min(radius, reach),
        )

    def _hop(self, x: FloatArray, distance: float, triangle: int) -> float:
        """How far a step from x (3,) may go that passes the nearest surface and nothing else.

        What hangs together with the nearest triangle within that ball, and has x on the same side,
        is passed with it: the surface there is one sheet, and a segment from x that came out
        through it meets none of it again. Of a sheet that folds back, the part that x is in front
        of stands in the way. Only under an inner edge, where that part is no farther than the
        nearest triangle, does it not.
        """
        ball = 2.0 * distance + 0.1 * HOP
        found = self.surface.within(x, ball)
        pieces = _pieces(self.surface, found)
        nearest = found.triangles == triangle
        corner = self.surface.vertices[self.surface.faces[found.triangles, 0]]
        heights = ((x - corner) * self.surface.normals[found.triangles]).sum(axis=1)
        apart = pieces != pieces[nearest][0]
        back = heights * heights[nearest][0] < 0.0
        reach = float(min(found.distances[apart | back].min(initial=np.inf), ball))
        if distance < 10.0 * ON_SURFACE and 0.99 * reach < distance + 2.0 * ON_SURFACE:
            reach = float(min(found.distances[apart].min(initial=np.inf), ball))
        return 0.99 * reach

    def _lifted(
        self, held: Planes, x: FloatArray, radius: float, standoff: float, tip_radius: float
    ) -> Planes:
        """The planes for a tip exactly on a closed surface, where sides cannot be told at x itself.

        They are those of a point a hair outside, relaxed so that x obeys them: the tip may stay
        on the surface or leave it, never enter. A step stays nearer than any triangle that does not
        touch x, so it meets none. Where no outside is found, `held` stands.
        """
        touch = 2.0 * FAINT * self.surface.rounding
        touching = self.surface.within(x, touch).triangles
        free = self._free(x, touch, radius)
        lift = min(LIFT, 0.25 * free)
        normals = self.surface.normals[touching]
        for normal in (normals.sum(axis=0), *normals):
            size = float(np.linalg.norm(normal))
            for side in (1.0, -1.0):
                lifted = x + side * lift * normal / max(size, 1e-12)
                if self.surface.nearest(lifted)[0] < 0.1 * lift or self.surface.inside(lifted):
                    continue
                planes = cover(self.surface, lifted, radius, standoff, tip_radius)
                offsets = np.minimum(planes.offsets, planes.normals @ x - self.surface.rounding)
                reach = max(min(planes.radius - lift, 0.5 * free), 0.0)
                # No floors: within this ball no path meets anything that x does not touch.
                return replace(planes, offsets=offsets, radius=reach, floors=None)
        return held

    def _free(self, x: FloatArray, touch: float, radius: float) -> float:
        """Distance of x (3,) to the nearest triangle that does not touch it, at most `radius`."""
        reach = min(max(4.0 * touch, ON_SURFACE), radius)
        while True:
            distances = self.surface.within(x, reach).distances
            apart = distances[distances > touch]
            if len(apart) or reach >= radius:
                return float(apart.min(initial=radius))
            reach = min(4.0 * reach, radius)


def _pieces(surface: Surface, found: Contacts) -> IntArray:
    """(k,) number of the piece each of these triangles belongs to: those of one share corners."""
    corners = surface.vertices[surface.faces[found.triangles]].reshape(-1, 3) + 0.0
    _, corner = np.unique(corners, axis=0, return_inverse=True)
    k = len(found)
    row = np.repeat(np.arange(k), 3)
    size = k + len(corners)
    graph = coo_array((np.ones(3 * k), (row, k + corner.ravel())), shape=(size, size))
    return np.asarray(connected_components(graph, directed=False)[1][:k])
