"""Active constraints by the paper's Conditions 1–3, and the naive baseline without conditions.

Z. Li et al., "Anatomical Mesh-Based Virtual Fixtures for Surgical Robots", IROS 2020, section
III-B. Ridge and valley follow the conditions' text, not the sign printed in its eq. 3: with that
sign the tool passes through.

The conditions hold on closed, welded, consistently wound meshes; `vf.certified_planes` is the rule
for all others.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from vf.kernels import njit
from vf.planes import Planes
from vf.surface import Surface
from vf.tree.closest import closest_on_triangle

# Closest points of two neighbours count as one within this share of the median edge.
SAME = 1e-9


def paper_planes(surface: Surface, x: ArrayLike, radius: float) -> Planes:
    """Planes of every triangle within `radius` [m] of x (3,) that meets Condition 1, 2 or 3.

    Condition 2 counts a flat edge as a ridge. The paper leaves it open; without it, a point right
    above the diagonal of a cube's side has no plane at all.
    """
    return _select(surface, x, radius, naive=False)


def every_plane(surface: Surface, x: ArrayLike, radius: float) -> Planes:
    """The face planes of all triangles within `radius` [m] of x: the paper's Fig. 2d."""
    return _select(surface, x, radius, naive=True)


def _select(surface: Surface, x: ArrayLike, radius: float, naive: bool) -> Planes:
    contacts = surface.within(x, radius)
    p = np.asarray(x, dtype=np.float64)
    k = len(contacts)
    normals = np.empty((k, 3))
    offsets = np.empty(k)
    rows = np.empty(k, dtype=np.int64)
    rules = np.empty(k, dtype=np.int64)
    m = _conditions(
        surface.vertices,
        surface.faces,
        surface.normals,
        surface.neighbours,
        surface.edges,
        SAME * surface.median_edge,
        p,
        contacts.triangles,
        contacts.points,
        contacts.features,
        naive,
        normals,
        offsets,
        rows,
        rules,
    )
    kept = rows[:m]
    return Planes(
        normals[:m],
        offsets[:m],
        contacts.points[kept],
        contacts.triangles[kept],
        rules[:m],
        radius,
    )


@njit(cache=True, nogil=True)
def _conditions(  # type: ignore[no-untyped-def]
    vertices,
    faces,
    face_normals,
    neighbours,
    edges,
    same,
    x,
    triangles,
    points,
    features,
    naive,
    normals,
    offsets,
    rows,
    rules,
):
    """Write the plane of every contact that meets a condition; returns their number."""
    m = 0
    corner_of = np.empty(triangles.shape[0], dtype=np.int64)  # vertex of a ridge plane, or −1
    for c in range(triangles.shape[0]):
        i = triangles[c]
        feature = features[c]
        px, py, pz = points[c, 0], points[c, 1], points[c, 2]
        dx, dy, dz = x[0] - px, x[1] - py, x[2] - pz
        nx, ny, nz = face_normals[i, 0], face_normals[i, 1], face_normals[i, 2]
        above = nx * dx + ny * dy + nz * dz >= 0.0
        rule = -1
        vertex = -1
        if nx == 0.0 and ny == 0.0 and nz == 0.0:
            continue  # a face without area has no plane to give
        if naive:
            rule = 0
        elif feature == 0:
            if above:
                rule = 1
        else:
            # The one edge the closest point lies on, or the two that meet in its corner.
            if feature <= 3:
                e0 = e1 = feature - 1
            else:
                e0, e1 = feature - 4, (feature - 2) % 3
                vertex = faces[i, feature - 4]
            ridge = False
            valley = False
            smaller = False
            for side in range(2):
                e = e0 if side == 0 else e1
                kind = edges[i, e]
                if kind == 1:
                    valley = True
                elif kind == 0 or kind == 2:
                    a = neighbours[i, e]
                    va, vb, vc = faces[a, 0], faces[a, 1], faces[a, 2]
                    qx, qy, qz, _f, _d2 = closest_on_triangle(
                        vertices[va, 0],
                        vertices[va, 1],
                        vertices[va, 2],
                        vertices[vb, 0],
                        vertices[vb, 1],
                        vertices[vb, 2],
                        vertices[vc, 0],
                        vertices[vc, 1],
                        vertices[vc, 2],
                        x[0],
                        x[1],
                        x[2],
                    )
                    if (qx - px) ** 2 + (qy - py) ** 2 + (qz - pz) ** 2 <= same * same:
                        ridge = True
                        smaller = a < i
            if ridge:
                rule = 2
                # The neighbour makes the same plane: the smaller face writes it.
                if vertex < 0 and smaller:
                    continue
            elif valley and above:
                rule = 3
        if rule < 0:
            continue
        if rule == 2:
            d = np.sqrt(dx * dx + dy * dy + dz * dz)
            if d > 0.0:
                nx, ny, nz = dx / d, dy / d, dz / d
        normals[m, 0], normals[m, 1], normals[m, 2] = nx, ny, nz
        offsets[m] = nx * px + ny * py + nz * pz
        rows[m] = c
        rules[m] = rule
        corner_of[m] = vertex if rule == 2 else -1
        m += 1
    return _once_per_vertex(m, triangles, corner_of, normals, offsets, rows, rules)


@njit(cache=True, nogil=True)
def _once_per_vertex(m, triangles, corner_of, normals, offsets, rows, rules):  # type: ignore[no-untyped-def]
    """All ridge planes at a vertex are one: keep that of the smallest face."""
    rank = np.argsort(corner_of[:m])
    drop = np.zeros(m, dtype=np.bool_)
    i = 0
    while i < m:
        j = i + 1
        vertex = corner_of[rank[i]]
        best = rank[i]
        while j < m and corner_of[rank[j]] == vertex:
            if vertex >= 0:
                loser = rank[j]
                if triangles[rows[loser]] < triangles[rows[best]]:
                    best, loser = loser, best
                drop[loser] = True
            j += 1
        i = j
    kept = 0
    for i in range(m):
        if drop[i]:
            continue
        normals[kept] = normals[i]
        offsets[kept] = offsets[i]
        rows[kept] = rows[i]
        rules[kept] = rules[i]
        kept += 1
    return kept
