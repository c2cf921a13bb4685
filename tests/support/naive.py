"""Slow references for the tests of vf: written from the definitions, none of them uses vf's code.

Exact answers come from rational arithmetic (a float is a fraction), the others from numpy.
"""

from __future__ import annotations

from fractions import Fraction
from functools import cache, lru_cache
from itertools import pairwise

import numpy as np
from hypothesis import settings

import meshes
import vf

# Property tests repeat exactly: no random seed, no clock.
PROPERTY = settings(derandomize=True, deadline=None, database=None, print_blob=True)
MANY = settings(PROPERTY, max_examples=5000)

HUGE = "skull-fine"  # a million triangles: only in the slow runs
NAMES = tuple(name for name in meshes.names() if name != HUGE)


@cache
def catalogue(name: str) -> vf.Surface:
    return meshes.load(name)


def rotation(rng: np.random.Generator) -> np.ndarray:
    """A random rotation matrix."""
    Q, R = np.linalg.qr(rng.normal(size=(3, 3)))
    Q = Q * np.sign(np.diag(R))
    return Q if np.linalg.det(Q) > 0 else -Q


def unit(rng: np.random.Generator) -> np.ndarray:
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


# Closest points


def fraction(value: float | Fraction) -> Fraction:
    return value if isinstance(value, Fraction) else Fraction(float(value))


def _dot(a: list[Fraction], b: list[Fraction]) -> Fraction:
    return sum((i * j for i, j in zip(a, b, strict=True)), Fraction(0))


def exact_closest(
    triangle: np.ndarray | list[list[Fraction]], x: np.ndarray | list[Fraction]
) -> tuple[list[Fraction], Fraction]:
    """Closest point of a triangle (3, 3) to x (3,) and the squared distance, both exact.

    Candidates are the corners, the feet on the edges and the foot on the plane; those that lie on
    the triangle are compared.
    """
    corners = [[fraction(v) for v in row] for row in triangle]
    p = [fraction(v) for v in x]
    candidates = list(corners)
    for k in range(3):
        a, b = corners[k], corners[(k + 1) % 3]
        along = [j - i for i, j in zip(a, b, strict=True)]
        length2 = _dot(along, along)
        if length2 > 0:
            t = _dot([j - i for i, j in zip(a, p, strict=True)], along) / length2
            if 0 < t < 1:
                candidates.append([i + t * d for i, d in zip(a, along, strict=True)])
    a, b, c = corners
    u = [j - i for i, j in zip(a, b, strict=True)]
    v = [j - i for i, j in zip(a, c, strict=True)]
    r = [j - i for i, j in zip(a, p, strict=True)]
    uu, uv, vv, ru, rv = _dot(u, u), _dot(u, v), _dot(v, v), _dot(r, u), _dot(r, v)
    det = uu * vv - uv * uv
    if det > 0:
        beta, gamma = (vv * ru - uv * rv) / det, (uu * rv - uv * ru) / det
        if beta >= 0 and gamma >= 0 and beta + gamma <= 1:
            candidates.append([i + beta * m + gamma * n for i, m, n in zip(a, u, v, strict=True)])
    squares = [_dot(*[[i - j for i, j in zip(q, p, strict=True)]] * 2) for q in candidates]
    best = min(range(len(candidates)), key=squares.__getitem__)
    return candidates[best], squares[best]


def exact_feature(triangle: np.ndarray, point: list[Fraction]) -> set[int]:
    """Features whose relative interior holds an exact point of a triangle with area."""
    a, b, c = [[Fraction(float(v)) for v in row] for row in triangle]
    u = [j - i for i, j in zip(a, b, strict=True)]
    v = [j - i for i, j in zip(a, c, strict=True)]
    r = [j - i for i, j in zip(a, point, strict=True)]
    uu, uv, vv, ru, rv = _dot(u, u), _dot(u, v), _dot(v, v), _dot(r, u), _dot(r, v)
    det = uu * vv - uv * uv
    beta, gamma = (vv * ru - uv * rv) / det, (uu * rv - uv * ru) / det
    alpha = 1 - beta - gamma
    zeros = (alpha == 0, beta == 0, gamma == 0)
    return {
        (False, False, False): {vf.Feature.FACE},
        (False, False, True): {vf.Feature.EDGE_0},
        (True, False, False): {vf.Feature.EDGE_1},
        (False, True, False): {vf.Feature.EDGE_2},
        (False, True, True): {vf.Feature.VERTEX_0},
        (True, False, True): {vf.Feature.VERTEX_1},
        (True, True, False): {vf.Feature.VERTEX_2},
    }[zeros]


def closest(corners: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Closest points (m, 3) of triangles (m, 3, 3) to x, and the distances (m,), in floats."""
    m = len(corners)
    rel = corners - x
    best = np.full(m, np.inf)
    points = np.zeros((m, 3))

    def offer(q: np.ndarray, valid: np.ndarray) -> None:
        d = np.linalg.norm(q, axis=1)
        better = valid & (d < best)
        best[better] = d[better]
        points[better] = q[better]

    everywhere = np.ones(m, dtype=bool)
    for k in range(3):
        a, b = rel[:, k], rel[:, (k + 1) % 3]
        along = b - a
        length2 = (along * along).sum(axis=1)
        safe = np.where(length2 > 0, length2, 1.0)
        t = np.clip(-(a * along).sum(axis=1) / safe, 0.0, 1.0)
        offer(a + t[:, None] * along, everywhere)
    a = rel[:, 0]
    n = np.cross(rel[:, 1] - a, rel[:, 2] - a)
    area2 = (n * n).sum(axis=1)
    proper = area2 > 0
    foot = n * ((a * n).sum(axis=1) / np.where(proper, area2, 1.0))[:, None]
    within = proper.copy()
    for k in range(3):
        p, q = rel[:, k], rel[:, (k + 1) % 3]
        within &= (np.cross(q - p, foot - p) * n).sum(axis=1) >= 0
    offer(foot, within)
    return points + x, best


class Brute:
    """Every triangle of a surface against a point.

    A ball around each, and their order along x, only save arithmetic.
    """

    def __init__(self, surface: vf.Surface) -> None:
        self.corners = surface.vertices[surface.faces]
        self.centres = self.corners.mean(axis=1)
        self.radii = np.linalg.norm(self.corners - self.centres[:, None], axis=2).max(axis=1)
        self._order = np.argsort(self.centres[:, 0])
        self._along = self.centres[self._order, 0]

    def candidates(self, x: np.ndarray, radius: float) -> np.ndarray:
        """Ids (k,), in rising order, of all triangles within the radius, and of more."""
        reach = radius * 1.001 + 1e-12
        slab = reach + self.radii.max()
        first, last = np.searchsorted(self._along, [x[0] - slab, x[0] + slab])
        ids = np.sort(self._order[first:last])
        gap = np.linalg.norm(self.centres[ids] - x, axis=1) - self.radii[ids]
        return ids[gap <= reach]

    def within(self, x: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
        """Ids and distances of the triangles within the radius, nearest first, and a bit more."""
        ids = self.candidates(x, radius)
        _, d = closest(self.corners[ids], x)
        rank = np.argsort(d, kind="stable")
        return ids[rank], d[rank]

    def nearest(self, x: np.ndarray) -> float:
        bound = np.linalg.norm(self.centres - x, axis=1).min()
        return float(self.within(x, bound)[1][0])


@lru_cache(maxsize=8)
def brute(surface: vf.Surface) -> Brute:
    """Of a surface that is asked more than once."""
    return Brute(surface)


def near(surface: vf.Surface, x: np.ndarray, radius: float) -> np.ndarray:
    """Corners (k, 3, 3) of the triangles within the radius, and of a few more; not by the tree."""
    found = brute(surface)
    return found.corners[found.within(x, radius)[0]]


def clear_radius(distances: np.ndarray, radius: float, hair: float) -> float:
    """A radius near the one given that no distance comes closer to than `hair`."""
    for k in range(1, 1000):
        if not (np.abs(distances - radius) < hair).any():
            break
        radius += k * hair
    return radius


def winding(corners: np.ndarray, x: np.ndarray) -> float:
    """Generalised winding number: all solid angles, each by L'Huilier's spherical excess."""
    d = corners - x
    u = d / np.linalg.norm(d, axis=2, keepdims=True)
    sides = [
        2 * np.arcsin(np.clip(np.linalg.norm(u[:, i] - u[:, j], axis=1) / 2, 0, 1))
        for i, j in ((1, 2), (2, 0), (0, 1))
    ]
    half = sum(sides) / 2
    product = np.tan(half / 2)
    for side in sides:
        product = product * np.tan((half - side) / 2)
    excess = 4 * np.arctan(np.sqrt(np.maximum(product, 0.0)))
    sign = np.sign((np.cross(u[:, 0], u[:, 1]) * u[:, 2]).sum(axis=1))
    return float((sign * excess).sum() / (4 * np.pi))


def parity(corners: np.ndarray, x: np.ndarray, direction: np.ndarray) -> bool:
    """Whether a ray from x cuts an odd number of triangles (m, 3, 3)."""
    # In coordinates with the ray along the third axis: a point in a triangle, and its height.
    frame = np.linalg.qr(np.column_stack([direction, np.eye(3)[:, :2]]))[0]
    p = (corners - x) @ np.column_stack([frame[:, 1], frame[:, 2], direction])
    flat = p[:, :, :2]
    areas = [
        flat[:, i, 0] * flat[:, j, 1] - flat[:, i, 1] * flat[:, j, 0]
        for i, j in ((1, 2), (2, 0), (0, 1))
    ]
    total = sum(areas)
    cut = (np.sign(areas[0]) == np.sign(areas[1])) & (np.sign(areas[1]) == np.sign(areas[2]))
    cut &= total != 0
    height = sum(a * p[:, k, 2] for k, a in enumerate(areas)) / np.where(total == 0, 1.0, total)
    return bool((cut & (height > 0)).sum() % 2)


# Leaks


def clip(polygon: np.ndarray, normal: np.ndarray, offset: float) -> np.ndarray:
    """The part of a convex polygon (k, 3) with n·z ≥ offset."""
    if len(polygon) == 0:
        return polygon
    kept = []
    heights = polygon @ normal - offset
    for (p, hp), (q, hq) in pairwise(
        [*zip(polygon, heights, strict=True), (polygon[0], heights[0])]
    ):
        if hp >= 0:
            kept.append(p)
        if (hp >= 0) != (hq >= 0):
            kept.append(p + (q - p) * (hp / (hp - hq)))
    return np.array(kept).reshape(-1, 3)


def leaks(
    corners: np.ndarray,
    planes: vf.Planes,
    x: np.ndarray,
    tip_radius: float = 0.0,
    hair: float = 1e-13,
) -> list[tuple[int, float]]:
    """Triangles with a part inside the ball on the allowed side of every plane, by over a hair.

    Returns their indices in `corners` (m, 3, 3) and how far from x the leak is. With a tip radius
    the ball is wider and the planes stand closer to the surface by it, as in the claim's proof.
    """
    reach = planes.radius + tip_radius
    if planes.radius <= 0.0:
        return []  # no motion is allowed, so nothing can be crossed
    _, distances = closest(corners, x)
    near = np.flatnonzero(distances < reach * (1 - 1e-9))
    # Relative to x, or the hair would drown in the coordinates' rounding.
    offsets = planes.offsets - planes.normals @ x - tip_radius + hair
    found = []
    for i in near:
        part = corners[i] - x
        if ((part @ planes.normals.T < offsets).all(axis=0)).any():
            continue
        for normal, offset in zip(planes.normals, offsets, strict=True):
            part = clip(part, normal, offset)
            if len(part) == 0:
                break
        if len(part) == 0:
            continue
        fan = np.array([[part[0], part[min(k, len(part) - 1)], part[min(k + 1, len(part) - 1)]]
                        for k in range(1, max(len(part) - 1, 2))])  # fmt: skip
        distance = closest(fan, np.zeros(3))[1].min()
        if distance < reach * (1 - 1e-9):
            found.append((int(i), float(distance)))
    return found


def around(surface: vf.Surface, rng: np.random.Generator, reach: float) -> np.ndarray:
    """A random point within `reach` of a random point of the surface, on either side."""
    face = rng.integers(len(surface.faces))
    corner = surface.vertices[surface.faces[face]]
    return rng.dirichlet((1, 1, 1)) @ corner + unit(rng) * reach * rng.random()


class Crossings:
    """Segments against every triangle of a mesh (m, 3, 3): exact where floats cannot tell."""

    def __init__(self, corners: np.ndarray) -> None:
        self.corners = corners
        self.centres = corners.mean(axis=1)
        self.radii = np.linalg.norm(corners - self.centres[:, None], axis=2).max(axis=1)
        self.normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self.sizes = np.linalg.norm(self.normals, axis=1)

    def __call__(self, a: np.ndarray, b: np.ndarray) -> bool:
        """Whether the segment a→b meets a triangle."""
        if (a == b).all():
            return False
        reach = self.radii + 0.51 * np.linalg.norm(b - a) + 1e-12
        offset = self.centres - 0.5 * (a + b)
        near = np.flatnonzero((offset * offset).sum(axis=1) <= reach * reach)
        # Both ends on one side of a triangle's plane, by far more than rounding.
        p = self.corners[near, 0]
        sides = [((z - p) * self.normals[near]).sum(axis=1) for z in (a, b)]
        clear = 1e-12 * self.sizes[near]
        away = (np.minimum(*sides) > clear) | (np.maximum(*sides) < -clear)
        return any(_crosses(self.corners[i], a, b) for i in near[~away])


def crosses(corners: np.ndarray, a: np.ndarray, b: np.ndarray) -> bool:
    """Whether the segment a→b meets one of the triangles (m, 3, 3)."""
    return Crossings(corners)(a, b)


def _crosses(triangle: np.ndarray, a: np.ndarray, b: np.ndarray) -> bool:
    A, B, C = [[Fraction(float(v)) for v in row] for row in triangle]
    p, q = ([Fraction(float(v)) for v in row] for row in (a, b))

    def volume(*points: list[Fraction]) -> Fraction:
        o, u, v, w = points
        u, v, w = ([i - j for i, j in zip(s, o, strict=True)] for s in (u, v, w))
        return (
            u[0] * (v[1] * w[2] - v[2] * w[1])
            - u[1] * (v[0] * w[2] - v[2] * w[0])
            + u[2] * (v[0] * w[1] - v[1] * w[0])
        )

    above, below = volume(A, B, C, p), volume(A, B, C, q)
    if above * below > 0:
        return False
    if above == below == 0:
        return False  # in the triangle's plane: judged by its neighbours
    sides = [volume(p, q, A, B), volume(p, q, B, C), volume(p, q, C, A)]
    return all(s >= 0 for s in sides) or all(s <= 0 for s in sides)
