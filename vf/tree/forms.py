"""The shapes of one mesh that deforms, what they have in common, and their memory."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vf.kernels import njit
from vf.planes import LARGEST, FloatArray, IntArray
from vf.tree.memory import Memory
from vf.tree.pdtree import Tree, children_of, triangles_below
from vf.tree.shapes import FEW, refit

MOST_KEPT = 4  # arrays of a kind that are taken again
ROOM = 256  # more vertices than a leaf can have, and than are looked at of any other node

_count = itertools.count(1)


def fresh_number() -> int:
    """A number that no other shape has."""
    return next(_count)


class Skeleton(NamedTuple):
    """What all shapes of a mesh have in common.

    Attributes:
        order: (n,) the caller's index of each vertex, those that faces use first.
        used: how many vertices faces use.
        faces: (m, 3) int32 rows of the vertices in that order, faces in tree order.
        starts, ends: (k,) int32 for each node where the vertices of the triangles below it are in
            `fans`; none, from the first of a node below it, where they are more than `shapes.FEW`.
        fans: rows of the vertices of nodes, each vertex of a node once, int32.
    """

    order: IntArray
    used: int
    faces: NDArray[np.int32]
    starts: NDArray[np.int32]
    ends: NDArray[np.int32]
    fans: NDArray[np.int32]


def skeleton(tree: Tree, faces: IntArray, vertices: int) -> Skeleton:
    """Of a mesh with that many vertices and faces (m, 3) in the caller's order."""
    m = len(faces)
    order = np.empty(vertices, dtype=np.int64)
    rows = np.empty((m, 3), dtype=np.int32)
    starts, ends = np.empty((2, len(tree.nodes)), dtype=np.int32)
    used, fans = _skeleton(tree.nodes, tree.order, faces, order, rows, starts, ends)
    for array in (order, rows, starts, ends, fans):
        array.flags.writeable = False
    return Skeleton(order, used, rows, starts, ends, fans)


@njit(cache=True, nogil=True)
def _skeleton(nodes, triangles, faces, order, rows, starts, ends):  # type: ignore[no-untyped-def]
    n = order.shape[0]
    rank = np.full(n, -1, dtype=np.int32)
    used = 0
    for t in range(triangles.shape[0]):
        for j in range(3):
            v = faces[triangles[t], j]
            if rank[v] < 0:
                rank[v] = used
                order[used] = v
                used += 1
            rows[t, j] = rank[v]
    rest = used
    for v in range(n):
        if rank[v] < 0:
            order[rest] = v
            rest += 1
    fans = np.empty(4 * rows.shape[0] + ROOM, dtype=np.int32)
    count = 0
    seen = np.full(n, -1, dtype=np.int32)  # the node that had a vertex last
    for node in range(nodes.shape[0] - 1, -1, -1):
        starts[node] = count
        link = nodes[node, 15]
        first, last = triangles_below(nodes, node)
        for t in range(first, last):
            if count - starts[node] > FEW and link > 0.0:
                break
            for j in range(3):
                v = rows[t, j]
                if seen[v] != node:
                    seen[v] = node
                    fans[count] = v
                    count += 1
        if count - starts[node] > FEW and link > 0.0:
            count = starts[node]
            starts[node] = starts[children_of(link)[0]]
            ends[node] = starts[node]
            continue
        ends[node] = count
        if fans.shape[0] < count + ROOM:
            longer = np.empty(2 * fans.shape[0], dtype=np.int32)
            longer[:count] = fans[:count]
            fans = longer
    return used, fans[:count].copy()


@njit(cache=True, nogil=True)
def take(vertices, order, used, kept):  # type: ignore[no-untyped-def]
    """Copy vertices (n, 3) in that order to `kept`.

    Returns:
        The largest magnitude of a coordinate of those that are used [m], and the first vertex that
        is not finite, or is used and beyond `LARGEST`; −1: none.
    """
    bad = -1
    largest = 0.0
    for i in range(order.shape[0]):
        v = order[i]
        x, y, z = vertices[v, 0], vertices[v, 1], vertices[v, 2]
        kept[i, 0], kept[i, 1], kept[i, 2] = x, y, z
        size = max(abs(x), abs(y), abs(z))
        # Not a number compares as false.
        fine = abs(x) <= LARGEST and abs(y) <= LARGEST and abs(z) <= LARGEST
        if i >= used:
            fine = np.isfinite(x) and np.isfinite(y) and np.isfinite(z)
        elif size > largest:
            largest = size
        if not fine and (bad < 0 or v < bad):
            bad = v
    return largest, bad


class Form:
    """One shape of a mesh.

    Attributes:
        kept: (n, 3) vertices in the order of the skeleton, read-only [m].
        boxes: (k, 6) of the nodes, read-only, see `shapes.refit` [m].
        largest: magnitude of a coordinate that a face uses [m].
        together: whether vertices that are at one place in the first shape are in this one.
        number: its own.
    """

    def __init__(self, kept: FloatArray, boxes: FloatArray, largest: float, together: bool) -> None:
        self.kept = read_only(kept)
        self.boxes = read_only(boxes)
        self.largest = largest
        self.together = together
        self.number = fresh_number()


class Family:
    """What all shapes of a mesh share.

    Attributes:
        skeleton: see `Skeleton`.
        order, nodes: of the tree of the first shape.
        rest: the first shape.
    """

    def __init__(
        self, tree: Tree, faces: IntArray, vertices: FloatArray, doubles: IntArray, firsts: IntArray
    ) -> None:
        """Of a mesh in its first shape, where vertices `doubles` are at the places of `firsts`."""
        self.skeleton = skeleton(tree, faces, len(vertices))
        self.order, self.nodes = tree.order, tree.nodes
        self._doubles, self._firsts = doubles, firsts
        self._vertices, self._boxes, self._shifts = (
            Memory(MOST_KEPT),
            Memory(MOST_KEPT),
            Memory(MOST_KEPT),
        )
        self.rest = self.form(vertices)

    def form(self, vertices: ArrayLike) -> Form:
        """A shape from vertices (n, 3) in the caller's order [m].

        Raises:
            ValueError: see `follow`.
        """
        return self.follow(None, vertices)[0]

    def follow(self, before: Form | None, vertices: ArrayLike) -> tuple[Form, FloatArray]:
        """A shape after another one, and how far what the nodes hold moves from that one to it.

        Args:
            before: the other shape; None: it is the same one.
            vertices: (n, 3) in the caller's order [m].

        Returns:
            The shape, and (k, 6) the shifts, read-only, see `shapes.refit` [m].

        Raises:
            ValueError: wrong shape, a vertex is not finite, or one of a face is too far away.
        """
        order, used = self.skeleton.order, self.skeleton.used
        try:
            v = np.ascontiguousarray(vertices, dtype=np.float64)
        except (TypeError, ValueError):
            raise ValueError("the vertices of a shape must be numbers of metres") from None
        if v.shape != (len(order), 3):
            raise ValueError(
                f"the vertices of a shape must be as many as before, ({len(order)}, 3), got"
                f" {v.shape}"
            )
        kept = self._vertices.array(v.shape)
        largest, bad = take(v, order, used, kept)
        if bad >= 0:
            if not np.isfinite(v[bad]).all():
                raise ValueError(f"vertex {bad} is not finite: {v[bad]}")
            raise ValueError(
                f"vertex {bad} is too far away: coordinates must be within ±{LARGEST:g} m, got"
                f" {v[bad]}"
            )
        together = bool((v[self._doubles] == v[self._firsts]).all())
        boxes = self._boxes.array((len(self.nodes), 6))
        shifts = self._shifts.array((len(self.nodes), 6))
        bones = self.skeleton
        read_only(kept)
        other = kept if before is None else before.kept
        refit(
            self.nodes, bones.starts, bones.ends, bones.fans, other, kept, boxes, shifts
        )  # fmt: skip
        return Form(kept, boxes, largest, together), read_only(shifts)


def read_only(array: FloatArray) -> FloatArray:
    """The array, not to be written any more."""
    array.flags.writeable = False
    return array
