"""Closed bodies of a mesh: their volumes, what lies inside what, which are inside out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from meshes.checks import probe
from meshes.checks.topology import Topology
from vf import pdtree
from vf.kernels import njit

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Flags = NDArray[np.bool_]

# What most rays from a body cross an odd number of times is around it, whether it is closed or has
# holes and fins. Where the first few rays agree about everything, more would not say anything else.
_FEW, _RAYS = 8, 64


@dataclass(frozen=True)
class Bodies:
    """The closed, two-sided patches of a mesh, each wound as most of its faces are.

    Attributes:
        patches: ``(k,)`` their numbers in the `Topology`.
        volumes: ``(k,)`` [m³], negative where the faces look inwards.
        outermost: ``(k,)`` row of the outermost body around each one; its own row if none is.
        in_open: ``(k,)`` whether that outermost one lies inside a wall that is not closed. Such a
            wall has a hole, or an edge of more than two faces; what is in it is a cavity or a body
            of its own, as in a closed one.
        inside_out: ``(k,)`` bodies to be turned: outermost ones with negative volume that no open
            wall is around, and what lies in them. An inner body keeps its winding relative to what
            is around it: whether it is a cavity or a body of its own is for the file to say.
        along: ``(patches,)`` open patches of the `Topology` that lie in a body to be turned, and
            turn with it.
        enclosed: [m³] of all places where the closed bodies' winding numbers do not cancel: their
            volumes, cavities taken off, and what lies inside twice counted once. Never negative.
        known: what lies inside what. Where so much overlaps that it would take too long, no body
            counts as in another one or as inside out, and ``enclosed`` is nan.
    """

    patches: IntArray
    volumes: FloatArray
    outermost: IntArray
    in_open: Flags
    inside_out: Flags
    along: Flags
    enclosed: float
    known: bool = True

    @property
    def turned(self) -> Flags:
        """``(patches,)`` of the `Topology`: all that is to be turned."""
        turned = self.along.copy()
        turned[self.patches] = self.inside_out
        return turned


def bodies(vertices: FloatArray, faces: IntArray, topology: Topology) -> Bodies:
    """The bodies of the mesh ``vertices`` ``(n, 3)`` [m], ``faces`` ``(m, 3)``."""
    patches = np.flatnonzero(topology.closed & ~topology.one_sided)
    count = len(patches)
    row = np.full(len(topology.closed), -1, dtype=np.int64)
    row[patches] = np.arange(count)
    body = row[topology.patches]
    middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0)) if len(vertices) else np.zeros(3)
    volumes = np.zeros(count)
    _volumes(vertices, faces, body, topology.minority, middle, volumes)
    along = np.zeros(len(topology.closed), dtype=bool)
    # Each body by itself, and the open parts of each component together, are shells.
    open_ = body < 0
    names, number = np.unique(topology.components[open_], return_inverse=True)
    shells = body.copy()
    shells[open_] = count + number
    if count == 0 or count + len(names) == 1:
        return Bodies(
            patches, volumes, np.arange(count), np.zeros(count, dtype=bool), volumes < 0.0, along,
            float(np.abs(volumes).sum()),
        )  # fmt: skip
    rays = _Rays(vertices, faces, shells)
    try:
        return _nested(rays, topology, patches, volumes, along, bool(open_.any()))
    except probe.TooMuch:
        no = np.zeros(count, dtype=bool)
        return Bodies(patches, volumes, np.arange(count), no, no, along, float("nan"), known=False)


def _nested(
    rays: _Rays,
    topology: Topology,
    patches: IntArray,
    volumes: FloatArray,
    along: Flags,
    any_open: bool,
) -> Bodies:
    """The bodies where there may be some in others. Raises `probe.TooMuch`."""
    count = len(patches)
    inner, outer, in_open = rays.around_bodies(count)
    depth = np.bincount(inner, minlength=count)
    outermost = np.arange(count)
    top = depth[outer] == 0
    outermost[inner[top]] = outer[top]
    in_open = in_open[outermost]
    inside_out = (volumes < 0.0)[outermost] & ~in_open

    sign = np.sign(volumes)
    beyond = np.bincount(inner, weights=sign[outer], minlength=count)
    enclosed = np.abs(volumes) @ (
        (beyond + sign != 0.0).astype(float) - (beyond != 0.0).astype(float)
    )
    if inside_out.any() and any_open:
        loose = np.flatnonzero(~topology.closed)
        own = np.flatnonzero(inside_out & (outermost == np.arange(count)))
        along[loose] = rays.inside(loose, topology.patches, own)
    return Bodies(patches, volumes, outermost, in_open, inside_out, along, float(enclosed))


class _Rays:
    """Rays from faces of a mesh, and which shells they cross."""

    def __init__(self, vertices: FloatArray, faces: IntArray, shells: IntArray) -> None:
        self._vertices, self._faces = vertices, faces
        self._shells = shells
        self._left = 4 * probe.effort(len(faces))  # rays are quick, and the answer is needed whole
        self._tree = pdtree.build(vertices, faces)
        turn = np.pi * (1.0 + 5.0**0.5) * np.arange(_RAYS)
        height = 1.0 - (2.0 * np.arange(_RAYS) + 1.0) / _RAYS
        # Any run of them is spread over the sphere.
        order = 29 * np.arange(_RAYS) % _RAYS
        across = np.sqrt(1.0 - height**2)
        self._directions = np.column_stack([across * np.cos(turn), across * np.sin(turn), height])
        self._directions = np.ascontiguousarray(self._directions[order])

    def around_bodies(self, count: int) -> tuple[IntArray, IntArray, Flags]:
        """Pairs of an inner and an outer body, and the bodies ``(count,)`` in an open wall.

        Those of the shells from ``count`` on are open. One of them may be around a body, or all of
        them together, as the triangles of an unwelded wall are.
        """
        members = np.argsort(self._shells, kind="stable")
        starts = np.searchsorted(self._shells[members], np.arange(count + 1))
        inner, outer = np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
        in_open = np.zeros(count, dtype=bool)
        asked = np.arange(count)
        width = int(self._shells.max()) + 2  # the last: all open ones together
        for rays in (_FEW, _RAYS):
            votes = np.empty(0, dtype=np.int64)
            for ray in range(rays):
                # Other faces each time, evenly over the body.
                first, size = starts[asked], starts[asked + 1] - starts[asked]
                chosen = members[first + (size * (ray % _FEW)) // _FEW]
                pairs = self._crossed(chosen, asked, ray)
                together = np.bincount(pairs[pairs[:, 1] >= count, 0], minlength=len(asked)) % 2
                also = np.flatnonzero(together)
                votes = np.concatenate(
                    [votes, pairs[:, 0] * width + pairs[:, 1], also * width + width - 1]
                )
            keys, times = np.unique(votes, return_counts=True)
            body, shell = keys // width, keys % width
            unsure = np.zeros(len(asked), dtype=bool)
            if rays < _RAYS:
                unsure[body[times < rays]] = True
            around = (2 * times > rays) & ~unsure[body]
            closed = around & (shell < count)
            inner = np.concatenate([inner, asked[body[closed]]])
            outer = np.concatenate([outer, shell[closed]])
            in_open[asked[body[around & (shell >= count)]]] = True
            asked = asked[unsure]
        return inner, outer, in_open

    def inside(self, patches: IntArray, of_face: IntArray, bodies: IntArray) -> Flags:
        """Which of these patches start inside one of these bodies, none of which is in another."""
        first = np.full(int(of_face.max()) + 1, -1, dtype=np.int64)
        first[of_face[::-1]] = np.arange(len(of_face))[::-1]
        votes = np.zeros(len(patches), dtype=np.int64)
        for ray in range(_FEW + 1):
            pairs = self._crossed(first[patches], self._shells[first[patches]], ray)
            pairs = pairs[np.isin(pairs[:, 1], bodies)]
            votes += np.bincount(pairs[:, 0], minlength=len(patches)) > 0
        return np.asarray(2 * votes > _FEW + 1)

    def _crossed(self, faces: IntArray, own: IntArray, ray: int) -> IntArray:
        # From an odd point of the face, so that drawn parts' straight edges are missed.
        corners = self._vertices[self._faces[faces]]
        starts = np.einsum("k,nkd->nd", np.array([0.4142, 0.2679, 0.3179]), corners)
        pairs, self._left = probe.crossings(
            self._tree, self._shells, starts, self._directions[ray], own, self._left
        )
        return pairs


@njit(cache=True, nogil=True)
def _volumes(vertices, faces, body, minority, middle, volumes):  # type: ignore[no-untyped-def]
    for f in range(faces.shape[0]):
        if body[f] < 0:
            continue
        a = vertices[faces[f, 0]] - middle
        b = vertices[faces[f, 1]] - middle
        c = vertices[faces[f, 2]] - middle
        det = (
            a[0] * (b[1] * c[2] - b[2] * c[1])
            + a[1] * (b[2] * c[0] - b[0] * c[2])
            + a[2] * (b[0] * c[1] - b[1] * c[0])
        ) / 6.0
        volumes[body[f]] += -det if minority[f] else det
