"""Attacks on the statement of docs/certified.md with numbers: huge, far, thin, to the last place.

Judged in rational arithmetic.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pinocchio as pin
import pytest

import vf
from tests.support import exact, naive

STANDOFF = 20e-6
ONE = np.eye(3)[None]


def turned(rng: np.random.Generator) -> np.ndarray:
    return np.asarray(pin.exp3(rng.normal(size=3) * 2.0))


# Range of numbers


@pytest.mark.parametrize("name", ["radius", "standoff", "tip_radius"])
def test_lengths_beyond_any_room_are_refused_by_name_and_value(name: str) -> None:
    # From the least on: a walk with the largest would never end, were they not refused.
    for value in (1.001e7, 1e77, 1e154, 1.4e154, 1e300):
        lengths = {"radius": 5e-3, "standoff": STANDOFF, "tip_radius": 0.0, name: value}
        with pytest.raises(ValueError, match=name.replace("_", " ")) as error:
            vf.certified_planes(exact.soup(ONE), np.zeros(3), **lengths)
        assert repr(value) in str(error.value)
        assert "1e+07 m" in str(error.value)
        if name == "radius":
            with pytest.raises(ValueError, match="radius"):
                vf.MeshFixture(exact.soup(ONE), radius=value)
            with pytest.raises(ValueError, match="radius"):
                vf.CorridorFixture([[0, 0, 0], [1, 0, 0]], [0, 0, 1], radius=value)
        else:
            with pytest.raises(ValueError, match=name):
                vf.Settings(**{name: value})


def test_vertices_beyond_any_room_are_refused_by_number() -> None:
    for far in (1.001e7, 5e9, 1e77, 1e160, 1e300):
        vertices = np.vstack([np.eye(3), [[0.0, 0.0, -far]]])
        with pytest.raises(ValueError, match="vertex 3") as error:
            vf.Surface.from_arrays(vertices, [[0, 1, 2], [1, 2, 3]])
        assert "1e+07 m" in str(error.value)


def tent(far: float, used: bool) -> tuple[np.ndarray, np.ndarray]:
    """A floor at z = 0 with a tent 80 µm high beside the origin, and one vertex somewhere else."""
    vertices = np.array([
        [-0.02, -0.02, 0], [0.02, -0.02, 0], [0.02, 0.02, 0], [-0.02, 0.02, 0],
        [0.001, -0.001, 0], [0.001, 0.001, 0], [0.002, 0, 80e-6],
        [0.003, -0.001, 0], [0.003, 0.001, 0], [far, far, far],
    ])  # fmt: skip
    faces = [[0, 1, 2], [0, 2, 3], [4, 6, 5], [7, 8, 6], [4, 7, 6], [5, 6, 8]]
    return vertices, np.array(faces + ([[9, 9, 9]] if used else []))


def test_a_vertex_that_no_face_uses_is_as_if_it_were_not_there() -> None:
    for far in (1e6, 5e9, 1e12, 1e77, 1e300):
        vertices, faces = tent(far, used=False)
        surface = vf.Surface.from_arrays(vertices, faces)
        alone = vf.Surface.from_arrays(vertices[:9], faces)
        assert surface.size == alone.size
        assert surface.rounding == alone.rounding
        x = np.array([0.0, 0.0, 1e-3])
        for standoff in (0.0, STANDOFF):
            found, plain = (vf.certified_planes(s, x, 5e-3, standoff) for s in (surface, alone))
            np.testing.assert_array_equal(found.offsets, plain.offsets)
            assert exact.leaking(vertices[faces], found, x).size == 0


@pytest.mark.parametrize("far", [1.0, 500.0, 1e3])
def test_a_vertex_as_far_as_it_may_be_opens_nothing_elsewhere(far: float) -> None:
    vertices, faces = tent(far, used=True)
    surface = vf.Surface.from_arrays(vertices, faces)
    rng = np.random.default_rng(1)
    for k in range(40):
        x = np.array([*rng.uniform(-3e-3, 5e-3, 2), 10.0 ** rng.uniform(-5.0, -2.5)])
        if surface.nearest(x)[0] < 1e-7:
            continue
        found = vf.certified_planes(surface, x, 5e-3, STANDOFF if k % 2 else 0.0)
        assert found.radius > 0.0
        assert exact.leaking(vertices[faces], found, x).size == 0


# Slivers


def sliver(rng: np.random.Generator, aspect: float) -> tuple[np.ndarray, np.ndarray]:
    """A triangle (3, 3) of that aspect somewhere, and a unit vector (3,) across it."""
    length = 10.0 ** rng.uniform(-2.0, 0.0)
    height = length / aspect * rng.uniform(0.5, 1.0)
    flat = np.array([[0, 0, 0], [length, 0, 0], [length * rng.uniform(0.2, 0.8), height, 0]])
    turn = turned(rng)
    triangle = flat[rng.permutation(3)] @ turn.T + rng.normal(size=3) * 0.02
    return triangle, turn[:, 2] if rng.random() < 0.5 else turn[:, 1]


@pytest.mark.parametrize("exponent", [3, 5, 6, 7, 8, 9, 10, 12, 14])
def test_a_sliver_just_inside_the_ball_is_in_the_ball(exponent: int) -> None:
    """The ball reaches it by a few parts in 1e16 to a few in 1e9 of its length."""
    rng = np.random.default_rng(exponent)
    for _ in range(50):
        triangle, across = sliver(rng, 10.0**exponent)
        length = float(np.ptp(triangle, axis=0).max())
        x = rng.dirichlet([2, 2, 2]) @ triangle + across * 10.0 ** rng.uniform(-7.0, -2.0)
        square = naive.exact_closest(triangle, x)[1]
        distance = float(square) ** 0.5
        surface = exact.soup(triangle[None])
        for extra in (3e-9, 3e-10, 3e-11, 1e-12, 1e-14, 0.0):
            radius = distance * (1.0 + 4e-16) + extra * length
            if not 0 < square <= Fraction(radius) ** 2:
                continue
            found = vf.certified_planes(surface, x, radius, STANDOFF)
            leaks = exact.leaking(triangle[None], found, x)
            assert leaks.size == 0, f"reaches it by {radius - distance:.1e} m"


@pytest.mark.parametrize("exponent", [4, 8, 11, 14])
def test_slivers_among_others_do_not_leak(exponent: int) -> None:
    rng = np.random.default_rng(exponent)
    for k in range(25):
        triangles = np.array([sliver(rng, 10.0 ** rng.uniform(0, exponent))[0] for _ in range(8)])
        surface = exact.soup(triangles)
        x = rng.normal(size=3) * 0.02
        nearest = min(naive.exact_closest(t, x)[1] for t in triangles)
        tip = float(nearest) ** 0.5 * 0.5 if k % 3 == 0 else 0.0
        found = vf.certified_planes(surface, x, 0.05, STANDOFF if k % 2 else 0.0, tip)
        assert exact.leaking(triangles, found, x, tip).size == 0


# Contact within units in the last place


@pytest.mark.parametrize("offset", [0.0, 1.0, 100.0])
@pytest.mark.parametrize("standoff", [0.0, 1e-15, STANDOFF])
def test_no_step_that_obeys_touches_the_triangle(offset: float, standoff: float) -> None:
    """Steps that end within a few units in the last place of a foot on the triangle."""
    rng = np.random.default_rng(2)
    for _ in range(80):
        triangle = rng.normal(size=(3, 3)) * 0.02 + offset * np.array([1.0, 0.7, -0.3])
        foot = rng.dirichlet([1.0, 1.0, 1.0]) @ triangle
        across = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
        x = foot + across / np.linalg.norm(across) * rng.choice([-1, 1]) * rng.uniform(1e-3, 0.02)
        found = vf.certified_planes(exact.soup(triangle[None]), x, 0.05, standoff)
        assert exact.leaking(triangle[None], found, x).size == 0
        unit = np.spacing(np.abs(triangle).max())
        for _ in range(12):
            y = foot + rng.integers(-3, 4, size=3) * unit
            if exact.obeys(found, x, y):
                assert exact.crossed(triangle[None], x, y).size == 0


def test_the_foot_itself_is_not_allowed_on_any_kind_of_feature() -> None:
    """Corners, edges and insides of the triangles of a small closed body, from all around."""
    rng = np.random.default_rng(3)
    corners = np.array([[0, 0, 0], [8, 0, 0], [0, 8, 0], [0, 0, 8]]) / 1024.0
    triangles = corners[np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])]
    surface = exact.soup(triangles)
    for _ in range(60):
        heading = rng.normal(size=3)
        x = corners.mean(axis=0) + 0.012 * heading / np.linalg.norm(heading)
        found = vf.certified_planes(surface, x, 0.05)
        assert exact.leaking(triangles, found, x).size == 0
        feet = [*corners, *corners[:3] * 0.5, surface.nearest(x)[2]]
        for y in feet:
            if exact.obeys(found, x, np.asarray(y)):
                assert exact.crossed(triangles, x, np.asarray(y)).size == 0


# Standing still is always allowed


@pytest.mark.parametrize("offset", [0.1, 10.0, 300.0])
@pytest.mark.parametrize("tip", [0.0, 5e-4])
def test_standing_still_obeys_as_a_caller_computes_it(offset: float, tip: float) -> None:
    """docs/library.md: (G @ x >= h).all(), and the same one plane at a time."""
    rng = np.random.default_rng(4)
    seen = 0
    for _ in range(120):
        triangles = rng.normal(size=(6, 3, 3)) * 0.01 + offset * rng.uniform(-1, 1, size=3)
        a, b, c = triangles[0]
        across = np.cross(b - a, c - a)
        # A tip with a radius overlaps by half of it.
        x = rng.dirichlet([1, 1, 1]) @ triangles[0]
        x = x + across / np.linalg.norm(across) * (0.5 * tip if tip else 1e-5)
        found = vf.certified_planes(exact.soup(triangles), x, 5e-3, STANDOFF, tip)
        seen += len(found)
        assert (found.normals @ x >= found.offsets).all()
        assert (found.slack(x) >= 0.0).all()
        assert all(n @ x >= o for n, o in zip(found.normals, found.offsets, strict=True))
    assert seen > 100
