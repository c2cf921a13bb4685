"""Fixtures: each turns the tool's position into planes."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from vf.layout import MESH
from vf.planes import FloatArray, IntArray, Planes, checked_length
from vf.rules.certified import cover
from vf.rules.inside import ON_SURFACE, leads_out, on_surface, way_out
from vf.rules.margins import margins_of
from vf.rules.nearest import DistanceField, nearest_plane
from vf.rules.paper import every_plane, paper_planes
from vf.rules.search import Search
from vf.settings import GUARDS
from vf.surface import Surface

# The planes of rules that are not certified are at least this far below x, so that rounding cannot
# block sliding [m].
ROOM = 1e-11
RULES = ("certified", "paper", "all", "off", "nearest", "sdf")


class Fixture(Protocol):
    """What the controller asks of a fixture. Answers depend on the arguments alone.

    One with an attribute `search` (`vf.rules.search.Search`) is not asked for planes where the tip
    is neither inside nor on its surface: the tick finds them itself.
    """

    radius: float | None  # of the motion sphere [m]; None: as far as the arm can go in a tick
    # Whether a verified step provably stays on its side. The tip's path then keeps to the floors of
    # the planes, where they have any, and to their radius.
    certified: bool

    def planes(
        self, x: FloatArray, radius: float, standoff: float, tip_radius: float, inside: bool
    ) -> Planes:
        """Planes with n·x ≥ o for a tip of `tip_radius` centred at x (3,) [m].

        In the arm's base frame, or for a fixture that moves in the frame of that (`vf.Motion`); so
        are the points of the other two methods.
        """
        ...

    def inside(self, x: FloatArray) -> bool:
        """Whether x (3,) is where the tool must never be."""
        ...

    def leads_out(self, x: FloatArray, y: FloatArray) -> bool:
        """Whether a step from x to y (3,) leads out: asked only where x is inside."""
        ...


class MeshFixture:
    """Keeps the tool on its side of a mesh.

    A margin is kept beside the standoff: the tool stays `standoff + margin` away, as if it were so
    much thicker. A tool that is closer may stay and go no deeper, is led out slowly (10 µm a tick,
    status RECOVERING), and is never led across the surface. Between two structures with less room
    than both margins it may come as deep into one's margin as it is in the other's. While the tip
    is inside of the anatomy margins do not count.

    Args:
        surface: the anatomy, in the arm's base frame, or in the frame that a `vf.Motion` moves.
        rule: "certified", "paper" (Conditions 1–3), "all" (every face plane), "off", "nearest" (one
            plane at the nearest point) or "sdf" (one plane, of a sampled distance field).
        radius: of the motion sphere [m], None: as far as the arm can go in a tick.
        margin: how far to stay away from the surface beside the standoff [m]: one length, or (n,)
            one for each vertex; a triangle has the largest of its corners'.
        guard: "tip", or "tool" for every capsule of the instrument; None: as `Settings.guard`
            says. Only the rule "certified" guards more than the tip.
        name: of the structure, for whoever reads `planes.fixtures`.

    Raises:
        ValueError: unknown rule or guard, a radius that is not positive and finite, a margin that
            is negative or not finite, or not one for each vertex, a name that is no text.
    """

    def __init__(
        self,
        surface: Surface,
        rule: str = "certified",
        radius: float | None = 5e-3,
        margin: ArrayLike = 0.0,
        guard: str | None = None,
        name: str = "",
    ) -> None:
        if rule not in RULES:
            raise ValueError(f"unknown rule {rule!r}: choose one of {', '.join(RULES)}")
        if guard is not None and guard not in GUARDS:
            raise ValueError(
                f"unknown guard {guard!r}: choose one of {', '.join(GUARDS)}, or None for that of"
                " the settings"
            )
        if not isinstance(name, str):
            raise ValueError(f"the name of a structure must be text, got {name!r}")
        if radius is not None:
            radius = checked_length("radius", radius, positive=True)
        self.surface = surface
        self.rule = rule
        self.radius = radius
        self.guard = guard
        self.name = name
        tree = surface.searched
        self.margins = margins_of(tree, surface.vertices, surface.faces, margin)
        self.certified = rule in ("certified", "off")
        self._field = DistanceField(surface) if rule == "sdf" else None
        # The controller looks for the certified planes itself where the tip is not inside.
        self.search: Search | None = None
        if rule == "certified":
            self.search = Search(MESH, tree, surface.edges, margins=self.margins)

    def on(self, surface: Surface) -> MeshFixture:
        """The same fixture on another shape of its mesh."""
        fixture = object.__new__(type(self))
        fixture.__dict__.update(self.__dict__)
        fixture.surface = surface
        if self._field is not None:
            fixture._field = DistanceField(surface)
        return fixture

    def margins_at(self, triangles: IntArray) -> FloatArray:
        """The margins (k,) of faces (k,) [m]."""
        if len(self.margins.own) == 0:
            return np.full(len(triangles), self.margins.margin)
        return np.asarray(self._of_faces[triangles])

    @cached_property
    def _of_faces(self) -> FloatArray:
        """`margins.own` in the order of the faces."""
        found = np.empty(len(self.margins.own))
        found[self.surface.tree.order] = self.margins.own
        return found

    def inside(self, x: FloatArray) -> bool:
        return self.rule != "off" and self.surface.inside(x)

    def leads_out(self, x: FloatArray, y: FloatArray) -> bool:
        if self.rule == "certified":
            return leads_out(self.surface, x, y)
        depth = self.surface.nearest(y)[0]
        deeper = self.surface.inside(y) and depth > self.surface.nearest(x)[0]
        return depth >= ON_SURFACE and not deeper

    def planes(
        self, x: FloatArray, radius: float, standoff: float, tip_radius: float, inside: bool
    ) -> Planes:
        if self.rule == "off":
            return Planes.none(radius)
        if self.rule == "certified":
            if inside:
                return way_out(self.surface, x, radius, standoff, tip_radius)
            planes = cover(self.surface, x, radius, standoff, tip_radius, self.margins)
            if planes.radius == 0.0 and self.surface.closed:
                return on_surface(self.surface, x, radius, standoff, tip_radius) or planes
            return planes
        reach = radius + tip_radius + self.margins.margin
        if self.rule == "paper":
            planes = paper_planes(self.surface, x, reach)
        elif self.rule == "nearest":
            planes = nearest_plane(self.surface, x, reach + standoff, inside)
        elif self._field is not None:
            planes = self._field.plane(x, reach + standoff, inside)
        else:
            planes = every_plane(self.surface, x, reach)
        # A plane of the field is of no face: the largest margin is kept.
        whole = self._field is not None
        margin = self.margins.margin if whole else self.margins_at(planes.triangles)
        # Towards x by standoff and margin, but never past it: standing still stays allowed.
        moved = planes.offsets + standoff + tip_radius + margin
        offsets = np.minimum(moved, planes.normals @ x - ROOM)
        return replace(planes, offsets=offsets, radius=radius)
