"""Attacks on the walk of the certified rule: more planes wanted than a walk may take."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
import trimesh

import robots
import vf
from tests.support import exact, naive
from vf.layout import PLANE
from vf.planes import Planes, planes_of
from vf.rules.certified import EASE, walk_alone
from vf.rules.margins import NO_MARGIN

STANDOFF = 1e-3
RADIUS = 5e-3
MOST = 64  # planes a walk may take: docs/certified.md


def turned(rng: np.random.Generator) -> np.ndarray:
    """Some rotation (3, 3)."""
    return np.asarray(pin.exp3(rng.normal(size=3) * 2.0))


def pins(rng: np.random.Generator, count: int, distance: float) -> np.ndarray:
    """Points (count, 3, 3) on a cap around the origin, each of which wants a plane: three corners
    at one place, so that no plane but the one across the way to it will do.
    """
    k = np.arange(count) + 0.5
    z = 1.0 - k / count * (1.0 - np.cos(np.radians(50.0)))
    angle = np.pi * (1.0 + 5.0**0.5) * k
    ring = np.sqrt(1.0 - z * z)
    centres = distance * np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)
    centres *= 1.0 + 1e-3 * rng.uniform(size=(count, 1))
    return np.repeat(centres[:, None], 3, axis=1)


def trapped(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Pins on one side of the origin and a wall on the other, and the way to the wall (3,)."""
    distance = STANDOFF * 10.0 ** rng.uniform(-2.0, -1.0)
    far = rng.uniform(2.0, 20.0) * distance
    wall = far * np.array([[[-0.5, -0.5, -1.0], [0.5, -0.5, -1.0], [0.0, 0.5, -1.0]]])
    turn = turned(rng)
    triangles = np.concatenate([pins(rng, count, distance), wall]) @ turn.T
    return triangles[rng.permutation(count + 1)], -3.0 * far * turn[:, 2]


def fixtures(surface: vf.Surface, others: int, corridor: bool) -> list[vf.Fixture]:
    """The surface, `others` that are far away, and perhaps a corridor that is wide."""
    away = exact.soup(np.array([[[0.25, 0.25, 0.25], [0.26, 0.25, 0.25], [0.25, 0.26, 0.25]]]))
    found: list[vf.Fixture] = [vf.MeshFixture(surface, radius=RADIUS)]
    found += [vf.MeshFixture(away, radius=RADIUS) for _ in range(others)]
    if corridor:
        path = [[-0.2, 0.0, 0.0], [0.2, 0.0, 0.0]]
        found.append(vf.CorridorFixture(path, [0.0, 0.0, 1.0], width=0.1, radius=RADIUS))
    return found


def walked(surface: vf.Surface, x: np.ndarray, room: int) -> Planes:
    """What a walk finds that has room for so many planes."""
    planes, tree = np.empty((room, PLANE)), surface.tree
    m, reach = walk_alone(
        tree.nodes, tree.corners, tree.order, tree.errors, surface.edges, *NO_MARGIN, False,
        x, RADIUS, STANDOFF, 0.0, EASE, planes,
    )  # fmt: skip
    return planes_of(planes[:m], reach)


@pytest.mark.parametrize("queries", [1, 2, 3, 8])
def test_a_walk_takes_no_more_planes_than_it_may_whatever_room_there_is(queries: int) -> None:
    most = 0
    # First what would take more than 64 without harm, so that a failure is an answer.
    for count in (66, 80, 100, 120, 127, 128, 129, 150, 190, 300):
        rng = np.random.default_rng(count)
        triangles, _ = trapped(rng, count)
        surface = exact.soup(triangles)
        found = walked(surface, np.zeros(3), queries * MOST)
        assert len(found) <= MOST, f"{count} pins, room for {queries} walks"
        most = max(most, len(found))
        assert exact.leaking(triangles, found, np.zeros(3)).size == 0
        alone = vf.certified_planes(surface, np.zeros(3), RADIUS, STANDOFF)
        np.testing.assert_array_equal(found.normals, alone.normals)
        assert found.radius == alone.radius
    assert most == MOST  # the scenes do want more


@pytest.mark.parametrize(
    ("others", "corridor"), [(1, False), (2, False), (4, False), (0, True), (1, True)]
)
def test_several_fixtures_let_nothing_through(others: int, corridor: bool) -> None:
    arm = robots.load("point")
    start = np.array(arm.neutral)
    x = arm.tip(start).translation
    # The first scenes take more than 64 planes but fewer than 128, see above.
    for case, count in enumerate((90, 100, 110, 126, 127, 128, 129, 140, 155, 170, 185)):
        triangles, way = trapped(np.random.default_rng(case), count)
        triangles = triangles + x
        everything = fixtures(exact.soup(triangles), others, corridor)
        controller = vf.Controller(arm, everything, vf.Settings(standoff=STANDOFF, dt=0.02))
        q = start
        for _ in range(5):
            goal = pin.SE3(np.eye(3), arm.tip(q).translation + way)
            step = controller.step(q, goal)
            # All of one mesh: the others are out of reach, and a corridor's have no triangle.
            assert (step.planes.triangles >= 0).sum() <= MOST
            a, b = arm.tip(q).translation, arm.tip(step.q).translation
            assert exact.crossed(triangles, a, b).size == 0, f"{count} pins, {step.status.name}"
            q = step.q


def test_a_cavity_smaller_than_the_standoff_is_no_more_than_a_walk_may_take() -> None:
    rng = np.random.default_rng(1)
    ball = trimesh.creation.icosphere(4, 3e-4)
    triangles = np.array(ball.triangles) * (1.0 + 0.05 * rng.normal(size=(len(ball.faces), 3, 1)))
    surface = exact.soup(triangles)
    most = 0
    for _ in range(12):
        x = rng.normal(size=3) * 3e-5
        found = walked(surface, x, 3 * MOST)
        assert len(found) <= MOST
        most = max(most, len(found))
        assert exact.leaking(triangles, found, x).size == 0
    assert most > 10


def bowl() -> vf.Surface:
    """Half a sphere of 8 mm, finely faceted, around the origin and open upwards."""
    ball = trimesh.creation.icosphere(4, 8e-3)
    return vf.Surface.from_arrays(ball.vertices, ball.faces[ball.triangles_center[:, 2] < 0.0])


def test_a_tip_that_overlaps_more_facets_than_there_may_be_planes_is_led_out() -> None:
    controller = vf.Controller(
        robots.load("point"), [vf.MeshFixture(bowl())], vf.Settings(tip_radius=6e-3)
    )
    start = np.array([1e-5, 2e-5, -2.1e-3])  # 0.1 mm too deep
    q = start
    for _ in range(30):
        q = controller.step(q, pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.01]))).q
    assert q[2] > start[2] + 1e-3


def test_a_step_of_an_overlapping_tip_meets_nothing_and_goes_no_deeper() -> None:
    rng = np.random.default_rng(8)
    surface = bowl()
    triangles = exact.triangles_of(surface)
    for _ in range(60):
        x = rng.normal(size=3) * 2e-3
        distance = naive.brute(surface).nearest(x)
        tip = distance * (1.0 + 10.0 ** rng.uniform(-4.0, 0.0))
        planes = vf.certified_planes(surface, x, distance, 20e-6, tip)
        assert exact.leaking(triangles, planes, x).size == 0  # of the centre
        assert planes.floors is not None
        assert (planes.floors < planes.offsets).all()
        for y in x + rng.normal(size=(30, 3)) * 0.3 * planes.radius:
            for _ in range(3):
                slack = planes.slack(y)
                y = y - 1.000001 * min(slack.min(), 0.0) * planes.normals[slack.argmin()]
            if exact.obeys(planes, x, y):
                assert naive.brute(surface).nearest(y) > distance - 1.1e-8
