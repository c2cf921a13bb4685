"""What others use as fixtures, to compare: the nearest point, and a sampled distance field.

Both give one plane, so that at a concavity the second wall is not guarded, and both only where the
distance to the anatomy is less than the motion sphere.

- "nearest": the plane through the nearest point of the mesh, facing the tool: the constraint of
  vector-field inequalities (M. M. Marinho et al., "Dynamic Active Constraints for Surgical Robots
  Using Vector-Field Inequalities", IEEE Transactions on Robotics 35(5), 2019).
- "sdf": the plane whose distance and normal are those of a signed distance field that is sampled on
  a regular grid and interpolated between the samples, as simulators and drilling assistants do.
"""

from __future__ import annotations

from itertools import product
from math import floor

import numpy as np

from vf.planes import FloatArray, Planes, Rule
from vf.surface import Surface

# Distance between the samples of the field [m].
CELL = 0.5e-3
# The corners of a cell, and the weights of trilinear interpolation as signs of its coordinates.
_CORNERS = np.array(list(product((0, 1), repeat=3)))


def nearest_plane(surface: Surface, x: FloatArray, radius: float, inside: bool) -> Planes:
    """The plane at the nearest point of the mesh, if that is within `radius` [m] of x (3,).

    It faces x, and away from it where x is inside. On the surface it is the plane of the face.
    """
    distance, triangle, foot = surface.nearest(x, radius)
    if triangle < 0:
        return Planes.none(radius)
    if distance > 0.0:
        normal = (foot - x if inside else x - foot) / distance
    else:
        normal = surface.normals[triangle].copy()
    return _one(normal, foot, triangle, Rule.EXIT if inside else Rule.NEAREST, radius)


class DistanceField:
    """Signed distances of a surface at the points of a regular grid, negative inside.

    A sample is computed when it is first needed, so that only those along the way of the tool are.
    An open surface has no inside: its distances are all positive.

    Args:
        surface: the anatomy.
        cell: distance between neighbouring samples [m].
    """

    def __init__(self, surface: Surface, cell: float = CELL) -> None:
        self.surface = surface
        self.cell = cell
        self._samples: dict[tuple[int, int, int], float] = {}

    def sample(self, place: tuple[int, int, int]) -> float:
        """The signed distance at a point of the grid, whose origin is that of the frame [m]."""
        value = self._samples.get(place)
        if value is None:
            point = self.cell * np.array(place, dtype=np.float64)
            value = self.surface.nearest(point)[0]
            if self.surface.inside(point):
                value = -value
            self._samples[place] = value
        return value

    def at(self, x: FloatArray) -> tuple[float, FloatArray]:
        """Interpolated distance [m] and its gradient (3,) at x (3,)."""
        scaled = x / self.cell
        base = [floor(v) for v in scaled]
        share = scaled - base
        values = np.array(
            [self.sample((base[0] + i, base[1] + j, base[2] + k)) for i, j, k in _CORNERS.tolist()]
        )
        # (8, 3): the weight of a corner along each coordinate, and its derivative.
        weights = np.where(_CORNERS == 1, share, 1.0 - share)
        slopes = np.where(_CORNERS == 1, 1.0, -1.0) / self.cell
        gradient = [
            float(values @ (slopes[:, k] * np.delete(weights, k, axis=1).prod(axis=1)))
            for k in range(3)
        ]
        return float(values @ weights.prod(axis=1)), np.array(gradient)

    def plane(self, x: FloatArray, radius: float, inside: bool) -> Planes:
        """The plane of the interpolated field at x (3,), if its distance is within `radius` [m].

        There is none where the field has no direction: in the middle between two walls.
        """
        distance, gradient = self.at(x)
        steep = float(np.linalg.norm(gradient))
        if distance > radius or steep < 1e-6:
            return Planes.none(radius)
        normal = gradient / steep
        rule = Rule.EXIT if inside else Rule.SAMPLED
        return _one(normal, x - distance * normal, -1, rule, radius)


def _one(normal: FloatArray, foot: FloatArray, triangle: int, rule: Rule, radius: float) -> Planes:
    return Planes(
        normal[None],
        np.array([normal @ foot]),
        foot[None].copy(),
        np.array([triangle]),
        np.array([int(rule)]),
        radius,
    )
