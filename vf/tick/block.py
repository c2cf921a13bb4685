"""The memory of a tick, laid out as `vf.layout` describes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from vf import layout as at
from vf.planes import FloatArray, IntArray
from vf.qp.active_set import scratch_size
from vf.rules.certified import BUDGET, CORNERS, HEAP
from vf.rules.search import Search
from vf.surface import DeformingSurface
from vf.tick.bodies import Guarded, tip_alone
from vf.tick.chain import LINK


class Block:
    """The arrays of a tick, and the words with their addresses. Not thread-safe.

    Attributes:
        words: (WORDS,) see `vf.layout`, at `address`; the other arrays are parts by the names of
            their words.
        report: bytes of REPORT and of the planes behind it.
        head: bytes of REPORT.
        poses: bytes of MOTIONS.
    """

    def __init__(
        self,
        n: int,
        chain: FloatArray | None,
        searches: Sequence[Search | None],
        guarded: Guarded | None = None,
    ) -> None:
        """For n joints.

        Args:
            chain: of the arm, see `vf.tick.chain`; None: the arm computes its kinematics in Python.
            searches: one for each fixture; None: the fixture computes its planes in Python.
            guarded: the tip and what is guarded beside it; None: nothing.
        """
        self.words = np.zeros(at.WORDS, dtype=np.int64)
        self.address = self.words.ctypes.data
        # The kernels hold addresses only: these references keep the arrays alive.
        self._searched = tuple(searches)
        self._parts: dict[int, NDArray[np.generic]] = {}
        self._scratch: dict[int, tuple[FloatArray, ...]] = {}
        self._deforming: dict[int, DeformingSurface] = {}
        self.n = n
        links = 0 if chain is None else len(chain)
        guarded = guarded or tip_alone(0.0)
        points = len(guarded.guards)
        for word, count in (
            (at.JOINTS, n), (at.LINKS, links), (at.FIXTURES, len(searches)),
            (at.POINTS, points), (at.BODIES, len(guarded.bodies)),
        ):  # fmt: skip
            self.words[word] = count
        self.chain = self._part(at.CHAIN, links, LINK)
        self.chain[:] = 0.0 if chain is None else chain
        self._part(at.AXES, links, 6)
        self.numbers = self._part(at.NUMBERS, at.SCALARS)
        self.table = self._part(at.TABLE, at.JOINT_ROWS, n)
        self.jacobian = self._part(at.JACOBIAN, 6, n)
        self._part(at.JACOBIANS, points, 3, n)
        self.places = self._part(at.PLACES, points, 3)
        self.trials = self._part(at.TRIALS, points, 3)
        self._part(at.ERRORS, points, 3)
        self._part(at.BULGES, points)
        self.start = self._part(at.START, 3, 4)
        self.tip = self._part(at.TIP, 3, 4)
        self._part(at.BEST, 3, 4)
        self.solution = self._part(at.SOLUTION, n)
        self._part(at.QUEUE, HEAP, 3)
        self._part(at.POLYGONS, 2, CORNERS, 3)
        self.sides = self._part(at.SIDES, len(searches), at.SIDE)
        self.sides[:] = np.nan
        self.motions = self._part(at.MOTIONS, len(searches), at.MOTION)
        self.poses = self.motions.reshape(-1).data.cast("B")
        self._searches(searches)
        self._point(at.GUARDS, guarded.guards)
        self._point(at.BODY_TABLE, guarded.bodies)
        self.head = 8 * (at.HEAD + 2 * n)
        self._spare = len(searches) * BUDGET * guarded.ends
        self.reserve(max(len(searches), 1) * BUDGET)

    def reserve(self, rows: int) -> None:
        """Make room for that many planes of the tip; their present content is lost."""
        self.room = rows
        rows += self._spare
        n, head = self.n, self.head // 8
        self.words[at.ROOM] = rows
        whole = np.zeros(head + rows * at.PLANE)
        self.words[at.REPORT] = whole.ctypes.data
        self.words[at.PLANES] = whole.ctypes.data + self.head
        self.planes = whole[head:].reshape(rows, at.PLANE)
        self.report = whole.data.cast("B")
        self._part(at.ROWS, rows, n)
        self._part(at.BOUNDS, rows)
        self._part(at.OTHER_BOUNDS, rows)
        self._part(at.GAINS, rows)
        self._part(at.NEEDED, rows)
        self._part(at.SOUGHT, rows, n)
        self._part(at.SOUGHT_GAINS, rows)
        self._part(at.MULTIPLIERS, rows)
        self.duals = self._part(at.DUALS, rows + 2 * n)
        size = scratch_size(n, rows + 2 * n)
        self.scratch = self._part(at.SCRATCH, size)
        self.words[at.SCRATCH_SIZE] = size

    def _part(self, word: int, *shape: int) -> FloatArray:
        """A new part; the array that the word pointed to before is released."""
        part = np.zeros(shape)
        self._point(word, part)
        return part

    def _point(self, word: int, part: NDArray[np.generic]) -> None:
        self.words[word] = part.ctypes.data
        self._parts[word] = part

    def _searches(self, searches: Sequence[Search | None]) -> None:
        table: IntArray = np.zeros((len(searches), at.SEARCH), dtype=np.int64)
        for row, side, search in zip(table, self.sides, searches, strict=True):
            if search is None:
                row[at.KIND] = at.GIVEN
                continue
            tree = search.tree
            row[at.KIND] = search.kind
            row[at.NODE_COUNT] = len(tree.nodes)
            row[at.TRIANGLES] = len(tree.order)
            row[at.WALL_COUNT] = len(search.walls)
            row[at.VARIED] = len(search.margins.own)
            side[at.MARGIN] = search.margins.margin
            for word, array in (
                (at.NODES, tree.nodes), (at.CORNERS, tree.corners),
                (at.ORDER, tree.order), (at.SLIVERS, tree.errors),
                (at.EDGES, search.edges), (at.WALLS, search.walls),
                (at.FRAME, search.frame), (at.NODE_MARGINS, search.margins.highest),
                (at.OWN_MARGINS, search.margins.own),
            ):  # fmt: skip
                if not array.flags.c_contiguous:
                    raise ValueError("the arrays of a fixture's search must be contiguous")
                row[word] = array.ctypes.data
        self.searches = table
        self._point(at.SEARCHES, table)

    def deform(self, f: int, surface: DeformingSurface) -> None:
        """Let fixture f have a surface that deforms, from now on; the same mesh as before."""
        row = self.searches[f]
        if row[at.FACES] == 0:
            # Where walks write the boxes and triangles that they come to, in the shape of the tick.
            # All of the memory is touched here, so that no tick has to wait for it.
            m, nodes = len(surface.faces), surface.searched.nodes.copy()
            scratch = np.full((m, 9), 0.0), np.full(m, 0.0), nodes
            self._scratch[f] = scratch
            for word, part in zip((at.CORNERS, at.SLIVERS, at.NODES), scratch, strict=True):
                row[word] = part.ctypes.data
            row[at.TRIANGLES], row[at.NODE_COUNT] = m, len(nodes)
            self.words[at.DEFORMS] = 1
        words = at.FACES, at.BEFORE, at.AFTER, at.BOXES, at.BOXES_AFTER, at.SHIFTS
        for word, array in zip(words, (*surface.parts, surface.shifts), strict=True):
            row[word] = array.ctypes.data
        row[at.FORM], row[at.FORM_BETWEEN], row[at.FORM_AFTER] = surface.forms
        self._deforming[f] = surface  # keeps the arrays alive
