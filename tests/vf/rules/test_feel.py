"""How the certified rule feels: reach, rest, sliding, corners and blocked space.

"Best" is the nearest rest to the proxy that any of the compared runs found.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import meshes
import robots
import vf
from tests.support import feel, naive
from tests.support.everyday import everyday

MM, UM = 1e-3, 1e-6
CURVED = ("torus", "sphere", "gyroid", "saddle-slab", "skull-coarse")


def spot(surface: vf.Surface, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A point of a clean closed surface, and a free point 1 to 3 mm over it."""
    while True:
        face = rng.integers(len(surface.faces))
        p = rng.dirichlet([1, 1, 1]) @ surface.vertices[surface.faces[face]]
        start = p + surface.normals[face] * rng.uniform(1 * MM, 3 * MM)
        if surface.nearest(start)[0] > 0.5 * MM and not surface.inside(start):
            return p, start


# Reach


def reach(names: tuple[str, ...], trials: int, seed: int) -> np.ndarray:
    """How far from its proxy the tool rests [m]: (trial, rule certified/paper, radius 0.5/5 mm).

    Pushes: the proxy jumps to a point around or below the surface. Slides: it jumps again, and all
    four runs go on from where the first came to rest.
    """
    rng = np.random.default_rng(seed)
    rows = []
    for name in names:
        surface = naive.catalogue(name)
        for trial in range(trials):
            p, start = spot(surface, rng)
            if trial % 2:
                proxy = p + naive.unit(rng) * rng.uniform(1 * MM, 5 * MM)
                start = feel.rest(surface, "certified", 0.5 * MM, start, proxy)
            proxy = p + naive.unit(rng) * rng.uniform(3 * MM, 15 * MM)
            rows.append(
                [
                    [
                        np.linalg.norm(feel.rest(surface, rule, radius, start, proxy) - proxy)
                        for radius in (0.5 * MM, 5 * MM)
                    ]
                    for rule in ("certified", "paper")
                ]
            )
            far = rows[-1][0][0] - rows[-1][1][0]
            assert far < 0.1 * MM, f"{name}: {start.tolist()} → {proxy.tolist()}: {far} m farther"
    return np.array(rows)


def check_reach(ends: np.ndarray) -> None:
    best = ends.min(axis=(1, 2))
    ours, theirs = (ends[:, rule, 1] - best for rule in (0, 1))
    # Where the paper's planes at 5 mm do not hinder there is nothing to compare.
    assert theirs.mean() > 0.05 * MM
    assert ours.mean() < 0.5 * theirs.mean()


def test_the_tool_comes_as_near_to_its_proxy_as_with_the_papers_planes():
    check_reach(reach(("saddle-slab", "gyroid", "torus", "l-block"), 6, seed=101))


@pytest.mark.slow
def test_reach_in_five_hundred_pushes_and_slides():
    """Trials of this seed: near a rim either rule may take the other way round, and end elsewhere.

    (At (4.331, −12.828, −11.951) mm of the gyroid, for a proxy at (−3.154, −21.640, −20.658) mm,
    the paper's rule with 0.5 mm passes a rim that the certified one stops before.)
    """
    names = tuple(name for name in naive.NAMES if name != "skull-closed")  # outside like the skull
    ends = reach(names, -(-500 // len(names)), seed=102)
    assert len(ends) >= 500
    check_reach(ends)


# Rest


def path(
    arm: robots.Arm, surface: vf.Surface, radius: float, q: np.ndarray, goals: list[np.ndarray]
) -> np.ndarray:
    """Tip positions (k, 3) of a tool that follows these proxies, one a tick."""
    controller = vf.Controller(arm, [vf.MeshFixture(surface, "certified", radius)])
    rotation = arm.tip(q).rotation
    tips = []
    for goal in goals:
        q = controller.step(q, pin.SE3(rotation, goal)).q
        tips.append(arm.tip(q).translation.copy())
    return np.array(tips)


@pytest.mark.parametrize("radius", everyday([0.5 * MM, 5 * MM], 5 * MM))
@pytest.mark.parametrize("robot", ["point", "psm"])
def test_a_resting_tool_does_not_jitter(robot, radius):
    arm = robots.load(robot)
    rng = np.random.default_rng(103)
    for name in ("cube", "l-block", "gear", "saddle-slab", "gyroid", "skull-coarse"):
        for _ in range(2):
            mesh = meshes.arrays(name)
            q = arm.lower + rng.uniform(0.3, 0.7, len(arm.lower)) * (arm.upper - arm.lower)
            x = arm.tip(q).translation
            surface = feel.surface_near(*mesh, x, rng)
            below = surface.nearest(x)[2] - x
            goal = x + below + (below / np.linalg.norm(below) + 0.7 * naive.unit(rng)) * 3 * MM
            tips = path(arm, surface, radius, q, [goal] * 900)
            rest = tips[-200:]
            jitter = np.linalg.norm(rest - rest.mean(axis=0), axis=1).max()
            assert jitter < 1 * UM, f"{name}, {robot}, {radius}: {jitter} m at {goal.tolist()}"


@pytest.mark.parametrize("radius", [0.5 * MM, 5 * MM])
def test_a_tool_rests_in_a_shallow_bowl(radius):
    """Between two faces of 1.3°, where either could be taken for a bump of the other."""
    start = np.array([0.029503301922983692, 0.037862645706755266, -0.03552375338015426])
    goal = np.array([0.02687708742452562, 0.04186496379788978, -0.04820812558172949])
    surface = naive.catalogue("skull-precut")
    tips = path(robots.load("point"), surface, radius, start, [goal] * 1200)
    assert np.ptp(tips[-200:], axis=0).max() < 1 * UM


# Sliding


@pytest.mark.parametrize("radius", [0.5 * MM, 5 * MM])
def test_sliding_along_a_flat_wall_is_even(radius):
    """The proxy moves at 20 mm/s, 2 mm below the top of a cube: so does the tool, 20 µm above."""
    surface = naive.catalogue("cube")
    start = np.array([-15.3 * MM, 1.234 * MM, 20 * MM + 20 * UM])
    heading = np.array([1.0, 0.37, 0.0])
    goals = [start + heading * 20 * UM * k - [0, 0, 2 * MM] for k in range(1, 1201)]
    tips = path(robots.load("point"), surface, radius, start, goals)
    assert np.ptp(tips[:, 2]) < 1 * UM
    # At first the tool takes up the distance that the press keeps it behind the proxy.
    along = np.diff(tips[200:, :2] @ heading[:2]) / np.linalg.norm(heading)
    assert along.min() > 0.0
    # Neither does it lag, stick and jump.
    assert np.abs(along - 20 * UM * np.linalg.norm(heading)).max() < 1 * UM
    assert np.abs(tips[-1, :2] - goals[-1][:2]).max() < 0.3 * MM


@pytest.mark.parametrize("radius", [0.5 * MM, 5 * MM])
@pytest.mark.parametrize(("name", "outer"), [("sphere", 30), ("cylinder", 20), ("torus", 40)])
def test_sliding_over_a_curved_wall_never_reverses(name, outer, radius):
    """Round the outside of a body [mm], the proxy on a circle 1 mm below its surface."""
    angles = np.linspace(0.2, 1.2, 1500)
    ring = np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])
    start = (outer + 0.5) * MM * ring[0] + [0, 0, 1.23 * MM]
    goals = (outer - 1) * MM * ring + [0, 0, 1.23 * MM]
    tips = path(robots.load("point"), naive.catalogue(name), radius, start, list(goals))[100:]
    turned = np.unwrap(np.arctan2(tips[:, 1], tips[:, 0]))
    assert np.diff(turned).min() * outer * MM > -0.01 * UM
    # 20 µm a tick on a circle; over a ridge the facets' nearest points come faster.
    assert np.diff(turned).max() * outer * MM < 100 * UM
    assert turned[-1] > 1.15
    assert np.linalg.norm(tips[:, :2], axis=1).min() > (outer - 0.2) * MM


# Corners


@pytest.mark.parametrize("radius", [0.5 * MM, 5 * MM])
@pytest.mark.parametrize("name", ["l-block", "stairs", "star-prism", "gear", "gyroid"])
def test_a_straight_free_way_out_of_a_corner_is_open(name, radius):
    """Pushed into the mesh at random, then called to a point that the tool sees."""
    surface = naive.catalogue(name)
    rng = np.random.default_rng(104)
    ways = 0
    while ways < 4:
        p, start = spot(surface, rng)
        x = feel.rest(surface, "certified", radius, start, p - (start - p))
        goal = x + naive.unit(rng) * rng.uniform(1 * MM, 4 * MM)
        # A hair's breadth of room along the way, but for its beginning at the standoff.
        begin = x + 0.05 * (goal - x)
        if not (
            feel.is_open(surface, x, begin, 0.0) and feel.is_open(surface, begin, goal, 25 * UM)
        ):
            continue
        ways += 1
        end = feel.rest(surface, "certified", radius, x, goal)
        assert np.linalg.norm(end - goal) < 1 * UM, f"{x.tolist()} → {goal.tolist()}: {end}"


def test_out_of_the_inner_corner_of_a_block_in_a_straight_line():
    """Pressed into the valley of 90°, then called out diagonally, along one wall, and up."""
    surface = naive.catalogue("l-block")
    p, start, normals = _valley(surface)
    corner = feel.rest(surface, "certified", 5 * MM, start, p - 2 * MM * normals.sum(axis=0))
    for n in normals:
        assert abs((corner - p) @ n - 20 * UM) < 2 * UM
    for direction in (normals.sum(axis=0), normals[0], normals[1]):
        goals = [corner + direction * 10 * UM * k for k in range(1, 401)]
        tips = path(robots.load("point"), surface, 5 * MM, corner, goals)
        assert np.linalg.norm(tips - goals, axis=1).max() < 2 * UM


def _valley(surface: vf.Surface) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A point amid the block's valley, a free point near it, and the two walls' normals (2, 3)."""
    i, k = np.argwhere(surface.edges == vf.Edge.VALLEY)[0]
    valley = surface.vertices[surface.faces[i, [k, (k + 1) % 3]]]
    normals = surface.normals[[i, surface.neighbours[i, k]]]
    p = valley.mean(axis=0)
    along = np.cross(*normals)
    p = p - (p @ along) * along  # the block is centred: its middle
    return p, p + 1 * MM * normals.sum(axis=0), normals


def _bowl(radius: float, rings: int = 12, spokes: int = 24) -> np.ndarray:
    """Corners (m, 3, 3) of the facets of a lower half sphere about the origin."""
    down, about = np.linspace(0, np.pi / 2, rings), np.linspace(0, 2 * np.pi, spokes)
    ring = np.stack([np.cos(about), np.sin(about)])
    p = radius * np.stack(
        [np.outer(np.sin(down), ring[0]), np.outer(np.sin(down), ring[1]),
         np.outer(-np.cos(down), np.ones(spokes))], axis=-1
    )  # fmt: skip
    a, b, c, d = p[:-1, :-1], p[1:, :-1], p[1:, 1:], p[:-1, 1:]
    return np.concatenate([np.stack(t, axis=-2).reshape(-1, 3, 3) for t in ((a, b, c), (a, c, d))])


@pytest.mark.parametrize("apart", [0.0, 1e-8], ids=["unwelded", "10 nm apart"])
def test_a_tool_rests_still_between_faces_that_do_not_know_each_other(apart: float) -> None:
    arm = robots.load("point")
    x = arm.tip(arm.neutral).translation
    for seed in (5, 21, 23):
        rng = np.random.default_rng(seed)
        R = naive.rotation(rng)
        radius = rng.uniform(2 * MM, 20 * MM)
        goal = pin.SE3(arm.tip(arm.neutral))
        goal.translation = x + R @ np.array([*rng.normal(scale=0.3, size=2), -1.0]) * 12 * MM
        vertices = (_bowl(radius).reshape(-1, 3) + np.array([0.0, 0.0, radius / 2])) @ R.T + x
        vertices = vertices + rng.uniform(-apart, apart, vertices.shape)
        surface = vf.Surface.from_arrays(vertices, np.arange(len(vertices)).reshape(-1, 3))
        controller = vf.Controller(arm, [vf.MeshFixture(surface)])
        q, tips = np.array(arm.neutral), []
        for _ in range(1500):
            step = controller.step(q, goal)
            q = step.q
            tips.append(step.tip.translation)
        moved = np.linalg.norm(np.diff(tips[-50:], axis=0), axis=1)
        assert moved.max() < 0.1 * UM  # the solver's tolerance


# Blocked


def blocked(surface: vf.Surface, edges: float, queries: int) -> tuple[float, float]:
    """Shares of reachable free space forbidden by certified and paper, at the same points."""
    rng = np.random.default_rng(105)
    radius = edges * surface.median_edge
    forbidden, free = np.zeros(2), np.zeros(2)
    for number in range(queries):
        while True:
            x = naive.around(surface, rng, radius)
            if not surface.inside(x):
                break
        both = (
            vf.certified_planes(surface, x, radius, standoff=0.0),
            vf.paper_planes(surface, x, radius),
        )
        for k, planes in enumerate(both):
            samples = np.random.default_rng(number)
            counts = feel.blocked(surface, planes, x, radius, samples, 24)
            forbidden[k] += counts[0]
            free[k] += counts[1]
    ours, theirs = forbidden / free
    return float(ours), float(theirs)


def check_blocked(name: str, queries: int) -> None:
    for edges in (0.3, 1.0, 3.0):
        ours, theirs = blocked(naive.catalogue(name), edges, queries)
        case = f"{name}, {edges} edges: {ours:.4f} against {theirs:.4f}"
        # Below an edge's length both forbid next to nothing; a tenth of a percent is chance.
        assert ours < theirs + 0.001, case
        if edges >= 1.0 and name in CURVED:
            assert ours < 0.5 * theirs, case


@pytest.mark.parametrize("name", everyday([*CURVED, "cube", "gear"], CURVED[0], "gear"))
def test_less_free_space_is_blocked_than_by_the_papers_conditions(name):
    check_blocked(name, queries=120)


@pytest.mark.slow
@pytest.mark.parametrize("name", naive.NAMES)
def test_less_free_space_is_blocked_on_every_mesh(name):
    check_blocked(name, queries=800)
