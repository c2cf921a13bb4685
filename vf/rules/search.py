"""The data with which the compiled tick chooses a fixture's planes without calling Python."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vf.planes import FloatArray
from vf.rules.margins import NO_MARGIN, Margins
from vf.tree.pdtree import Tree


class Search(NamedTuple):
    """A fixture's geometry as the compiled tick searches it.

    Attributes:
        kind: `layout.MESH` or `layout.WALLED`.
        tree, edges: of the triangles, arguments of `certified.walk`.
        walls: (k, corridor.WALL) of a corridor, else empty.
        frame: (8,) of a corridor: its axes, width and hair; else empty.
        margins: of the triangles.
    """

    kind: int
    tree: Tree
    edges: NDArray[np.int8]
    walls: FloatArray = np.empty((0, 7))
    frame: FloatArray = np.empty(0)
    margins: Margins = NO_MARGIN
