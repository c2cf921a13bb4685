"""The anatomy: an immutable triangle mesh with adjacency, edge kinds and its PD-tree."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vf.adjacency import adjacency, closedness, fill_normals
from vf.planes import LARGEST, ROUND, FloatArray, IntArray, checked_length, checked_point
from vf.tree.build import build
from vf.tree.nearest import PATIENCE, UNFINISHED, nearest_face, nearest_face_freely
from vf.tree.winding import Moments, moments, winding_number
from vf.tree.within import closest_points, within_ball


class _Compiled:
    """The kernels of single queries, compiled for fixed types at the first use.

    Numba checks every argument of every call, a third of the time of a kernel of microseconds.
    Functions compiled here are not checked: the callers guarantee types and contiguous arrays.
    """

    @cached_property
    def nearest(self) -> Callable[..., tuple[float, int]]:
        return nearest_face.compile("(f8[:, ::1], f8[:, ::1], f8[::1], f8, i8, i8)")

    @cached_property
    def within(self) -> Callable[..., int]:
        return within_ball.compile("(f8[:, ::1], f8[:, ::1], i8[::1], f8[::1], f8, i8[::1])")


_COMPILED = _Compiled()


class Contacts:
    """Triangles cut by a closed ball, one row each, in no particular order.

    Closest points, features and distances are computed at their first use.

    Attributes:
        triangles: (k,) faces, the caller's indices.
        points: (k, 3) closest points to the centre [m].
        features: (k,) values of `vf.Feature`.
        distances: (k,) [m].
    """

    def __init__(self, surface: Surface, x: FloatArray, triangles: IntArray) -> None:
        """Of the ball around x (3,), which must not change any more."""
        self._surface = surface
        self._x = x
        self.triangles = triangles

    def __len__(self) -> int:
        return len(self.triangles)

    @cached_property
    def _closest(self) -> tuple[FloatArray, NDArray[np.int8], FloatArray]:
        k = len(self.triangles)
        found = np.empty((k, 3)), np.empty(k, dtype=np.int8), np.empty(k)
        surface = self._surface
        closest_points(surface.vertices, surface.faces, self.triangles, self._x, *found)
        return found

    @property
    def points(self) -> FloatArray:
        return self._closest[0]

    @property
    def features(self) -> NDArray[np.int8]:
        return self._closest[1]

    @property
    def distances(self) -> FloatArray:
        return self._closest[2]


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
        return f"Surface({len(self.faces):,} triangles, {len(self.vertices):,} vertices)"

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
            k = _COMPILED.within(tree[0], tree[1], tree[2], p, radius, triangles)
            if k < 0:
                checked_point(x)
            if k <= room:
                return Contacts(self, p, triangles[:k])
            room = k

    def nearest(self, x: ArrayLike, limit: float = np.inf) -> tuple[float, int, FloatArray]:
        """Distance [m], face and closest point (3,) of the nearest triangle.

        Beyond `limit` [m] the answer is (inf, −1, x).
        """
        point = np.array(x, dtype=np.float64)
        if point.shape != (3,):
            checked_point(x)
        tree, guess = self.tree, self._guess
        distance, row = _COMPILED.nearest(tree[0], tree[1], point, limit, guess, PATIENCE)
        if row == UNFINISHED:  # much of the surface is at the same distance
            distance, row = nearest_face_freely(tree[0], tree[1], point, float(limit), guess)
        if row < 0:
            return np.inf, -1, checked_point(x)
        self._guess = row
        return distance, tree[2].item(row), point

    @cached_property
    def _solid(self) -> tuple[bool, Moments, NDArray[np.bool_]]:
        if self._manifold:
            none = np.zeros(len(self.faces), dtype=bool)
            return True, moments(self.tree, ~none), none
        proper, repeated, closed = closedness(self.vertices, self.faces)
        return closed, moments(self.tree, proper & ~repeated), repeated

    @property
    def closed(self) -> bool:
        """Whether the surface encloses volume: only then does it have an inside.

        Corners at equal coordinates count as one and repeated faces as one; the surface is closed
        when every edge is then walked as often one way as the other. A closed surface turned
        inside out is closed; one with single faces flipped is not, because next to those the
        winding number says inside where there is none.
        """
        return self._solid[0]

    @property
    def repeats(self) -> NDArray[np.bool_]:
        """(m,) whether a face has the corners of an earlier one, either way round."""
        return self._solid[2]

    @cached_property
    def distance_error(self) -> float:
        """How much a computed distance can exceed the true one, beside rounding [m]: slivers."""
        return float(self.tree.errors.max())

    def winding(self, x: ArrayLike) -> float:
        """Generalised winding number of the surface around x (3,), repeated faces counted once."""
        p = checked_point(x)
        return float(winding_number(self.tree, self._solid[1], p[0], p[1], p[2]))

    def inside(self, x: ArrayLike) -> bool:
        """Whether x (3,) is inside: |winding number| of 1, and only if the surface is closed.

        An open surface has no defined inside (a vessel's lumen is free space), so there the answer
        is False and the fixtures guard it from both sides. A winding number of 2 is not inside
        either: the cavity of a hollow body whose inner shell is wound outwards too, as scanners
        export it, has it, and so has the intersection of two bodies.
        """
        return self.closed and 0.5 < abs(self.winding(x)) < 1.5


def _used(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """The vertices (k, 3) that a face uses."""
    mask = np.zeros(len(vertices), dtype=bool)
    mask[faces] = True
    return vertices if mask.all() else vertices[mask]
