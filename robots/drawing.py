"""The drawing of an arm: triangle meshes that move with frames, and solids to build them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import trimesh
from numpy.typing import ArrayLike, NDArray

Color = tuple[int, int, int]

CREASE = np.deg2rad(30.0)
"""Angle [rad] above which an edge stays sharp under smooth shading."""


@dataclass(frozen=True)
class Body:
    """One rigid, single-coloured part of an arm's drawing.

    Attributes:
        name:     unique within the arm.
        frame:    "universe" (the base), a joint's name, or a passive link's name.
        color:    red, green, blue, 0–255.
        vertices: (n, 3) float32 [m] in that frame, read-only. Vertices are split at creases, for
                  smooth shading by vertex normals.
        faces:    (m, 3) uint32, read-only, counter-clockwise seen from outside.
    """

    name: str
    frame: str
    color: Color
    vertices: NDArray[np.float32]
    faces: NDArray[np.uint32]


@dataclass(frozen=True)
class Drawing:
    """The bodies of an arm, and the poses of its passive links for a joint vector `(n,)`."""

    bodies: tuple[Body, ...]
    passive: Callable[[NDArray[np.float64]], Mapping[str, pin.SE3]] = lambda q: {}


def body(name: str, frame: str, color: Color, *parts: trimesh.Trimesh) -> Body:
    """One body from closed solids [m], in the frame it moves with."""
    whole = trimesh.util.concatenate([split_creases(part) for part in parts])
    vertices = np.ascontiguousarray(whole.vertices, dtype=np.float32)
    faces = np.ascontiguousarray(whole.faces, dtype=np.uint32)
    vertices.flags.writeable = False
    faces.flags.writeable = False
    return Body(name, frame, color, vertices, faces)


def split_creases(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The mesh with vertices split at edges sharper than `CREASE`."""
    if len(mesh.faces) == 0:
        return mesh
    return trimesh.graph.smooth_shade(mesh, angle=CREASE)


def hull(points: ArrayLike) -> trimesh.Trimesh:
    """The convex hull of points `(n, 3)` [m]."""
    return trimesh.convex.convex_hull(np.asarray(points, dtype=np.float64))


def box(low: ArrayLike, high: ArrayLike, chamfer: float = 0.0) -> trimesh.Trimesh:
    """An axis-aligned box between two corners [m], its edges chamfered by `chamfer` [m]."""
    low, high = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
    shrunk = np.full((3, 3), chamfer)
    np.fill_diagonal(shrunk, 0.0)
    # Each corner becomes three, one on each of its faces.
    corners = [
        np.where(side, high - inset, low + inset)
        for side in np.array(np.meshgrid(*[[False, True]] * 3)).T.reshape(-1, 3)
        for inset in shrunk
    ]
    return hull(corners)


def rod(
    start: ArrayLike,
    end: ArrayLike,
    radius: float,
    end_radius: float | None = None,
    chamfer: float = 0.0,
    sections: int = 40,
) -> trimesh.Trimesh:
    """A round bar between two points [m], tapering to `end_radius`, its rims chamfered."""
    start, end = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    last = radius if end_radius is None else end_radius
    length = float(np.linalg.norm(end - start))
    rings = [(radius - chamfer, 0.0), (radius, chamfer), (last, length - chamfer)]
    rings.append((last - chamfer, length))
    angle = np.linspace(0.0, 2.0 * np.pi, sections, endpoint=False)
    points = [(r * np.cos(a), r * np.sin(a), z) for r, z in dict.fromkeys(rings) for a in angle]
    solid = hull(points)
    solid.apply_transform(_along(start, end - start))
    return solid


def ball(center: ArrayLike, radius: float) -> trimesh.Trimesh:
    """A sphere [m]."""
    solid = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    solid.apply_translation(center)
    return solid


def bar(
    ends: ArrayLike, radii: ArrayLike, across: ArrayLike, chamfer: float = 0.0, sections: int = 40
) -> trimesh.Trimesh:
    """A flat link with round eyes: the hull of two discs in the y-z plane, thick along x.

    `ends` (2, 3) are the discs' centres [m] (their x is ignored), `radii` (2,) [m], `across` the
    two x between which it lies [m].
    """
    angle = np.linspace(0.0, 2.0 * np.pi, sections, endpoint=False)
    low, high = np.asarray(across, dtype=np.float64)
    layers = [(low, chamfer), (low + chamfer, 0.0), (high - chamfer, 0.0), (high, chamfer)]
    points = [
        (x, center[1] + (r - inset) * np.cos(a), center[2] + (r - inset) * np.sin(a))
        for center, r in zip(np.asarray(ends), np.asarray(radii), strict=True)
        for x, inset in dict.fromkeys(layers)
        for a in angle
    ]
    return hull(points)


def _along(origin: NDArray[np.float64], axis: NDArray[np.float64]) -> NDArray[np.float64]:
    T = trimesh.geometry.align_vectors([0.0, 0.0, 1.0], axis)
    T[:3, 3] = origin
    return T
