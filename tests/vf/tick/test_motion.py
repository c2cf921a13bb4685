"""Structures that move: what a tick makes of them, judged by their true motion."""

from __future__ import annotations

import pickle

import numpy as np
import pinocchio as pin
import pytest
import trimesh

import robots
import vf
from tests.support import moving, naive
from tests.support.ticks import UM, plate, pose
from vf import Status
from vf.layout import MORE, MOTION
from vf.tick.moving import bend, more_reach

STANDOFF = 20 * UM
HERE = pin.SE3.Identity()


def shifted(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array([x, y, z]))


def twisted(rng: np.random.Generator, most: float, turn: float) -> pin.SE3:
    twist = np.concatenate([naive.unit(rng) * most * rng.random(), naive.unit(rng) * turn])
    return pin.exp6(twist)


def ball(radius: float = 0.01, subdivisions: int = 2) -> vf.Surface:
    shape = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return vf.Surface.from_arrays(shape.vertices, shape.faces)


def over(surface: vf.Surface, *others: vf.Fixture, **options: float) -> vf.Controller:
    fixtures = [vf.MeshFixture(surface), *others]
    return vf.Controller(robots.load("point"), fixtures, vf.Settings(**options))


def test_without_motion_nothing_changes() -> None:
    surface, q = plate(), np.array([0.0, 0.0, 1e-3])
    goal = pose([1e-3, 2e-3, -5e-3])
    one, other, third = over(surface), over(surface), over(surface)
    for _ in range(40):
        a = one.step(q, goal)
        b = other.step(q, goal, motions=[None])
        c = third.step(q, goal, motions=[vf.Motion(HERE, HERE)])
        assert (a.q == b.q).all()
        assert a.planes.offsets.tobytes() == b.planes.offsets.tobytes()
        assert np.abs(a.q - c.q).max() < 1e-9
        assert a.status is b.status is c.status is Status.SOLVED
        q = a.q


def test_a_structure_that_stands_elsewhere_is_guarded_there() -> None:
    """The same ticks in another frame."""
    rng = np.random.default_rng(1)
    T = pin.SE3(naive.rotation(rng), rng.normal(size=3) * 0.01)
    surface = ball()
    still, placed = over(surface), over(surface)
    q = np.array([0.0, 0.0, 0.01 + 50 * UM])
    for k in range(60):
        # Shorter than what the slides can do in a tick, along any axis.
        goal = q + 0.1e-3 * np.array([np.sin(k), np.cos(2 * k), -0.7])
        one = still.step(q, pose(goal))
        other = placed.step(T.act(q), pose(T.act(goal)), motions=[vf.Motion(T, T)])
        assert np.abs(T.actInv(other.tip.translation) - one.tip.translation).max() < 2e-9
        assert len(one.planes) == len(other.planes)
        assert other.planes.slack(other.tip.translation).min() >= -1e-15
        q = one.tip.translation.copy()


@pytest.mark.parametrize("hand", ["held", "pressed", "away"])
def test_a_held_tool_yields_to_what_comes_and_no_more_than_it_has_to(hand: str) -> None:
    surface = plate()
    controller = over(surface)
    q, T = np.array([0.0, 0.0, 5e-4]), HERE
    heights = []
    for _ in range(100):
        after = T * shifted(z=0.1e-3)  # 0.1 m/s
        tip = pose(q)
        if hand == "pressed":
            tip = pose(q - [0.0, 0.0, 4e-3])
        if hand == "away":
            tip = pose([*q[:2], q[2] + 0.15e-3])
        step = controller.step(q, tip, motions=[vf.Motion(T, after)])
        assert step.status is Status.SOLVED
        assert step.violation == 0.0
        q, T = step.q, after
        heights.append(q[2] - T.translation[2])
    assert min(heights) >= STANDOFF - 0.1 * UM
    if hand == "away":
        assert heights[-1] > 4e-3
    else:
        assert heights[-1] < 25 * UM
        assert abs(q[:2]).max() < 1 * UM


def test_what_recedes_is_not_followed() -> None:
    controller = over(plate())
    q, T = np.array([0.0, 0.0, 30e-6]), HERE
    for _ in range(20):
        after = T * shifted(z=-0.1e-3)
        step = controller.step(q, pose(q), motions=[vf.Motion(T, after)])
        assert np.abs(step.q - q).max() < 1e-9
        q, T = step.q, after


@pytest.mark.parametrize("rise", [0.6e-3, 5e-3])
def test_what_is_faster_than_the_arm_overtakes_it_by_no_more_than_is_said(rise: float) -> None:
    surface = ball()
    controller = over(surface)
    arm = robots.load("point")
    reach = float(arm.velocity[2]) * 1e-3
    after = shifted(z=rise + reach)
    q = np.array([0.0, 0.0, 0.01 + 50e-6])
    step = controller.step(q, pose(q - [0.0, 0.0, 1e-3]), motions=[vf.Motion(HERE, after)])
    assert step.status is Status.OVERTAKEN
    assert step.q[2] - q[2] == pytest.approx(reach, rel=1e-6)  # as fast as it can
    deep = moving.depth(surface.vertices[surface.faces], after.actInv(step.tip.translation))
    assert 0.0 < deep <= step.violation < deep + 150 * UM


def test_an_overtaken_tool_is_led_out_of_the_structure_that_moves_on() -> None:
    surface = ball()
    controller = over(surface)
    reach = float(robots.load("point").velocity[2]) * 1e-3
    T, q = HERE, np.array([0.0, 0.0, 0.01 + 50e-6])
    seen = []
    for k in range(400):
        after = T * (shifted(z=reach + 0.2e-3) if k == 0 else shifted(x=0.1e-3, z=-0.05e-3))
        step = controller.step(q, pose(q), motions=[vf.Motion(T, after)])
        q, T = step.q, after
        seen.append(step.status)
        if k > 300:
            assert moving.depth(surface.vertices[surface.faces], T.actInv(q)) < 0.0
    assert seen[0] is Status.OVERTAKEN
    assert seen[1] is Status.INSIDE
    assert Status.INSIDE not in seen[-50:]


def test_the_side_is_remembered_in_the_frame_of_the_structure() -> None:
    """No tick of a moving structure looks it up anew, and a jump of the structure does."""
    rng = np.random.default_rng(5)
    fixture = vf.MeshFixture(ball())
    asked = []
    look = fixture.inside
    fixture.inside = lambda x: asked.append(x) or look(x)  # type: ignore[method-assign]
    controller = vf.Controller(robots.load("point"), [fixture], vf.Settings())
    q, T = np.array([0.0, 0.0, 0.012]), HERE
    asked.clear()
    for _ in range(50):
        after = T * twisted(rng, 0.1e-3, 1e-3)
        q = controller.step(q, pose(q - [0, 0, 1e-3]), motions=[vf.Motion(T, after)]).q
        T = after
    assert len(asked) == 1
    jumped = shifted(x=q[0], y=q[1], z=q[2])
    step = controller.step(q, pose(q), motions=[vf.Motion(jumped, jumped)])
    assert len(asked) == 2
    assert step.status is Status.INSIDE


def test_a_corridor_that_moves_carries_the_tool_along() -> None:
    path = [[-0.05, 0.0, 0.0], [0.05, 0.0, 0.0]]
    corridor = vf.CorridorFixture(path, [0.0, 0.0, 1.0], width=0.5e-3)
    controller = vf.Controller(robots.load("point"), [corridor], vf.Settings())
    q, T = np.array([0.0, 0.0, 0.0]), HERE
    for _ in range(60):
        after = T * shifted(y=0.1e-3)
        step = controller.step(q, pose([0.0, 0.0, 0.0]), motions=[vf.Motion(T, after)])
        q, T = step.q, after
        assert abs(q[1] - T.translation[1]) <= 0.5e-3 - 0.9 * STANDOFF
    assert q[1] > 5e-3


def test_between_two_that_close_the_tool_ends_in_the_middle() -> None:
    lower, upper = plate(0.0, 0.05), plate(6e-3, 0.05)
    controller = over(lower, vf.MeshFixture(upper))
    q, A, B = np.array([0.0, 0.0, 3e-4]), HERE, HERE
    for _ in range(48):
        a, b = A * shifted(z=10e-6), B * shifted(z=-10e-6)
        step = controller.step(q, pose(q), motions=[vf.Motion(A, a), vf.Motion(B, b)])
        q, A, B = step.q, a, b
    # 1 mm apart less 0.96 mm: two standoffs.
    assert q[2] == pytest.approx(0.5e-3, abs=3 * UM)
    statuses = []
    for _ in range(20):
        a, b = A * shifted(z=10e-6), B * shifted(z=-10e-6)
        step = controller.step(q, pose(q), motions=[vf.Motion(A, a), vf.Motion(B, b)])
        q, A, B = step.q, a, b
        statuses.append(step.status)
    assert Status.OVERTAKEN in statuses


@pytest.mark.parametrize("rule", ["certified", "paper", "all"])
def test_every_rule_takes_a_motion(rule: str) -> None:
    fixture = vf.MeshFixture(plate(), rule)
    controller = vf.Controller(robots.load("point"), [fixture], vf.Settings())
    q, T = np.array([0.0, 0.0, 1e-4]), HERE
    for _ in range(50):
        after = T * shifted(z=50e-6)
        q, T = controller.step(q, pose(q), motions=[vf.Motion(T, after)]).q, after
    assert q[2] - T.translation[2] == pytest.approx(STANDOFF, abs=3 * UM)


def test_the_shaft_yields_too() -> None:
    arm = robots.load("psm")
    q = arm.neutral
    a, b = arm.axes(q)[2]
    wall = ball(0.02, 3)
    place = 0.6 * a + 0.4 * b - [0.02 + arm.capsules[2].radius + 1e-3, 0.0, 0.0]
    T = pin.SE3(np.eye(3), place)
    controller = vf.Controller(arm, [vf.MeshFixture(wall)], vf.Settings(guard="tool"))
    for _ in range(60):
        after = T * shifted(x=50e-6)
        step = controller.step(q, arm.tip(q), motions=[vf.Motion(T, after)])
        assert step.status in (Status.SOLVED, Status.SHORTENED)
        q, T = step.q, after
        a, b = arm.axes(q)[2]
        marks = a + np.linspace(0.0, 1.0, 300)[:, None] * (b - a)
        gap = min(wall.nearest(T.actInv(p))[0] for p in marks) - arm.capsules[2].radius
        assert gap > 0.5 * STANDOFF
    assert gap < 2 * STANDOFF


@pytest.mark.parametrize(
    "motions", [[], [None, None], [7], 7, [pin.SE3.Identity()], [vf.Motion(HERE, HERE)] * 2]
)
def test_motions_of_no_use_are_refused_and_the_tool_stays(motions: object) -> None:
    controller = over(plate())
    q = np.array([0.0, 0.0, 1e-3])
    step = controller.step(q, pose([0, 0, 0.01]), motions=motions)  # type: ignore[arg-type]
    assert step.status is Status.REFUSED
    assert (step.q == q).all()
    assert controller.step(q, pose([0, 0, 0.01])).status is Status.SOLVED


def test_motions_that_are_none_are_refused_when_they_are_made() -> None:
    bad = pin.SE3(np.diag([1.0, 1.0, 0.5]), np.zeros(3))
    mirrored = pin.SE3(np.diag([1.0, 1.0, -1.0]), np.zeros(3))
    half = pin.SE3(pin.exp3(np.array([0.0, 0.0, 3.1])), np.zeros(3))
    for end, said in (
        (bad, "end.*rotation"), (mirrored, "end.*rotation"), (half, r"3\.1"),
        (shifted(x=np.nan), "end.*nan"), (shifted(x=1e9), "end.*e\\+09|1000000000"),
        (np.eye(4), "end.*SE3"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=said):
            vf.Motion(HERE, end)


def test_a_motion_is_a_value() -> None:
    rng = np.random.default_rng(2)
    a, b = twisted(rng, 0.1, 1.0), twisted(rng, 0.1, 1.0)
    motion = vf.Motion(a, b)
    assert motion == vf.Motion(a, b) != vf.Motion(a, a)
    assert pickle.loads(pickle.dumps(motion)) == motion
    assert hash(motion) == hash(vf.Motion(a, b))
    with pytest.raises(AttributeError, match="does not change"):
        motion.start = b  # type: ignore[misc]
    rough = pin.SE3(a.rotation + 1e-5, a.translation)
    R = vf.Motion(rough, rough).start.rotation
    assert np.abs(R.T @ R - np.eye(3)).max() < 1e-14


def overlap(triangles: np.ndarray, p: np.ndarray, radius: float) -> float:
    """How deep a ball is in a convex body, or less than 0 [m]."""
    deep = moving.depth(triangles, p)
    return radius + (deep if deep > 0.0 else -float(naive.closest(triangles, p)[1].min()))


def test_what_motion_adds_to_a_path_and_to_the_ball_is_bounded() -> None:
    """Sampled: a constant twist, and an origin that goes straight while the axes turn."""
    rng = np.random.default_rng(8)
    tightest = 0.0
    for _ in range(300):
        start = pin.SE3(naive.rotation(rng), rng.normal(size=3) * 0.1)
        turn = 10 ** rng.uniform(-4, -0.3)
        end = start * twisted(rng, 10 ** rng.uniform(-4, -1), turn)
        if rng.random() < 0.3:
            end = start * pin.SE3(pin.exp3(naive.unit(rng) * turn), np.zeros(3))
        x = start.translation + rng.normal(size=3) * 10 ** rng.uniform(-3, -1)
        y = x + rng.normal(size=3) * 10 ** rng.uniform(-5, -1.5)
        row = np.zeros(MOTION)
        row[:MORE] = vf.Motion(start, end).record
        d = float(np.linalg.norm(y - x))
        most = bend(row, x, d)
        ball_ = d + more_reach(row, x, d)
        log = pin.log3(start.rotation.T @ end.rotation)
        for screw in (True, False):
            for share in np.linspace(0.0, 1.0, 9):
                T = moving.between(start, end, share)
                if not screw:
                    T = pin.SE3(
                        start.rotation @ pin.exp3(share * log),
                        (1.0 - share) * start.translation + share * end.translation,
                    )
                seen = T.actInv(x + share * (y - x))
                chord = (1.0 - share) * start.actInv(x) + share * end.actInv(y)
                off = float(np.linalg.norm(seen - chord))
                assert off <= most + 1e-15
                assert np.linalg.norm(seen - start.actInv(x)) <= ball_ + 1e-15
                tightest = max(tightest, off / most)
    assert tightest > 0.5


def campaign(seed: int, ticks: int, dt: float) -> dict[Status, int]:
    """A tool and a structure that both move at random towards each other, every tick judged."""
    rng = np.random.default_rng(seed)
    arm = robots.load("point")
    surface = ball(0.01, 1) if seed % 3 else plate(0.0, 0.03)
    triangles = surface.vertices[surface.faces]
    margin = 0.3e-3 * (seed % 2)
    radius = [5e-3, 1e-3][seed % 2]
    tip_radius = [0.0, 1e-3][seed // 2 % 2]
    fixture = vf.MeshFixture(surface, radius=radius, margin=margin)
    settings = vf.Settings(dt=dt, tip_radius=tip_radius)
    controller = vf.Controller(arm, [fixture], settings)
    T = pin.SE3(naive.rotation(rng), rng.normal(size=3) * 0.02)
    q = T.act(np.array([0.002, 0.003, 0.0125 if seed % 3 else 0.0025]))
    counts = dict.fromkeys(Status, 0)
    twist = np.zeros(6)
    aim = q
    contacts = 0
    for k in range(ticks):
        if k % 25 == 0:
            towards = T.rotation.T @ (q - T.translation)
            twist[:3] = 0.2 * rng.random() * (towards / np.linalg.norm(towards) * 0.7
                                              + 0.5 * naive.unit(rng))  # fmt: skip
            twist[:3] *= rng.choice([1.0, -0.7])
            twist[3:] = 2.0 * rng.random() * naive.unit(rng)
            if np.linalg.norm(q) > 0.1:
                twist[:3] = T.rotation.T @ (-q) / np.linalg.norm(q) * 0.1
        aim = T.act(rng.normal(size=3) * 0.004) if k % 40 < 25 else q
        after = T * pin.exp6(twist * dt)
        step = controller.step(q, pose(aim), motions=[vf.Motion(T, after)])
        counts[step.status] += 1
        case = f"seed {seed}, tick {k}, {step.status.name}"
        way = step.q - q
        began = moving.depth(triangles, T.actInv(q)) if seed % 3 else -1.0
        near = float(naive.closest(triangles, T.actInv(q))[1].min()) - tip_radius - margin
        contacts += near < 2 * STANDOFF
        if step.status is Status.OVERTAKEN:
            if seed % 3:
                # Of a tip that overlapped when the tick began the centre alone is promised.
                whole = overlap(triangles, T.actInv(q), tip_radius) < 0.0
                deep = overlap(triangles, after.actInv(step.q), tip_radius if whole else 0.0)
                assert deep <= step.violation, f"{case}: {deep} deeper than {step.violation}"
        elif step.status is not Status.INSIDE and began < 0.0:
            apart = float(naive.closest(triangles, T.actInv(q))[1].min())
            held = tip_radius if apart > tip_radius + 1e-9 else 0.0
            start = q.copy()
            least = moving.clearance(
                triangles, T, after, lambda share, start=start, way=way: start + share * way,
                float(np.linalg.norm(way)), held,
            )  # fmt: skip
            assert least > moving.TOUCH, f"{case}: clearance {least}"
        q, T = step.q, after
    assert contacts > ticks / 20  # or nothing was tried
    return counts


@pytest.mark.parametrize("seed", [0, 1, 2, 4])
def test_nothing_is_met_unless_the_tool_was_overtaken(seed: int) -> None:
    counts = campaign(seed, 250, [1e-3, 1e-2][seed // 4 % 2])
    assert counts[Status.SOLVED] > 100


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(0, 12, 3))
def test_nothing_is_met_in_long_campaigns_unless_the_tool_was_overtaken(seed: int) -> None:
    campaign(seed, 2000, [1e-3, 1e-2][seed // 4 % 2])
