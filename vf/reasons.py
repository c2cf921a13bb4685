"""Why each triangle near the tool gave a plane, or was passed over: by both rules, in numbers.

Nothing here affects the control. The conditions are evaluated a second time, triangle by triangle
and independent of the kernels that choose the planes, and the reasons are kept.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vf.adjacency import Edge
from vf.fixtures import MeshFixture
from vf.planes import FloatArray, IntArray, Planes, Rule, checked_length, checked_point
from vf.rules.paper import SAME
from vf.surface import Surface
from vf.tree.closest import Feature, closest_on_triangle, closest_point


class Verdict(IntEnum):
    """What the paper's conditions make of a triangle. The first three are its `Rule`s."""

    FACE = 1  # Condition 1
    RIDGE = 2  # Condition 2, and it gave the plane
    VALLEY = 3  # Condition 3
    SHARED = 4  # Condition 2, but the plane stands under a triangle with the same closest point
    BEHIND = 5  # closest point inside the face, but x is behind the face
    APART = 6  # closest point on a ridge or flat edge, the neighbour's closest point is another
    BEHIND_VALLEY = 7  # closest point on a valley edge, but x is behind the face
    OPEN = 8  # closest point on an edge that has no neighbour, or more than one
    NO_AREA = 9  # the triangle has no normal
    OUTSIDE = 10  # not cut by the ball: never asked


MET = (Verdict.FACE, Verdict.RIDGE, Verdict.VALLEY, Verdict.SHARED)


class Cover(IntEnum):
    """What the certified rule makes of a triangle."""

    GAVE = 0  # it gave a plane
    BEHIND_ONE = 1  # wholly behind the plane of one other triangle
    BEHIND_SEVERAL = 2  # its part in the ball is behind the planes taken together
    UNJUDGED = 3  # beyond the ball that the planes are valid in, or the tool is inside


@dataclass(frozen=True)
class Across:
    """What lies across an edge that a closest point is on.

    Attributes:
        edge: 0, 1 or 2: from that corner of the triangle to the next.
        kind: ridge, valley, flat, boundary or non-manifold.
        neighbour: the face there; −1 none, −2 several.
        gap: between the two faces' closest points [m]; nan where there is no single neighbour.
        same: whether the two closest points count as one.
    """

    edge: int
    kind: Edge
    neighbour: int
    gap: float
    same: bool


@dataclass(frozen=True)
class TriangleReport:
    """One triangle as seen from x.

    Attributes:
        triangle: the face, the caller's index.
        point: (3,) its closest point to x [m].
        feature: what the closest point lies on.
        distance: [m].
        height: N·(x − point) [m]; negative: x is behind the face.
        across: of the edge the closest point is on, or of the two that meet in its corner.
        verdict: by the paper's conditions.
        owner: the triangle under which the plane of this one stands, −1: it has none.
        paper: row of `Explanation.paper` with that plane, −1 none.
        cover: by the certified rule.
        covered_by: BEHIND_ONE: the triangle behind whose plane it is, else −1.
        certified: row of `Explanation.certified` with the plane it gave, −1 none.
    """

    triangle: int
    point: FloatArray
    feature: Feature
    distance: float
    height: float
    across: tuple[Across, ...]
    verdict: Verdict
    owner: int
    paper: int
    cover: Cover
    covered_by: int
    certified: int


@dataclass(frozen=True)
class Explanation(Sequence[TriangleReport]):
    """Reports on the triangles cut by the ball, nearest first; each is made when asked for.

    Attributes:
        surface, x, radius, tip_radius: what was asked about.
        inside: whether x is inside a closed surface: the certified rule then only leads out.
        paper: the planes of the paper's rule, moved towards x by the standoff.
        certified: the planes of the certified rule.
        total: triangles cut by the ball, of which the nearest were examined.
        triangles: (k,) the faces examined.
        points: (k, 3); features, distances, heights, verdicts, owners, covers, covered_by: (k,).
    """

    surface: Surface
    x: FloatArray
    radius: float
    tip_radius: float
    inside: bool
    paper: Planes
    certified: Planes
    total: int
    triangles: IntArray
    points: FloatArray
    features: NDArray[np.int8]
    distances: FloatArray
    heights: FloatArray
    verdicts: NDArray[np.int8]
    owners: IntArray
    covers: NDArray[np.int8]
    covered_by: IntArray

    def __len__(self) -> int:
        return len(self.triangles)

    @overload
    def __getitem__(self, row: int) -> TriangleReport: ...
    @overload
    def __getitem__(self, row: slice) -> tuple[TriangleReport, ...]: ...
    def __getitem__(self, row: int | slice) -> TriangleReport | tuple[TriangleReport, ...]:
        if isinstance(row, slice):
            return tuple(self[k] for k in range(*row.indices(len(self))))
        if not -len(self) <= row < len(self):
            raise IndexError(f"row {row} of {len(self)}")
        i = int(self.triangles[row])
        owner = int(self.owners[row])
        return TriangleReport(
            triangle=i,
            point=self.points[row],
            feature=Feature(self.features[row]),
            distance=float(self.distances[row]),
            height=float(self.heights[row]),
            across=_across(self.surface, self.x, i, self.points[row], int(self.features[row])),
            verdict=Verdict(self.verdicts[row]),
            owner=owner,
            paper=_row_of(self.paper, owner),
            cover=Cover(self.covers[row]),
            covered_by=int(self.covered_by[row]),
            certified=-1 if self.inside else _row_of(self.certified, i),
        )

    def __iter__(self) -> Iterator[TriangleReport]:
        return (self[row] for row in range(len(self)))

    def row(self, triangle: int) -> int:
        """Row of a face among those examined, −1: it is not one of them."""
        found = np.flatnonzero(self.triangles == triangle)
        return int(found[0]) if len(found) else -1

    def of(self, triangle: int) -> TriangleReport:
        """Report on any face; OUTSIDE for one that was not examined.

        Raises:
            IndexError: there is no such face.
        """
        if not 0 <= triangle < len(self.surface.faces):
            raise IndexError(f"no face {triangle}: there are {len(self.surface.faces)}")
        row = self.row(triangle)
        if row >= 0:
            return self[row]
        corners = self.surface.vertices[self.surface.faces[triangle]]
        point, feature, distance = closest_point(corners, self.x)
        height = _dot(self.surface.normals[triangle], self.x - point)
        across = _across(self.surface, self.x, triangle, point, int(feature))
        return TriangleReport(
            triangle, point, feature, distance, float(height), across,
            Verdict.OUTSIDE, -1, -1, Cover.UNJUDGED, -1, -1,
        )  # fmt: skip


def explain(
    surface: Surface,
    x: ArrayLike,
    radius: float,
    standoff: float = 0.0,
    tip_radius: float = 0.0,
    limit: int | None = None,
) -> Explanation:
    """Why each triangle within `radius` + `tip_radius` of x (3,) has the planes it has.

    Args:
        surface: the anatomy.
        x: (3,) centre of the tool tip [m].
        radius: of the motion sphere [m].
        standoff: distance that planes are moved from the mesh [m].
        tip_radius: of the spherical cutter [m].
        limit: examine at most so many triangles, the nearest; None: all.

    Raises:
        ValueError: x, or a length, is not finite or not in its range.
    """
    p = checked_point(x)
    radius = checked_length("radius", radius, positive=True)
    standoff = checked_length("standoff", standoff)
    tip_radius = checked_length("tip radius", tip_radius)
    inside = surface.inside(p)
    paper, certified = (
        MeshFixture(surface, rule, radius).planes(p, radius, standoff, tip_radius, inside)
        for rule in ("paper", "certified")
    )
    contacts = surface.within(p, radius + tip_radius)
    order = np.lexsort((contacts.triangles, contacts.distances))[:limit]
    triangles = contacts.triangles[order]
    points = contacts.points[order]
    features = contacts.features[order]
    heights = _dot(surface.normals[triangles], p - points)
    beside = _same_across(
        surface, p, triangles, points, features, contacts.triangles, contacts.points
    )
    verdicts = _verdicts(surface, triangles, features, heights, beside)
    owners = _owners(surface, triangles, features, verdicts, beside)
    covers, covered_by = _covers(
        surface, certified, inside, triangles, contacts.distances[order], tip_radius
    )
    return Explanation(
        surface, p, radius, tip_radius, inside, paper, certified, len(contacts),
        triangles, points, features, contacts.distances[order], heights,
        verdicts, owners, covers, covered_by,
    )  # fmt: skip


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Row by row, in the order of the control's kernels: BLAS may round x on a plane otherwise."""
    return np.asarray(a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2])


def _edges_of(features: NDArray[np.int8]) -> IntArray:
    """Edges (k, 2) that closest points lie on: one twice, the two at a corner, or −1 (face)."""
    f = features.astype(np.int64)
    first = np.where(f == 0, -1, np.where(f <= 3, f - 1, f - 4))
    second = np.where(f == 0, -1, np.where(f <= 3, f - 1, (f - 2) % 3))
    return np.stack([first, second], axis=1)


def _same_across(
    surface: Surface,
    x: FloatArray,
    triangles: IntArray,
    points: FloatArray,
    features: NDArray[np.int8],
    known: IntArray,
    known_points: FloatArray,
) -> NDArray[np.bool_]:
    """Whether the neighbour across each of a row's edges (k, 2) has the same closest point.

    Asked across ridge and flat edges only. Most neighbours are in the ball, their closest points
    known (`known_points` of the faces `known`).
    """
    edges = _edges_of(features)
    asked = np.isin(surface.edges[triangles[:, None], edges], (Edge.RIDGE, Edge.FLAT))
    asked &= edges >= 0
    rows, sides = np.nonzero(asked)
    across = surface.neighbours[triangles[rows], edges[rows, sides]].astype(np.int64)
    rank = np.argsort(known)
    place = np.searchsorted(known, across, sorter=rank)
    place = rank[np.minimum(place, len(known) - 1)] if len(known) else place
    theirs = known_points[place] if len(known) else np.empty((0, 3))
    for k in np.flatnonzero(known[place] != across) if len(known) else ():
        theirs[k] = _closest(surface, int(across[k]), x)
    away = theirs - points[rows]
    same = SAME * surface.median_edge
    beside = np.zeros((len(triangles), 2), dtype=bool)
    beside[rows, sides] = _dot(away, away) <= same * same
    return beside


def _verdicts(
    surface: Surface,
    triangles: IntArray,
    features: NDArray[np.int8],
    heights: FloatArray,
    beside: NDArray[np.bool_],
) -> NDArray[np.int8]:
    """(k,) verdicts, SHARED not yet told from RIDGE."""
    edges = _edges_of(features)
    kinds = surface.edges[triangles[:, None], edges]
    above = heights >= 0.0
    on_face = features == 0
    valley = (kinds == Edge.VALLEY).any(axis=1)
    joined = np.isin(kinds, (Edge.RIDGE, Edge.FLAT)).any(axis=1)
    return np.select(
        [
            ~surface.normals[triangles].any(axis=1),
            on_face & above,
            on_face,
            beside.any(axis=1),
            valley & above,
            valley,
            joined,
        ],
        [
            Verdict.NO_AREA, Verdict.FACE, Verdict.BEHIND, Verdict.RIDGE, Verdict.VALLEY,
            Verdict.BEHIND_VALLEY, Verdict.APART,
        ],
        default=Verdict.OPEN,
    ).astype(np.int8)  # fmt: skip


def _owners(
    surface: Surface,
    triangles: IntArray,
    features: NDArray[np.int8],
    verdicts: NDArray[np.int8],
    beside: NDArray[np.bool_],
) -> IntArray:
    """(k,) the triangle each plane stands under; turns RIDGE into SHARED where that is another.

    Two faces at an edge make one plane, under the smaller number; so do all that meet Condition 2
    in one corner.
    """
    owners = np.where(np.isin(verdicts, MET), triangles, -1)
    edges = _edges_of(features)
    ridge = verdicts == Verdict.RIDGE
    at_edge = ridge & (features <= 3)
    across = surface.neighbours[triangles[at_edge], edges[at_edge, 0]].astype(np.int64)
    owners[at_edge] = np.minimum(owners[at_edge], across)
    at_corner = np.flatnonzero(ridge & (features > 3))
    corner = surface.faces[triangles[at_corner], features[at_corner] - 4]
    for vertex in np.unique(corner):
        group = at_corner[corner == vertex]
        owners[group] = triangles[group].min()
    # Rounding may put the closest point of one face on the edge and of the other in its corner.
    place = {int(t): int(o) for t, o in zip(triangles[ridge], owners[ridge], strict=True)}
    for row in np.flatnonzero(ridge & (owners != triangles)):
        owners[row] = place.get(int(owners[row]), int(owners[row]))
    verdicts[ridge & (owners != triangles)] = Verdict.SHARED
    return owners


def _covers(
    surface: Surface,
    planes: Planes,
    inside: bool,
    triangles: IntArray,
    distances: FloatArray,
    tip_radius: float,
) -> tuple[NDArray[np.int8], IntArray]:
    """(k,) what the certified rule makes of each triangle, and behind whose plane it is."""
    k = len(triangles)
    covers = np.full(k, Cover.UNJUDGED, dtype=np.int8)
    covered_by = np.full(k, -1, dtype=np.int64)
    if inside or k == 0:
        return covers, covered_by
    covers[distances < planes.radius + tip_radius] = Cover.BEHIND_SEVERAL
    if len(planes):
        corners = surface.vertices[surface.faces[triangles]]  # (k, 3, 3)
        room = planes.offsets - tip_radius - (corners @ planes.normals.T).max(axis=1)  # (k, m)
        best = room.argmax(axis=1)
        behind = room[np.arange(k), best] > 0.0
        covers[behind] = Cover.BEHIND_ONE
        covered_by[behind] = planes.triangles[best[behind]]
    gave = np.isin(triangles, planes.triangles)
    covers[gave] = Cover.GAVE
    covered_by[gave] = -1
    return covers, covered_by


def _across(
    surface: Surface, x: FloatArray, triangle: int, point: FloatArray, feature: int
) -> tuple[Across, ...]:
    same = SAME * surface.median_edge
    found = []
    for e in dict.fromkeys(int(e) for e in _edges_of(np.array([feature], np.int8))[0] if e >= 0):
        a = int(surface.neighbours[triangle, e])
        gap = float(np.linalg.norm(_closest(surface, a, x) - point)) if a >= 0 else np.nan
        found.append(Across(e, Edge(surface.edges[triangle, e]), a, gap, gap <= same))
    return tuple(found)


def _closest(surface: Surface, triangle: int, x: FloatArray) -> FloatArray:
    a, b, c = surface.vertices[surface.faces[triangle]]
    return np.array(closest_on_triangle(*a, *b, *c, *x)[:3])


def _row_of(planes: Planes, triangle: int) -> int:
    rows = np.flatnonzero((planes.triangles == triangle) & (planes.rules != Rule.EXIT))
    return int(rows[0]) if triangle >= 0 and len(rows) else -1
