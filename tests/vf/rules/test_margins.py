"""Margins of a surface: what planes promise with them, at the level of a query and of ticks."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

import robots
import vf
from tests.support import naive
from tests.support.ticks import UM, plate, pose

HAIR = 3e-8  # what planes leave a tool to slide by, and rounding [m]
STANDOFF = 20 * UM


def soup(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Triangles that share corners here and there, within some millimetres of the origin."""
    vertices = rng.normal(size=(max(count, 3), 3)) * rng.uniform(1e-3, 4e-3)
    faces = np.array([rng.choice(len(vertices), 3, replace=False) for _ in range(count)])
    return vertices, faces


def distances(vertices: np.ndarray, faces: np.ndarray, x: np.ndarray) -> np.ndarray:
    return naive.closest(vertices[faces], x)[1]


def promised(d: np.ndarray, margins: np.ndarray, tip_radius: float, standoff: float) -> np.ndarray:
    """How far the tip's centre stays from each triangle (k,), from the definition.

    The distances at the start are d (k,). Margins that are not kept there are all lowered by what
    is missing to the worst of them.
    """
    room = d - tip_radius
    missing = np.where(margins > 0.0, margins + standoff - room, 0.0).max(initial=0.0)
    if missing <= 0.1 * standoff:
        missing = 0.1 * standoff  # nothing is lowered for that
    return tip_radius + np.maximum(margins - missing, 0.0)


def farthest(planes: vf.Planes, x: np.ndarray, way: np.ndarray) -> np.ndarray:
    """Where a straight step (3,) has to end to obey the planes."""
    slack, rate = planes.slack(x), planes.normals @ way
    towards = rate < 0.0
    share = float((slack[towards] / -rate[towards]).min(initial=1.0))
    length = float(np.linalg.norm(way))
    return x + min(share, planes.radius / length) * (1.0 - 1e-9) * way


@naive.PROPERTY
@given(st.integers(0, 10**6), st.sampled_from([1, 2, 6, 25]), st.booleans(), st.booleans())
def test_steps_keep_every_margin_or_go_no_deeper(
    seed: int, count: int, varied: bool, thick: bool
) -> None:
    rng = np.random.default_rng(seed)
    vertices, faces = soup(rng, count)
    surface = vf.Surface.from_arrays(vertices, faces)
    size = 10 ** rng.uniform(-5, -2.5)
    own = rng.uniform(0.0, size, len(vertices)) * (rng.random(len(vertices)) < 0.8)
    margin = own if varied else float(size)
    of_faces = own[faces].max(axis=1) if varied else np.full(count, size)
    tip_radius = 1e-4 if thick else 0.0
    x = rng.normal(size=3) * 3e-3
    d = distances(vertices, faces, x)
    if d.min() < tip_radius + 1e-7:
        return
    radius = 10 ** rng.uniform(-4, -2)
    planes = vf.certified_planes(surface, x, radius, STANDOFF, tip_radius, margin)
    assert planes.slack(x).min(initial=0.0) >= 0.0
    kept = promised(d, of_faces, tip_radius, STANDOFF)
    points = naive.closest(vertices[faces], x)[0]
    for k in range(40):
        # Towards a triangle, past it, or anywhere.
        way = rng.normal(size=3) * radius
        if k % 2:
            way = 1.5 * (points[rng.integers(count)] - x) + rng.normal(size=3) * 0.1 * radius
        y = farthest(planes, x, way)
        short = kept - distances(vertices, faces, y)
        assert short.max() <= HAIR, f"seed {seed}: {short.max():.3g} m below a margin"


def test_margins_are_not_kept_by_a_query_without_them() -> None:
    """The judge of the property above can fail."""
    surface = plate()
    x = np.array([0.0, 0.0, 2e-3])
    planes = vf.certified_planes(surface, x, 3e-3, STANDOFF)
    y = farthest(planes, x, np.array([0.0, 0.0, -3e-3]))
    assert y[2] == pytest.approx(STANDOFF, abs=UM)
    planes = vf.certified_planes(surface, x, 3e-3, STANDOFF, margin=1e-3)
    y = farthest(planes, x, np.array([0.0, 0.0, -3e-3]))
    assert y[2] == pytest.approx(1e-3 + STANDOFF, abs=UM)


@pytest.mark.parametrize("axis", [False, True])
def test_a_margin_is_a_larger_radius(axis: bool) -> None:
    rng = np.random.default_rng(3)
    for _ in range(50):
        vertices, faces = soup(rng, 12)
        surface = vf.Surface.from_arrays(vertices, faces)
        x = rng.normal(size=3) * 4e-3
        ends = np.stack([x, x + rng.normal(size=3) * 3e-3]) if axis else x
        if vf.certified_planes(surface, ends, 1e-6, STANDOFF, 5e-4).radius < 1e-6:
            continue
        wide = vf.certified_planes(surface, ends, 2e-3, STANDOFF, 3e-4)
        with_margin = vf.certified_planes(surface, ends, 2e-3, STANDOFF, 1e-4, 2e-4)
        if np.abs(wide.slack(np.atleast_2d(ends)[0])).min(initial=1.0) < STANDOFF:
            continue
        same = vf.certified_planes(
            surface, ends, 2e-3, STANDOFF, 1e-4, np.full(len(vertices), 2e-4)
        )
        for other in (with_margin, same):
            np.testing.assert_allclose(other.normals, wide.normals, atol=1e-12)
            np.testing.assert_allclose(other.offsets, wide.offsets, atol=1e-12)


@pytest.mark.parametrize(
    ("margin", "said"),
    [
        (-1e-3, "margin"),
        (np.inf, "margin"),
        ("wide", "wide"),
        (np.full(3, 1e-3), r"\(3,\)"),
        (np.zeros((4, 1)), r"\(4, 1\)"),
        (np.array([0.0, 1.0, -2.0, 0.0]), "vertex 2.*-2"),
        (np.array([0.0, np.nan, 0.0, 0.0]), "vertex 1.*nan"),
    ],
)
def test_margins_of_no_use_are_refused(margin: object, said: str) -> None:
    surface = vf.Surface.from_arrays(np.eye(4)[:, :3], [[0, 1, 2], [0, 1, 3]])
    for make in (
        lambda: vf.MeshFixture(surface, margin=margin),  # type: ignore[arg-type]
        lambda: vf.certified_planes(surface, np.ones(3), 1.0, margin=margin),  # type: ignore[arg-type]
    ):
        with pytest.raises(ValueError, match=said):
            make()


def test_guards_and_names_of_no_use_are_refused() -> None:
    surface = plate()
    with pytest.raises(ValueError, match=r"'shaft'.*tip, tool"):
        vf.MeshFixture(surface, guard="shaft")
    with pytest.raises(ValueError, match="text, got 7"):
        vf.MeshFixture(surface, name=7)  # type: ignore[arg-type]
    assert vf.MeshFixture(surface, name="dura").name == "dura"


def pressed(
    fixtures: list[vf.MeshFixture], start: list[float], goal: list[float], ticks: int
) -> list[vf.Step]:
    controller = vf.Controller(robots.load("point"), fixtures, vf.Settings())
    q, steps = np.array(start), []
    for _ in range(ticks):
        steps.append(controller.step(q, pose(goal)))
        q = steps[-1].q
    return steps


@pytest.mark.parametrize("rule", ["certified", "paper", "all"])
@pytest.mark.parametrize("varied", [False, True])
def test_a_tool_pressed_onto_a_plate_rests_at_its_margin(rule: str, varied: bool) -> None:
    surface = plate()
    margin = np.full(len(surface.vertices), 1e-3) if varied else 1e-3
    fixture = vf.MeshFixture(surface, rule, margin=margin)
    last = pressed([fixture], [0.0, 0.0, 2e-3], [3e-3, 0.0, -5e-3], 100)[-1]
    assert last.tip.translation[2] == pytest.approx(1e-3 + STANDOFF, abs=1.5 * UM)
    assert last.tip.translation[0] == pytest.approx(3e-3, abs=10 * UM)


def test_a_margin_that_varies_is_followed_along_the_surface() -> None:
    surface = plate()
    margin = np.where(surface.vertices[:, 0] > 0.01, 1e-3, 0.0)
    fixture = vf.MeshFixture(surface, margin=margin)
    here = pressed([fixture], [-8e-3, 0.0, 2e-3], [-8e-3, 0.0, -5e-3], 60)[-1]
    there = pressed([fixture], [0.014, 0.0, 2e-3], [0.014, 0.0, -5e-3], 60)[-1]
    assert here.tip.translation[2] < 2 * STANDOFF
    assert there.tip.translation[2] > 1e-3
    # A triangle has the largest margin of its corners: from x = 0.3 mm on.
    steps = pressed([fixture], [-8e-3, 0.0, 1e-3], [0.02, 0.0, -1e-3], 400)
    high = [s.tip.translation for s in steps if s.tip.translation[0] > 1e-3]
    assert all(p[2] > 1e-3 for p in high)


def test_a_tool_within_the_margin_is_led_out_slowly_and_never_deeper() -> None:
    fixture = vf.MeshFixture(plate(), margin=1e-3)
    steps = pressed([fixture], [0.0, 0.0, 4e-4], [0.0, 0.0, -5e-3], 150)
    heights = np.array([4e-4] + [s.tip.translation[2] for s in steps])
    rises = np.diff(heights)
    assert rises.min() > -HAIR
    assert rises.max() < 25 * UM
    assert heights[-1] > 1e-3
    assert steps[0].status is vf.Status.RECOVERING


@pytest.mark.parametrize(("low", "high"), [(3e-3, 5e-4), (3e-3, 0.0), (1e-3, 1e-3), (2e-3, 9e-4)])
def test_between_two_structures_a_tool_neither_freezes_nor_crosses(low: float, high: float) -> None:
    """A gap of 2 mm: the margins overlap, and the tool can still slide along and out of it."""
    lower, upper = plate(0.0, 0.05), plate(7e-3, 0.05)
    fixtures = [vf.MeshFixture(lower, margin=low), vf.MeshFixture(upper, margin=high)]
    steps = pressed(fixtures, [-0.02, 0.0, 5e-4], [0.04, 0.0, -5e-3], 900)
    tips = np.array([s.tip.translation for s in steps])
    inside = np.abs(tips[:, 0]) < 0.024
    assert (tips[inside, 2] > 0.0).all()
    assert (tips[inside, 2] < 2e-3).all()
    assert tips[:, 0].max() > 0.03  # it came out at the other end
    assert np.diff(tips[:, 0])[:50].min() >= -HAIR


def test_a_fixture_says_which_parts_of_the_tool_it_guards() -> None:
    arm = robots.load("psm")
    q = arm.neutral
    middle = arm.axes(q)[2].mean(axis=0)
    wall = plate(0.0, 0.02)
    beside = middle - [0.0, 0.0, 1e-3] - [0.011 + arm.capsules[2].radius, 0.0, 0.0]
    surface = vf.Surface.from_arrays(wall.vertices + beside, wall.faces)
    found = {}
    for own in (None, "tip", "tool"):
        for whole in ("tip", "tool"):
            fixture = vf.MeshFixture(surface, guard=own, margin=1.5e-3)
            controller = vf.Controller(arm, [fixture], vf.Settings(guard=whole))
            step = controller.step(q, arm.tip(q))
            assert step.planes.capsules is not None
            found[own, whole] = bool((step.planes.capsules > 0).any())
    assert found == {
        (None, "tip"): False, (None, "tool"): True, ("tip", "tip"): False,
        ("tip", "tool"): False, ("tool", "tip"): True, ("tool", "tool"): True,
    }  # fmt: skip


def test_the_margin_of_a_structure_holds_for_the_shaft() -> None:
    arm = robots.load("psm")
    q = arm.neutral
    a, b = arm.axes(q)[2]
    wall = plate(0.0, 0.02)
    turned = wall.vertices @ pin.rpy.rpyToMatrix(0.0, np.pi / 2, 0.0).T
    edge = turned[:, 0].max()
    place = 0.5 * (a + b) - [edge + arm.capsules[2].radius + 2e-3, 0.0, 0.0]
    surface = vf.Surface.from_arrays(turned + place, wall.faces)
    fixture = vf.MeshFixture(surface, margin=1e-3, guard="tool")
    controller = vf.Controller(arm, [fixture], vf.Settings())
    goal = arm.tip(q)
    goal = pin.SE3(goal.rotation, goal.translation - [0.03, 0.0, 0.0])
    for _ in range(150):
        q = controller.step(q, goal).q
    a, b = arm.axes(q)[2]
    marks = a + np.linspace(0.0, 1.0, 200)[:, None] * (b - a)
    gap = min(surface.nearest(p)[0] for p in marks) - arm.capsules[2].radius
    assert 1e-3 <= gap < 1e-3 + 60 * UM
