"""What the tests of how a fixture feels share: rest, free ways, blocked space, a surface nearby."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

import robots
import vf
from tests.support import naive

MM = 1e-3


def rest(
    surface: vf.Surface, rule: str, radius: float, start: np.ndarray, proxy: np.ndarray
) -> np.ndarray:
    """Where a free-flying tip comes to rest that follows a proxy from a start, all (3,) [m]."""
    controller = vf.Controller(robots.load("point"), [vf.MeshFixture(surface, rule, radius)])
    goal = pin.SE3(np.eye(3), proxy)
    q, still = start.copy(), 0
    for _ in range(4000):
        step = controller.step(q, goal)
        still = still + 1 if np.abs(step.q - q).max() < 1e-8 else 0
        q = step.q
        if still == 20:
            break
    return q


def is_open(surface: vf.Surface, a: np.ndarray, b: np.ndarray, room: float) -> bool:
    """Whether a ball of radius `room` [m] at least is free all along the way from a to b (3,)."""
    spacing = 10e-6  # between two samples the distance is less by half of it at most
    reach = room + spacing
    corners = in_box(surface, a, b, reach)
    if naive.crosses(corners, a, b):
        return False
    count = int(np.ceil(np.linalg.norm(b - a) / spacing)) + 1
    return all(
        (naive.closest(corners, x)[1] > room + spacing / 2).all() for x in np.linspace(a, b, count)
    )


def blocked(
    surface: vf.Surface,
    planes: vf.Planes,
    x: np.ndarray,
    radius: float,
    rng: np.random.Generator,
    samples: int,
) -> tuple[int, int]:
    """Of sampled points that a straight free path reaches: how many are forbidden, how many.

    The points are uniform in the ball of `radius` [m] around x (3,). Forbidden is what is behind a
    plane, and what is outside the ball that the planes are valid in, if that is a smaller one.
    """
    u = rng.normal(size=(samples, 3))
    u /= np.linalg.norm(u, axis=1)[:, None]
    ys = x + u * (radius * rng.uniform(size=(samples, 1)) ** (1.0 / 3.0))
    ys = ys[~crossed(in_box(surface, x, x, radius), x, ys)]
    behind = (ys @ planes.normals.T < planes.offsets).any(axis=1)
    beyond = np.linalg.norm(ys - x, axis=1) > planes.radius
    return int((behind | beyond).sum()), len(ys)


def crossed(corners: np.ndarray, x: np.ndarray, ys: np.ndarray) -> np.ndarray:
    """Which of the segments (k,) from x (3,) to ys (k, 3) cut a triangle (m, 3, 3).

    Möller and Trumbore's test in floats: good enough for segments that end at random points.
    """
    a, b, c = corners.transpose(1, 0, 2)
    e1, e2, s = b - a, c - a, x - a
    q = np.cross(s, e1)
    d = ys - x
    # Triple products with every direction: (k, m).
    with np.errstate(divide="ignore", invalid="ignore"):
        det = d @ np.cross(e2, e1).T
        u = d @ np.cross(e2, s).T / det
        v = d @ q.T / det
        t = (e2 * q).sum(axis=1) / det
        return ((u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0) & (t <= 1)).any(axis=1)


def in_box(surface: vf.Surface, a: np.ndarray, b: np.ndarray, margin: float) -> np.ndarray:
    """Corners (m, 3, 3) of the triangles whose box comes within `margin` [m] of that of ab (3,)."""
    low, high = np.minimum(a, b) - margin, np.maximum(a, b) + margin
    every = naive.brute(surface)
    corners = every.corners[every.candidates(0.5 * (low + high), 0.5 * np.linalg.norm(high - low))]
    meets = (corners.min(axis=1) <= high) & (corners.max(axis=1) >= low)
    return corners[meets.all(axis=1)]


def surface_near(
    vertices: np.ndarray, faces: np.ndarray, p: np.ndarray, rng: np.random.Generator
) -> vf.Surface:
    """The mesh (n, 3), (m, 3), moved so that p (3,) is outside it and within 3 mm of it [m]."""
    while True:
        corners = vertices[faces[rng.integers(len(faces))]]
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        normal /= np.linalg.norm(normal)
        spot = rng.dirichlet([1.0, 1.0, 1.0]) @ corners
        # Open meshes are met from behind as well.
        side = 1.0 if rng.random() < 0.7 else -1.0
        start = spot + side * rng.uniform(0.05 * MM, 3 * MM) * normal
        surface = vf.Surface.from_arrays(vertices + (p - start), faces)
        if not surface.inside(p) and surface.nearest(p)[0] > 0.04 * MM:
            return surface
