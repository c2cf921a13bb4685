"""Marching cubes with closed surfaces for any values: the triangles of one cell.

A cell is a cube of eight voxels, corner ``c`` at ``x + 2y + 4z``; its twelve edges are
``3 * lower corner + axis``. On every face of the cell the crossed edges are joined by segments.
Where two inside corners lie on one diagonal of a face and two outside corners on the other, the
inside ones are joined: oblique walls one voxel thick then have no slits. The segments close to
loops, which are triangulated.

The surface is closed and manifold: the segments on a face depend on its four signs alone, so its
two cells have the same ones, in opposite directions; diagonals of the triangulation never join two
edges of one face, so none lies in a neighbour cell too. scikit-image's marching cubes decides
ambiguous faces per cell within a tolerance; its surfaces of label maps have holes.
"""

from __future__ import annotations

from functools import cache

import numpy as np

# Corners of each face, counter-clockwise as seen from outside the cell.
FACES = (
    (0, 4, 6, 2),  # x = 0
    (1, 3, 7, 5),  # x = 1
    (0, 1, 5, 4),  # y = 0
    (2, 6, 7, 3),  # y = 1
    (0, 2, 3, 1),  # z = 0
    (4, 5, 7, 6),  # z = 1
)


def edge(a: int, b: int) -> int:
    """Number of the edge between two corners that are neighbours."""
    return 3 * min(a, b) + (a ^ b).bit_length() - 1


@cache
def triangles(inside: int) -> tuple[tuple[int, int, int], ...]:
    """Triangles of a cell, as triples of edges, wound outwards (from inside to outside).

    Bit ``c`` of ``inside`` is set where corner ``c`` is inside.
    """
    following: dict[int, int] = {}
    for corners in FACES:
        crossed = []  # edges around the face, with whether the walk leaves the inside there
        for a, b in zip(corners, (*corners[1:], corners[0]), strict=True):
            if (inside >> a ^ inside >> b) & 1:
                crossed.append((edge(a, b), bool(inside >> a & 1)))
        for n, (number, leaves) in enumerate(crossed):
            if leaves:  # to the next one, around what is outside between them
                following[number] = crossed[(n + 1) % len(crossed)][0]
    found: list[tuple[int, int, int]] = []
    while following:
        loop = [next(iter(following))]
        while (number := following.pop(loop[-1])) != loop[0]:
            loop.append(number)
        found += _triangulated(loop)
    return tuple(found)


def _triangulated(loop: list[int]) -> list[tuple[int, int, int]]:
    """The least area (with edges crossed at their middles) without diagonals in a cell's face.

    Seen from outside the surface the loop runs clockwise; its triangles run the other way.
    """
    points = [_middle(number) for number in loop]

    def area(i: int, k: int, j: int) -> float:
        normal = np.cross(points[k] - points[i], points[j] - points[i])
        return 0.5 * float(np.linalg.norm(normal))

    @cache
    def best(i: int, j: int) -> tuple[float, tuple[tuple[int, int, int], ...]]:
        """Area and triangles of the polygon i, i+1, …, j."""
        if j - i < 2:
            return 0.0, ()
        if j - i < len(loop) - 1 and _faces(loop[i]) & _faces(loop[j]):
            return np.inf, ()
        choices = []
        for k in range(i + 1, j):
            (left, before), (right, after) = best(i, k), best(k, j)
            here = ((loop[j], loop[k], loop[i]),)
            choices.append((round(area(i, k, j) + left + right, 9), before + here + after))
        return min(choices)

    return list(best(0, len(loop) - 1)[1])


def _middle(number: int) -> np.ndarray:
    corner, axis = divmod(number, 3)
    return np.array([corner & 1, corner >> 1 & 1, corner >> 2]) + 0.5 * np.eye(3)[axis]


def _faces(number: int) -> frozenset[int]:
    """The two faces that an edge borders."""
    corner, axis = divmod(number, 3)
    other = corner | 1 << axis
    return frozenset(f for f, corners in enumerate(FACES) if corner in corners and other in corners)
