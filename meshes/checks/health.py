"""The health report: defects of a mesh, where they are, and their effect on the fixtures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshes.checks import probe
from meshes.checks.bodies import Bodies, bodies
from meshes.checks.topology import Topology, topology
from meshes.checks.weld import first_of_kind, repeats_a_corner, weld
from meshes.content import checked
from meshes.errors import MeshError
from meshes.formats.text import pluralized
from meshes.meaning import MEANING
from vf import Surface
from vf.kernels import njit
from vf.tree.build import build
from vf.tree.closest import SLIVER

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

NEAR = 1e-6
"""Weld tolerance as a share of the diagonal: single precision, rounded twice."""
SLIM = 0.01
"""A sliver's height is less than this share of its longest edge."""
PERCENTILES = (0, 5, 50, 95, 100)
THIN = 1e-4  # [m] thickness below which a wall is reported: the size of a hand's tremor
EXAMINED = 50_000


@dataclass(frozen=True)
class Finding:
    """One kind of defect or remark: its number, its places, its meaning for the fixtures.

    Attributes:
        kind: a key of `MEANING`.
        count: number of faces, edges, vertices, loops, bodies or pairs, as ``kind`` says.
        defect: to be repaired before use; otherwise a remark.
        text: one line with the numbers.
        of: the kind of ``ids``: "vertices", "faces", or "edges".
        ids: ``(k,)`` rows of vertices or faces, or ``(k, 2)`` ends of edges, in the caller's order.
    """

    kind: str
    count: int
    defect: bool
    text: str
    of: str
    ids: IntArray

    @property
    def meaning(self) -> str:
        return MEANING[self.kind]


@dataclass(frozen=True)
class Health:
    """The report on a mesh. Lengths [m], areas [m²], volumes [m³].

    Attributes:
        extents: ``(x, y, z)`` of the bounding box.
        watertight: every edge joins exactly two faces, and no face is degenerate by its corners.
        consistent: no face is wound against its patch, and no patch is one-sided.
        components: pieces connected across edges.
        genus: handles of all components together; None where non-manifold or one-sided.
        volume: enclosed, cavities subtracted, positive also for a body that is inside out; None
            unless watertight and consistent.
        edge_percentiles: length at each of `PERCENTILES`.
        boundary_lengths: of every boundary loop, longest first.
        wall, wall_face: thinnest wall found and a face on it, or None.
        examined: faces examined for self-intersections and walls: all, or evenly sampled.
        findings: defects first, then remarks; empty for a clean mesh.
    """

    vertices: int
    triangles: int
    extents: tuple[float, float, float]
    watertight: bool
    consistent: bool
    components: int
    genus: int | None
    area: float
    volume: float | None
    edge_percentiles: tuple[float, ...]
    boundary_lengths: tuple[float, ...]
    wall: float | None
    wall_face: int | None
    examined: int
    findings: tuple[Finding, ...]

    @property
    def exact(self) -> bool:
        """Whether every face was examined for self-intersections and walls."""
        return self.examined == self.triangles

    @property
    def sound(self) -> bool:
        """No defects."""
        return not any(finding.defect for finding in self.findings)

    def count(self, kind: str) -> int:
        """The number in the finding of a kind, 0 if there is none.

        Raises:
            ValueError: unknown kind; lists the valid ones.
        """
        if kind not in MEANING:
            raise ValueError(f"unknown finding {kind!r}: choose one of {', '.join(MEANING)}")
        return next((finding.count for finding in self.findings if finding.kind == kind), 0)

    def as_dict(self, most_ids: int = 1000) -> dict[str, Any]:
        """Plain values for JSON, with at most so many ids of each finding."""
        return {
            "vertices": self.vertices,
            "triangles": self.triangles,
            "extents_m": list(self.extents),
            "sound": self.sound,
            "watertight": self.watertight,
            "consistent": self.consistent,
            "components": self.components,
            "genus": self.genus,
            "area_m2": self.area,
            "volume_m3": self.volume,
            "edge_percentiles_m": dict(
                zip(map(str, PERCENTILES), self.edge_percentiles, strict=True)
            ),
            "boundary_lengths_m": list(self.boundary_lengths[:most_ids]),
            "thinnest_wall_m": self.wall,
            "thinnest_wall_face": self.wall_face,
            "examined_faces": self.examined,
            "exact": self.exact,
            "findings": [
                {
                    "kind": finding.kind,
                    "count": finding.count,
                    "defect": finding.defect,
                    "text": finding.text,
                    "meaning": finding.meaning,
                    "of": finding.of,
                    "ids": finding.ids[:most_ids].tolist(),
                }
                for finding in self.findings
            ],
        }


def health(
    mesh: Surface | ArrayLike,
    faces: ArrayLike | None = None,
    *,
    examine: int = EXAMINED,
    progress: Callable[[str], None] | None = None,
) -> Health:
    """Report on a `vf.Surface`, or on vertices ``(n, 3)`` [m] and ``faces`` ``(m, 3)``.

    Faces with a repeated corner and duplicate faces are counted and then excluded, so that they do
    not also appear as non-manifold edges or components.

    Args:
        examine: at most so many faces, evenly sampled, are examined for self-intersections and thin
            walls. 0: none.
        progress: called with the name of each stage.

    Raises:
        MeshError: no faces, wrong shapes, indices out of range, vertices that are not finite.
    """
    say = progress or (lambda _stage: None)
    if isinstance(mesh, Surface):
        v, f = mesh.vertices, mesh.faces
    else:
        v, f = checked_mesh(mesh, faces)
    if examine < 0:
        raise ValueError(f"the number of faces to examine must be zero or more, not {examine}")
    found: list[Finding] = []

    def note(
        kind: str, ids: IntArray, text: str, of: str = "faces", defect: bool = False, n: int = -1
    ) -> None:
        count = len(ids) if n < 0 else n
        if count:
            found.append(Finding(kind, count, defect, pluralized(text, count), of, ids))

    say("vertices")
    used = np.zeros(len(v), dtype=bool)
    used[f] = True
    note(
        "unused vertices",
        np.flatnonzero(~used),
        "{n} [vertex is|vertices are] in no face",
        "vertices",
    )
    rows = np.flatnonzero(used)
    diagonal = float(np.linalg.norm(np.ptp(v[rows], axis=0)))
    stands_for, distance = weld(v[rows], NEAR * diagonal)
    joined = stands_for != np.arange(len(rows))
    repeated, near = joined & (distance == 0.0), joined & (distance > 0.0)
    note(
        "repeated vertices", rows[repeated],
        "{n} [vertex repeats|vertices repeat] the place of another (unwelded)", "vertices",
    )  # fmt: skip
    note(
        "near vertices", rows[near],
        f"{{n}} [vertex is|vertices are] within {NEAR * diagonal * 1e6:.2g} µm of another",
        "vertices",
    )  # fmt: skip
    welded = np.arange(len(v))
    welded[rows] = rows[stands_for]
    # Vertices at exactly the same place are one corner.
    place = np.arange(len(v))
    place[rows[repeated]] = rows[stands_for[repeated]]

    say("faces")
    lengths, normals, slimness, areas = _measured(v, f)
    corners = place[f]
    collapsed = repeats_a_corner(corners)
    degenerate = collapsed | (slimness <= SLIVER)
    note(
        "degenerate faces",
        np.flatnonzero(degenerate),
        "{n} [face has|faces have] no area",
        defect=True,
    )
    copies = (first_of_kind(corners) != np.arange(len(f))) & ~collapsed
    note(
        "duplicate faces",
        np.flatnonzero(copies),
        "{n} [face repeats|faces repeat] another",
        defect=True,
    )
    slim = ~degenerate & (slimness < SLIM)
    note(
        "slivers",
        np.flatnonzero(slim),
        f"{{n}} [face is|faces are] slimmer than 1 : {1 / SLIM:.0f}",
    )

    say("edges")
    proper = np.flatnonzero(~repeats_a_corner(f) & ~copies)
    t = topology(f[proper], len(v))
    solid = bodies(v, f[proper], t)
    loop_lengths = _loop_lengths(v, f, proper, t)
    _note_edges(note, v, f, proper, t, solid, welded if joined.any() else None, loop_lengths)

    wall, wall_face, examined = None, None, 0
    if examine:
        say("self-intersections and walls")
        tree = mesh.tree if isinstance(mesh, Surface) else build(v, f)
        wanted = min(examine, len(f))
        sample = probe.well_distributed(
            np.unique(np.linspace(0, len(f) - 1, wanted).astype(np.int64))
        )
        pairs, examined = probe.intersections(v, corners, tree, sample)
        sample = sample[:examined]
        # Duplicates are represented by their first face; (f, g) and (g, f) are one pair.
        pairs = np.sort(pairs[~copies[pairs].any(axis=1)], axis=1)
        pairs = np.unique(pairs, axis=0)
        outward = normals.copy()
        outward[proper[t.minority ^ solid.turned[t.patches]]] *= -1.0
        outward[degenerate | slim] = 0.0  # imprecise
        thickness, examined = probe.walls(v, corners, outward, tree, sample)
        how = "all faces" if examined == len(f) else f"{examined:,} sampled faces"
        note(
            "self-intersections", np.unique(pairs),
            f"{{n}} [pair|pairs] of faces cut each other ({how})", defect=True, n=len(pairs),
        )  # fmt: skip
        if np.isfinite(thickness).any():
            wall, wall_face = float(thickness.min()), int(sample[thickness.argmin()])
        thin = np.sort(sample[thickness < THIN])
        shown = f"{wall * 1e6:.3g} µm" if wall is not None else ""
        note(
            "thin walls", thin, f"{{n}} [face|faces] of walls under 0.1 mm, down to {shown} ({how})"
        )
        if examined < wanted:
            note(
                "crowded faces", np.empty(0, dtype=np.int64),
                f"so many faces are near each other that only {{n}} of {len(f):,} "
                "[was|were] looked at for self-intersections and walls", n=examined,
            )  # fmt: skip

    watertight = not (t.boundary_edges or t.non_manifold_edges or len(proper) < len(f))
    consistent = not (t.minority.any() or t.one_sided.any())
    extents = np.ptp(v[rows], axis=0)
    return Health(
        vertices=len(v),
        triangles=len(f),
        extents=(float(extents[0]), float(extents[1]), float(extents[2])),
        watertight=watertight,
        consistent=consistent,
        components=int(t.components.max(initial=-1)) + 1,
        genus=t.genus,
        area=float(areas[~copies].sum()),
        volume=solid.enclosed if watertight and consistent and solid.known else None,
        edge_percentiles=tuple(np.percentile(lengths, PERCENTILES).tolist()),
        boundary_lengths=tuple(np.sort(loop_lengths)[::-1].tolist()),
        wall=wall,
        wall_face=wall_face,
        examined=examined,
        findings=tuple(sorted(found, key=lambda finding: not finding.defect)),
    )


def checked_mesh(vertices: ArrayLike, faces: ArrayLike | None) -> tuple[FloatArray, IntArray]:
    """The arrays as ``(n, 3)`` float64 and ``(m, 3)`` int64, not copied if they already are.

    Raises:
        MeshError: as `health` says.
    """
    v, f = np.asarray(vertices, dtype=np.float64, order="C"), np.asarray(faces)
    if not np.issubdtype(f.dtype, np.integer):
        raise MeshError(f"faces must be integers of shape (m, 3), not {f.dtype} of {f.shape}")
    if len(f) == 0:
        raise MeshError("a mesh without faces")
    return checked(v, np.ascontiguousarray(f, dtype=np.int64))


def _note_edges(
    note: Callable[..., None],
    v: FloatArray,
    f: IntArray,
    proper: IntArray,
    t: Topology,
    solid: Bodies,
    welded: IntArray | None,
    loop_lengths: FloatArray,
) -> None:
    """The findings about edges, winding and bodies."""
    if len(loop_lengths):
        text = f"{{n}} boundary [loop|loops], {loop_lengths.sum() * 1e3:.4g} mm in all"
        if welded is not None:
            joined = welded[f[proper]]
            joined = joined[~repeats_a_corner(joined)]
            after = len(topology(joined, len(v)).boundary_starts) - 1 if len(joined) else 0
            text += (
                f"; {after:,} {'is' if after == 1 else 'are'} left once near vertices are welded"
            )
        boundary = t.boundary[t.opposite[t.boundary] == -1]
        note("boundary loops", _ends(f, proper, boundary), text, "edges", True, len(loop_lengths))
    note(
        "non-manifold edges", _ends(f, proper, t.non_manifold),
        "{n} [edge has|edges have] more than two faces", "edges", True,
    )  # fmt: skip
    note(
        "pinched vertices",
        t.pinched,
        "{n} [vertex joins|vertices join] sheets that share no edge",
        "vertices",
    )
    note(
        "flipped faces", proper[t.minority],
        "{n} [face is|faces are] wound against [its|their] surroundings", defect=True,
    )  # fmt: skip
    if not solid.known:
        note(
            "undecided bodies", np.empty(0, dtype=np.int64),
            "{n} closed bodies overlap so much that it was not worked out which lie inside others",
            defect=True, n=len(solid.patches),
        )  # fmt: skip
    # Inner bodies, also those in an open shell, turn with the outermost one.
    own = (solid.outermost == np.arange(len(solid.patches))) & ~solid.in_open
    for kind, which, text, defect in (
        ("inside-out bodies", solid.patches[solid.inside_out & own],
         "{n} closed [body is|bodies are] inside out", True),
        ("one-sided patches", np.flatnonzero(t.one_sided),
         "{n} [patch has|patches have] only one side", True),
        ("nested bodies", solid.patches[~own],
         "{n} closed [body lies|bodies lie] inside another", False),
    ):  # fmt: skip
        if len(which):
            ids = proper[np.isin(t.patches, which)]
            note(kind, ids, text, defect=defect, n=len(which))


def _ends(f: IntArray, proper: IntArray, half: IntArray) -> IntArray:
    """Vertices ``(k, 2)`` of half-edges of the proper faces."""
    face, k = proper[half // 3], half % 3
    return np.column_stack([f[face, k], f[face, (k + 1) % 3]])


def _loop_lengths(v: FloatArray, f: IntArray, proper: IntArray, t: Topology) -> FloatArray:
    """Length [m] of each boundary loop, non-manifold edges on its way not counted."""
    if len(t.boundary) == 0:
        return np.empty(0)
    ends = _ends(f, proper, t.boundary)
    lengths = np.linalg.norm(v[ends[:, 0]] - v[ends[:, 1]], axis=1) * (t.opposite[t.boundary] == -1)
    sums: FloatArray = np.add.reduceat(lengths, t.boundary_starts[:-1])
    return sums


def _measured(v: FloatArray, f: IntArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Edge lengths (m, 3), unit normals (m, 3), height over longest edge (m,), areas (m,)."""
    lengths, normals = np.empty((len(f), 3)), np.zeros((len(f), 3))
    slimness, areas = np.zeros(len(f)), np.empty(len(f))
    _measure(v, f, lengths, normals, slimness, areas)
    return lengths, normals, slimness, areas


@njit(cache=True, nogil=True)
def _measure(v, f, lengths, normals, slimness, areas):  # type: ignore[no-untyped-def]
    for i in range(f.shape[0]):
        a, b, c = v[f[i, 0]], v[f[i, 1]], v[f[i, 2]]
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        wx, wy, wz = c[0] - b[0], c[1] - b[1], c[2] - b[2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        norm = np.sqrt(nx * nx + ny * ny + nz * nz)
        lengths[i, 0] = np.sqrt(ux * ux + uy * uy + uz * uz)
        lengths[i, 1] = np.sqrt(wx * wx + wy * wy + wz * wz)
        lengths[i, 2] = np.sqrt(vx * vx + vy * vy + vz * vz)
        longest = max(lengths[i, 0], max(lengths[i, 1], lengths[i, 2]))
        areas[i] = 0.5 * norm
        if norm > 0.0:
            normals[i, 0], normals[i, 1], normals[i, 2] = nx / norm, ny / norm, nz / norm
            slimness[i] = norm / (longest * longest)
