"""What a health report holds: kinds of findings and their meaning, and the report itself."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

PERCENTILES = (0, 5, 50, 95, 100)
MEANING = {
    "unused vertices": "no rule uses them",
    "repeated vertices": "faces on them are not neighbours: the paper's rule leaks at such seams; "
    "the certified rule and the inside test are not affected",
    "near vertices": "if they should be one vertex, the seam between them leaks under the paper's "
    "rule and the mesh is not closed; the certified rule holds",
    "degenerate faces": "they have no normal: the paper's rule ignores them; the certified rule "
    "guards them by their nearest point",
    "duplicate faces": "their edges have more than two faces, where the paper's rule finds no "
    "neighbour; the certified rule and the inside test count them once",
    "slivers": "their normals are imprecise: the paper's rule may tilt a plane; the certified "
    "rule checks a plane against the corners first",
    "boundary loops": "the mesh has no inside: the paper's rule guards its outer side only, the "
    "certified rule both sides; a tool that starts inside is not reported",
    "non-manifold edges": "the paper's conditions need one neighbour on each edge and do not hold "
    "here; the certified rule needs none",
    "pinched vertices": "no rule is affected; some repair and remeshing programs are",
    "flipped faces": "the paper's rule guards the wrong side of them and lets the tool through; "
    "the certified rule does not use the winding, but the inside test is wrong",
    "inside-out bodies": "the paper's rule and every face plane guard the wrong side; the "
    "certified rule and the inside test are not affected",
    "one-sided patches": "no winding is right everywhere: only the certified rule guards "
    "both sides",
    "nested bodies": "a cavity or a separate body, as the winding says; so does the inside test",
    "undecided bodies": "whether they face outwards, which of them are cavities, and the volume "
    "are not known; the certified rule is not affected",
    "crowded faces": "there may be more self-intersections and thin walls than were found",
    "self-intersections": "the inside test counts overlaps twice (still inside); the paper's rule "
    "may leak along the cut, which no edge marks; the certified rule holds",
    "thin walls": "with the paper's rule an error of that size can lead through; the certified "
    "rule checks every step and holds",
}  # fmt: skip
"""What each kind of finding means for the fixtures' rules."""


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
    ids: NDArray[np.int64]

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


def pluralized(text: str, n: int) -> str:
    """A text with ``{n}`` replaced by a number, and ``[singular|plural]`` by the form it needs.

    The text may hold no other braces or square brackets.
    """
    return re.sub(r"\[([^|]*)\|([^]]*)\]", r"\1" if n == 1 else r"\2", text).format(n=f"{n:,}")
