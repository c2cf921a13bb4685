"""The triangles that a ball cuts."""

from __future__ import annotations

import numpy as np

from vf.kernels import njit
from vf.tree.closest import closest_on_triangle
from vf.tree.pdtree import (
    STACK,
    box_distances2,
    children_of,
    triangle_distance2,
    triangles_below,
    triangles_of,
)


@njit(cache=True, nogil=True)
def within(nodes, corners, order, x, y, z, radius, triangles):  # type: ignore[no-untyped-def]
    """Every triangle cut by the closed ball, the caller's indices, as far as the array has room.

    Returns their number, which may exceed the array's length: then call again with a longer one.
    Triangles come out in tree order.
    """
    waiting = np.empty(STACK, dtype=np.int32)
    r2 = radius * radius
    # Boxes are tested with a relative margin of 1e-9: the exact test is that of the triangle.
    reach2 = r2 * (1.0 + 1e-9) + 1e-30
    sure2 = r2 * (1.0 - 1e-9) - 1e-30
    waiting[0] = 0
    depth = 1
    found = 0
    room = triangles.shape[0]
    while depth > 0:
        depth -= 1
        node = waiting[depth]
        near2, far2 = box_distances2(nodes, node, x, y, z)
        if near2 > reach2:
            continue
        link = nodes[node, 15]
        if far2 <= sure2:
            first, last = triangles_below(nodes, node)
            for t in range(first, last):
                if found < room:
                    triangles[found] = order[t]
                found += 1
        elif link > 0.0:
            first, last = children_of(link)
            for child in range(last - 1, first - 1, -1):
                waiting[depth] = child
                depth += 1
        else:
            first, last = triangles_of(link)
            for t in range(first, last):
                cut = False
                for j in range(0, 9, 3):
                    dx, dy, dz = corners[t, j] - x, corners[t, j + 1] - y, corners[t, j + 2] - z
                    cut |= dx * dx + dy * dy + dz * dz <= r2
                if cut or triangle_distance2(corners, t, x, y, z) <= r2:
                    if found < room:
                        triangles[found] = order[t]
                    found += 1
    return found


@njit(cache=True, nogil=True)
def within_ball(nodes, corners, order, p, radius, triangles):  # type: ignore[no-untyped-def]
    """`within` for one call from Python; −1 where p (3,) is not finite."""
    if not np.isfinite(p[0] + p[1] + p[2]):
        return -1
    return within(nodes, corners, order, p[0], p[1], p[2], radius, triangles)


@njit(cache=True, nogil=True)
def closest_points(vertices, faces, triangles, p, points, features, distances):  # type: ignore[no-untyped-def]
    """`closest_on_triangle` for each of the triangles (k,), into arrays of k rows."""
    for i in range(triangles.shape[0]):
        a, b, c = faces[triangles[i], 0], faces[triangles[i], 1], faces[triangles[i], 2]
        points[i, 0], points[i, 1], points[i, 2], features[i], d2 = closest_on_triangle(
            vertices[a, 0],
            vertices[a, 1],
            vertices[a, 2],
            vertices[b, 0],
            vertices[b, 1],
            vertices[b, 2],
            vertices[c, 0],
            vertices[c, 1],
            vertices[c, 2],
            p[0],
            p[1],
            p[2],
        )
        distances[i] = np.sqrt(d2)
