"""Steps out of a body: decided and covered as rational arithmetic and brute force say."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
import trimesh

import vf
from tests.support import exact
from tests.support.bodies import box, cells, crossing, folded, together, wrong
from vf.rules import inside


def starts(surface: vf.Surface, rng: np.random.Generator, count: int) -> list[np.ndarray]:
    """Points inside, most of them just below a wall."""
    triangles, found = exact.triangles_of(surface), []
    for _ in range(50 * count):
        face = rng.integers(len(triangles))
        point = rng.dirichlet([1, 1, 1]) @ triangles[face]
        x = point - surface.normals[face] * 10 ** rng.uniform(-8.9, -4)
        if surface.inside(x) and surface.nearest(x)[0] > 1e-9:
            found.append(x)
        if len(found) == count:
            break
    return found


def turn_of(triangles: np.ndarray, x: np.ndarray) -> int:
    """The winding number around x, which is 1 or −1."""
    turn = exact.winding(triangles, x)
    assert turn in (1, -1)
    return turn


def scenes(rng: np.random.Generator) -> list[vf.Surface]:
    return [crossing(rng), folded(rng, 10 ** rng.uniform(-8, -5))[0]]


def test_a_side_is_told_only_where_it_is_sure() -> None:
    """Flat and slender triangles near and far, points on their planes within rounding."""
    rng = np.random.default_rng(1)
    told = 0
    for _ in range(2000):
        corners = rng.normal(size=(3, 3)) * 10 ** rng.uniform(-4, 0)
        corners[2] = corners[0] + (corners[1] - corners[0]) * rng.uniform() + (
            rng.normal(size=3) * 10 ** rng.uniform(-17, 0)
        )  # fmt: skip
        corners += rng.normal(size=3) * rng.choice([0.0, 1.0, 1e3])
        x = rng.dirichlet([1, 1, 1]) @ corners + rng.normal(size=3) * 10 ** rng.uniform(-18, -1)
        side = exact.inner_side(corners, x)
        for turn in (1.0, -1.0):
            sure = bool(inside._inner_sides(corners.reshape(1, 9), x, turn)[0])
            assert not sure or side == turn
            told += sure
    assert told > 1000


def test_the_nearest_passable_triangle_is_the_nearest_there_is() -> None:
    rng = np.random.default_rng(2)
    asked = 0
    for _ in range(6):
        for surface in scenes(rng):
            triangles = exact.triangles_of(surface)
            for x in starts(surface, rng, 6):
                turn = turn_of(triangles, x)
                distance, face, point = inside.nearest_passable(surface, x, float(turn))
                rows = [t for t in triangles if exact.inner_side(t, x) == turn]
                best = min(vf.closest_point(t, x)[2] for t in rows)
                assert distance == pytest.approx(best, rel=1e-9)
                assert exact.inner_side(triangles[face], x) == turn
                assert np.linalg.norm(point - x) == pytest.approx(distance, rel=1e-9)
                asked += 1
    assert asked > 40


def test_the_planes_of_the_way_out_cover_every_guarded_triangle() -> None:
    """Guarded in rational arithmetic; far from any wall the ball holds no triangle at all."""
    rng = np.random.default_rng(3)
    covered = 0
    for _ in range(8):
        for surface in scenes(rng):
            triangles = exact.triangles_of(surface)
            for x in starts(surface, rng, 5):
                turn = turn_of(triangles, x)
                planes = inside.way_out(surface, x, 5e-3, 2e-5, 0.0)
                assert (planes.slack(x) >= 0.0).all()
                guarded = np.array([t for t in triangles if exact.inner_side(t, x) != turn])
                others = vf.Planes(
                    planes.normals[1:], planes.offsets[1:], planes.points[1:],
                    planes.triangles[1:], planes.rules[1:], planes.radius,
                )  # fmt: skip
                if planes.radius < surface.nearest(x)[0]:
                    assert len(planes) == 1
                    guarded = triangles
                assert not len(exact.leaking(guarded, others, x))
                covered += len(others) > 0
    assert covered > 10


def test_a_step_leads_out_only_if_it_passes_one_wall_into_the_open() -> None:
    """Steps of any length in any direction, whatever the planes would say of them."""
    rng = np.random.default_rng(4)
    allowed = passed = 0
    for _ in range(3):
        for surface in scenes(rng):
            triangles = exact.triangles_of(surface)
            for x in starts(surface, rng, 4):
                to_wall = surface.nearest(x)[2] - x
                for _ in range(15):
                    y = x + (
                        to_wall * rng.uniform(0, 3)
                        + rng.normal(size=3) * np.linalg.norm(to_wall) * rng.choice([0.3, 5.0])
                    )
                    if not inside.leads_out(surface, x, y):
                        continue
                    assert not wrong(triangles, x, y)
                    allowed += 1
                    passed += exact.winding(triangles, y) == 0
    assert allowed > 70
    assert passed > 20


def test_what_leads_out_may_be_taken() -> None:
    """Through a face, an edge and a corner of a box; not through two walls, nor deeper."""
    surface = together(box((-1, -1, -1), (1, 1, 1)), box((2, -1, -1), (3, 1, 1)))
    x = np.array([0.9, 0.3, 0.2])
    for y in ([1.5, 0.3, 0.2], [1.1, 0.1, 0.1], [0.95, 0.3, 0.2]):
        assert inside.leads_out(surface, x, np.array(y, dtype=float)), y
    for y in ([0.8, 0.3, 0.2], [3.5, 0.3, 0.2], [2.5, 0.3, 0.2], [1.0, 0.3, 0.2]):
        assert not inside.leads_out(surface, x, np.array(y, dtype=float)), y
    middle = np.array([0.5, 0.5, 0.5])
    for y in ([1.5, 1.5, 1.5], [1.5, 1.5, 0.5]):  # the corner itself, and an edge of the box
        assert inside.leads_out(surface, middle, np.array(y)), y


@pytest.mark.parametrize("flip", [False, True])
def test_repeated_faces_are_no_second_wall(flip: bool) -> None:
    solid = trimesh.creation.box((2.0, 2.0, 2.0))
    again = solid.faces[:, ::-1] if flip else solid.faces
    surface = vf.Surface.from_arrays(solid.vertices, np.concatenate([solid.faces, again]))
    assert surface.closed
    assert surface.repeats.tolist() == [False] * 12 + [True] * 12
    x, y = np.array([0.0, 0.1, 1.0 - 1e-6]), np.array([0.0, 0.1, 1.0 + 1e-6])
    assert inside.leads_out(surface, x, y)
    planes = inside.way_out(surface, x, 5e-3, 2e-5, 0.0)
    assert len(planes) == 1
    assert planes.slack(y)[0] > 0.0


def test_two_walls_in_one_place_are_two() -> None:
    """Faces of two bodies on each other, in a third that is inside out: from 1 to −1 at once."""
    one, other = box((-1, -1, -1), (1, 1, 1)), box((-0.5, -0.5, -1.5), (0.5, 0.5, 1))
    vertices, faces = box((-5, -5, -5), (5, 5, 5))
    surface = together(one, other, (vertices, faces[:, ::-1]))
    x, y = np.array([0.1, 0.2, 0.9]), np.array([0.1, 0.2, 1.1])
    assert round(surface.winding(x)) == 1
    assert round(surface.winding(y)) == -1
    assert not inside.leads_out(surface, x, y)
    alone = together(one, (vertices, faces[:, ::-1]))
    assert round(alone.winding(y)) == -1
    assert inside.leads_out(alone, y, x)  # into where the two cancel out


def test_the_place_of_a_passage_is_exact() -> None:
    triangle = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    x = np.array([0.25, 0.25, -1.0])
    assert inside._passage(triangle, x, np.array([0.25, 0.25, 3.0])) == Fraction(1, 4)
    assert inside._passage(triangle, x, np.array([0.25, 0.25, -0.5])) is None
    assert inside._passage(triangle, x, np.array([9.0, 0.25, 1.0])) is None
    edge = inside._passage(triangle, np.array([0.5, 0.0, -1.0]), np.array([0.5, 0.0, 1.0]))
    assert edge == Fraction(1, 2)


def test_nothing_is_passed_where_there_is_no_room_to_end() -> None:
    """Below a wall with another half a nanometre above it."""
    flap = {(0, 0), (1, 0), (2, 0), (1, 1), (1, 2), (2, 2)}
    gap = 5e-10
    surface = cells(flap, [-5e-3, -1e-6, 0.0, 5e-3], [-5e-3, 0.0, gap, 2.0 * gap], 4e-3)
    x = np.array([1e-3, 1e-3, -1e-8])
    for height in np.linspace(-9e-9, 3e-9, 60):
        y = np.array([1e-3, 1e-3, height])
        assert inside.leads_out(surface, x, y) == (height < -1e-9), height
