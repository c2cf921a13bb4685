"""Picking: the triangle of a surface that a ray meets first, by the PD-tree."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

import meshes
import vf
from app.structure import Structure

FloatArray = NDArray[np.float64]


def pick(surface: vf.Surface, origin: ArrayLike, direction: ArrayLike) -> int:
    """The first triangle that a ray from origin (3,) [m] meets; −1: none.

    The tree is traversed breadth-first, all nodes of a level at once.

    Raises:
        ValueError: the ray is not made of finite numbers, or has no direction.
    """
    o, d = np.asarray(origin, dtype=np.float64), np.asarray(direction, dtype=np.float64)
    if o.shape != (3,) or d.shape != (3,) or not (np.isfinite(o).all() and np.isfinite(d).all()):
        raise ValueError("a ray must be 3 + 3 finite numbers")
    length = float(np.linalg.norm(d))
    if length == 0.0:
        raise ValueError("a ray needs a direction")
    d = d / length
    tree = surface.tree
    nodes = np.array([0])
    leaves = []
    while len(nodes):
        nodes = nodes[_meets(tree.nodes[nodes], o, d)]
        link = tree.nodes[nodes, 15].astype(np.int64)
        leaves.append(-link[link <= 0])
        inner = link[link > 0]
        first, count = inner >> 3, inner & 7
        nodes = np.concatenate([first[count > k] + k for k in range(4)])
    at = np.concatenate(leaves)
    rows = [np.arange(code // 64, code // 64 + code % 64) for code in at]
    if not rows:
        return -1
    candidates = np.concatenate(rows)
    along = distances(tree.corners[candidates].reshape(-1, 3, 3), o, d)
    if not np.isfinite(along).any():
        return -1
    return int(tree.order[candidates[np.argmin(along)]])


def along(surface: vf.Surface, triangle: int, origin: ArrayLike, direction: ArrayLike) -> float:
    """Distance along a ray to a triangle that it meets, in lengths of the direction."""
    corners = surface.vertices[surface.faces[triangle]][None]
    return float(distances(corners, np.asarray(origin, float), np.asarray(direction, float))[0])


def main_structure(
    surfaces: Sequence[vf.Surface],
    step: vf.Step,
    points: Sequence[FloatArray],
    chosen: int | None,
) -> int:
    """The surface to inspect, by its number: the chosen one.

    Else the one whose plane pushes the tool most, or else the nearest.

    Args:
        points: the tip (3,) [m], as each surface sees it.
    """
    if chosen is not None:
        return chosen
    fixtures, pushes = step.planes.fixtures, step.multipliers
    if fixtures is not None and len(pushes):
        own = np.where(fixtures < len(surfaces), pushes, 0.0)
        if own.max() > 0.0:
            return int(fixtures[own.argmax()])
    return min(range(len(surfaces)), key=lambda k: surfaces[k].nearest(points[k])[0])


def margin_near(
    own: Structure, surface: vf.Surface, x: FloatArray, added: meshes.MarginMap | None
) -> float:
    """The margin of a structure where its surface is nearest to x (3,) [m].

    Args:
        added: as `Scene.added`.
    """
    margin = own.margin or 0.0
    if added is None:
        return margin
    corners = surface.vertices[surface.faces[surface.nearest(x)[1]]]
    return margin + float(added.at(corners).max())


def distances(corners: FloatArray, origin: FloatArray, direction: FloatArray) -> FloatArray:
    """Distance along a ray to each triangle (m, 3, 3), in lengths of `direction`; inf: not met.

    Möller and Trumbore, "Fast, minimum storage ray/triangle intersection", 1997; without culling.
    """
    a = corners[:, 0]
    u, v = corners[:, 1] - a, corners[:, 2] - a
    h = np.cross(direction, v)
    det = np.einsum("ij,ij->i", u, h)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        s = origin - a
        p = np.einsum("ij,ij->i", s, h) / det
        q = np.cross(s, u)
        r = (q @ direction) / det
        t = np.einsum("ij,ij->i", v, q) / det
        met = (p >= 0.0) & (r >= 0.0) & (p + r <= 1.0) & (t >= 0.0) & np.isfinite(t)
    return np.where(met, t, np.inf)


def _meets(boxes: FloatArray, o: FloatArray, d: FloatArray) -> NDArray[np.bool_]:
    """Which boxes (k, 15) of the tree the ray meets, by the slab test."""
    axes = boxes[:, 6:15].reshape(-1, 3, 3)
    start = axes @ o - np.einsum("kij,kj->ki", axes, boxes[:, :3])
    along = axes @ d
    half = boxes[:, 3:6] * (1.0 + 1e-9) + 1e-12
    with np.errstate(divide="ignore", invalid="ignore"):
        t0, t1 = (-half - start) / along, (half - start) / along
    flat = along == 0.0  # parallel to the slab
    beside = (flat & (np.abs(start) > half)).any(axis=1)
    enter = np.where(flat, -np.inf, np.minimum(t0, t1)).max(axis=1)
    leave = np.where(flat, np.inf, np.maximum(t0, t1)).min(axis=1)
    return np.asarray((leave >= np.maximum(enter, 0.0)) & ~beside)
