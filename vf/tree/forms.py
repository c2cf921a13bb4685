"""The shapes of one mesh that deforms, what they have in common, and their memory."""

from __future__ import annotations

import itertools
from sys import getrefcount

import numpy as np
from numpy.typing import ArrayLike

from vf.planes import LARGEST, FloatArray, IntArray
from vf.tree.pdtree import Tree
from vf.tree.shapes import refit, skeleton, take

MOST_KEPT = 4  # arrays of a kind that are taken again

_count = itertools.count(1)


def fresh_number() -> int:
    """A number that no other shape has."""
    return next(_count)


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
        skeleton: see `shapes.Skeleton`.
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
        self._vertices, self._boxes, self._shifts = _Memory(), _Memory(), _Memory()
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
        refit(self.nodes, bones.starts, bones.fans, other, kept, boxes, shifts)
        return Form(kept, boxes, largest, together), read_only(shifts)


class _Memory:
    """Arrays of one size, given out anew when nobody refers to them any more.

    Fresh memory costs as much as what is written to it: the system clears its pages.
    """

    def __init__(self) -> None:
        self._arrays: list[FloatArray] = []

    def array(self, shape: tuple[int, ...]) -> FloatArray:
        """An array of that shape, which is the same at every call.

        What is given out is a view, and so are views of that: each refers to its base. An array
        that is looked at here is out of the list, so that no two threads look at the same.
        """
        for _ in range(len(self._arrays)):
            try:
                array = self._arrays.pop(0)
            except IndexError:  # another thread has it
                break
            alone = getrefcount(array) == _ALONE
            view = array[:]
            self._arrays.append(array)
            if alone:
                return view
        array = np.empty(shape)
        view = array[:]
        if len(self._arrays) < MOST_KEPT:
            self._arrays.append(array)
        return view


def _alone() -> int:
    """What `getrefcount` says of an array that only a local variable refers to."""
    array = [np.empty(1)].pop(0)
    return getrefcount(array)


_ALONE = _alone()


def read_only(array: FloatArray) -> FloatArray:
    """The array, not to be written any more."""
    array.flags.writeable = False
    return array
