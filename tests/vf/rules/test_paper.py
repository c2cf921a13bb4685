"""The paper's Conditions 1–3 on tiny meshes worked out by hand, and on the clean catalogue."""

from __future__ import annotations

import numpy as np
import pytest

import vf
from tests.support import naive
from tests.support.figures import CASES, RIDGE, T1, hinge, polar


def rules(planes: vf.Planes) -> dict[int, int]:
    assert len(set(planes.triangles.tolist())) == len(planes)
    return dict(zip(planes.triangles.tolist(), planes.rules.tolist(), strict=True))


@pytest.mark.parametrize("case", list(CASES))
def test_the_cases_of_figures_4_and_5(case):
    degrees, x, expected = CASES[case]
    planes = vf.paper_planes(vf.Surface.from_arrays(*hinge(degrees)), x, 2.0)
    assert rules(planes) == expected
    assert planes.radius == 2.0
    up = np.array([0.0, 0.0, 1.0])
    tilted = polar(degrees + 90)
    for n, o, p, triangle, rule in zip(
        planes.normals, planes.offsets, planes.points, planes.triangles, planes.rules, strict=True
    ):
        # All planes of these cases pass through the edge at O or hold it.
        assert o == pytest.approx(0.0, abs=1e-12)
        assert n @ p == pytest.approx(o, abs=1e-12)
        if rule == RIDGE:
            assert np.allclose(n, x / np.linalg.norm(x))
        else:
            assert np.allclose(n, up if triangle == T1 else tilted)


def _moved(
    case: str, scale: float, R: np.ndarray, shift: np.ndarray, mirror: bool, order: list[int]
) -> tuple[vf.Surface, np.ndarray, float, np.ndarray]:
    degrees, x, _ = CASES[case]
    vertices, faces = hinge(degrees)
    M = R @ np.diag([-1.0, 1, 1]) if mirror else R
    if mirror:
        faces = faces[:, ::-1]  # a mirror image faces out only with its corners reversed
    names = np.argsort(order)
    vertices, faces = vertices[order], names[faces]
    return (
        vf.Surface.from_arrays(scale * vertices @ M.T + shift, faces), scale * M @ x + shift,
        2.0 * scale, M,
    )  # fmt: skip


@pytest.mark.parametrize("case", list(CASES))
@pytest.mark.parametrize("mirror", [False, True], ids=["as is", "mirrored"])
def test_moved_copies_have_the_same_planes(case, mirror):
    original = vf.paper_planes(vf.Surface.from_arrays(*hinge(CASES[case][0])), CASES[case][1], 2.0)
    rng = np.random.default_rng(31)
    for scale in (1e-3, 1e-2, 1.0, 1e3):
        for _ in range(5):
            R = naive.rotation(rng)
            shift = scale * rng.normal(size=3)
            order = rng.permutation(4).tolist()
            surface, x, radius, M = _moved(case, scale, R, shift, mirror, order)
            planes = vf.paper_planes(surface, x, radius)
            assert rules(planes) == rules(original), (scale, R.tolist(), order)
            for triangle in rules(original):
                i, j = (np.flatnonzero(p.triangles == triangle)[0] for p in (planes, original))
                assert np.allclose(planes.normals[i], M @ original.normals[j], atol=1e-9)
                offset = scale * original.offsets[j] + planes.normals[i] @ shift
                assert planes.offsets[i] == pytest.approx(offset, abs=1e-9 * scale)


@pytest.mark.parametrize("case", list(CASES))
def test_reordered_faces_and_corners_have_the_same_planes(case):
    degrees, x, expected = CASES[case]
    vertices, faces = hinge(degrees)
    original = vf.paper_planes(vf.Surface.from_arrays(vertices, faces), x, 2.0)
    for swap in (False, True):
        for roll in range(3):
            other = np.roll(faces[::-1] if swap else faces, roll, axis=1)
            planes = vf.paper_planes(vf.Surface.from_arrays(vertices, other), x, 2.0)
            assert len(planes) == len(expected)
            for n in original.normals:
                assert (np.abs(planes.normals - n).max(axis=1) < 1e-12).any()
            found = {1 - t if swap else t: r for t, r in rules(planes).items()}
            if RIDGE in expected.values():
                assert list(found.values()) == [RIDGE]  # under whichever of the two is first
            else:
                assert found == expected


def test_a_vertex_of_a_convex_fan_gives_one_plane():
    """The apex of a pyramid is the closest point of all its faces."""
    for sides in (3, 4, 7):
        angle = 2 * np.pi * np.arange(sides) / sides
        ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle - 1], axis=1)
        k = np.arange(sides)
        faces = np.stack([k, (k + 1) % sides, np.full(sides, sides)], axis=1)
        surface = vf.Surface.from_arrays([*ring.tolist(), [0, 0, 0]], faces)
        planes = vf.paper_planes(surface, [0.02, 0.01, 0.5], 0.6)
        assert planes.rules.tolist() == [RIDGE]
        assert np.allclose(planes.points, 0.0)
        x = np.array([0.02, 0.01, 0.5])
        assert np.allclose(planes.normals[0], x / np.linalg.norm(x))


def test_above_the_diagonal_of_a_flat_square_there_is_a_plane():
    surface = vf.Surface.from_arrays(
        [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]]
    )
    planes = vf.paper_planes(surface, [0.5, 0.5, 0.25], 0.3)
    assert len(planes) == 1
    assert np.allclose(planes.normals, [[0, 0, 1]])


def test_only_triangles_within_the_ball_count():
    surface = vf.Surface.from_arrays(*hinge(60))
    x = polar(120)
    assert len(vf.paper_planes(surface, x, 0.8)) == 0  # √3/2 from both
    assert len(vf.paper_planes(surface, x, 0.9)) == 2


def test_every_plane_is_the_face_plane_of_every_triangle_in_the_ball():
    surface = naive.catalogue("star-prism")
    rng = np.random.default_rng(8)
    for _ in range(20):
        x = naive.around(surface, rng, 2e-3)
        planes = vf.every_plane(surface, x, 3e-3)
        ids, distances = naive.brute(surface).within(x, 3e-3)
        inside = np.sort(ids[distances <= 3e-3])
        assert (np.sort(planes.triangles) == inside).all()
        assert (planes.rules == vf.Rule.NAIVE).all()
        corners = surface.vertices[surface.faces[planes.triangles]]
        n = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        n /= np.linalg.norm(n, axis=1, keepdims=True)
        assert np.allclose(planes.normals, n, atol=1e-12)
        heights = np.einsum("ij,ikj->ik", n, corners)
        assert np.allclose(heights, planes.offsets[:, None], atol=1e-12)


@pytest.mark.parametrize("radius", [-1e-3, np.nan])
@pytest.mark.parametrize("rule", [vf.paper_planes, vf.every_plane])
def test_a_bad_radius_is_refused_by_its_value(rule, radius):
    surface = vf.Surface.from_arrays(*hinge(60))
    with pytest.raises(ValueError, match=str(radius)):
        rule(surface, polar(120), radius)


@pytest.mark.parametrize("rule", [vf.paper_planes, vf.every_plane])
def test_a_bad_point_is_refused(rule):
    surface = vf.Surface.from_arrays(*hinge(60))
    with pytest.raises(ValueError, match="nan"):
        rule(surface, [0.0, np.nan, 0.0], 1.0)


def outside(surface: vf.Surface, rng: np.random.Generator, reach: float) -> np.ndarray:
    while True:
        x = naive.around(surface, rng, reach)
        if not surface.inside(x) and surface.nearest(x)[0] > 1e-9:
            return x


@pytest.mark.parametrize("name", naive.NAMES)
def test_no_leak_on_clean_closed_meshes(name):
    """Seen from outside, each part of the surface in the ball is behind some plane."""
    surface = naive.catalogue(name)
    rng = np.random.default_rng(41)
    checked = 0
    for share in (0.3, 1.0, 3.0):
        radius = share * surface.median_edge
        for _ in range(12):
            x = outside(surface, rng, radius)
            planes = vf.paper_planes(surface, x, radius)
            corners = naive.near(surface, x, radius)
            found = naive.leaks(corners, planes, x, hair=1e-9 * surface.median_edge)
            assert not found, (name, share, x.tolist(), corners[[i for i, _ in found]])
            checked += len(corners)
    assert checked > 100
