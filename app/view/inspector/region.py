"""The allowed region of a tick as a solid: motion sphere ∩ half-spaces of all planes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError

import vf

FloatArray = NDArray[np.float64]

FACETS = 400  # of the polyhedron that approximates the ball
# Smallest radius of a ball inside a region that is drawn, in radii of the sphere.
MIN_RADIUS = 1e-4


@dataclass(frozen=True)
class Region:
    """A convex solid; empty if the planes leave (almost) no room.

    Attributes:
        vertices: (n, 3) [m].
        faces: (k, 3).
        share: of the ball's volume.
    """

    vertices: FloatArray
    faces: NDArray[np.int64]
    share: float


EMPTY = Region(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64), 0.0)


def allowed_region(planes: vf.Planes, x: FloatArray) -> Region:
    """Ball ∩ half-spaces around x (3,) [m], with an inscribed polyhedron for the ball.

    The polyhedron has 98.0 % of the ball's volume.
    """
    radius = planes.radius
    if radius <= 0.0:
        return EMPTY
    # Half-spaces n·z + c ≤ 0, z in radii from x.
    room = planes.slack(x) / radius
    cutting = room < 1.0
    half_spaces = np.vstack([_ball(), np.column_stack([-planes.normals[cutting], -room[cutting]])])
    found = linprog(  # centre and radius of the largest inscribed ball
        [0.0, 0.0, 0.0, -1.0],
        A_ub=np.column_stack([half_spaces[:, :3], np.ones(len(half_spaces))]),
        b_ub=-half_spaces[:, 3],
        bounds=[(None, None)] * 3 + [(0.0, None)],
    )
    if found.status != 0 or found.x[3] < MIN_RADIUS:
        return EMPTY
    try:
        corners = HalfspaceIntersection(half_spaces, found.x[:3]).intersections
        hull = ConvexHull(corners)
    except QhullError:
        return EMPTY
    a, b, c = corners[hull.simplices].transpose(1, 0, 2)
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    hull.simplices[inward] = hull.simplices[inward][:, ::-1]
    used, faces = np.unique(hull.simplices, return_inverse=True)
    return Region(
        x + radius * corners[used],
        faces.reshape(-1, 3).astype(np.int64),
        float(hull.volume / (4.0 / 3.0 * np.pi)),
    )


@cache
def _ball() -> FloatArray:
    """Half-spaces (k, 4) of a polyhedron inscribed in the unit ball, evenly spread."""
    k = np.arange(FACETS)
    z = 1.0 - (2.0 * k + 1.0) / FACETS
    angle = k * np.pi * (3.0 - np.sqrt(5.0))  # golden angle
    s = np.sqrt(1.0 - z * z)
    normals = np.column_stack([s * np.cos(angle), s * np.sin(angle), z])
    tangent = np.column_stack([normals, -np.ones(FACETS)])
    corners = HalfspaceIntersection(tangent, np.zeros(3)).intersections
    tangent[:, 3] /= np.linalg.norm(corners, axis=1).max()
    return tangent
