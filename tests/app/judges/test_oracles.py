"""The judges of the certified rule, judged: exact rational arithmetic, linear programs, volumes."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from itertools import product

import numpy as np
import pytest
from scipy.optimize import linprog, minimize

import meshes
import vf
from app.judges import oracles
from tests.support import naive

Vector = list[Fraction]


def exact(p: np.ndarray) -> Vector:
    return [Fraction(float(c)) for c in p]


def minus(p: Vector, q: Vector) -> Vector:
    return [a - b for a, b in zip(p, q, strict=True)]


def dot(p: Vector, q: Vector) -> Fraction:
    return sum((a * b for a, b in zip(p, q, strict=True)), Fraction(0))


def cross(p: Vector, q: Vector) -> Vector:
    return [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]]


def on_segment(z: Vector, p: Vector, q: Vector) -> bool:
    along = minus(q, p)
    if not any(along):
        return z == p
    return not any(cross(minus(z, p), along)) and 0 <= dot(minus(z, p), along) <= dot(along, along)


def segments_meet(p: Vector, q: Vector, r: Vector, s: Vector) -> bool:
    u, v, w = minus(q, p), minus(s, r), minus(r, p)
    n = cross(u, v)
    nn = dot(n, n)
    if nn == 0:
        return (
            on_segment(p, r, s) or on_segment(q, r, s) or on_segment(r, p, q) or on_segment(s, p, q)
        )
    if dot(w, n) != 0:
        return False
    return 0 <= dot(cross(w, v), n) <= nn and 0 <= dot(cross(w, u), n) <= nn


def meets(a: np.ndarray, b: np.ndarray, triangle: np.ndarray) -> bool:
    """Whether the closed segment ab and the closed triangle (3, 3) share a point: exact."""
    p, q = exact(a), exact(b)
    corners = [exact(c) for c in triangle]
    edges = [(corners[k], corners[(k + 1) % 3]) for k in range(3)]
    if any(segments_meet(p, q, r, s) for r, s in edges):
        return True
    n = cross(minus(corners[1], corners[0]), minus(corners[2], corners[0]))
    hp, hq = dot(n, minus(p, corners[0])), dot(n, minus(q, corners[0]))
    if not any(n) or hp * hq > 0:
        return False
    # In the triangle's plane without cutting its rim: wholly inside or wholly outside.
    t = hp / (hp - hq) if hp != hq else Fraction(0)
    z = [i + t * (j - i) for i, j in zip(p, q, strict=True)]
    return all(dot(cross(minus(s, r), minus(z, r)), n) >= 0 for r, s in edges)


def exact_gap(a: np.ndarray, b: np.ndarray, triangle: np.ndarray) -> float:
    """Distance of a segment and a triangle that share no point."""
    squares = [naive.exact_closest(triangle, p)[1] for p in (a, b)]
    p, q = exact(a), exact(b)
    for k in range(3):
        r0, s0 = triangle[k], triangle[(k + 1) % 3]
        squares += [naive.exact_closest(np.array([a, b, b]), e)[1] for e in (r0, s0)]
        r, s = exact(r0), exact(s0)
        u, v, w = minus(q, p), minus(s, r), minus(r, p)
        n = cross(u, v)
        nn = dot(n, n)
        if nn and 0 < dot(cross(w, v), n) < nn and 0 < dot(cross(w, u), n) < nn:
            squares.append(dot(w, n) ** 2 / nn)
    return float(min(squares)) ** 0.5


def one(triangle: np.ndarray) -> vf.Surface:
    return vf.Surface.from_arrays(triangle, [[0, 1, 2]])


def agree(a: np.ndarray, b: np.ndarray, triangle: np.ndarray) -> bool:
    truth = meets(a, b, triangle)
    case = f"{a.tolist()} → {b.tolist()}, {triangle.tolist()}"
    assert (oracles.crossings(one(triangle), a, b) > 0) == truth, case
    return truth


# Crossings


def test_crossings_of_integer_segments_and_triangles():
    """Small integers: every second case is touching, coplanar or degenerate."""
    rng = np.random.default_rng(1)
    truths = []
    for _ in range(1500):
        triangle = rng.integers(-2, 3, (3, 3)).astype(float)
        a, b = rng.integers(-2, 3, (2, 3)).astype(float)
        truths.append(agree(a, b, triangle))
    assert 200 < sum(truths) < 1300


def test_crossings_in_a_plane():
    rng = np.random.default_rng(2)
    truths = []
    for _ in range(250):
        flat = rng.integers(-3, 4, (5, 2)).astype(float)
        points = np.column_stack([flat, flat @ [1.0, -2.0] + 1.0])[:, rng.permutation(3)]
        truths.append(agree(points[0], points[1], points[2:]))
    assert 40 < sum(truths) < 210


@pytest.mark.parametrize("kind", ["needle", "cap", "line", "point"])
def test_crossings_of_degenerate_triangles(kind):
    rng = np.random.default_rng(3)
    truths = []
    for _ in range(300):
        p, q = rng.integers(-2, 3, (2, 3)).astype(float)
        share = rng.integers(0, 5) / 4.0
        r = p + share * (q - p)
        if kind == "needle":
            r = q + rng.normal(size=3) * 10.0 ** rng.uniform(-15, -6)
        elif kind == "cap":
            r = r + rng.normal(size=3) * 10.0 ** rng.uniform(-15, -6)
        elif kind == "point":
            q = r = p
        triangle = np.array([p, q, r])
        z = rng.dirichlet([1, 1, 1]) @ triangle if rng.random() < 0.5 else p + 0.5 * (q - p)
        heading = rng.integers(-2, 3, 3) / 2.0
        a, b = (z - heading, z + heading) if rng.random() < 0.7 else (z, z + heading)
        truths.append(agree(a, b, triangle))
    assert any(truths)


def test_crossings_at_the_scale_of_anatomy():
    """Triangles of a millimetre, ends on and within a hair of them, in metres off the origin."""
    rng = np.random.default_rng(4)
    truths = []
    for _ in range(1500):
        centre = rng.uniform(-0.3, 0.3, 3)
        triangle = centre + rng.normal(size=(3, 3)) * 10.0 ** rng.uniform(-4, -2.5)
        weights = rng.dirichlet([1, 1, 1])
        if rng.random() < 0.3:
            weights[rng.integers(3)] = 0.0  # over an edge
        z = weights / weights.sum() @ triangle
        n = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
        n /= np.linalg.norm(n)
        hair = 10.0 ** rng.uniform(-18, -4) * rng.choice([-1.0, 0.0, 1.0])
        a = z + 5e-4 * n + rng.normal(size=3) * 2e-4
        truths.append(agree(a, z + hair * n, triangle))
    assert 300 < sum(truths) < 1200


def test_a_segment_without_length_touches_what_it_is_on():
    triangle = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    for p, truth in (([0.25, 0.25, 0], True), ([0.5, 0.5, 0], True), ([0.25, 0.25, 1e-9], False)):
        assert (oracles.crossings(one(triangle), np.array(p), np.array(p)) > 0) == truth


def test_crossings_count_triangles_of_a_mesh():
    """Through a whole mesh, against every triangle one by one."""
    surface = meshes.load("torus")
    corners = surface.vertices[surface.faces]
    rng = np.random.default_rng(5)
    seen = 0
    for _ in range(6):
        a, b = rng.uniform(-0.045, 0.045, (2, 3)) * [1, 1, 0.3]
        # A plane through the segment that a triangle does not cut excuses it.
        sides = np.cross(corners - a, b - a) @ naive.unit(rng)
        perhaps = (sides.min(axis=1) <= 0) & (sides.max(axis=1) >= 0)
        expected = sum(meets(a, b, t) for t in corners[perhaps])
        assert oracles.crossings(surface, a, b) == expected
        seen += expected
    assert seen > 0


# A tip with a radius


@pytest.mark.slow
def test_a_ball_scrapes_what_it_comes_nearer_than_its_radius():
    rng = np.random.default_rng(6)
    found = 0
    for _ in range(250):
        triangle = rng.normal(size=(3, 3)) * 1e-3
        a = rng.normal(size=3) * 1.5e-3
        b = a + rng.normal(size=3) * 5e-4
        tip_radius = 10.0 ** rng.uniform(-4, -2.7)
        gap = 0.0 if meets(a, b, triangle) else exact_gap(a, b, triangle)
        if abs(gap - tip_radius) < 2 * oracles.OVERLAP_TOLERANCE:
            continue
        truth = gap < tip_radius
        assert (oracles.overlaps(one(triangle), a, b, tip_radius) > 0) == truth
        found += truth
    assert 40 < found < 220


# Leaks


def reachable(triangle: np.ndarray, planes: vf.Planes, x: np.ndarray) -> tuple[float, float]:
    """Best common room of a triangle's points at all planes; distance of the nearest allowed one.

    A linear program in barycentric coordinates, then a convex quadratic one from its answer.
    """
    m = len(planes)
    heights = planes.normals @ triangle.T - planes.offsets[:, None]  # (m, 3) at the corners
    room = linprog(
        [0, 0, 0, -1],
        A_ub=np.column_stack([-heights, np.ones(m)]), b_ub=np.zeros(m),
        A_eq=[[1, 1, 1, 0]], b_eq=[1], bounds=[(0, 1)] * 3 + [(None, 10.0)],
    )  # fmt: skip
    if room.x[3] < 0:
        return float(room.x[3]), np.inf
    rel = triangle - x
    nearest = minimize(
        lambda w: (w @ rel) @ (w @ rel), room.x[:3], jac=lambda w: 2 * rel @ (w @ rel),
        bounds=[(0, 1)] * 3, method="SLSQP", options={"ftol": 1e-14, "maxiter": 300},
        constraints=[
            {"type": "eq", "fun": lambda w: w.sum() - 1, "jac": lambda w: np.ones(3)},
            {"type": "ineq", "fun": lambda w: heights @ w, "jac": lambda w: heights},
        ],
    )  # fmt: skip
    return float(room.x[3]), float(np.sqrt(nearest.fun))


def some_planes(rng: np.random.Generator, m: int, x: np.ndarray, radius: float) -> vf.Planes:
    """Random half-spaces around x (3,)."""
    normals = np.array([naive.unit(rng) for _ in range(m)]).reshape(-1, 3)
    offsets = normals @ x - rng.uniform(0.05, 0.8, m)
    index = np.zeros(m, dtype=np.int64)
    return vf.Planes(normals, offsets, np.zeros((m, 3)), index, index, radius)


@pytest.mark.slow
def test_leaks_are_what_linear_and_quadratic_programs_find():
    rng = np.random.default_rng(7)
    found = 0
    for _ in range(250):
        triangle = rng.normal(size=(3, 3))
        x = rng.normal(size=3) * 0.7
        radius = rng.uniform(0.3, 2.0)
        planes = some_planes(rng, int(rng.integers(1, 7)), x, radius)
        room, distance = reachable(triangle, planes, x)
        if abs(room) < 1e-7 or abs(distance - radius) < 1e-4:
            continue
        truth = room > 0 and distance < radius
        case = f"{triangle.tolist()} {x.tolist()} {radius} {planes}"
        assert oracles.leaks(one(triangle), planes, x, radius) == truth, case
        found += truth
    assert 40 < found < 190


def test_leaks_of_triangles_without_area():
    x = np.zeros(3)
    planes = some_planes(np.random.default_rng(8), 0, x, 1.0)
    planes = replace(planes, normals=np.array([[0.0, 0, 1]]), offsets=np.array([-0.5]))
    line = np.array([[-1, 0, -0.6], [1, 0, -0.4], [0, 0, -0.5]])
    for triangle, truth in (
        (line, True),
        (line - [0, 0, 0.2], False),
        (np.array([[0, 0, -0.4]] * 3), True),
        (np.array([[0, 0, -0.6]] * 3), False),
        (np.array([[2, 0, -0.4]] * 3), False),  # beyond the ball
        (line + np.array([0, 1.1, 0]), False),
    ):
        assert oracles.leaks(one(triangle), planes, x, 1.0) == truth, triangle


def sampled_leak(
    surface: vf.Surface, planes: vf.Planes, x: np.ndarray, radius: float, grid: int = 30
) -> bool:
    """Whether any point of a dense grid on the triangles near x leaks."""
    weights = np.array([(i, j, grid - i - j) for i, j in product(range(grid + 1), repeat=2)
                        if i + j <= grid]) / grid  # fmt: skip
    corners = naive.near(surface, x, radius)
    z = np.einsum("sk,mkj->msj", weights, corners).reshape(-1, 3)
    z = z[np.linalg.norm(z - x, axis=1) < radius]
    return bool(((z @ planes.normals.T - planes.offsets) > 1e-9).all(axis=1).any())


@pytest.mark.parametrize("name", ["cube", "star-prism", "gear", "skull-coarse"])
def test_a_dropped_plane_is_a_leak(name):
    surface = meshes.load(name)
    rng = np.random.default_rng(9)
    radius = 1.5 * surface.median_edge
    dropped = confirmed = 0
    for _ in range(10):
        x = naive.around(surface, rng, 0.7 * radius)
        planes = vf.certified_planes(surface, x, radius)
        assert oracles.leaks(surface, planes, x, planes.radius) == 0
        assert not sampled_leak(surface, planes, x, planes.radius)
        for k in range(len(planes)):
            kept = np.arange(len(planes)) != k
            fewer = replace(planes, normals=planes.normals[kept], offsets=planes.offsets[kept])
            leaking = oracles.leaks(surface, fewer, x, planes.radius) > 0
            sampled = sampled_leak(surface, fewer, x, planes.radius)
            assert leaking or not sampled, f"plane {k} of {planes}"
            dropped += leaking
            confirmed += sampled
    # The grid is too coarse for the smallest of leaks.
    assert dropped > 10
    assert confirmed > 0.8 * dropped


def test_without_planes_every_triangle_of_the_ball_leaks():
    surface = meshes.load("gear")
    x = surface.vertices[0] + 1e-4
    radius = 2e-3
    _, distances = naive.brute(surface).within(x, radius)
    assert oracles.leaks(surface, vf.Planes.none(radius), x, radius) == (distances < radius).sum()


# Blocked


def cap(height: float) -> float:
    """Volume of a unit ball beyond a plane at this distance from its centre."""
    return np.pi * (1 - height) ** 2 * (2 + height) / 3


BALL = 4 * np.pi / 3
SAMPLES = 8000
SPREAD = 5 * 0.5 / SAMPLES**0.5  # five standard deviations of a share, at most


@pytest.mark.parametrize(("wall", "plane"), [(0.5, 0.2), (0.9, 0.0), (2.0, 0.3), (0.4, 0.4)])
def test_blocked_share_of_a_half_space(wall, plane):
    """A flat wall and a plane nearer to x: the slab between them is forbidden for nothing."""
    big = np.array([[-50.0, -50, -wall], [50, -50, -wall], [0, 80, -wall]])
    x = np.zeros(3)
    planes = replace(
        vf.Planes.none(1.0), normals=np.array([[0.0, 0, 1]]), offsets=np.array([-plane])
    )
    forbidden, free = oracles.blocked(one(big), planes, x, 1.0, np.random.default_rng(10), SAMPLES)
    behind = cap(wall) if wall < 1 else 0.0
    assert abs(free / SAMPLES - (1 - behind / BALL)) < SPREAD
    assert abs(forbidden / free - (cap(plane) - behind) / (BALL - behind)) < 1.5 * SPREAD


def test_what_is_beyond_a_shrunken_ball_is_blocked():
    far = np.array([[0.0, 0, 9], [1, 0, 9], [0, 1, 9]])
    forbidden, free = oracles.blocked(
        one(far), vf.Planes.none(0.5), np.zeros(3), 1.0, np.random.default_rng(11), SAMPLES
    )
    assert free == SAMPLES
    assert abs(forbidden / free - 7 / 8) < SPREAD


def test_what_a_wall_hides_is_not_counted():
    """Free space behind a thin wall is no loss, since no straight path leads there."""
    wall = np.array([[-50.0, -50, -0.2], [50, -50, -0.2], [0, 80, -0.2]])
    x = np.zeros(3)
    planes = vf.certified_planes(one(wall), x, 1.0)
    forbidden, _free = oracles.blocked(one(wall), planes, x, 1.0, np.random.default_rng(12), 2000)
    assert forbidden <= 0.02 * 2000  # what the cover eases
