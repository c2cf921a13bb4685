"""The memory that a tick works in, as `vf.layout` describes it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vf import layout
from vf.planes import FloatArray, IntArray
from vf.qp.active_set import scratch_size
from vf.rules.certified import BUDGET, CORNERS, HEAP
from vf.tick.chain import LINK
from vf.tree.pdtree import Tree


class Search(NamedTuple):
    """What a tick needs to look for a fixture's planes itself.

    Attributes:
        kind: `layout.MESH` or `layout.WALLED`.
        tree, edges: what `cover.walk` goes through.
        walls: (k, corridor.WALL) of a corridor, else empty.
        frame: (8,) of a corridor: its axes, width and hair; else empty.
    """

    kind: int
    tree: Tree
    edges: NDArray[np.int8]
    walls: FloatArray = np.empty((0, 7))
    frame: FloatArray = np.empty(0)


class Block:
    """Arrays of a tick, and the words that lead the kernels to them. Not thread-safe.

    Attributes:
        words: (WORDS,) see `vf.layout`, at `address`; the other arrays are parts by the names of
            their words.
        report: bytes of REPORT and of the planes behind it.
        head: bytes of REPORT.
    """

    def __init__(self, n: int, chain: FloatArray | None, searches: Sequence[Search | None]) -> None:
        """For n joints.

        Args:
            chain: of the arm, see `vf.tick.chain`; None: it answers itself.
            searches: one for each fixture; None: it answers itself.
        """
        self.words = np.zeros(layout.WORDS, dtype=np.int64)
        self.address = self.words.ctypes.data
        # What the addresses lead to must not go away.
        self._searched = tuple(searches)
        self._parts: dict[int, NDArray[np.generic]] = {}
        self.n = n
        links = 0 if chain is None else len(chain)
        points = 1  # the tip
        for word, count in (
            (layout.JOINTS, n), (layout.LINKS, links), (layout.FIXTURES, len(searches)),
            (layout.POINTS, points),
        ):  # fmt: skip
            self.words[word] = count
        self.chain = self._part(layout.CHAIN, links, LINK)
        self.chain[:] = 0.0 if chain is None else chain
        self._part(layout.AXES, links, 6)
        self.numbers = self._part(layout.NUMBERS, layout.SCALARS)
        self.table = self._part(layout.TABLE, layout.JOINT_ROWS, n)
        self.jacobian = self._part(layout.JACOBIAN, 6, n)
        self._part(layout.JACOBIANS, points, 3, n)
        self.places = self._part(layout.PLACES, points, 3)
        self.trials = self._part(layout.TRIALS, points, 3)
        self._part(layout.ERRORS, points, 3)
        self._part(layout.BULGES, points)
        self.start = self._part(layout.START, 3, 4)
        self.tip = self._part(layout.TIP, 3, 4)
        self._part(layout.BEST, 3, 4)
        self.solution = self._part(layout.SOLUTION, n)
        self._part(layout.QUEUE, HEAP, 3)
        self._part(layout.POLYGONS, 2, CORNERS, 3)
        self.sides = self._part(layout.SIDES, len(searches), layout.SIDE)
        self.sides[:] = np.nan
        self._searches(searches)
        self.head = 8 * (layout.HEAD + 2 * n)
        self.reserve(max(len(searches), 1) * BUDGET)

    def reserve(self, rows: int) -> None:
        """Have room for that many planes, which lose what they say."""
        n, head = self.n, self.head // 8
        self.room = self.words[layout.ROOM] = rows
        whole = np.zeros(head + rows * layout.PLANE)
        self.words[layout.REPORT] = whole.ctypes.data
        self.words[layout.PLANES] = whole.ctypes.data + self.head
        self.planes = whole[head:].reshape(rows, layout.PLANE)
        self.report = whole.data.cast("B")
        self._part(layout.ROWS, rows, n)
        self._part(layout.BOUNDS, rows)
        self._part(layout.OTHER_BOUNDS, rows)
        self._part(layout.MULTIPLIERS, rows)
        self.duals = self._part(layout.DUALS, rows + 2 * n)
        size = scratch_size(n, rows + 2 * n)
        self.scratch = self._part(layout.SCRATCH, size)
        self.words[layout.SCRATCH_SIZE] = size

    def _part(self, word: int, *shape: int) -> FloatArray:
        """A new part; what the word led to before is forgotten."""
        part = np.zeros(shape)
        self._lead(word, part)
        return part

    def _lead(self, word: int, part: NDArray[np.generic]) -> None:
        self.words[word] = part.ctypes.data
        self._parts[word] = part

    def _searches(self, searches: Sequence[Search | None]) -> None:
        table: IntArray = np.zeros((len(searches), layout.SEARCH), dtype=np.int64)
        for row, search in zip(table, searches, strict=True):
            if search is None:
                row[layout.KIND] = layout.GIVEN
                continue
            tree = search.tree
            row[layout.KIND] = search.kind
            row[layout.NODE_COUNT] = len(tree.nodes)
            row[layout.TRIANGLES] = len(tree.corners)
            row[layout.WALL_COUNT] = len(search.walls)
            for word, array in (
                (layout.NODES, tree.nodes), (layout.CORNERS, tree.corners),
                (layout.ORDER, tree.order), (layout.SLIVERS, tree.errors),
                (layout.EDGES, search.edges), (layout.WALLS, search.walls),
                (layout.FRAME, search.frame),
            ):  # fmt: skip
                if not array.flags.c_contiguous:
                    raise ValueError("what a fixture lets a tick search must be contiguous")
                row[word] = array.ctypes.data
        self.searches = table
        self._lead(layout.SEARCHES, table)
