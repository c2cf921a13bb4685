"""The certified cover: nothing leaks, on any soup, at any radius, standoff and tip."""

from __future__ import annotations

import heapq
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

import vf
from tests.support import naive
from tests.support.everyday import everyday
from vf.rules.certified import BUDGET, YIELD
from vf.rules.queue import pop, push

UM = 1e-6


def check(
    surface: vf.Surface,
    x: np.ndarray,
    radius: float,
    standoff: float = 0.0,
    tip_radius: float = 0.0,
    corners: np.ndarray | None = None,
) -> vf.Planes:
    """One query against everything the certificate promises."""
    planes = vf.certified_planes(surface, x, radius, standoff, tip_radius)
    scale = np.abs(surface.vertices).max()
    case = f"x {x.tolist()}, radius {radius!r}, standoff {standoff!r}, tip {tip_radius!r}"
    assert 0.0 <= planes.radius <= radius, case
    assert len(planes) <= BUDGET, case
    # Standing still is always allowed.
    assert (planes.slack(x) >= -1e-15 * scale).all(), case
    assert np.abs(np.linalg.norm(planes.normals, axis=1) - 1).max(initial=0) < 1e-12, case
    if corners is None:
        corners = naive.near(surface, x, (radius + tip_radius) * (1 + 1e-6))
    hair = 1e-13 * scale + 1e-300
    # A tip that already touches the surface cannot keep its radius clear of it: what is promised
    # then is that its centre crosses nothing.
    clear = naive.brute(surface).nearest(x) > tip_radius + 2 * hair
    found = naive.leaks(corners, planes, x, tip_radius if clear else 0.0, hair)
    assert not found, f"{case}: {found[:3]}"
    return planes


def loose(corners: np.ndarray) -> vf.Surface:
    return vf.Surface.from_arrays(
        corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3)
    )


# The catalogue


@pytest.mark.parametrize("name", naive.NAMES)
def test_no_leak_on_the_catalogue(name):
    _sweep(naive.catalogue(name), queries=3, seed=51)


@pytest.mark.slow
@pytest.mark.parametrize("name", [*naive.NAMES, naive.HUGE])
def test_no_leak_on_the_catalogue_at_length(name):
    _sweep(naive.catalogue(name), queries=150, seed=52)


def _sweep(surface: vf.Surface, queries: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    for share in (0.3, 1.0, 3.0):
        radius = share * surface.median_edge
        for standoff in (0.0, 20 * UM):
            for tip_radius in (0.0, 0.5e-3):
                for _ in range(queries):
                    x = naive.around(surface, rng, radius + tip_radius)
                    check(surface, x, radius, standoff, tip_radius)


def _damaged(damage: str, rng: np.random.Generator) -> vf.Surface:
    whole = naive.catalogue("skull-coarse")
    vertices, faces = whole.vertices, whole.faces.copy()
    if damage == "unwelded":
        return loose(vertices[faces])
    if damage in ("some flipped", "all flipped"):
        turn = rng.random(len(faces)) < (0.05 if damage == "some flipped" else 1.0)
        faces[turn] = faces[turn][:, ::-1]
    elif damage == "deleted":
        faces = faces[rng.random(len(faces)) > 0.05]
    elif damage == "duplicated":
        faces = np.concatenate([faces, faces[rng.random(len(faces)) < 0.3], faces[::7, ::-1]])
    elif damage == "jittered":
        corners = vertices[faces]
        return loose(corners + 1e-5 * whole.size * rng.normal(size=corners.shape))
    elif damage == "slivers":
        a, b, _ = vertices[faces[::5]].transpose(1, 0, 2)
        width = 10.0 ** rng.uniform(-14, -6, (len(a), 1)) * rng.choice([0, 1], (len(a), 1))
        slivers = np.stack([a, b, 0.3 * a + 0.7 * b + width * rng.normal(size=a.shape)], axis=1)
        return loose(np.concatenate([vertices[faces], slivers, np.repeat(slivers[:9, :1], 3, 1)]))
    elif damage == "fin":
        top = vertices[vertices[:, 2].argmax()]
        fin = top + 1e-2 * np.array([[[-1, 0, -1], [1, 0, -1], [0, 0, 1.0]]])
        return loose(np.concatenate([vertices[faces], fin, fin]))
    elif damage == "interpenetrating":
        corners = vertices[faces]
        return loose(np.concatenate([corners, corners @ naive.rotation(rng).T + 5e-3]))
    return vf.Surface.from_arrays(vertices, faces)


DAMAGES = ["unwelded", "some flipped", "all flipped", "deleted", "duplicated", "jittered",
           "slivers", "fin", "interpenetrating"]  # fmt: skip


@pytest.mark.parametrize("damage", DAMAGES)
def test_damage_opens_no_leak(damage):
    _sweep(_damaged(damage, np.random.default_rng(61)), queries=4, seed=62)


@pytest.mark.slow
@pytest.mark.parametrize("damage", DAMAGES)
def test_damage_opens_no_leak_at_length(damage):
    _sweep(_damaged(damage, np.random.default_rng(63)), queries=300, seed=64)


def test_an_open_sheet_is_guarded_from_both_sides():
    sheet = vf.Surface.from_arrays(
        [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]]
    )
    for z in (0.1, -0.1):
        planes = check(sheet, np.array([0.7, 0.4, z]), 0.5)
        assert np.allclose(planes.normals, [[0, 0, np.sign(z)]])
        assert 0.0 <= planes.offsets[0] < 1e-3


# Random soups


@st.composite
def soups(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray]:
    """A soup (m, 3, 3) of a nature that hypothesis picks and a seed fills in, and a point."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    m = draw(st.integers(1, 60))
    size = 10.0 ** draw(st.integers(-3, 1))
    corners = rng.normal(size=(m, 1, 3)) + size * rng.normal(size=(m, 3, 3))
    kind = draw(st.sampled_from(["free", "dyadic", "planar", "slivers", "repeated", "fans"]))
    if kind == "dyadic":  # exact coincidences of corners, edges and planes
        corners = rng.integers(-2, 3, (m, 3, 3)).astype(float)
    elif kind == "planar":
        corners[:, :, 2] = rng.integers(-1, 2, (m, 1)) * 0.25
    elif kind == "slivers":
        corners[:, 2] = corners[:, 0] + rng.random((m, 1)) * (corners[:, 1] - corners[:, 0])
        corners[:, 2] += 10.0 ** rng.uniform(-17, -3, (m, 1)) * rng.normal(size=(m, 3))
    elif kind == "repeated":
        corners[m // 2 :] = corners[rng.integers(0, max(m // 2, 1), m - m // 2)]
    elif kind == "fans":
        corners[:, 0] = corners[0, 0]
        corners[1:, 1] = corners[:-1, 2]
    x = draw(st.sampled_from(["near", "corner", "dyadic"]))
    if x == "near":
        point = rng.normal(size=3) * 10.0 ** rng.uniform(-3, 0.5)
    elif x == "corner":
        point = corners[0, 0] + 10.0 ** rng.uniform(-12, 0) * rng.normal(size=3)
    else:
        point = rng.integers(-4, 5, 3) / 2.0
    return corners, point


def _weld(corners: np.ndarray) -> vf.Surface:
    vertices, names = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    return vf.Surface.from_arrays(vertices, names.reshape(-1, 3))


@naive.PROPERTY
@given(soups(), st.floats(1e-3, 4.0), st.sampled_from([0.0, 1e-4, 0.1]),
       st.sampled_from([0.0, 0.05, 0.5]), st.booleans())  # fmt: skip
def test_no_leak_on_random_soups(soup, radius, standoff, tip_radius, welded):
    corners, x = soup
    check((_weld if welded else loose)(corners), x, radius, standoff, tip_radius, corners)


@pytest.mark.slow
@naive.MANY
@given(soups(), st.floats(1e-3, 4.0), st.sampled_from([0.0, 1e-4, 0.1]),
       st.sampled_from([0.0, 0.05, 0.5]), st.booleans())  # fmt: skip
def test_no_leak_on_many_random_soups(soup, radius, standoff, tip_radius, welded):
    corners, x = soup
    check((_weld if welded else loose)(corners), x, radius, standoff, tip_radius, corners)


def test_random_points_of_the_surface_are_behind_some_plane():
    """The same property by plain sampling, which shares nothing with the clipping oracle."""
    rng = np.random.default_rng(71)
    for name in ("saddle-slab", "gear", "skull-coarse"):
        surface = naive.catalogue(name)
        for _ in range(20):
            radius = surface.median_edge * 10.0 ** rng.uniform(-0.5, 0.7)
            x = naive.around(surface, rng, radius)
            planes = vf.certified_planes(surface, x, radius, 20 * UM)
            corners = naive.near(surface, x, radius)
            weights = rng.dirichlet((0.6, 0.6, 0.6), size=200)
            z = np.einsum("sk,ikj->isj", weights, corners)
            z = z.reshape(-1, 3)
            z = z[np.linalg.norm(z - x, axis=1) < planes.radius]
            behind = (z @ planes.normals.T < planes.offsets).any(axis=1)
            assert behind.all(), (name, x.tolist(), radius, z[~behind][:3].tolist())


def test_the_oracle_sees_a_missing_plane():
    """The leak oracle is worth nothing if it lets everything pass."""
    rng = np.random.default_rng(72)
    surface = naive.catalogue("gear")
    missed = seen = 0
    for _ in range(30):
        radius = 2 * surface.median_edge
        x = naive.around(surface, rng, 0.5 * radius)
        planes = vf.certified_planes(surface, x, radius)
        corners = naive.near(surface, x, radius)
        for k in range(len(planes)):
            keep = np.arange(len(planes)) != k
            fewer = replace(planes, normals=planes.normals[keep], offsets=planes.offsets[keep])
            if naive.leaks(corners, fewer, x):
                seen += 1
            else:
                missed += 1
    # A few planes are made superfluous by later ones.
    assert seen > 10 * missed


def test_steps_within_planes_and_ball_cross_nothing():
    """The claim itself: end points that obey the planes, joined to x, against exact crossings."""
    rng = np.random.default_rng(73)
    taken = 0
    for name in ("star-prism", "skull-coarse", "thin-plate"):
        surface = naive.catalogue(name)
        for _ in range(15):
            radius = surface.median_edge * 10.0 ** rng.uniform(-0.5, 0.8)
            x = naive.around(surface, rng, 0.3 * radius)
            planes = vf.certified_planes(surface, x, radius, 20 * UM)
            near = naive.near(surface, x, radius)
            for _ in range(20):
                y = x + naive.unit(rng) * planes.radius * rng.random() ** 0.3
                for _ in range(50):  # pushed back onto the planes it is behind
                    slack = planes.slack(y)
                    if len(slack) == 0 or slack.min() >= 0:
                        break
                    y = y - slack.min() * planes.normals[slack.argmin()] * 1.000001
                if np.linalg.norm(y - x) <= planes.radius and (planes.slack(y) >= 0).all():
                    assert not naive.crosses(near, x, y), (name, x.tolist(), y.tolist())
                    taken += 1
    assert taken > 300


# Budget, surface contact, tip, bad input


def _urchin() -> np.ndarray:
    """Spines pointing at the origin from all around, 0.97 to 1 away."""
    rng = np.random.default_rng(81)
    away = rng.normal(size=(400, 3))
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    side = np.cross(away, rng.normal(size=(400, 3))) * 0.02
    start = away * rng.uniform(0.97, 1.0, (400, 1))
    return np.stack([start, start + side + 0.3 * away, start - side + 0.3 * away], axis=1)


def test_when_the_budget_is_spent_the_ball_shrinks_and_nothing_leaks():
    """A tip that all but fills the urchin: every spine wants its own plane."""
    corners = _urchin()
    planes = check(loose(corners), np.zeros(3), 0.3, 0.0, 0.95, corners)
    assert len(planes) == BUDGET
    assert 0.02 <= planes.radius < 0.05


@pytest.mark.parametrize("budget", everyday([1, 3, 10], 10))
@pytest.mark.parametrize(("standoff", "tip_radius"), [(0, 0), (0.05, 0), (0, 0.1), (0.05, 0.1)])
def test_the_ball_shrinks_at_any_budget(budget, standoff, tip_radius, monkeypatch):
    monkeypatch.setattr("vf.rules.certified.BUDGET", budget)
    corners = _urchin()
    planes = check(loose(corners), np.zeros(3), 1.2, standoff, tip_radius, corners)
    assert len(planes) == budget
    assert 0.97 - tip_radius - 1e-6 <= planes.radius < 1.0 - tip_radius
    rng = np.random.default_rng(83)
    surface = naive.catalogue("saddle-slab")
    for _ in range(10):
        radius = 3 * surface.median_edge
        check(surface, naive.around(surface, rng, radius), radius, 1e-3 * standoff)


@pytest.mark.parametrize("name", ["cube", "sphere", "saddle-slab"])
def test_a_tip_on_the_surface(name):
    """x on a corner, an edge or a face, within rounding: no motion, or none that leaks."""
    surface = naive.catalogue(name)
    rng = np.random.default_rng(82)
    radius = surface.median_edge
    for weights in ([1, 0, 0], [0.5, 0.5, 0], [0.2, 0.5, 0.3]):
        for hair in (0.0, 1e-18, 1e-16, 1e-15, 1e-13, 1e-10):
            face = surface.faces[rng.integers(len(surface.faces))]
            x = np.array(weights) @ surface.vertices[face] + hair * naive.unit(rng)
            check(surface, x, radius, 20 * UM)


def test_offsets_stand_off_from_the_surface_but_never_past_the_tool():
    surface = loose(np.array([[[-1, -1, 0], [1, -1, 0], [0, 2, 0]]], dtype=float))
    for z, standoff, tip, expected in (
        (0.5, 0.0, 0.0, 0.0), (0.5, 0.1, 0.0, 0.1), (0.05, 0.1, 0.0, 0.05),
        (0.5, 0.1, 0.2, 0.3), (0.25, 0.1, 0.2, 0.25),
    ):  # fmt: skip
        planes = vf.certified_planes(surface, [0.0, 0.0, z], 1.0, standoff, tip)
        # Far planes may stand off by a little more, so that facets share them.
        assert expected - 1.01 * YIELD <= planes.offsets[0] <= min(expected + 0.005 * z, z)
        assert len(planes) == 1


def test_a_tip_low_beside_a_valley():
    """A valley plane below the tip's centre by less than its radius would let the rim in."""
    surface = vf.Surface.from_arrays(
        [[-1, 0.2, -0.02], [0.7, -0.1, 0.01], [-1.4, 0, 0.02], [0, 0.6, 0]], [[1, 2, 3], [1, 3, 0]]
    )
    check(surface, np.array([0.47, 0.57, 0.05]), 1.1, tip_radius=0.12)


def test_few_welded_triangles_with_a_tip():
    """Ridges and valleys at all angles, between triangles as long as the tip is wide."""
    rng = np.random.default_rng(84)
    for _ in range(60):
        vertices = rng.normal(size=(6, 3)) * [1, 1, rng.choice([0.01, 0.1, 1])]
        faces = [rng.choice(6, 3, replace=False) for _ in range(rng.integers(2, 7))]
        surface = vf.Surface.from_arrays(vertices, faces)
        for _ in range(10):
            x = rng.normal(size=3) * [1, 1, rng.choice([0.1, 1])]
            radius, tip_radius = 10 ** rng.uniform(-1.5, 0.5), 10 ** rng.uniform(-2, 0)
            check(surface, x, radius, rng.choice([0, 0.05]), tip_radius, vertices[faces])


BAD = [
    ({"x": [0.0, np.nan, 0.0]}, "nan"),
    ({"x": [0.0, 0.0]}, "0.0, 0.0"),
    ({"radius": np.nan}, "nan"),
    ({"radius": -1e-3}, "-0.001"),
    ({"standoff": -1e-6}, "-1e-06"),
    ({"standoff": np.nan}, "nan"),
    ({"tip_radius": -0.5}, "-0.5"),
    ({"tip_radius": np.nan}, "nan"),
]


@pytest.mark.parametrize(("change", "word"), BAD)
def test_bad_input_is_refused_by_its_value(change, word):
    good = {"x": [0.0, 0.0, 1.5], "radius": 1.0, "standoff": 0.0, "tip_radius": 0.0}
    solid = trimesh.creation.box((2, 2, 2))
    with pytest.raises(ValueError, match=word):
        vf.certified_planes(vf.Surface.from_arrays(solid.vertices, solid.faces), **(good | change))


def test_the_queue_gives_the_nearest_first_whatever_comes_and_goes():
    """Against heapq, with ties, from empty to some hundred entries and back."""
    rng = np.random.default_rng(3)
    queue = np.full((512, 3), np.nan)
    expected: list[tuple[float, int]] = []
    size = 0
    for turn in range(5_000):
        growing = turn % 1000 < 500
        if size == 0 or (size < 500 and rng.random() < (0.7 if growing else 0.3)):
            key = float(rng.integers(50))
            push(queue, size, key, turn, float(turn))
            heapq.heappush(expected, (key, turn))
            size += 1
        else:
            key, item = float(queue[0, 0]), int(queue[0, 1])
            pop(queue, size)
            size -= 1
            assert key == expected[0][0]
            expected.remove((key, item))
            heapq.heapify(expected)
        assert sorted(map(tuple, queue[:size, :2].tolist())) == sorted(expected)
        assert (queue[:size, 1] == queue[:size, 2]).all()  # what belongs together stays together
