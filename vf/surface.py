"""The anatomy: an immutable triangle mesh with adjacency, edge kinds and its PD-tree."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from enum import IntEnum
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vf.kernels import njit
from vf.planes import LARGEST, FloatArray, IntArray, checked_length, checked_point
from vf.tree import pdtree
from vf.tree.pdtree import (
    PATIENCE,
    UNFINISHED,
    closest_points,
    nearest_face,
    nearest_face_freely,
    within_ball,
)
from vf.tree.winding import Moments, moments, winding_number


class Edge(IntEnum):
    """What lies across an edge of a face, by the sign of N_a · (w_i − p_e)."""

    RIDGE = 0  # locally convex: the two half-spaces form a union
    VALLEY = 1  # locally concave: the two half-spaces intersect
    FLAT = 2  # coplanar within rounding, or the neighbour has no usable normal
    BOUNDARY = 3  # no neighbour
    NON_MANIFOLD = 4  # more than one neighbour


# Bound on the rounding error of n·z, a few operations on coordinates up to one metre [m].
ROUND = 1e-14
# Sine of the dihedral angle below which an edge is flat.
FLAT_SINE = 1e-9


class _Compiled:
    """The kernels of single questions, compiled for fixed types when the first is asked.

    Numba looks at every argument of every call; for a kernel of a few microseconds that takes as
    long as a third of its work. Nobody looks here: the callers see to types and contiguous arrays.
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

    Which they are is found at once; where they are closest, when that is first asked for.

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
        _normals(vertices, faces, self.normals, lengths)
        self.median_edge = float(np.median(lengths))
        say("neighbours")
        self.neighbours, self.edges, self._manifold = _adjacency(vertices, faces, self.normals)
        say("PD-tree")
        self.tree = pdtree.build(vertices, faces)
        for array in (
            self.vertices, self.faces, self.normals, self.neighbours, self.edges, *self.tree
        ):  # fmt: skip
            array.flags.writeable = False
        # Where `nearest` looks first. Threads may overwrite each other's: it makes an answer
        # quicker, never another.
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
        if row == UNFINISHED:  # a point that has much of the surface at the same distance
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
        proper, repeated, closed = _closedness(self.vertices, self.faces)
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

        An open surface has no inside to be sure of (a vessel's lumen is free space), so there the
        answer is False and the fixtures guard it from both sides. Nor does a winding number of 2
        say so: it is that of the cavity of a hollow body whose inner shell is wound outwards too,
        as scanners export it, and of what two bodies have in common.
        """
        return self.closed and 0.5 < abs(self.winding(x)) < 1.5


def _used(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """The vertices (k, 3) that a face uses."""
    mask = np.zeros(len(vertices), dtype=bool)
    mask[faces] = True
    return vertices if mask.all() else vertices[mask]


@njit(cache=True, nogil=True)
def _normals(vertices, faces, normals, lengths):  # type: ignore[no-untyped-def]
    """Unit normals (zero without area) and the three edge lengths of every face."""
    for i in range(faces.shape[0]):
        a, b, c = vertices[faces[i, 0]], vertices[faces[i, 1]], vertices[faces[i, 2]]
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        wx, wy, wz = c[0] - b[0], c[1] - b[1], c[2] - b[2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        norm = np.sqrt(nx * nx + ny * ny + nz * nz)
        scale = 1.0 / norm if norm > 0.0 else 0.0
        normals[i, 0], normals[i, 1], normals[i, 2] = nx * scale, ny * scale, nz * scale
        lengths[i, 0] = np.sqrt(ux * ux + uy * uy + uz * uz)
        lengths[i, 1] = np.sqrt(wx * wx + wy * wy + wz * wz)
        lengths[i, 2] = np.sqrt(vx * vx + vy * vy + vz * vz)


def edge_keys(faces: IntArray, vertices: int) -> IntArray:
    """One integer per edge (3m,), the same for both directions, faces' edges in a row."""
    tail = faces.ravel()
    head = faces[:, [1, 2, 0]].ravel()
    return np.minimum(tail, head) * np.int64(vertices) + np.maximum(tail, head)


def _adjacency(
    vertices: FloatArray, faces: IntArray, normals: FloatArray
) -> tuple[NDArray[np.int32], NDArray[np.int8], bool]:
    """Neighbours, kinds, and whether every edge has two faces that walk it in turn."""
    keys = edge_keys(faces, len(vertices))
    rank = np.argsort(keys, kind="stable")
    neighbours = np.empty((len(faces), 3), dtype=np.int32)
    kinds = np.empty((len(faces), 3), dtype=np.int8)
    manifold = _link(keys, rank, vertices, faces, normals, neighbours, kinds)
    return neighbours, kinds, bool(manifold)


@njit(cache=True, nogil=True)
def _link(keys, rank, vertices, faces, normals, neighbours, kinds):  # type: ignore[no-untyped-def]
    """Neighbour and kind of every edge from the sorted edge table; whether all are in pairs."""
    count = keys.shape[0]
    manifold = True
    i = 0
    while i < count:
        j = i + 1
        while j < count and keys[rank[j]] == keys[rank[i]]:
            j += 1
        if j - i == 2:
            e, g = rank[i], rank[i + 1]
            _pair(e, g, vertices, faces, normals, neighbours, kinds)
            _pair(g, e, vertices, faces, normals, neighbours, kinds)
        else:
            for k in range(i, j):
                e = rank[k]
                neighbours[e // 3, e % 3] = -1 if j - i == 1 else -2
                kinds[e // 3, e % 3] = 3 if j - i == 1 else 4
        excess = 0
        for k in range(i, j):
            e = rank[k]
            excess += 1 if faces[e // 3, e % 3] < faces[e // 3, (e % 3 + 1) % 3] else -1
        manifold &= excess == 0 and j - i == 2
        i = j
    return manifold


@njit(cache=True, nogil=True)
def _pair(e, g, vertices, faces, normals, neighbours, kinds):  # type: ignore[no-untyped-def]
    """Half-edge e (face 3·i + k) learns of the face behind half-edge g."""
    i, k = e // 3, e % 3
    a = g // 3
    neighbours[i, k] = a
    p = vertices[faces[i, k]]
    w = vertices[faces[i, (k + 2) % 3]]
    dx, dy, dz = w[0] - p[0], w[1] - p[1], w[2] - p[2]
    side = normals[a, 0] * dx + normals[a, 1] * dy + normals[a, 2] * dz
    # The sine of the angle is that height of w over the neighbour's plane per height over the edge.
    q = vertices[faces[i, (k + 1) % 3]]
    ex, ey, ez = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    along = ex * ex + ey * ey + ez * ez
    height2 = dx * dx + dy * dy + dz * dz
    if along > 0.0:
        height2 -= (dx * ex + dy * ey + dz * ez) ** 2 / along
    flat = FLAT_SINE * np.sqrt(max(height2, 0.0)) + 1e-300
    if side > flat:
        kinds[i, k] = 1
    elif side < -flat:
        kinds[i, k] = 0
    else:
        kinds[i, k] = 2


def _closedness(
    vertices: FloatArray, faces: IntArray
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], bool]:
    """(m,) whether a face has three corners, (m,) whether it repeats another, and closedness."""
    # Adding zero turns −0.0 into 0.0, which is the same place.
    rows = np.ascontiguousarray(vertices + 0.0).view([("", np.float64)] * 3).ravel()
    _, place = np.unique(rows, return_inverse=True)
    corners = place.reshape(-1)[faces]
    ordered = np.sort(corners, axis=1)
    proper = (ordered[:, 0] != ordered[:, 1]) & (ordered[:, 1] != ordered[:, 2])
    rank = np.lexsort(ordered.T)
    ranked = ordered[rank]
    repeated = np.zeros(len(faces), dtype=bool)
    repeated[rank[1:]] = (ranked[1:] == ranked[:-1]).all(axis=1)
    first = proper & ~repeated
    if not first.any():
        return proper, repeated, False
    kept = np.ascontiguousarray(corners[first])
    keys = edge_keys(kept, len(vertices))
    forward = np.where(kept < kept[:, [1, 2, 0]], 1, -1).ravel()
    rank = np.argsort(keys)
    keys, forward = keys[rank], forward[rank]
    starts = np.flatnonzero(np.r_[True, keys[1:] != keys[:-1]])
    return proper, repeated, not np.add.reduceat(forward, starts).any()
