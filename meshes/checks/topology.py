"""Adjacency and orientation of a triangle mesh, for the health report and the repair.

Half-edge h = 3 f + k is the edge of face f from its corner k to corner k + 1. On an edge of exactly
two faces each half-edge has an opposite one. A *patch* is connected across such edges, a
*component* across any edge.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vf.adjacency import edge_keys
from vf.kernels import njit

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

BOUNDARY, NON_MANIFOLD = -1, -2
"""In place of an opposite half-edge: the edge has one face, or more than two."""


@dataclass(frozen=True)
class Topology:
    """Adjacency of faces ``(m, 3)``, none of which has the same corner twice.

    Attributes:
        opposite: ``(3m,)`` the opposite half-edge, `BOUNDARY` or `NON_MANIFOLD`.
        components, patches: ``(m,)`` numbers from 0 in order of their first face.
        minority: ``(m,)`` faces wound against most of their patch (of a tie: against the first).
        closed: ``(patches,)`` neither boundary nor non-manifold edges.
        one_sided: ``(patches,)`` no winding is consistent (a Möbius strip): minority is all False.
        edges, boundary_edges, non_manifold_edges: numbers of all edges, of those with one face, and
            of those with more than two.
        non_manifold: ``(k,)`` one half-edge of each non-manifold edge.
        fans: number of fans, the sets of faces connected about one vertex.
        pinched: vertices of several fans without a non-manifold edge.
        boundary, boundary_starts: half-edges of the boundary loops one after the other ``(k,)``,
            and where each loop starts ``(loops + 1,)``, the last one being k.
    """

    opposite: IntArray
    components: IntArray
    patches: IntArray
    minority: NDArray[np.bool_]
    closed: NDArray[np.bool_]
    one_sided: NDArray[np.bool_]
    edges: int
    boundary_edges: int
    non_manifold_edges: int
    non_manifold: IntArray
    fans: int
    pinched: IntArray
    boundary: IntArray
    boundary_starts: IntArray

    @property
    def genus(self) -> int | None:
        """Handles of all components together, holes counted as filled; None where it is undefined
        (non-manifold edges, one-sided patches)."""
        if self.non_manifold_edges or bool(self.one_sided.any()):
            return None
        loops, bodies = len(self.boundary_starts) - 1, len(self.closed)
        characteristic = self.fans - self.edges + len(self.opposite) // 3
        return bodies - (characteristic + loops) // 2


def topology(faces: IntArray, vertices: int) -> Topology:
    """Adjacency of ``faces`` ``(m, 3)`` over a number of ``vertices``."""
    keys = edge_keys(faces, vertices)
    rank = np.argsort(keys)
    opposite = np.empty(len(keys), dtype=np.int64)
    non_manifold = np.empty(len(keys), dtype=np.int64)
    parents = np.arange(len(faces), dtype=np.int64)
    edges, boundary_edges, non_manifold_edges = _match(keys, rank, opposite, non_manifold, parents)
    components = _numbered(parents)
    patches = np.full(len(faces), -1, dtype=np.int64)
    turned = np.zeros(len(faces), dtype=np.bool_)
    count, twisted = _walk(faces, opposite, patches, turned)
    one_sided = np.zeros(count, dtype=bool)
    one_sided[patches[twisted // 3]] = True
    open_ = np.zeros(count, dtype=bool)
    open_[patches[np.flatnonzero(opposite < 0) // 3]] = True
    # Each patch was walked from its first face: turned is relative to that one.
    sizes = np.bincount(patches, minlength=count)
    against = np.bincount(patches[turned], minlength=count)
    minority = np.where((2 * against > sizes)[patches], ~turned, turned) & ~one_sided[patches]
    fans, several = _fans(faces, opposite, vertices)
    excluded = np.zeros(vertices, dtype=bool)
    half = np.flatnonzero(opposite == NON_MANIFOLD)
    excluded[faces[half // 3, half % 3]] = True
    excluded[faces[half // 3, (half + 1 - 3 * (half % 3 == 2)) % 3]] = True
    return Topology(
        opposite, components, patches, minority, ~open_, one_sided, edges, boundary_edges,
        non_manifold_edges, non_manifold[:non_manifold_edges], fans,
        np.flatnonzero(several & ~excluded), *_boundary_loops(faces, opposite),
    )  # fmt: skip


@njit(cache=True, nogil=True)
def _root(parents, i):  # type: ignore[no-untyped-def]
    while parents[i] != i:
        parents[i] = parents[parents[i]]
        i = parents[i]
    return i


@njit(cache=True, nogil=True)
def _join(parents, i, j):  # type: ignore[no-untyped-def]
    i, j = _root(parents, i), _root(parents, j)
    if i < j:
        parents[j] = i
    elif j < i:
        parents[i] = j


@njit(cache=True, nogil=True)
def _match(keys, rank, opposite, non_manifold, parents):  # type: ignore[no-untyped-def]
    """Fill opposite half-edges and components from the sorted edge table; return edge counts."""
    edges = boundary_edges = non_manifold_edges = 0
    i = 0
    while i < keys.shape[0]:
        j = i + 1
        while j < keys.shape[0] and keys[rank[j]] == keys[rank[i]]:
            j += 1
        edges += 1
        h = rank[i]
        if j - i == 1:
            boundary_edges += 1
            opposite[h] = -1
        elif j - i == 2:
            opposite[h], opposite[rank[i + 1]] = rank[i + 1], h
            _join(parents, h // 3, rank[i + 1] // 3)
        else:
            non_manifold[non_manifold_edges] = h
            non_manifold_edges += 1
            for k in range(i, j):
                opposite[rank[k]] = -2
                _join(parents, h // 3, rank[k] // 3)
        i = j
    return edges, boundary_edges, non_manifold_edges


@njit(cache=True, nogil=True)
def _numbered(parents):  # type: ignore[no-untyped-def]
    """Numbers from 0 of the sets in a union-find forest whose roots are the smallest members."""
    numbers = np.empty(parents.shape[0], dtype=np.int64)
    count = 0
    for i in range(parents.shape[0]):
        r = _root(parents, i)
        if r == i:
            numbers[i] = count
            count += 1
        else:
            numbers[i] = numbers[r]
    return numbers


@njit(cache=True, nogil=True)
def _walk(faces, opposite, patches, turned):  # type: ignore[no-untyped-def]
    """Breadth first over every patch; its number, and the half-edges where the winding clashes."""
    m = faces.shape[0]
    queue = np.empty(m, dtype=np.int64)
    twisted = np.empty(3 * m, dtype=np.bool_)
    count = 0
    for seed in range(m):
        if patches[seed] >= 0:
            continue
        patches[seed] = count
        queue[0] = seed
        head, tail = 0, 1
        while head < tail:
            f = queue[head]
            head += 1
            for k in range(3):
                h = 3 * f + k
                g = opposite[h]
                twisted[h] = False
                if g < 0:
                    continue
                other = g // 3
                # Two faces wound alike walk their edge in opposite directions.
                alike = faces[f, k] != faces[other, g % 3]
                expected = turned[f] if alike else not turned[f]
                if patches[other] < 0:
                    patches[other] = count
                    turned[other] = expected
                    queue[tail] = other
                    tail += 1
                elif turned[other] != expected:
                    twisted[h] = True
        count += 1
    return count, np.flatnonzero(twisted)


def _fans(faces: IntArray, opposite: IntArray, vertices: int) -> tuple[int, NDArray[np.bool_]]:
    """Number of fans, and the vertices ``(vertices,)`` with more than one."""
    parents = np.arange(3 * len(faces), dtype=np.int64)
    per_vertex = np.zeros(vertices, dtype=np.int64)
    fans = _join_fans(faces, opposite, parents, per_vertex)
    return int(fans), per_vertex > 1


@njit(cache=True, nogil=True)
def _join_fans(faces, opposite, parents, per_vertex):  # type: ignore[no-untyped-def]
    """Join the corners of a vertex across manifold edges; count fans."""
    for h in range(opposite.shape[0]):
        g = opposite[h]
        if g < h:  # none, or done from the other side
            continue
        h1 = h + 1 - 3 * (h % 3 == 2)
        g1 = g + 1 - 3 * (g % 3 == 2)
        if faces[h // 3, h % 3] == faces[g // 3, g % 3]:
            _join(parents, h, g)
            _join(parents, h1, g1)
        else:
            _join(parents, h, g1)
            _join(parents, h1, g)
    fans = 0
    for c in range(parents.shape[0]):
        if parents[c] == c:
            fans += 1
            per_vertex[faces[c // 3, c % 3]] += 1
    return fans


def _boundary_loops(faces: IntArray, opposite: IntArray) -> tuple[IntArray, IntArray]:
    """Half-edges of the boundary loops one after the other ``(k,)``, and ``(loops + 1,)`` starts.

    The walk turns about each vertex through the faces of one fan, so that holes touching at a
    vertex are one loop. It follows non-manifold edges from one boundary edge to the next, and does
    not depend on the winding.
    """
    half = np.flatnonzero(opposite < 0)
    order = np.empty(len(half), dtype=np.int64)
    starts = np.empty(len(half) + 1, dtype=np.int64)
    loops = _trace(faces, opposite, half, order, starts)
    return order[: starts[loops]].copy(), starts[: loops + 1].copy()


@njit(cache=True, nogil=True)
def _trace(faces, opposite, half, order, starts):  # type: ignore[no-untyped-def]
    seen = np.zeros(opposite.shape[0], dtype=np.bool_)
    loops = done = 0
    for start in half:
        if opposite[start] != -1 or seen[start]:
            continue
        starts[loops] = done
        h = start
        ahead = True  # from corner k to k + 1
        while not seen[h]:
            seen[h] = True
            order[done] = h
            done += 1
            while True:
                # Turn about the vertex ahead: the other edge of this face at it.
                h = h + 1 - 3 * (h % 3 == 2) if ahead else h - 1 + 3 * (h % 3 == 0)
                g = opposite[h]
                if g < 0:
                    break
                # A neighbour wound alike has the vertex ahead as well.
                if faces[h // 3, h % 3] == faces[g // 3, g % 3]:
                    ahead = not ahead
                h = g
        loops += 1
    starts[loops] = done
    return loops
