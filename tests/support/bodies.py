"""Closed bodies that overlap, fold back or nest, and what is wrong with a step out of them."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import trimesh

import vf
from tests.support import exact

BOX_FACES = np.array(
    [[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
     [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5]]
)  # fmt: skip
STRAIGHT = np.eye(3)


def box(low: tuple[float, ...], high: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    corners = [[x, y, z] for z in (low[2], high[2]) for y in (low[1], high[1])
               for x in (low[0], high[0])]  # fmt: skip
    return np.array(corners), BOX_FACES


def ball(radius: float, centre: tuple[float, ...] = (0.0, 0.0, 0.0), outwards: bool = True):
    shape = trimesh.creation.icosphere(2, radius)
    faces = np.array(shape.faces)
    return np.array(shape.vertices) + centre, faces if outwards else faces[:, ::-1]


def together(*bodies: tuple[np.ndarray, np.ndarray]) -> vf.Surface:
    vertices = np.vstack([v for v, _ in bodies])
    starts = np.cumsum([0] + [len(v) for v, _ in bodies])
    faces = np.vstack([f + start for (_, f), start in zip(bodies, starts, strict=False)])
    return vf.Surface.from_arrays(vertices, faces)


def cells(
    filled: set[tuple[int, int]], xs: list[float], zs: list[float], half: float
) -> vf.Surface:
    """The surface of a prism along y whose profile is the filled cells of a grid: one piece."""
    corners = np.array([[x, y, z] for x in xs for y in (-half, half) for z in zs])
    faces = []

    def at(i: int, j: int, k: int) -> int:
        return (2 * i + j) * len(zs) + k

    def quad(a: int, b: int, c: int, d: int) -> None:
        faces.extend([[a, b, c], [a, c, d]])

    for i, k in filled:
        low, high = (i, k), (i + 1, k + 1)
        quad(*(at(p, 0, r) for p, r in (low, (i + 1, k), high, (i, k + 1))))
        quad(*(at(p, 1, r) for p, r in (low, (i, k + 1), high, (i + 1, k))))
        for beside, a, b in (
            ((i, k - 1), low, (i + 1, k)), ((i + 1, k), (i + 1, k), high),
            ((i, k + 1), high, (i, k + 1)), ((i - 1, k), (i, k + 1), low),
        ):  # fmt: skip
            if beside not in filled:
                quad(at(a[0], 0, a[1]), at(a[0], 1, a[1]), at(b[0], 1, b[1]), at(b[0], 0, b[1]))
    return vf.Surface.from_arrays(corners, faces)


def wrong(triangles: np.ndarray, x: np.ndarray, y: np.ndarray) -> str:
    """What is wrong with a step from x to y (3,), x strictly on a side. Empty: nothing. Exact."""
    before, after = exact.winding(triangles, x), exact.winding(triangles, y)
    met = exact.passages(triangles, x, y)
    if any(sign == 0 for _, _, sign in met):
        return "it runs in a wall"
    points = len({place for _, place, _ in met})
    if after is None:
        return "it ends on a wall"
    if points > 1 or (points == 1 and after != 0):
        return f"it passes {points} walls from winding number {before} into {after}"
    return ""


def folded(rng: np.random.Generator, gap: float) -> tuple[vf.Surface, list[float]]:
    """A body under a stack of flaps of its own, some `gap` apart and thick, and their heights."""
    flaps = int(rng.integers(1, 6))
    steps = gap * rng.uniform(0.3, 2.0, 2 * flaps)
    zs = [-5e-3, 0.0, *np.cumsum(steps).tolist()]
    filled = {(0, 0), (1, 0), (2, 0)}
    for k in range(1, 2 * flaps + 1):
        filled |= {(1, k), (2, k)} if k % 2 == 0 else {(1, k)}
    return cells(filled, [-5e-3, -(10 ** rng.uniform(-7, -4)), 0.0, 5e-3], zs, 4e-3), zs


def crossing(rng: np.random.Generator) -> vf.Surface:
    """Two to four boxes and balls that overlap, one of them inside out now and then."""
    size = 10 ** rng.uniform(-4, -2)
    bodies = []
    for _ in range(rng.integers(2, 5)):
        if rng.random() < 0.4:
            half = size * rng.uniform(0.3, 1.0, 3)
            vertices, faces = box(tuple(-half), tuple(half))
        else:
            shape = trimesh.creation.icosphere(int(rng.integers(0, 3)), size)
            vertices, faces = np.array(shape.vertices) * rng.uniform(0.3, 1.0, 3), shape.faces
        turn = pin.exp3(rng.normal(size=3)) if rng.random() < 0.6 else STRAIGHT
        aside = rng.normal(size=3) * size * rng.choice([0.4, 4e-4], p=[0.8, 0.2])
        bodies.append((vertices @ turn.T + aside, faces[:, ::-1] if rng.random() < 0.15 else faces))
    return together(*bodies)
