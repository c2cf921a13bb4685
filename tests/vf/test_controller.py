"""Whole ticks: limits, planes, contact, statuses and purity, with the point arm and the PSM.

Every step of every run here is checked by `Run`: joint limits and speeds, the true tip against the
planes and the ball, and against the mesh itself by exact segment–triangle tests.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
import trimesh

import robots
import vf
from tests.support import naive
from tests.support.everyday import everyday
from tests.support.ticks import UM, Run, fixed, plate, point, pose, psm_over
from vf import Status

# Limits, planes and the ball, over random targets


@pytest.mark.parametrize("radius", [0.5e-3, 5e-3, None])
@pytest.mark.parametrize("name", ["star-prism", "saddle-slab"])
def test_random_targets_with_the_point(name, radius):
    surface = naive.catalogue(name)
    rng = np.random.default_rng(1)
    centre = surface.vertices.mean(axis=0)
    high = surface.vertices[:, 2].max()
    start = [centre[0], centre[1], high + 1e-3]
    run = point(surface, start, radius=radius)
    low, top = surface.vertices.min(axis=0) - 5e-3, surface.vertices.max(axis=0) + 5e-3
    for _ in range(8):
        run.to(pose(rng.uniform(low, top)), 40)
    statuses = {s.status for s in run.steps}
    assert statuses <= {Status.SOLVED, Status.SHORTENED, Status.RECOVERING, Status.HELD}
    assert sum(s.multipliers.any() for s in run.steps) > 20  # there was contact


def test_random_targets_with_the_psm():
    run, surface = psm_over("skull-coarse")
    rng = np.random.default_rng(2)
    low, top = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    for _ in range(8):
        R = (
            pin.exp3(rng.uniform(0, 1.0) * naive.unit(rng)) @ run.steps[-1].tip.rotation
            if (run.steps)
            else run.arm.tip(run.q).rotation
        )
        run.to(pose(rng.uniform(low, top), R), 60)
    assert sum(s.multipliers.any() for s in run.steps) > 20


@pytest.mark.parametrize("name", robots.names())
def test_joint_limits_are_reached_and_kept(name):
    """Far targets in free space, a start anywhere within the limits, and slow ticks."""
    arm = robots.load(name)
    controller = vf.Controller(arm, [], vf.Settings(dt=0.02))
    rng = np.random.default_rng(3)
    at_limit = False
    for _ in range(10):
        run = Run(controller, rng.uniform(arm.lower, arm.upper))
        goal = pin.SE3(pin.exp3(3.0 * rng.random() * naive.unit(rng)), 0.9 * naive.unit(rng))
        for _ in range(100):
            step = run.step(goal)
            near = (step.q >= run.arm.upper).astype(int) - (step.q <= run.arm.lower)
            assert (step.limits == near).all()
            at_limit |= bool(near.any())
    assert at_limit


def test_joints_beyond_their_limits_come_back_and_go_no_further():
    arm = robots.load("psm")
    controller = vf.Controller(arm, [], vf.Settings())
    q = arm.neutral.copy()
    q[1], q[2] = arm.upper[1] + 0.01, arm.upper[2] + 1e-3
    run = Run(controller, q)
    goal = arm.tip(arm.neutral)
    for _ in range(400):
        step = run.step(goal)
    assert (step.q >= arm.lower).all()
    assert (step.q <= arm.upper).all()


# Free motion


@pytest.mark.parametrize("name", ["point", "psm", "panda", "ur5"])
def test_a_free_target_is_reached_within_a_micrometre_and_held(name):
    arm = robots.load(name)
    controller = vf.Controller(arm, [], vf.Settings())
    run = Run(controller, arm.neutral)
    here = arm.tip(arm.neutral)
    R = here.rotation if name == "point" else pin.exp3(np.array([0.1, -0.05, 0.08])) @ here.rotation
    goal = pose(here.translation + np.array([6e-3, -4e-3, 5e-3]), R)
    step = run.to(goal, 800)
    assert np.linalg.norm(run.tip - goal.translation) < 1 * UM
    assert np.linalg.norm(pin.log3(step.tip.rotation.T @ R)) < 2e-5
    assert step.status is Status.SOLVED
    assert step.solver is vf.Solver.FREE
    for _ in range(50):
        before = run.tip
        run.step(goal)
        assert np.linalg.norm(run.tip - before) < 0.01 * UM


def test_the_tip_heads_straight_for_a_free_target():
    run = point(None, [0.0, 0.0, 0.0])
    goal = np.array([3e-3, 1e-3, -2e-3])
    run.to(pose(goal), 60)
    path = np.array(run.tips)
    off = np.linalg.norm(np.cross(path, goal / np.linalg.norm(goal)), axis=1)
    assert off.max() < 1 * UM
    assert np.linalg.norm(run.tip - goal) < 1 * UM


def test_off_passes_through():
    surface = plate()
    controller = vf.Controller(robots.load("point"), fixed(surface, "off"), vf.Settings())
    run = Run(controller, [0.0, 0.0, 1e-3])
    step = run.to(pose([0.0, 0.0, -1e-3]), 30)
    assert np.linalg.norm(run.tip - [0, 0, -1e-3]) < 1 * UM
    assert len(step.planes) == 0
    assert step.status is Status.SOLVED


# Contact


@pytest.mark.parametrize("rule", ["certified", "paper", "all"])
def test_pressing_on_a_plate_rests_at_the_standoff(rule):
    surface = plate()
    controller = vf.Controller(robots.load("point"), fixed(surface, rule), vf.Settings())
    run = Run(controller, [1e-3, 2e-3, 2e-3], surface)
    goal = pose([1e-3, 2e-3, -3e-3])
    run.to(goal, 100)
    rest = []
    for _ in range(200):
        step = run.step(goal)
        rest.append(run.tip)
    rest = np.array(rest)
    assert np.abs(rest[:, 2] - 20 * UM).max() < 2 * UM
    assert np.ptp(rest, axis=0).max() < 1 * UM
    assert np.abs(rest[:, :2] - [1e-3, 2e-3]).max() < 1 * UM
    assert step.status is Status.SOLVED
    # 3.02 mm at 150 N/m, upwards.
    assert np.allclose(step.force, [0, 0, 150 * 3.02e-3], atol=1e-3)
    assert step.distance == pytest.approx(20 * UM, abs=2 * UM)
    assert step.multipliers.max() > 0


@pytest.mark.parametrize("name", everyday(["skull-coarse", "saddle-slab", "gear"], "gear"))
@pytest.mark.parametrize("arm", ["point", "psm"])
def test_pressing_anywhere_does_not_chatter(name, arm):
    rng = np.random.default_rng(4)
    if arm == "psm":
        run, surface = psm_over(name)
    else:
        surface = naive.catalogue(name)
        top = surface.vertices[:, 2].max()
        centre = surface.vertices.mean(axis=0)
        run = point(surface, [centre[0], centre[1], top + 2e-3])
    R = run.arm.tip(run.q).rotation
    for _ in range(2):
        below = rng.choice(surface.vertices)
        goal = pose([below[0], below[1], below[2] - 4e-3], R)
        run.to(goal, 600)
        rest = []
        for _ in range(200):
            run.step(goal)
            rest.append(run.tip)
        assert np.ptp(np.array(rest), axis=0).max() < 1 * UM, goal.translation.tolist()


def test_a_finite_tip_rests_a_radius_higher():
    surface = plate()
    run = point(surface, [0.0, 0.0, 4e-3], tip_radius=1e-3)
    run.to(pose([0.0, 0.0, -3e-3]), 150)
    assert run.tip[2] == pytest.approx(1e-3 + 20 * UM, abs=2 * UM)


@pytest.mark.parametrize("rule", ["certified", "paper"])
def test_sliding_along_a_wall(rule):
    """Pushed in and along, the tool goes along at its full speed and keeps its height."""
    surface = plate()
    controller = vf.Controller(robots.load("point"), fixed(surface, rule), vf.Settings())
    run = Run(controller, [-10e-3, 0.0, 1e-3], surface)
    run.to(pose([-10e-3, 0.0, -1e-3]), 50)
    goal = pose([10e-3, 5e-3, -1e-3])
    heights = []
    for _ in range(300):
        run.step(goal)
        heights.append(run.tip[2])
    assert np.abs(run.tip[:2] - [10e-3, 5e-3]).max() < 1 * UM
    assert np.abs(np.array(heights) - 20 * UM).max() < 3 * UM


def test_sliding_into_a_corner_rests_in_it():
    surface = naive.catalogue("l-block")
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    # The block's valley is where a ray from above the middle ends lower than the top.
    x = np.array([high[0] - 8e-3, 0.5 * (low[1] + high[1]), high[2] + 2e-3])
    run = point(surface, x.tolist())
    goal = pose([low[0] + 5e-3, x[1], low[2] + 5e-3])
    run.to(goal, 600)
    rest = run.tip.copy()
    run.to(goal, 100)
    assert np.linalg.norm(run.tip - rest) < 1 * UM


@pytest.mark.parametrize("gap", [60 * UM, 39 * UM, 30 * UM, 10 * UM, 2 * UM])
def test_walls_closer_than_two_standoffs_do_not_freeze_the_tool(gap):
    """In a slot the tool stays between the walls, slides along it and out of it."""
    lower = trimesh.creation.box((0.02, 0.02, 2e-3))
    shift = np.array([0.0, 0.0, 1e-3 + gap / 2])
    vertices = np.concatenate([lower.vertices - shift, lower.vertices + shift])
    surface = vf.Surface.from_arrays(vertices, np.concatenate([lower.faces, lower.faces + 8]))
    for z in (0.0, 0.3 * gap, -0.45 * gap):
        run = point(surface, [1e-3, 2e-3, z])
        run.to(pose([5e-3, 2e-3, 3e-3]), 200)
        assert np.abs(run.tip[2]) < gap / 2
        assert np.abs(run.tip[:2] - [5e-3, 2e-3]).max() < 5 * UM
        run.to(pose([20e-3, 2e-3, -3e-3]), 200)
        assert run.tip[0] > 10e-3, "out of the slot"


def test_a_tool_below_the_standoff_is_led_out():
    surface = plate()
    run = point(surface, [0.0, 0.0, 3 * UM])
    step = run.step(pose([0.0, 0.0, 3 * UM]))
    assert step.status is Status.RECOVERING
    assert run.tip[2] > 3 * UM
    run.to(pose([0.0, 0.0, 3 * UM]), 60)
    assert run.tip[2] == pytest.approx(20 * UM, abs=2 * UM)
    heights = np.array(run.tips)[:, 2]
    assert (np.diff(heights) > -0.1 * UM).all()  # never deeper


# Inside and flipped meshes


@pytest.mark.parametrize("flip", [False, True])
def test_a_tool_inside_comes_out_and_never_gets_deeper(flip):
    solid = trimesh.creation.box((0.02, 0.02, 0.02)).subdivide()
    faces = solid.faces[:, ::-1] if flip else solid.faces
    surface = vf.Surface.from_arrays(solid.vertices, faces)

    def depth(p: np.ndarray) -> float:
        return 0.01 - np.abs(p).max()

    for goal in ([0.0, 0.0, 0.0], [0.0, 0.0, 0.03], [0.009, -0.009, 0.0], [0.03, 0.03, 0.03]):
        run = point(surface, [1e-3, 2e-3, 6e-3])
        deepest = depth(run.tip)
        for tick in range(250):
            step = run.step(pose(goal))
            if tick == 0:
                assert step.status is Status.INSIDE
            now = depth(run.tip)
            if deepest > 0:
                assert now <= deepest + 1e-12, (goal, tick)
                deepest = now
            else:
                assert now < 0  # once out, out
        if goal == [0.0, 0.0, 0.03]:
            assert run.tip == pytest.approx(goal, abs=UM)


@pytest.mark.parametrize("height", [0.0, 1e-18, 1e-16, 1e-15])
@pytest.mark.parametrize("gap", [5 * UM, 30 * UM])
def test_a_tool_on_the_floor_beside_a_wall_does_not_enter_it(height, gap):
    """On the surface within rounding the way out is up, not along into what stands there."""
    wall = trimesh.creation.box((0.02, 0.02, 0.04))
    floor = trimesh.creation.box((0.02, 0.02, 0.02))
    vertices = np.concatenate(
        [floor.vertices - np.array([0.01, 0, 0.01]), wall.vertices + np.array([0.01, 0, 0])]
    )
    surface = vf.Surface.from_arrays(vertices, np.concatenate([floor.faces, wall.faces + 8]))
    run = point(surface, [-gap, 1e-3, height])
    run.to(pose([3e-3, 1e-3, 0.0]), 50)
    assert run.tip[0] < 0
    assert run.tip[2] >= 0


@pytest.mark.parametrize("tip_radius", [0.5e-3, 4e-3, 4.5e-3, 4.8e-3])
def test_a_tip_that_overlaps_the_surface_gets_no_deeper(tip_radius):
    """In a rough cavity nearly or more than filled by the tip; the largest spend all planes."""
    rng = np.random.default_rng(6)
    cavity = trimesh.creation.icosphere(4)
    rough = 5e-3 * cavity.vertices * (1 + 0.04 * rng.normal(size=(len(cavity.vertices), 1)))
    shell = trimesh.creation.box((0.03, 0.03, 0.03))
    surface = vf.Surface.from_arrays(
        np.concatenate([rough, shell.vertices]),
        np.concatenate([cavity.faces[:, ::-1], shell.faces + len(rough)]),
    )
    brute = naive.Brute(surface)
    for direction in np.eye(3):
        start = max(0.0, 4.3e-3 - 0.8 * tip_radius) * direction  # overlapping from the start
        run = point(surface, start.tolist(), tip_radius=tip_radius)
        before = brute.nearest(run.tip)
        for _ in range(60):
            run.step(pose(8e-3 * direction))
            now = brute.nearest(run.tip)
            assert now >= min(before, tip_radius) - 1e-9, (before, now, run.tip.tolist())
            before = now


@pytest.mark.parametrize("flipped", [[4, 6], [4], [0, 3, 7]])
def test_flipped_faces_of_a_closed_mesh_are_not_crossed(flipped):
    solid = trimesh.creation.box((0.02, 0.02, 0.02))
    faces = solid.faces.copy()
    faces[flipped] = faces[flipped][:, ::-1]
    surface = vf.Surface.from_arrays(solid.vertices, faces)
    centres = solid.vertices[solid.faces].mean(axis=1)
    for k in flipped:
        start = centres[k] + 1e-4 * solid.face_normals[k]
        run = point(surface, start.tolist())
        run.to(pose([0.0, 0.0, 0.0]), 50)  # Run checks every step for crossings
        assert np.abs(run.tip).max() > 0.01


@pytest.mark.parametrize("robot", ["point", "psm", "ur5"])
def test_the_tip_keeps_to_its_speed_limit_and_still_arrives(robot):
    """In free space and into a wall; what the limit allows is used."""
    arm = robots.load(robot)
    start = arm.tip(arm.neutral)
    surface = plate(start.translation[2] - 2e-3)
    surface = vf.Surface.from_arrays(
        surface.vertices + np.array([*start.translation[:2], 0.0]), surface.faces
    )
    speed, dt = 0.03, 1e-3
    controller = vf.Controller(arm, fixed(surface), vf.Settings(dt=dt, tip_speed=speed))
    run = Run(controller, arm.neutral, surface)
    goal = pose(start.translation + np.array([4e-3, 1e-3, -3e-3]), start.rotation)
    run.to(goal, 300)
    moved = np.linalg.norm(np.diff(run.tips, axis=0), axis=1)
    # The limit holds for the linear motion: an arm's curvature over a tick is far below 0.1 %.
    assert moved.max() <= speed * dt * 1.001
    assert moved[10:40].mean() > 0.95 * speed * dt
    assert run.tip[:2] == pytest.approx(goal.translation[:2], abs=2e-5)


# Purity, force, timings


@pytest.mark.parametrize("name", ["point", "psm"])
def test_steps_do_not_depend_on_earlier_calls(name):
    """A recorded run fed tick by tick, out of order, to other controllers: the same bits."""
    if name == "psm":
        run, surface = psm_over("skull-coarse")
    else:
        surface = naive.catalogue("skull-coarse")
        run = point(surface, [0.0, 0.0, surface.vertices[:, 2].max() + 1e-3])
    rng = np.random.default_rng(5)
    R = run.arm.tip(run.q).rotation
    record = []
    for _ in range(5):
        goal = pose(rng.choice(surface.vertices) - [0, 0, 3e-3], R)
        for _ in range(40):
            before = run.q
            record.append((before, goal, run.step(goal)))
    other = vf.Controller(robots.load(name), fixed(surface), vf.Settings())
    for k in rng.permutation(len(record)):
        q, goal, expected = record[k]
        step = other.step(q, goal)
        assert step.q.tobytes() == expected.q.tobytes(), k
        assert step.status is expected.status, k
        assert step.solver is expected.solver, k
        assert step.force.tobytes() == expected.force.tobytes(), k
        assert step.multipliers.tobytes() == expected.multipliers.tobytes(), k
        assert step.planes.normals.tobytes() == expected.planes.normals.tobytes(), k


def test_the_arguments_are_left_alone_and_the_results_read_only():
    surface = plate()
    controller = vf.Controller(robots.load("point"), fixed(surface), vf.Settings())
    q, goal = np.array([0.0, 0.0, 1e-3]), pose([0.0, 0.0, -1e-3])
    step = controller.step(q, goal)
    assert (q == [0.0, 0.0, 1e-3]).all()
    assert (goal.translation == [0.0, 0.0, -1e-3]).all()
    kept = step.q.copy(), step.planes.normals.copy()
    for _ in range(20):
        controller.step(step.q, pose([5e-3, 0.0, -1e-3]))
    assert (step.q == kept[0]).all()
    assert (step.planes.normals == kept[1]).all()
    for array in (step.q, step.force, step.multipliers, step.limits, step.planes.normals):
        assert not array.flags.writeable


def test_the_force_is_the_gain_times_what_the_fixture_took_up_to_the_cap():
    surface = plate()
    run = point(surface, [0.0, 0.0, 1e-3], force_gain=1000.0, force_cap=2.0)
    for depth, expected in ((1e-3, 1000.0 * (1e-3 + run_height)), (10e-3, 2.0)):
        step = run.to(pose([0.0, 0.0, -depth]), 60)
        assert step.force[2] == pytest.approx(expected, abs=3e-3)
        assert np.abs(step.force[:2]).max() < 1e-3
        assert np.allclose(
            step.force,
            vf.force(run.tip, np.array([0, 0, -depth]), 1000.0, 2.0),
        )


run_height = 20e-6  # [m] the default standoff


def test_the_parts_of_a_tick_add_up():
    run = point(plate(), [0.0, 0.0, 1e-3])
    for _ in range(20):
        t = run.step(pose([0.0, 0.0, -1e-3])).timings
        parts = t.kinematics + t.planes + t.qp + t.verify
        assert parts == pytest.approx(t.total, rel=1e-6, abs=1e-9)
        assert min(t) >= 0


def test_several_fixtures_hold_together():
    """A floor and a wall as two fixtures: the tool ends in their corner."""
    floor, wall = plate(), plate()
    upright = vf.Surface.from_arrays(wall.vertices[:, [2, 0, 1]], wall.faces)  # its top at x = 0
    arm = robots.load("point")
    fixtures = [vf.MeshFixture(floor), vf.MeshFixture(upright, radius=2e-3)]
    run = Run(vf.Controller(arm, fixtures, vf.Settings()), [3e-3, 0.0, 3e-3])
    step = run.to(pose([-2e-3, 1e-3, -2e-3]), 150)
    assert run.tip == pytest.approx([20 * UM, 1e-3, 20 * UM], abs=2 * UM)
    assert step.radius == 2e-3


class Aloof:
    """A fixture that hands out arrays only, as one of the user's own would."""

    def __init__(self, fixture):
        self.radius, self.certified = fixture.radius, fixture.certified
        self.planes, self.inside, self.leads_out = fixture.planes, fixture.inside, fixture.leads_out


@pytest.mark.parametrize("aloof", [(True, True), (True, False), (False, True)])
def test_it_is_the_same_to_the_bit_whether_fixtures_fill_the_buffer_or_not(aloof):
    arm = robots.load("psm")
    tip = arm.tip(arm.neutral).translation
    wall = plate(tip[2] - 2e-3)
    path = tip + np.array([[-0.02, 0.0, 0.0], [0.0, 5e-4, 0.0], [0.02, 0.0, 0.0]])
    fixtures = [vf.MeshFixture(wall), vf.CorridorFixture(path, [0.0, 0.0, 1.0], 1e-3)]
    asked = [Aloof(f) if a else f for f, a in zip(fixtures, aloof, strict=True)]
    filled, given = (vf.Controller(arm, chosen) for chosen in (fixtures, asked))
    rng = np.random.default_rng(12)
    q = arm.neutral
    rules = set()
    for _ in range(40):
        goal = pose(tip + rng.uniform(-1.0, 1.0, 3) * [8e-3, 4e-3, 5e-3], arm.tip(q).rotation)
        for _ in range(10):
            one, other = filled.step(q, goal), given.step(q, goal)
            assert one.q.tobytes() == other.q.tobytes()
            assert (one.status, one.solver) == (other.status, other.solver)
            for name in ("normals", "offsets", "points", "triangles", "rules"):
                a, b = getattr(one.planes, name), getattr(other.planes, name)
                np.testing.assert_array_equal(a, b)
            assert one.planes.radius == other.planes.radius
            np.testing.assert_array_equal(one.multipliers, other.multipliers)
            np.testing.assert_array_equal(one.force, other.force)
            rules |= set(one.planes.rules.tolist())
            q = one.q
    assert {vf.Rule.FACE, vf.Rule.CORRIDOR} <= rules
