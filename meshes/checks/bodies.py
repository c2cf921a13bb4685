"""Closed bodies of a mesh: volumes, nesting, and which are inside out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from meshes.checks import probe
from meshes.checks.topology import Topology
from vf.kernels import njit
from vf.tree.build import build

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Flags = NDArray[np.bool_]

# A shell that most rays from a body cross an odd number of times encloses it, also where the shell
# has holes or fins. The larger number is used where the first rays do not all agree.
_FEW, _RAYS = 8, 64


@dataclass(frozen=True)
class Bodies:
    """The closed, two-sided patches of a mesh, each wound as most of its faces are.

    Attributes:
        patches: ``(k,)`` their numbers in the `Topology`.
        outermost: ``(k,)`` row of the outermost body that encloses each one; its own row if none.
        in_open: ``(k,)`` whether that outermost body lies inside a shell with boundary or
            non-manifold edges.
        inside_out: ``(k,)`` bodies to be turned: outermost ones of negative volume that no open
            shell encloses, and all bodies in them. An inner body keeps its winding relative to the
            outer one, which distinguishes a cavity from a separate body.
        along: ``(patches,)`` open patches of the `Topology` in a body to be turned, turned with it.
        enclosed: volume [m³] where the winding numbers of the closed bodies do not sum to zero:
            cavities are subtracted, overlaps counted once. Never negative.
        known: whether the nesting was determined. If that exceeds the work limit, no body counts as
            enclosed or inside out, and ``enclosed`` is nan.
    """

    patches: IntArray
    outermost: IntArray
    in_open: Flags
    inside_out: Flags
    along: Flags
    enclosed: float
    known: bool = True

    @property
    def turned(self) -> Flags:
        """``(patches,)`` of the `Topology` to be turned."""
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
            patches, np.arange(count), np.zeros(count, dtype=bool), volumes < 0.0, along,
            float(np.abs(volumes).sum()),
        )  # fmt: skip
    rays = _Rays(vertices, faces, shells)
    try:
        return _nested(rays, topology, patches, volumes, along, bool(open_.any()))
    except probe.WorkLimit:
        no = np.zeros(count, dtype=bool)
        return Bodies(patches, np.arange(count), no, no, along, float("nan"), known=False)


def _nested(
    rays: _Rays,
    topology: Topology,
    patches: IntArray,
    volumes: FloatArray,
    along: Flags,
    any_open: bool,
) -> Bodies:
    """The bodies where some may enclose others. Raises `probe.WorkLimit`."""
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
    return Bodies(patches, outermost, in_open, inside_out, along, float(enclosed))


class _Rays:
    """Rays from faces of a mesh, and the shells that they cross."""

    def __init__(self, vertices: FloatArray, faces: IntArray, shells: IntArray) -> None:
        self._vertices, self._faces = vertices, faces
        self._shells = shells
        self._left = 4 * probe.effort(
            len(faces)
        )  # rays are quick, and a part of the answer is no use
        self._tree = build(vertices, faces)
        turn = np.pi * (1.0 + 5.0**0.5) * np.arange(_RAYS)
        height = 1.0 - (2.0 * np.arange(_RAYS) + 1.0) / _RAYS
        # Consecutive ones are distributed over the sphere.
        order = 29 * np.arange(_RAYS) % _RAYS
        across = np.sqrt(1.0 - height**2)
        self._directions = np.column_stack([across * np.cos(turn), across * np.sin(turn), height])
        self._directions = np.ascontiguousarray(self._directions[order])

    def around_bodies(self, count: int) -> tuple[IntArray, IntArray, Flags]:
        """Pairs of an inner and an outer body, and the bodies ``(count,)`` in an open shell.

        Shells from ``count`` on are open. One of them may enclose a body, or all of them together,
        such as the triangles of an unwelded wall.
        """
        members = np.argsort(self._shells, kind="stable")
        starts = np.searchsorted(self._shells[members], np.arange(count + 1))
        inner, outer = np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
        in_open = np.zeros(count, dtype=bool)
        asked = np.arange(count)
        width = int(self._shells.max()) + 2  # the last: all open shells together
        for rays in (_FEW, _RAYS):
            votes = np.empty(0, dtype=np.int64)
            for ray in range(rays):
                # Each ray starts at another face of the body.
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
        """Which patches have their first face inside one of these bodies, none of them nested."""
        first = np.full(int(of_face.max()) + 1, -1, dtype=np.int64)
        first[of_face[::-1]] = np.arange(len(of_face))[::-1]
        votes = np.zeros(len(patches), dtype=np.int64)
        for ray in range(_FEW + 1):
            pairs = self._crossed(first[patches], self._shells[first[patches]], ray)
            pairs = pairs[np.isin(pairs[:, 1], bodies)]
            votes += np.bincount(pairs[:, 0], minlength=len(patches)) > 0
        return np.asarray(2 * votes > _FEW + 1)

    def _crossed(self, faces: IntArray, own: IntArray, ray: int) -> IntArray:
        # An irrational point of the face: rays then miss the edges of regular meshes.
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
