"""The anatomy: an immutable triangle mesh with adjacency, edge kinds and its PD-tree."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vf.adjacency import adjacency, closedness, doubles_of, fill_normals
from vf.planes import (
    LARGEST,
    ROUND,
    FloatArray,
    IntArray,
    checked_blend,
    checked_length,
    checked_point,
)
from vf.tree.build import build
from vf.tree.contacts import COMPILED, Contacts
from vf.tree.forms import Family, Form, fresh_number, read_only
from vf.tree.nearest import PATIENCE, UNFINISHED, nearest_face_freely
from vf.tree.pdtree import Tree
from vf.tree.shapes import fill_boxes, fill_corners
from vf.tree.winding import Moments, moments, winding_number

_NONE = np.empty(0, dtype=np.int64)
_NO_CORNERS = read_only(np.empty((0, 9)))


class Surface:
    """A triangle mesh as the fixtures see it. Nothing is welded, re-ordered or repaired.

    All arrays are read-only, so a surface may be queried from any number of threads.

    Attributes:
        vertices: (n, 3) float64 [m].
        faces: (m, 3) int64, in the caller's order.
        normals: (m, 3) unit normals by the right-hand rule; zero for faces without area.
        neighbours: (m, 3) int32 face across the edge from corner k to k+1; −1 none, −2 several.
        edges: (m, 3) int8 values of `Edge`.
        tree: the `pdtree.Tree`.
        size: diagonal of the bounding box of what the faces use [m].
        median_edge: [m].
        rounding: bound on the rounding error of n·z for points z of the mesh [m].
    """

    def __init__(
        self,
        vertices: FloatArray,
        faces: IntArray,
        progress: Callable[[str], None] | None = None,
    ) -> None:
        say = progress or (lambda _stage: None)
        self.vertices = vertices
        self.faces = faces
        used = _used(vertices, faces)
        self.size = float(np.linalg.norm(np.ptp(used, axis=0)))
        self.rounding = ROUND * float(np.abs(used).max()) + 1e-300
        say("normals")
        self.normals = np.empty((len(faces), 3))
        lengths = np.empty((len(faces), 3))
        fill_normals(vertices, faces, self.normals, lengths)
        self.median_edge = float(np.median(lengths))
        say("neighbours")
        self.neighbours, self.edges, self._manifold = adjacency(vertices, faces, self.normals)
        say("PD-tree")
        self.tree = build(vertices, faces)
        for array in (
            self.vertices, self.faces, self.normals, self.neighbours, self.edges, *self.tree
        ):  # fmt: skip
            array.flags.writeable = False
        # The row that `nearest` tests first. Threads may overwrite each other's: it changes how
        # long an answer takes, never the answer.
        self._guess = -1

    @staticmethod
    def from_arrays(
        vertices: ArrayLike,
        faces: ArrayLike,
        progress: Callable[[str], None] | None = None,
    ) -> Surface:
        """Surface over copies of `vertices` (n, 3) [m] and `faces` (m, 3).

        Args:
            progress: called with the name of each stage of the work.

        Raises:
            ValueError: wrong shapes, non-finite vertices, no faces, indices out of range, a
                vertex of a face farther than `planes.LARGEST` (10,000 km) from the origin.
        """
        v = np.array(vertices, dtype=np.float64, order="C")
        f_in = np.asarray(faces)
        if v.ndim != 2 or v.shape[1] != 3:
            raise ValueError(f"vertices must have shape (n, 3), got {v.shape}")
        if f_in.ndim != 2 or f_in.shape[1] != 3:
            raise ValueError(f"faces must have shape (m, 3), got {f_in.shape}: triangles only")
        if len(f_in) == 0:
            raise ValueError("a surface needs at least one face, got 0")
        if not np.issubdtype(f_in.dtype, np.integer):
            raise ValueError(f"faces must be integers, got {f_in.dtype}")
        f = np.array(f_in, dtype=np.int64, order="C")
        if f.min() < 0 or f.max() >= len(v):
            bad = f.min() if f.min() < 0 else f.max()
            raise ValueError(f"face index {bad} out of range: vertices are 0 … {len(v) - 1}")
        if not np.isfinite(v).all():
            row = int(np.argmin(np.isfinite(v).all(axis=1)))
            raise ValueError(f"vertex {row} is not finite: {v[row]}")
        if not np.abs(v).max() <= LARGEST:  # what no face uses may be anywhere
            far = f.ravel()[~np.all(np.abs(v) <= LARGEST, axis=1)[f.ravel()]]
            if len(far):
                raise ValueError(
                    f"vertex {far[0]} is too far away: coordinates must be within ±{LARGEST:g} m,"
                    f" got {v[far[0]]}"
                )
        return Surface(v, f, progress)

    @cached_property
    def checksum(self) -> str:
        """SHA-256 of vertices and faces, in hexadecimal: equal for the same mesh in the same place.

        Little-endian float64 and int64 in the caller's order, so it is the same on any machine.
        """
        digest = hashlib.sha256()
        for array, kind in ((self.vertices, "<f8"), (self.faces, "<i8")):
            digest.update(f"{array.shape}{kind}".encode())
            digest.update(np.ascontiguousarray(array, dtype=kind).data)
        return digest.hexdigest()

    def __repr__(self) -> str:
        name = type(self).__name__
        return f"{name}({len(self.faces):,} triangles, {self._count:,} vertices)"

    @property
    def searched(self) -> Tree:
        """What a controller needs of `tree`; where the shape changes, without the triangles."""
        return self.tree

    @property
    def _count(self) -> int:
        return len(self.vertices)

    @cached_property
    def _family(self) -> Family:
        doubles = (_NONE, _NONE) if self._manifold else doubles_of(self.vertices)
        return Family(self.tree, self.faces, self.vertices, *doubles)

    @property
    def _form(self) -> Form:
        """Where it is on its way to another shape."""
        return self._family.rest

    def deforming(self, vertices_after: ArrayLike) -> DeformingSurface:
        """This surface on its way to another shape with the same faces.

        Prepares the mesh at the first call (seconds for millions of triangles); after that a call
        takes the new vertices over, and fits the boxes of the PD-tree to both shapes, with the
        interpreter lock released: it may run beside a control loop.

        Args:
            vertices_after: (n, 3) where the vertices go [m], in the order of `vertices`.

        Raises:
            ValueError: another shape than that of `vertices`, a vertex is not finite, or one of a
                face is farther than `planes.LARGEST` from the origin.
        """
        return DeformingSurface(self, vertices_after)

    def within(self, x: ArrayLike, radius: float) -> Contacts:
        """Every triangle cut by the closed ball of `radius` [m] around x (3,)."""
        p = np.array(x, dtype=np.float64)
        if not isinstance(radius, float):
            radius = checked_length("radius", radius)
        if p.shape != (3,) or not 0.0 <= radius < np.inf:
            checked_point(x)
            checked_length("radius", radius)
        tree = self.tree
        room = 2048
        while True:
            triangles = np.empty(room, dtype=np.int64)
            k = COMPILED.within(tree[0], tree[1], tree[2], p, radius, triangles)
            if k < 0:
                checked_point(x)
            if k <= room:
                return Contacts(self.vertices, self.faces, p, triangles[:k])
            room = k

    def nearest(self, x: ArrayLike, limit: float = np.inf) -> tuple[float, int, FloatArray]:
        """Distance [m], face and closest point (3,) of the nearest triangle.

        Beyond `limit` [m] the answer is (inf, −1, x).
        """
        point = np.array(x, dtype=np.float64)
        if point.shape != (3,):
            checked_point(x)
        tree, guess = self.tree, self._guess
        distance, row = COMPILED.nearest(tree[0], tree[1], point, limit, guess, PATIENCE)
        if row == UNFINISHED:  # much of the surface is at the same distance
            distance, row = nearest_face_freely(tree[0], tree[1], point, float(limit), guess)
        if row < 0:
            return np.inf, -1, checked_point(x)
        self._guess = row
        return distance, tree[2].item(row), point

    @cached_property
    def _topology(self) -> tuple[bool, NDArray[np.bool_], NDArray[np.bool_]]:
        """Whether it is closed, which faces count (m,), and which repeat others (m,)."""
        if self._manifold:
            none = np.zeros(len(self.faces), dtype=bool)
            return True, ~none, none
        proper, repeated, closed = closedness(self.vertices, self.faces)
        return closed, proper & ~repeated, repeated

    @cached_property
    def _moments(self) -> Moments:
        return moments(self.tree, self._topology[1])

    @property
    def closed(self) -> bool:
        """Whether the surface encloses volume: only then does it have an inside.

        Corners at equal coordinates count as one and repeated faces as one; the surface is closed
        when every edge is then walked as often one way as the other. A closed surface turned
        inside out is closed; one with single faces flipped is not, because next to those the
        winding number says inside where there is none.
        """
        return self._topology[0]

    @property
    def repeats(self) -> NDArray[np.bool_]:
        """(m,) whether a face has the corners of an earlier one, either way round."""
        return self._topology[2]

    @cached_property
    def distance_error(self) -> float:
        """How much a computed distance can exceed the true one, beside rounding [m]: slivers."""
        return float(self.tree.errors.max())

    def winding(self, x: ArrayLike) -> float:
        """Generalised winding number of the surface around x (3,), repeated faces counted once."""
        p = checked_point(x)
        return float(winding_number(self.tree, self._moments, p[0], p[1], p[2]))

    def inside(self, x: ArrayLike) -> bool:
        """Whether x (3,) is inside: |winding number| of 1, and only if the surface is closed.

        An open surface has no defined inside (a vessel's lumen is free space), so there the answer
        is False and the fixtures guard it from both sides. A winding number of 2 is not inside
        either: the cavity of a hollow body whose inner shell is wound outwards too, as scanners
        export it, has it, and so has the intersection of two bodies.
        """
        return self.closed and 0.5 < abs(self.winding(x)) < 1.5


class _Relative(Surface):
    """A surface with the faces of another one: what depends on its shape is made when asked for."""

    _blend = 0.0

    def __init__(self, kin: Surface, before: Form, after: Form) -> None:
        self._family = kin._family
        self._before, self._after = before, after
        self.faces, self.edges, self.neighbours = kin.faces, kin.edges, kin.neighbours
        self.median_edge = kin.median_edge
        self._manifold = kin._manifold
        closed, counted, repeated = kin._topology
        self._topology = closed and before.together and after.together, counted, repeated
        self.rounding = ROUND * max(before.largest, after.largest) + 1e-300
        self._guess = -1

    @property
    def _count(self) -> int:
        return len(self._before.kept)

    @cached_property
    def vertices(self) -> FloatArray:  # type: ignore[override]
        return self._at(self._blend)

    def _at(self, blend: float) -> FloatArray:
        vertices = np.empty((self._count, 3))
        moved = (1.0 - blend) * self._before.kept + blend * self._after.kept
        vertices[self._family.skeleton.order] = moved
        return read_only(vertices)

    @cached_property
    def size(self) -> float:  # type: ignore[override]
        return float(np.linalg.norm(np.ptp(_used(self.vertices, self.faces), axis=0)))

    @cached_property
    def normals(self) -> FloatArray:  # type: ignore[override]
        normals = np.empty((len(self.faces), 3))
        fill_normals(self.vertices, self.faces, normals, np.empty((len(self.faces), 3)))
        return read_only(normals)

    @cached_property
    def tree(self) -> Tree:  # type: ignore[override]
        m = len(self.faces)
        corners, errors = np.empty((m, 9)), np.empty(m)
        before, after = self._before.kept, self._after.kept
        rows = self._family.skeleton.faces
        fill_corners(rows, before, after, self._blend, corners, errors)
        nodes = self._family.nodes.copy()
        fill_boxes(self._before.boxes, self._after.boxes, self._blend, nodes)
        return Tree(read_only(nodes), read_only(corners), self._family.order, read_only(errors))


class DeformingSurface(_Relative):
    """A mesh on its way from one shape to another: `Surface.deforming` makes it.

    At a blend τ its vertices are at (1 − τ)·`vertices` + τ·`vertices_after`. As a surface it is
    what it is at blend 0: that is where its queries look, where fixtures without a `vf.Motion`
    guard it, and what its attributes describe. They are made when they are first asked for. The
    kinds of edges and the median edge are those of the surface that it was made from; no promise
    depends on them. It is closed if that one is, and vertices that were at one place there still
    are, in both shapes.

    Attributes:
        vertices_after: (n, 3) float64 [m].
        shifts: (k, 6) of `shapes.refit` [m].
        forms: numbers that no other shape has: of its shape at blend 0, of those between, and of
            its shape at blend 1, which is the first of the interval that follows.
    """

    def __init__(self, kin: Surface, vertices_after: ArrayLike) -> None:
        """From the shape that `kin` goes on from."""
        family, before = kin._family, kin._form
        after, shifts = family.follow(before, vertices_after)
        super().__init__(kin, before, after)
        self.forms = (before.number, fresh_number(), self._after.number)
        self.shifts = shifts
        self._shown: tuple[float, Surface] | None = None

    @property
    def _form(self) -> Form:
        return self._after

    @cached_property
    def vertices_after(self) -> FloatArray:
        return self._at(1.0)

    @property
    def searched(self) -> Tree:
        return Tree(self._family.nodes, _NO_CORNERS, self._family.order, _NO_CORNERS[:, 0])

    @property
    def parts(self) -> tuple[NDArray[Any], ...]:
        """Faces of the skeleton, the vertices of both shapes in its order, and their boxes."""
        before, after = self._before, self._after
        return self._family.skeleton.faces, before.kept, after.kept, before.boxes, after.boxes

    def follows(self, other: Surface) -> bool:
        """Whether it is a shape of the same mesh, made by `deforming` from one surface."""
        return vars(other).get("_family") is self._family

    def shape(self, blend: float) -> Surface:
        """The surface as it is at a blend from 0 to 1. The last one asked for is kept.

        Raises:
            ValueError: the blend is not from 0 to 1.
        """
        share = checked_blend("blend", blend)
        shown = self._shown
        if shown is None or shown[0] != share:
            shown = self._shown = share, _Shape(self, share)
        return shown[1]


class _Shape(_Relative):
    """A deforming surface at one blend."""

    def __init__(self, whole: DeformingSurface, blend: float) -> None:
        super().__init__(whole, whole._before, whole._after)
        self._blend = blend

    @cached_property
    def _form(self) -> Form:
        return self._family.form(self.vertices)


def _used(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """The vertices (k, 3) that a face uses."""
    mask = np.zeros(len(vertices), dtype=bool)
    mask[faces] = True
    return vertices if mask.all() else vertices[mask]
