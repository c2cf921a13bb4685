"""The corridor: judged by the distance from the path, which its planes never compute."""

import itertools

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import robots
import vf

WIDTH = 1e-3
DOWN = np.array([0.0, 0.0, -1.0])


def zigzag(seed: int, bends: int = 6, turn: float = 1.2) -> np.ndarray:
    """A path (k, 3) whose projection along DOWN bends left and right at random."""
    rng = np.random.default_rng(seed)
    heading = np.cumsum(rng.uniform(-turn, turn, bends))
    steps = rng.uniform(4e-3, 8e-3, bends)[:, None] * np.stack(
        [np.cos(heading), np.sin(heading), rng.uniform(-0.5, 0.5, bends)], axis=1
    )
    return np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])


def corridor_along(path: np.ndarray) -> vf.CorridorFixture:
    """The corridor along a random path; such as come near to themselves are refused, see below."""
    try:
        return vf.CorridorFixture(path, DOWN, WIDTH)
    except ValueError as error:
        assume("near to itself" not in str(error))
        raise


def aside(path: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distance (n,) of points (n, 3) from the path seen from above, its ends carried on."""
    flat = path[:, :2].copy()
    flat[0] += 1.0 * (flat[0] - flat[1]) / np.linalg.norm(flat[0] - flat[1])
    flat[-1] += 1.0 * (flat[-1] - flat[-2]) / np.linalg.norm(flat[-1] - flat[-2])
    a, b = flat[:-1], flat[1:]
    u = b - a
    w = points[:, None, :2] - a
    t = np.clip((w * u).sum(-1) / (u * u).sum(-1), 0.0, 1.0)
    return np.linalg.norm(w - t[..., None] * u, axis=-1).min(axis=1)


def somewhere(path: np.ndarray, rng: np.random.Generator, spread: float) -> np.ndarray:
    i = rng.integers(len(path) - 1)
    spot = path[i] + rng.random() * (path[i + 1] - path[i])
    return spot + rng.uniform(-spread, spread, 3) * [1.0, 1.0, 3.0]


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), radius=st.sampled_from([3e-4, 1e-3, 5e-3]))
def test_what_the_planes_allow_is_never_farther_than_the_width(seed: int, radius: float) -> None:
    rng = np.random.default_rng(seed)
    path = zigzag(seed)
    corridor = corridor_along(path)
    x = somewhere(path, rng, 0.8 * WIDTH)
    if corridor.room(x) <= 0.0:
        return
    planes = corridor.planes(x, radius, 20e-6, 0.0, False)
    assert (planes.slack(x) >= 0.0).all()  # standing still is allowed
    ys = x + radius * rng.uniform(-1.0, 1.0, (4000, 3))
    inside = np.linalg.norm(ys - x, axis=1) <= planes.radius
    allowed = ys[inside & (ys @ planes.normals.T >= planes.offsets).all(axis=1)]
    assert len(allowed) > 0
    assert aside(path, allowed).max() <= WIDTH
    halfway = 0.5 * (allowed + x)
    assert aside(path, halfway).max() <= WIDTH


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_nothing_just_outside_is_allowed(seed: int) -> None:
    """Points a few microns beyond the width, where a gap between the planes would show first."""
    rng = np.random.default_rng(seed)
    path = zigzag(seed)
    corridor = corridor_along(path)
    x = somewhere(path, rng, 0.9 * WIDTH)
    if corridor.room(x) <= 0.0:
        return
    planes = corridor.planes(x, 5e-3, 0.0, 0.0, False)
    marks = np.linspace(0.0, 1.0, 150)[:, None, None]
    along = path[:-1] + marks * np.diff(path, axis=0)  # (150, k, 3)
    angle = rng.uniform(0.0, 2 * np.pi, (8, *along.shape[:2]))
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)
    forward = np.diff(path[:, :2], axis=0)
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    square = np.stack([-forward[:, 1], forward[:, 0], np.zeros(len(forward))], axis=1)
    ring[0], ring[1] = square, -square
    points = (along + (WIDTH + 3e-6) * ring).reshape(-1, 3)
    points[:, 2] = x[2]
    near = np.linalg.norm(points - x, axis=1) <= planes.radius
    beyond = points[near & (aside(path, points) > WIDTH + 1e-9)]
    assert len(beyond) > 20
    assert (beyond @ planes.normals.T < planes.offsets).any(axis=1).all()


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_a_ball_between_the_walls_stays_between_them(seed: int) -> None:
    rng = np.random.default_rng(seed)
    path, tip = zigzag(seed), 4e-4
    corridor = corridor_along(path)
    x = somewhere(path, rng, 0.3 * WIDTH)
    if corridor.room(x) <= tip:
        return
    planes = corridor.planes(x, 3e-3, 20e-6, tip, False)
    ys = x + 3e-3 * rng.uniform(-1.0, 1.0, (2000, 3))
    inside = np.linalg.norm(ys - x, axis=1) <= planes.radius
    allowed = ys[inside & (ys @ planes.normals.T >= planes.offsets).all(axis=1)]
    rim = np.stack([np.cos(np.arange(16)), np.sin(np.arange(16)), np.zeros(16)], axis=1)
    assert aside(path, (allowed[:, None] + tip * rim).reshape(-1, 3)).max() <= WIDTH + 1e-12


def test_a_straight_path_has_two_walls_at_its_width() -> None:
    bend = np.stack([np.zeros(9), np.linspace(0, 0.03, 9), -(np.linspace(0, 0.05, 9) ** 2)], axis=1)
    corridor = vf.CorridorFixture(bend, DOWN, WIDTH)
    x = np.array([3e-4, 0.012, -0.002])
    planes = corridor.planes(x, 5e-3, 0.0, 0.0, False)
    assert sorted(planes.normals[:, 0].tolist()) == [-1.0, 1.0]
    np.testing.assert_allclose(planes.offsets, -WIDTH, atol=1e-15)
    assert (planes.rules == vf.Rule.CORRIDOR).all()
    assert (planes.triangles == -1).all()
    np.testing.assert_allclose(
        np.abs(planes.points - x).sum(axis=1).min(), WIDTH - 3e-4, atol=1e-15
    )
    assert corridor.room(x) == pytest.approx(0.7e-3, abs=1e-15)
    assert len(corridor.planes(x, 5e-4, 0.0, 0.0, False)) == 0


def test_the_walls_take_little_of_the_width() -> None:
    """At a bend the outside is cut across: no more than width · (1 − cos θ/2)."""
    path = zigzag(3, turn=0.3)
    corridor = vf.CorridorFixture(path, DOWN, WIDTH)
    rng = np.random.default_rng(0)
    points = np.array([somewhere(path, rng, WIDTH) for _ in range(3000)])
    free = points[aside(path, points) < WIDTH * np.cos(0.15) - 1e-9]
    assert min(corridor.room(p) for p in free) > 0.0


def test_a_tool_outside_is_led_back_gently_and_not_let_farther_out() -> None:
    path = np.array([[0.0, 0.0, -0.12], [0.0, 0.03, -0.12]])
    arm = robots.load("point")
    q = arm.inverse(pin.SE3(arm.tip(arm.neutral).rotation, np.array([2e-3, 0.01, -0.12])))
    controller = vf.Controller(arm, [vf.CorridorFixture(path, DOWN, WIDTH)])
    away = pin.SE3(arm.tip(q).rotation, np.array([5e-3, 0.01, -0.12]))
    aside_before = 2e-3
    for _ in range(150):
        step = controller.step(q, away)
        q = step.q
        assert step.tip.translation[0] <= aside_before + 1e-12
        assert aside_before - step.tip.translation[0] <= 2e-5
        aside_before = step.tip.translation[0]
    assert WIDTH - 40e-6 <= aside_before <= WIDTH


def test_the_tool_follows_a_bent_path_and_stays_in_the_corridor() -> None:
    path = zigzag(11) - 0.1 * np.array([0.0, 0.0, 1.0])
    arm = robots.load("point")
    rotation = arm.tip(arm.neutral).rotation
    q = arm.inverse(pin.SE3(rotation, path[0]))
    controller = vf.Controller(arm, [vf.CorridorFixture(path, DOWN, WIDTH)])
    rng = np.random.default_rng(1)
    tips = []
    for a, b in itertools.pairwise(path):
        for share in np.linspace(0.0, 1.0, 120):
            goal = a + share * (b - a) + 2e-3 * rng.normal(size=3)
            step = controller.step(q, pin.SE3(rotation, goal))
            q = step.q
            tips.append(step.tip.translation)
    assert aside(path, np.array(tips)).max() <= WIDTH
    assert np.linalg.norm(tips[-1][:2] - path[-1][:2]) < 3e-3


def test_corridor_and_mesh_hold_together() -> None:
    """Pressed into the corner between a wall and a face, both hold."""
    arm = robots.load("point")
    rotation = arm.tip(arm.neutral).rotation
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * 0.05
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    surface = vf.Surface.from_arrays(corners - 0.12 * np.array([0.0, 0.0, 1.0]), faces)
    path = np.array([[0.0, -0.02, -0.12], [0.0, 0.02, -0.12]])
    fixtures = [vf.MeshFixture(surface), vf.CorridorFixture(path, DOWN, WIDTH)]
    controller = vf.Controller(arm, fixtures)
    q = arm.inverse(pin.SE3(rotation, np.array([0.0, 0.0, -0.119])))
    goal = pin.SE3(rotation, np.array([4e-3, 3e-3, -0.124]))
    for _ in range(300):
        step = controller.step(q, goal)
        q = step.q
    x, y, z = step.tip.translation
    assert 0.0 <= WIDTH - x <= 25e-6
    assert 0.0 <= z + 0.12 <= 25e-6
    assert y == pytest.approx(3e-3, abs=1e-5)
    assert {vf.Rule.CORRIDOR, vf.Rule.FACE} <= set(step.planes.rules.tolist())


@pytest.mark.parametrize(
    ("path", "direction", "width", "word"),
    [
        ([[0, 0, 0]], DOWN, 1e-3, "two or more"),
        ([[0, 0, 0], [0, np.nan, 0]], DOWN, 1e-3, "finite"),
        ([[0, 0, 0], [0, 0, 1]], DOWN, 1e-3, "no length"),
        ([[0, 0, 0], [0, 1, 0]], [0, 0, 0], 1e-3, "direction"),
        ([[0, 0, 0], [0, 1, 0]], DOWN, 0.0, "width"),
        ([[0, 0, 0], [0, 1, 0], [0, 0.5, 0]], DOWN, 1e-3, "back on itself"),
        ([[0, 0, 0], [0, 5e-4, 0], [5e-4, 5e-4, 0], [5e-4, 0, 0]], DOWN, 1e-3, "too tightly"),
    ],
)
def test_unusable_corridors_are_refused(path, direction, width, word) -> None:
    with pytest.raises(ValueError, match=word):
        vf.CorridorFixture(np.array(path, dtype=float), direction, width)


def omega(neck: float) -> np.ndarray:
    """A path (6, 3) [mm] whose two arms come as near to each other as `neck` and part again."""
    half = 0.5 * neck
    flat = [[-10, 20], [-half, 10], [-6, 0], [6, 0], [half, 10], [10, 20]]
    return np.column_stack([np.array(flat), np.zeros(6)])


def test_a_path_that_comes_near_itself_is_refused_and_one_that_keeps_off_is_not() -> None:
    for neck in (1.6, 1.0, 0.1, -3.0):
        with pytest.raises(ValueError, match=r"near to itself.* legs \d and \d meet") as error:
            vf.CorridorFixture(1e-3 * omega(neck), DOWN, 1e-3)
        assert "±1 mm" in str(error.value)
    for neck in (3.0, 4.0):
        corridor = vf.CorridorFixture(1e-3 * omega(neck), DOWN, 1e-3)
        assert corridor.room(np.array([0.0, 0.0, 0.0])) == pytest.approx(1e-3)
        assert corridor.room(np.array([0.0, 10e-3, 0.0])) < 0.0  # between the arms
    assert vf.CorridorFixture(1e-3 * omega(1.0), DOWN, 2e-4).width == 2e-4  # a narrower one fits


def test_paths_whose_ends_carried_on_run_into_the_path_are_refused() -> None:
    """Two ticks of such a corridor passed a wall: which side of crossing walls is free is open."""
    spiral = [
        [-5.7476, -0.1137], [-5.3373, 2.3558], [-4.3998, 3.83], [-0.8444, 3.458], [0, 0],
        [-0.7262, -1.4069], [-3.5517, -3.5862], [-6.6534, -4.6258], [-8.6178, -4.3874],
    ]  # fmt: skip
    turn = np.linspace(0.0, 2.0 * np.pi, 24)
    ring = 10.0 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    for flat in (np.array(spiral), ring, ring[:-1], ring[:16]):
        path = 1e-3 * np.column_stack([flat, np.zeros(len(flat))])
        with pytest.raises(ValueError, match="near to itself"):
            vf.CorridorFixture(path, DOWN, 1.2e-5)
    vf.CorridorFixture(1e-3 * np.column_stack([ring[:12], np.zeros(12)]), DOWN, 1.2e-5)


@pytest.mark.slow
def test_no_tick_between_walls_that_keep_apart_passes_one() -> None:
    """Judged by the distance from the path and by the walls themselves, whatever is promised."""
    arm = robots.load("point")
    rotation = arm.tip(arm.neutral).rotation
    used = 0
    for seed in range(120):
        rng = np.random.default_rng(seed)
        path = zigzag(seed, int(rng.integers(2, 9)), 2.0)
        path += [0.0, 0.0, -0.12 - path[:, 2].mean()]
        width = 10.0 ** rng.uniform(-4.5, -3.0)
        try:
            corridor = vf.CorridorFixture(path, DOWN, width, (None, 5e-3, 5e-5)[seed % 3])
        except ValueError:
            continue
        used += 1
        walls = [w[:, :2, :2] for w in corridor.ribbons(1e-3, 0.9)]
        a, b = np.concatenate([w[:, 0] for w in walls]), np.concatenate([w[:, 1] for w in walls])
        controller = vf.Controller(arm, [corridor], vf.Settings(dt=(1e-3, 1e-2)[seed % 2]))
        q = arm.inverse(pin.SE3(rotation, path[len(path) // 2]))
        x = arm.tip(q).translation
        for tick in range(100):
            if tick % 10 == 0:
                way = rng.normal(size=3) * 0.01
            q = controller.step(q, pin.SE3(rotation, x + way)).q
            y = arm.tip(q).translation
            assert aside(path, y[None])[0] <= width + 1e-12
            left = np.sign(_turn(x[:2], y[:2], a) * _turn(x[:2], y[:2], b))
            right = np.sign(_turn(a, b, x[:2]) * _turn(a, b, y[:2]))
            assert not ((left < 0) & (right < 0)).any()
            x = y
    assert used > 40


def _turn(p: np.ndarray, q: np.ndarray, r: np.ndarray) -> np.ndarray:
    """Which side of the line from p to q the point r is on, in the plane."""
    u, v = q - p, r - p
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]


def test_the_direction_of_a_sagittal_cut_lies_in_its_plane() -> None:
    y = np.linspace(-0.02, 0.02, 30)
    path = np.stack([0.0 * y, y, -8.0 * y**2], axis=1)
    normals = np.stack([0.02 + 0.0 * y, 16.0 * y, 1.0 + 0.0 * y], axis=1)
    direction = vf.cutting_direction(path, normals)
    np.testing.assert_allclose(direction, [0.0, 0.0, -1.0], atol=1e-12)
    straight = np.stack([0.0 * y, y, 0.0 * y], axis=1)
    assert vf.cutting_direction(straight, normals)[0] < -0.01  # no plane: the normals decide
    with pytest.raises(ValueError, match="no direction"):
        vf.cutting_direction(path, np.concatenate([normals[:15], -normals[:15]]))
