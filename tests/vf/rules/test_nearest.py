"""The rules to compare with: one plane at the nearest point, one of a sampled distance field."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import robots
import vf
from vf.rules.nearest import CELL, DistanceField

CUBE = trimesh.creation.box((0.02, 0.02, 0.02))


def surface(mesh: trimesh.Trimesh) -> vf.Surface:
    return vf.Surface.from_arrays(mesh.vertices, mesh.faces)


def cube_distance(x: np.ndarray) -> float:
    """Signed distance to the cube, by its formula."""
    beyond = np.abs(x) - 0.01
    return float(np.linalg.norm(np.maximum(beyond, 0.0)) + min(beyond.max(), 0.0))


@pytest.mark.parametrize("rule", ["nearest", "sdf"])
def test_one_plane_faces_the_tool_and_keeps_the_standoff(rule):
    fixture = vf.MeshFixture(surface(CUBE), rule)
    planes = fixture.planes(np.array([0.003, 0.002, 0.012]), 5e-3, 20e-6, 1e-3, False)
    assert planes.normals == pytest.approx(np.array([[0.0, 0.0, 1.0]]), abs=1e-9)
    assert planes.offsets == pytest.approx([0.01 + 20e-6 + 1e-3], abs=1e-9)
    assert planes.points == pytest.approx(np.array([[0.003, 0.002, 0.01]]), abs=1e-9)
    assert not fixture.certified
    kind = vf.Rule.NEAREST if rule == "nearest" else vf.Rule.SAMPLED
    assert planes.rules.tolist() == [kind]


@pytest.mark.parametrize("rule", ["nearest", "sdf"])
def test_out_of_reach_there_is_none(rule):
    fixture = vf.MeshFixture(surface(CUBE), rule)
    assert len(fixture.planes(np.array([0.0, 0.0, 0.0162]), 5e-3, 20e-6, 1e-3, False)) == 0
    assert len(fixture.planes(np.array([0.0, 0.0, 0.0159]), 5e-3, 20e-6, 1e-3, False)) == 1


def test_inside_the_nearest_plane_leads_out():
    fixture = vf.MeshFixture(surface(CUBE), "nearest")
    planes = fixture.planes(np.array([0.001, 0.0, 0.009]), 5e-3, 20e-6, 0.0, True)
    assert planes.normals == pytest.approx(np.array([[0.0, 0.0, 1.0]]))
    assert planes.rules.tolist() == [vf.Rule.EXIT], "nothing pushes the tool out"


def test_on_the_surface_the_nearest_plane_is_the_faces():
    fixture = vf.MeshFixture(surface(CUBE), "nearest")
    x = np.array([0.01, 0.002, 0.003])
    planes = fixture.planes(x, 5e-3, 20e-6, 0.0, False)
    assert planes.normals == pytest.approx(np.array([[1.0, 0.0, 0.0]]))
    assert planes.offsets[0] < x[0], "standing still is allowed"


def test_the_field_is_the_distance_at_its_samples_and_linear_along_an_edge_of_its_grid():
    field = DistanceField(surface(CUBE))
    rng = np.random.default_rng(3)
    for place in rng.integers(-40, 40, (200, 3)).tolist():
        x = CELL * np.array(place, dtype=float)
        assert field.sample(tuple(place)) == pytest.approx(cube_distance(x), abs=1e-12)
        assert field.at(x)[0] == pytest.approx(cube_distance(x), abs=1e-12)
        ahead = x + 0.25 * CELL * np.eye(3)[0]
        ends = [cube_distance(x), cube_distance(x + CELL * np.eye(3)[0])]
        assert field.at(ahead)[0] == pytest.approx(0.75 * ends[0] + 0.25 * ends[1], abs=1e-12)


def test_the_gradient_is_that_of_the_interpolated_distance():
    field = DistanceField(surface(CUBE))
    rng = np.random.default_rng(4)
    h = 1e-9
    for x in rng.uniform(-0.015, 0.015, (200, 3)):
        if (np.abs(x / CELL - np.rint(x / CELL)) < 1e-3).any():
            continue  # beside a border of cells, where it jumps
        slope = [(field.at(x + h * e)[0] - field.at(x - h * e)[0]) / (2.0 * h) for e in np.eye(3)]
        assert field.at(x)[1] == pytest.approx(np.array(slope), abs=1e-5)


def press(mesh: trimesh.Trimesh, rule: str, start: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Tips (k, 3) of the point robot, led from one place to another."""
    arm = robots.load("point")
    controller = vf.Controller(arm, [vf.MeshFixture(surface(mesh), rule)], vf.Settings(dt=0.01))
    target = arm.tip(arm.neutral)
    target.translation = start
    q = arm.inverse(target, start=arm.neutral)
    target.translation = goal
    tips = []
    for _ in range(400):
        step = controller.step(q, target)
        q = step.q
        tips.append(np.array(step.tip.translation))
    return np.array(tips)


WEDGE = trimesh.Trimesh(  # a narrow valley along y, open upwards
    [
        *([-0.01, -1, 0.05], [0.0, -1, 0.0], [0.01, -1, 0.05]),
        *([-0.01, 1, 0.05], [0.0, 1, 0.0], [0.01, 1, 0.05]),
    ],
    [[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]],
    process=False,
)  # fmt: skip


def walls_crossed(tips: np.ndarray) -> bool:
    """Whether a tip is not between the two walls any more."""
    return bool((np.abs(tips[:, 0]) > 0.2 * tips[:, 2]).any())


def test_between_two_walls_one_plane_is_not_enough():
    """A step away from the nearer wall passes the other one, which is in no row."""
    start, goal = np.array([0.0005, 0.0, 0.01]), np.array([0.03, 0.0, 0.0102])
    assert not walls_crossed(press(WEDGE, "certified", start, goal))
    start = np.array([-0.0005, 0.0, 0.005])  # nearer to the left wall
    goal = np.array([0.03, 0.0, 0.005])
    assert not walls_crossed(press(WEDGE, "certified", start, goal))
    assert walls_crossed(press(WEDGE, "nearest", start, goal))


@pytest.mark.parametrize(
    ("rule", "through"), [("certified", False), ("nearest", False), ("sdf", True)]
)
def test_a_sheet_thinner_than_a_cell_vanishes_between_samples(rule, through):
    sheet = trimesh.creation.box((0.05, 0.05, 0.4 * CELL))
    sheet.apply_translation([0.0, 0.0, 0.5 * CELL])
    tips = press(sheet, rule, np.array([0.0002, 0.0002, 0.004]), np.array([0.0002, 0.0002, -0.02]))
    assert (tips[-1, 2] < -0.005) == through
