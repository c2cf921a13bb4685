"""Repair without remeshing: weld vertices, drop degenerate and duplicate faces, fix windings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshes.checks.bodies import Bodies, bodies
from meshes.checks.health import NEAR
from meshes.checks.report import pluralized
from meshes.checks.topology import Topology, topology
from meshes.checks.weld import first_of_kind, repeats_a_corner, weld
from meshes.content import Arrays, checked_mesh, compact
from vf import Surface
from vf.kernels import njit
from vf.tree.closest import SLIVER

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Changes:
    """What a repair did, and what it left.

    Attributes:
        welded: vertices joined with an earlier one; ``farthest`` is the largest distance [m].
        degenerate, duplicates: faces dropped.
        unused: vertices dropped because no face uses them.
        flipped: faces turned to agree with most of their patch (of a tie: with the first).
        turned_bodies: closed bodies turned as a whole, to face outwards.
        turned_patches: open patches turned as a whole, by ``flip`` or with the enclosing body.
        left: defects that remain, a line each.
    """

    welded: int
    farthest: float
    degenerate: int
    duplicates: int
    unused: int
    flipped: int
    turned_bodies: int
    turned_patches: int
    left: tuple[str, ...]

    @property
    def any(self) -> bool:
        """Whether the repair changed the mesh."""
        return bool(self.lines())

    def lines(self) -> tuple[str, ...]:
        """What was done, a line for each kind that occurred."""
        rows = (
            (self.welded, "welded {n} [vertex|vertices], the farthest over "
             f"{self.farthest * 1e6:.2g} µm"),
            (self.degenerate, "dropped {n} [face|faces] without area"),
            (self.duplicates, "dropped {n} repeated [face|faces]"),
            (self.unused, "dropped {n} [vertex|vertices] that no face uses"),
            (self.flipped, "turned {n} [face|faces] to agree with [its|their] surroundings"),
            (self.turned_bodies, "turned {n} closed [body|bodies]"),
            (self.turned_patches, "turned {n} open [patch|patches]"),
        )  # fmt: skip
        return tuple(pluralized(text, count) for count, text in rows if count)


@dataclass(frozen=True)
class Repaired:
    """A repaired mesh: vertices ``(n, 3)`` [m], faces ``(m, 3)``, and what was changed.

    Vertices and faces keep their order, vertices their place, faces their first corner.
    """

    vertices: FloatArray
    faces: IntArray
    changes: Changes

    @property
    def arrays(self) -> Arrays:
        return self.vertices, self.faces


def repair(
    mesh: Surface | ArrayLike,
    faces: ArrayLike | None = None,
    *,
    tolerance: float | None = None,
    flip: bool = False,
    progress: Callable[[str], None] | None = None,
) -> Repaired:
    """A repaired copy of a `vf.Surface`, or of vertices ``(n, 3)`` [m] and ``faces`` ``(m, 3)``.

    Vertices within the tolerance are replaced by the first of them. Faces are dropped that then
    repeat a corner or another face, or are lower than the tolerance and have no neighbour (a flat
    face with neighbours closes a seam between them). Faces are turned to agree with the majority of
    their patch, of a tie with its first face: so also where two fins that share an edge are wound
    against each other. Closed bodies are turned to face outwards; inner bodies turn with the
    outermost one around them, so that a cavity stays one, also where the outer wall has a hole or a
    fin. The outside of an open patch is unknown: ``flip`` turns all open patches and the bodies in
    them. No hole is filled, nothing is cut or moved.

    Args:
        tolerance: of the weld [m]; a millionth of the diagonal by default.
        progress: called with the name of each stage.

    Raises:
        MeshError: not a mesh, see `meshes.health`.
        ValueError: a negative or infinite tolerance.
    """
    say = progress or (lambda _stage: None)
    v, f = (mesh.vertices, mesh.faces) if isinstance(mesh, Surface) else checked_mesh(mesh, faces)
    say("weld")
    used = np.zeros(len(v), dtype=bool)
    used[f] = True
    rows = np.flatnonzero(used)
    if tolerance is None:
        tolerance = NEAR * float(np.linalg.norm(np.ptp(v[rows], axis=0)))
    stands_for, distance = weld(v[rows], tolerance)
    place = np.arange(len(v))
    place[rows] = rows[stands_for]
    f = place[f]

    say("faces")
    collapsed = repeats_a_corner(f)
    f = f[~collapsed]
    copies = first_of_kind(f) != np.arange(len(f))
    f = f[~copies]
    flat = _flat(v, f, tolerance)
    t = topology(f, len(v)) if len(f) else None
    degenerate, stitches = int(collapsed.sum()), 0
    if t is not None and flat.any():
        stray = flat & (t.opposite.reshape(-1, 3) < 0).all(axis=1)
        degenerate, stitches = degenerate + int(stray.sum()), int((flat & ~stray).sum())
        if stray.any():
            f = f[~stray]
            t = topology(f, len(v)) if len(f) else None

    say("winding")
    flipped = turned_bodies = turned_patches = 0
    left: list[str] = []
    if t is not None:
        solid = bodies(v, f, t)
        turned = solid.turned
        if flip:
            turned ^= ~t.closed
            turned[solid.patches] |= solid.in_open
        flipped = int(t.minority.sum())
        turned_bodies = int(turned[t.closed].sum())
        turned_patches = int(turned[~t.closed].sum())
        wrong = t.minority ^ turned[t.patches]
        f[wrong] = f[wrong][:, [0, 2, 1]]  # the first corner stays
        left = _left(t, solid, stitches)
    else:
        left = ["nothing: no face had any area"]
    vertices, faces = compact(v, f)
    welded = int((stands_for != np.arange(len(rows))).sum())
    changes = Changes(
        welded=welded,
        farthest=float(distance.max(initial=0.0)),
        degenerate=degenerate,
        duplicates=int(copies.sum()),
        unused=len(v) - welded - len(vertices),
        flipped=flipped,
        turned_bodies=turned_bodies,
        turned_patches=turned_patches,
        left=tuple(left),
    )
    return Repaired(vertices, faces, changes)


def _left(t: Topology, solid: Bodies, stitches: int) -> list[str]:
    """The defects that remain."""
    rows = (
        (len(t.boundary_starts) - 1, "{n} boundary [loop|loops]: holes are not filled"),
        (int((~t.closed).sum()), "{n} open [patch has|patches have] no outside: see which way "
         "[it looks|they look]"),
        (t.non_manifold_edges, "{n} [edge|edges] with more than two faces"),
        (len(t.pinched), "{n} [vertex|vertices] joining sheets that share no edge"),
        (int(t.one_sided.sum()), "{n} [patch|patches] with one side only"),
        (stitches, "{n} [face|faces] without area that close[s|] a seam"),
        (0 if solid.known else len(solid.patches), "{n} closed [body|bodies], not turned: so much "
         "overlaps that it was not worked out which lie inside others"),
    )  # fmt: skip
    return [pluralized(text, count) for count, text in rows if count]


def _flat(v: FloatArray, f: IntArray, tolerance: float) -> NDArray[np.bool_]:
    """``(m,)`` faces whose height over the longest edge is within the tolerance or rounding."""
    flat = np.zeros(len(f), dtype=np.bool_)
    _find_flat(v, f, tolerance, flat)
    return flat


@njit(cache=True, nogil=True)
def _find_flat(v, f, tolerance, flat):  # type: ignore[no-untyped-def]
    for i in range(f.shape[0]):
        a, b, c = v[f[i, 0]], v[f[i, 1]], v[f[i, 2]]
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        wx, wy, wz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        nx, ny, nz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
        longest2 = max(ux * ux + uy * uy + uz * uz, wx * wx + wy * wy + wz * wz)
        ux, uy, uz = c[0] - b[0], c[1] - b[1], c[2] - b[2]
        longest2 = max(longest2, ux * ux + uy * uy + uz * uz)
        # The cross product is the longest edge times the height over it.
        doubled = np.sqrt(nx * nx + ny * ny + nz * nz)
        longest = np.sqrt(longest2)
        flat[i] = doubled <= longest * max(tolerance, SLIVER * longest)
