"""Fixtures: each turns the tool's position into planes."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np

from vf.conditions import every_plane, paper_planes
from vf.cover import YIELD, Buffer, cover
from vf.planes import FloatArray, Planes, Rule, checked_length
from vf.surface import Surface

# Nearer than this to the surface, the direction to it is rounding [m].
ON_SURFACE = 1e-9
LIFT = 1e-8  # [m], far above rounding and far below any standoff
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
            checked_length("radius", radius, positive=True)
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
                return self._way_out(x, radius, standoff + tip_radius)
            planes = cover(self.surface, x, radius, standoff, tip_radius)
            if planes.radius == 0.0 and self.surface.closed:
                return self._lifted(planes, x, radius, standoff, tip_radius)
            return planes
        choose = paper_planes if self.rule == "paper" else every_plane
        planes = choose(self.surface, x, radius + tip_radius)
        # Towards x by the standoff, but never past it: standing still stays allowed.
        offsets = np.minimum(planes.offsets + standoff + tip_radius, planes.normals @ x - YIELD)
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

    def _way_out(self, x: FloatArray, radius: float, clearance: float) -> Planes:
        """From inside: one plane at x that lets only motion towards the nearest surface pass."""
        distance, triangle, point = self.surface.nearest(x)
        if distance > ON_SURFACE:
            normal = (point - x) / distance
        else:
            normal = self.surface.normals[triangle].copy()
        return Planes(
            normal[None, :],
            np.array([normal @ x]),
            point[None, :],
            np.array([triangle]),
            np.array([int(Rule.EXIT)]),
            # Through the wall and clear of it, not across whatever lies behind.
            min(radius, distance + 2.0 * clearance),
        )

    def _lifted(
        self, held: Planes, x: FloatArray, radius: float, standoff: float, tip_radius: float
    ) -> Planes:
        """The planes for a tip exactly on a closed surface, where sides cannot be told at x itself.

        They are those of a point a hair outside, relaxed so that x obeys them: the tip may stay
        on the surface or leave it, never enter. Where no outside is found, `held` stands.
        """
        touching = self.surface.within(x, ON_SURFACE).triangles
        normals = self.surface.normals[touching]
        for normal in (normals.sum(axis=0), *normals):
            size = float(np.linalg.norm(normal))
            for side in (1.0, -1.0):
                lifted = x + side * LIFT * normal / max(size, 1e-12)
                if self.surface.nearest(lifted)[0] < 0.1 * LIFT or self.surface.inside(lifted):
                    continue
                planes = cover(self.surface, lifted, radius, standoff, tip_radius)
                offsets = np.minimum(planes.offsets, planes.normals @ x)
                reach = max(planes.radius - LIFT, 0.0)
                return replace(planes, offsets=offsets, radius=reach)
        return held
