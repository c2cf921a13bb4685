"""Margins of a surface: how far the tool stays away from it, beside the standoff."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from vf.kernels import njit
from vf.planes import LARGEST, FloatArray, IntArray, checked_length
from vf.tree.pdtree import Tree, children_of, triangles_of


class Margins(NamedTuple):
    """Margins as `certified.walk` takes them.

    Attributes:
        margin: the largest [m].
        highest: (k,) the largest below each node of the tree [m]; empty: `margin` for all.
        own: (m,) of each triangle, the largest of its corners', in tree order [m]; or empty.
    """

    margin: float
    highest: FloatArray
    own: FloatArray


def _empty() -> FloatArray:
    array = np.empty(0)
    array.flags.writeable = False  # as those of surfaces: kernels are compiled for one kind only
    return array


NO_MARGIN = Margins(0.0, _empty(), _empty())


def margins_of(tree: Tree, vertices: FloatArray, faces: IntArray, margin: ArrayLike) -> Margins:
    """The margins of a surface (its tree, vertices (n, 3) and faces) from a length or (n,) [m].

    Raises:
        ValueError: not a length, or not one for each vertex; one is negative or not finite.
    """
    if np.ndim(margin) == 0:
        return NO_MARGIN._replace(margin=checked_length("margin", margin))  # type: ignore[arg-type]
    try:
        values = np.array(margin, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"margins must be numbers of metres, got {margin!r}") from None
    if values.shape != (len(vertices),):
        raise ValueError(
            f"a margin must be one length, or one for each of the {len(vertices)} vertices, got"
            f" shape {values.shape}"
        )
    bad = ~((values >= 0.0) & (values <= LARGEST))
    if bad.any():
        row = int(bad.argmax())
        raise ValueError(
            f"the margin of vertex {row} must be from 0 to {LARGEST:g} m, got {values[row]}"
        )
    own = values[faces[tree.order]].max(axis=1)
    highest = np.empty(len(tree.nodes))
    _fill(tree.nodes, own, highest)
    own.flags.writeable = highest.flags.writeable = False
    return Margins(float(own.max()), highest, own)


@njit(cache=True, nogil=True)
def _fill(nodes, own, highest):  # type: ignore[no-untyped-def]
    """The largest margin below each node: a node comes before its children."""
    for node in range(nodes.shape[0] - 1, -1, -1):
        link = nodes[node, 15]
        if link > 0.0:
            first, last = children_of(link)
            highest[node] = highest[first:last].max()
        else:
            first, last = triangles_of(link)
            highest[node] = own[first:last].max()
