"""Structures that deform: what a tick makes of them, judged by their true motion."""

from __future__ import annotations

import pickle
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest

import robots
import vf
from tests.support import deforming, moving, naive
from tests.support.balls import ball, bumped
from tests.support.ticks import UM, plate, pose
from vf import Status
from vf.tick.moving import shape_of
from vf.tree.shapes import shift_near

STANDOFF = 20 * UM
HERE = pin.SE3.Identity()


def over(surface: vf.Surface, arm: str = "point", **options: float) -> vf.Controller:
    return vf.Controller(robots.load(arm), [vf.MeshFixture(surface)], vf.Settings(**options))


def corners(surface: vf.Surface, vertices: np.ndarray | None = None) -> np.ndarray:
    return (surface.vertices if vertices is None else vertices)[surface.faces]


def near(
    surface: vf.DeformingSurface, x: np.ndarray, radius: float, start: float, share: float
) -> tuple[float, ...]:
    """What `shift_near` says of a point (3,)."""
    controller = over(surface)
    search = controller._block.searches[0]
    shape, nodes = shape_of(search, start), controller._block._scratch[0][2]
    return shift_near(nodes, surface.shifts, shape, tuple(map(float, x)), radius, share)


def blended(surface: vf.DeformingSurface, blend: float) -> np.ndarray:
    """(m, 3, 3) corners at a blend."""
    moved = (1.0 - blend) * surface.vertices + blend * surface.vertices_after
    return moved[surface.faces]


def test_a_surface_that_does_not_change_is_guarded_as_one_that_cannot() -> None:
    surface, q = plate(), np.array([0.0, 0.0, 1e-3])
    goal = pose([1e-3, 2e-3, -5e-3])
    same = surface.deforming(surface.vertices)
    one, other, third = over(surface), over(same), over(same)
    for k in range(40):
        a = one.step(q, goal)
        b = other.step(q, goal)
        c = third.step(q, goal, motions=[vf.Motion(HERE, HERE, blend=(k / 40, (k + 1) / 40))])
        assert np.abs(a.q - b.q).max() < 1e-12
        assert np.abs(a.q - c.q).max() < 1e-9
        assert a.status is b.status is c.status is Status.SOLVED
        q = a.q


def test_a_translation_is_as_good_as_a_motion() -> None:
    """Deformed by the same displacement everywhere, or moved: the same ticks."""
    surface = ball()
    rng = np.random.default_rng(2)
    shift = np.array([0.0, 0.0, 2e-3])
    one, other = over(surface), over(surface.deforming(surface.vertices + shift))
    q, T = np.array([1e-3, 2e-3, 0.01]), HERE
    for k in range(50):
        goal = pose(q + 1e-3 * naive.unit(rng))
        after = pin.SE3(np.eye(3), (k + 1) / 50 * shift)
        a = one.step(q, goal, motions=[vf.Motion(T, after)])
        b = other.step(q, goal, motions=[vf.Motion(HERE, HERE, blend=(k / 50, (k + 1) / 50))])
        assert a.status is b.status
        assert np.abs(a.q - b.q).max() < 1e-8
        q, T = a.q, after


def test_a_held_tool_yields_to_a_wall_that_bulges_and_no_more_than_it_has_to() -> None:
    surface = plate(0.0, 0.05)
    rest = surface.vertices.copy()
    raised = rest.copy()
    x = rest[:, :2] / 0.02
    # By 4 mm in the middle.
    raised[:, 2] += 4e-3 * np.exp(-(x**2).sum(axis=1))
    body = surface.deforming(raised)
    controller, q = over(body), np.array([0.003, 0.001, 1e-4])
    for k in range(100):
        before, after = blended(body, k / 100), blended(body, (k + 1) / 100)
        step = controller.step(
            q, pose(q), motions=[vf.Motion(HERE, HERE, blend=(k / 100, (k + 1) / 100))]
        )
        assert step.status is Status.SOLVED
        way = step.q - q
        least = deforming.clearance(
            before, after, lambda s, q=q, way=way: q + s * way, float(np.linalg.norm(way))
        )
        assert least > 0.9 * STANDOFF
        q = step.q
    assert q[2] > 3e-3
    assert naive.closest(after, q)[1].min() < 60 * UM  # it was not pushed farther than it has to


def test_frames_follow_one_another_and_the_side_is_looked_up_once() -> None:
    rng = np.random.default_rng(5)
    surface = ball()
    fixture = vf.MeshFixture(surface)
    asked = []
    looks = vf.Surface.inside
    controller = vf.Controller(robots.load("point"), [fixture], vf.Settings())

    def inside(self: vf.Surface, x: np.ndarray) -> bool:
        asked.append(x)
        return looks(self, x)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(vf.Surface, "inside", inside)
        body: vf.Surface = surface
        q = np.array([0.0, 0.0, 0.0125])
        for _ in range(6):
            now = body.vertices_after if isinstance(body, vf.DeformingSurface) else body.vertices
            body = body.deforming(now + bumped(rng, now, 3e-4))
            controller.replace(0, body)
            for first, last in pairwise(np.linspace(0.0, 1.0, 6)):
                motion = vf.Motion(HERE, HERE, blend=(first, last))
                step = controller.step(q, pose(q - [0.0, 0.0, 1e-3]), motions=[motion])
                assert step.status in (Status.SOLVED, Status.RECOVERING)
                q = step.q
        assert len(asked) == 1
        # A frame that is not a continuation: looked up, on the shape where the tick begins.
        grown = surface.deforming(surface.vertices).deforming(2.0 * surface.vertices)
        controller.replace(0, grown)
        motion = vf.Motion(HERE, HERE, blend=(0.9, 0.9))
        assert controller.step(q, pose(q), motions=[motion]).status is Status.INSIDE
        assert len(asked) == 2
        motion = vf.Motion(HERE, HERE, blend=(0.0, 0.0))
        assert controller.step(q, pose(q), motions=[motion]).status is not Status.INSIDE
        assert len(asked) == 3


def test_what_is_faster_than_the_arm_overtakes_it_by_no_more_than_is_said() -> None:
    surface = ball()
    for growth in (1.1, 1.4):
        body = surface.deforming(growth * surface.vertices)
        controller = over(body)
        q = np.array([0.0, 0.0, 0.01 + 50e-6])
        motion = vf.Motion(HERE, HERE, blend=(0.0, 1.0))
        step = controller.step(q, pose(q), motions=[motion])
        assert step.status is Status.OVERTAKEN
        deep = deforming.depth(corners(surface, body.vertices_after), step.q)
        assert 0.0 < deep <= step.violation < deep + 1e-3


def test_an_overtaken_tool_is_led_out() -> None:
    surface = ball()
    body = surface.deforming(1.2 * surface.vertices)
    controller = over(body)
    q, seen = np.array([0.0, 0.0, 0.01 + 50e-6]), []
    for k in range(400):
        blend = (0.0, 1.0) if k == 0 else (1.0 - (k - 1) / 400, 1.0 - k / 400)
        step = controller.step(q, pose(q), motions=[vf.Motion(HERE, HERE, blend=blend)])
        q = step.q
        seen.append(step.status)
    assert seen[0] is Status.OVERTAKEN
    assert seen[1] is Status.INSIDE
    assert seen[-1] is Status.SOLVED
    assert deforming.depth(blended(body, blend[1]), q) < 0.0


def test_the_shaft_yields_to_what_swells() -> None:
    arm = robots.load("psm")
    q = arm.neutral
    a, b = arm.axes(q)[2]
    wall = ball(0.02, 3)
    place = 0.6 * a + 0.4 * b - [0.02 + arm.capsules[2].radius + 1e-3, 0.0, 0.0]
    T = pin.SE3(np.eye(3), place)
    body = wall.deforming(1.15 * wall.vertices)
    controller = vf.Controller(arm, [vf.MeshFixture(body)], vf.Settings(guard="tool"))
    for k in range(60):
        blend = (k / 60, (k + 1) / 60)
        step = controller.step(q, arm.tip(q), motions=[vf.Motion(T, T, blend=blend)])
        assert step.status in (Status.SOLVED, Status.SHORTENED)
        q = step.q
        a, b = arm.axes(q)[2]
        gap = moving.axis_gap(blended(body, blend[1]), T.actInv(a), T.actInv(b))
        assert gap - arm.capsules[2].radius > 0.5 * STANDOFF
    assert gap - arm.capsules[2].radius < 10 * STANDOFF


@pytest.mark.parametrize("rule", ["certified", "paper", "all", "nearest", "sdf"])
def test_every_rule_takes_a_shape(rule: str) -> None:
    surface = plate()
    body = surface.deforming(surface.vertices + np.array([0.0, 0.0, 2e-3]))
    controller = vf.Controller(robots.load("point"), [vf.MeshFixture(body, rule)])
    q = np.array([0.0, 0.0, 1e-4])
    for k in range(40):
        motion = vf.Motion(HERE, HERE, blend=(k / 40, (k + 1) / 40))
        q = controller.step(q, pose(q), motions=[motion]).q
    assert q[2] - 2e-3 == pytest.approx(STANDOFF, abs=3 * UM)


def test_a_wall_whose_parts_move_apart_is_not_met() -> None:
    """What a plane covers rises here and sinks there: it goes along with what rises."""
    surface = plate(0.0, 0.02)
    v = surface.vertices
    for slope in (0.02, -0.02):
        rise = np.where(v[:, 2] > -1e-3, np.clip(slope * v[:, 0], -60 * UM, 60 * UM), 0.0)
        body = surface.deforming(v + rise[:, None] * [0.0, 0.0, 1.0])
        controller = over(body)
        q = np.array([np.sign(slope) * 3e-3, 0.0, 40e-6])
        motion = vf.Motion(HERE, HERE, blend=(0.0, 1.0))
        step = controller.step(q, pose(q + np.array([np.sign(slope) * 1e-4, 0.0, 0.0])), [motion])
        way = step.q - q
        least = deforming.clearance(
            corners(surface), corners(surface, body.vertices_after),
            lambda s, way=way, q=q: q + s * way, float(np.linalg.norm(way)),
        )  # fmt: skip
        assert step.status is Status.SOLVED
        assert least > 0.9 * STANDOFF


def test_what_comes_from_beyond_the_ball_is_not_met() -> None:
    """A thin wall that is out of the reach of the tool's step when the tick begins."""
    surface = plate()
    body = surface.deforming(surface.vertices + np.array([0.0, 0.0, 0.4e-3]))
    fixture = vf.MeshFixture(body, radius=0.1e-3)
    controller = vf.Controller(robots.load("point"), [fixture])
    q = np.array([0.0, 0.0, 0.35e-3])
    motion = vf.Motion(HERE, HERE, blend=(0.0, 1.0))
    step = controller.step(q, pose(q), [motion])
    assert step.status is Status.SOLVED or step.violation > 0.0
    assert len(step.planes) > 0
    if step.status is Status.SOLVED:
        assert step.q[2] > 0.4e-3


def test_a_part_that_beats_far_away_does_not_enlarge_the_ball_of_a_still_one() -> None:
    """Nor do its planes ask for anything."""
    surface = plate(0.0, 0.1)
    beating = surface.vertices.copy()
    beating[surface.vertices[:, 0] > 0.03] += [0.0, 0.0, 2e-3]
    body = surface.deforming(beating)
    here = near(body, np.array([-0.03, 0.0, 1e-3]), 5e-3, 0.0, 1.0)
    assert max(here) < 1e-12
    there = near(body, np.array([0.045, 0.0, 1e-3]), 5e-3, 0.0, 1.0)
    assert there[0] == pytest.approx(2e-3, abs=1e-9)
    controller, q = over(body), np.array([-0.03, 0.0, 30e-6])
    step = controller.step(q, pose(q), motions=[vf.Motion(HERE, HERE, blend=(0.0, 1.0))])
    assert step.status is Status.SOLVED
    assert np.abs(step.q - q).max() < 1e-9


def test_what_is_near_is_bounded() -> None:
    """Every vertex of a triangle that comes within the radius on the way is as near as said, and
    is displaced as said."""
    rng = np.random.default_rng(7)
    surface = ball(0.01, 3)
    tightest = 1.0
    for _ in range(60):
        body = surface.deforming(surface.vertices + bumped(rng, surface.vertices, 1e-3))
        share = rng.uniform(-1.0, 1.0)
        start = rng.uniform(0.0, 1.0 - share) if share > 0.0 else rng.uniform(-share, 1.0)
        x = naive.unit(rng) * rng.uniform(0.009, 0.02)
        radius = 10 ** rng.uniform(-4, -2)
        far, *rest = near(body, x, radius, start, share)
        middle, wide = np.array(rest[:3]), np.array(rest[3:])
        ways = share * (body.vertices_after - body.vertices)
        moved = ways[body.faces]
        first = blended(body, start)
        for s in np.linspace(0.0, 1.0, 5):
            here = first + s * moved
            close = naive.closest(here, x)[1] <= radius
            if not close.any():
                continue
            assert np.linalg.norm(moved[close], axis=2).max() <= far
            assert (np.abs(moved[close] - middle) <= wide).all()
            assert naive.closest(first[close], x)[1].max() <= radius + far
            most = np.linalg.norm(moved[close], axis=2).max()
            tightest = min(tightest, far / most)
    assert tightest < 1.3


def test_how_far_off_a_distance_to_a_sliver_may_be_is_known_in_every_shape() -> None:
    rng = np.random.default_rng(8)
    middles, along = rng.uniform(-0.01, 0.01, (40, 3)), rng.normal(size=(40, 3))
    middles[:, 2], along[:, 2] = 0.0, 0.0
    thin = 10.0 ** rng.uniform(-8.0, -3.0, 40)[:, None] * rng.normal(size=(40, 3))
    soup = np.stack([middles - 1e-3 * along, middles + 1e-3 * along, middles + 1e-3 * thin], axis=1)
    surface = vf.Surface.from_arrays(soup.reshape(-1, 3), np.arange(120).reshape(-1, 3))
    body = surface.deforming(1.02 * surface.vertices)
    controller, q = over(body), np.array([0.0, 0.0, 1e-3])
    blend = 0.375
    controller.step(q, pose(q), motions=[vf.Motion(HERE, HERE, blend=(blend, blend))])
    placed, errors, _nodes = controller._block._scratch[0]
    tree = body.shape(blend).tree
    known = errors > 0.0
    assert known.sum() > 5
    assert (errors[known] == tree.errors[known]).all()
    assert (placed[known] == tree.corners[known]).all()
    # The nearest one is measured in any case.
    nearest = tree.order == body.shape(blend).nearest(q)[1]
    assert (errors[nearest] == tree.errors[nearest]).all()


@pytest.mark.parametrize(
    "blend", [(-0.1, 0.0), (0.0, 1.1), (np.nan, 0.0), (0.0, "1"), (0.5,), 0.5, None]
)
def test_blends_of_no_use_are_refused(blend: object) -> None:
    if blend == (0.0, "1"):
        assert vf.Motion(HERE, HERE, blend=blend).blend == (0.0, 1.0)  # type: ignore[arg-type]
        return
    with pytest.raises(ValueError, match="blend"):
        vf.Motion(HERE, HERE, blend=blend)  # type: ignore[arg-type]


def test_a_blend_is_a_part_of_the_value_of_a_motion() -> None:
    motion = vf.Motion(HERE, HERE, blend=(0.25, 0.5))
    assert motion.blend == (0.25, 0.5)
    assert motion != vf.Motion(HERE, HERE)
    assert pickle.loads(pickle.dumps(motion)) == motion


def test_a_blend_of_what_does_not_deform_is_refused() -> None:
    controller, q = over(plate()), np.array([0.0, 0.0, 1e-3])
    motion = vf.Motion(HERE, HERE, blend=(0.0, 0.5))
    assert controller.step(q, pose(q), motions=[motion]).status is Status.REFUSED
    assert controller.step(q, pose(q)).status is Status.SOLVED


def test_only_a_shape_of_its_own_mesh_replaces_a_surface() -> None:
    surface, other = ball(), ball()
    controller = over(surface)
    body = surface.deforming(surface.vertices)
    for number, given, said in (
        (1, body, "fixture 1"), (0, surface, "deforming"), (0, other.deforming(other.vertices),
        "another mesh"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=said):
            controller.replace(number, given)  # type: ignore[arg-type]
    controller.replace(0, body.deforming(1.1 * surface.vertices))
    assert isinstance(controller.surfaces[0], vf.DeformingSurface)
    corridor = vf.CorridorFixture([[0, 0, 0], [1, 0, 0]], [0, 0, 1])
    with pytest.raises(ValueError, match="CorridorFixture"):
        vf.Controller(robots.load("point"), [corridor]).replace(0, body)


def test_the_two_judges_agree() -> None:
    """The cubic's roots and the advancement, for a triangle and a point that both move."""
    rng = np.random.default_rng(9)
    met = 0
    for _ in range(400):
        before, after = rng.normal(size=(2, 1, 3, 3))
        x, y = rng.normal(size=(2, 3)) * 0.7
        found = deforming.crossings(before, after, x, y)
        least = deforming.clearance(
            before, after, lambda s, x=x, y=y: x + s * (y - x), float(np.linalg.norm(y - x))
        )
        assert bool(found) == (least < 1e-5)
        met += bool(found)
    assert 20 < met < 380
