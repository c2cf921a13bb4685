"""Surfaces that deform: boxes, sides and memory of their shapes, and vertices of no use."""

from __future__ import annotations

import numpy as np
import pytest

import vf
from tests.support.balls import ball, bumped
from vf.tree.pdtree import triangles_below


def test_boxes_hold_both_shapes_and_all_between() -> None:
    rng = np.random.default_rng(3)
    surface = ball(0.01, 3)
    body: vf.Surface = surface
    for _ in range(4):
        now = body.vertices_after if isinstance(body, vf.DeformingSurface) else body.vertices
        body = body.deforming(now + bumped(rng, now, 2e-3) + 0.01 * rng.normal(size=3))
        for blend in (0.0, 0.3, 1.0):
            shown = body.shape(blend)
            expected = vf.Surface.from_arrays(
                (1.0 - blend) * body.vertices + blend * body.vertices_after, body.faces
            )
            assert np.abs(shown.vertices - expected.vertices).max() < 1e-17
            for _ in range(40):
                x = expected.vertices[rng.integers(len(expected.vertices))]
                x = x + rng.normal(size=3) * 10 ** rng.uniform(-6, -2)
                assert shown.nearest(x)[0] == pytest.approx(expected.nearest(x)[0], abs=1e-15)
                assert shown.inside(x) == expected.inside(x)
                radius = 10 ** rng.uniform(-4, -2)
                one, other = shown.within(x, radius), expected.within(x, radius)
                assert sorted(one.triangles) == sorted(other.triangles)
        assert (body.vertices == body.shape(0.0).vertices).all()
        assert (body.vertices_after == body.shape(1.0).vertices).all()
        assert np.abs(body.normals - vf.Surface.from_arrays(body.vertices, body.faces).normals
                      ).max() < 1e-9  # fmt: skip
        assert body.closed


@pytest.mark.parametrize("kind", ["any triangles", "flat", "on a grid", "apart"])
@pytest.mark.parametrize("triangles", [1, 7, 64, 300, 2000])
def test_boxes_and_bounds_of_displacements_hold_any_mesh(kind: str, triangles: int) -> None:
    rng = np.random.default_rng(triangles)
    count = 3 * triangles if kind == "apart" else max(3, triangles // 2)
    vertices = rng.normal(size=(count, 3)) * 0.01
    if kind == "flat":
        vertices[:, 2] = 0.0
    elif kind == "on a grid":  # many are at one place
        vertices = np.round(vertices, 2)
    faces = rng.permutation(count) if kind == "apart" else rng.integers(0, count, 3 * triangles)
    surface = vf.Surface.from_arrays(vertices, faces.reshape(-1, 3))
    after = vertices + rng.normal(size=vertices.shape) * 2e-3
    body = surface.deforming(vertices).deforming(after)
    nodes, *_ = body.shape(1.0).tree
    for node, record in enumerate(nodes):
        first, last = triangles_below(nodes, node)
        held = np.unique(surface.faces[body.searched.order[first:last]])
        far = np.abs((after[held] - record[:3]) @ record[6:15].reshape(3, 3).T).max(axis=0)
        assert (far <= record[3:6]).all()
        ways = after[held] - vertices[held]
        assert (body.shifts[node, :3] <= ways.min(axis=0)).all()
        assert (body.shifts[node, 3:] >= ways.max(axis=0)).all()


def test_boxes_are_hardly_larger_than_what_they_hold() -> None:
    """Where each is fitted to those of its children they are 1.84 times as large here."""
    rng = np.random.default_rng(4)
    surface = ball(0.01, 4)
    shape = surface.vertices + bumped(rng, surface.vertices, 2e-3)
    body = surface.deforming(shape).deforming(surface.vertices)
    for blend in (0.0, 0.4, 1.0):
        nodes, corners, *_ = body.shape(blend).tree
        for node, record in enumerate(nodes):
            first, last = triangles_below(nodes, node)
            points = corners[first:last].reshape(-1, 3) - record[:3]
            held = np.abs(points @ record[6:15].reshape(3, 3).T).max(axis=0)
            assert (held <= record[3:6]).all()
            assert record[3:6].sum() < 1.4 * held.sum()


def test_memory_is_taken_again_only_when_nobody_looks_at_it() -> None:
    surface = ball(0.01, 3)
    held = surface.deforming(1.1 * surface.vertices)
    parts, vertices = [part.copy() for part in held.parts], held.vertices_after.copy()
    places = set()
    body = held
    for k in range(20):
        body = body.deforming((1.0 + 0.01 * k) * surface.vertices)
        places.add(body.parts[-1].ctypes.data)
    assert len(places) <= 3
    for part, kept in zip(held.parts, parts, strict=True):
        assert (part == kept).all()
    assert (held.shape(1.0).vertices == vertices).all()
    part = held.parts[-1][3:5]
    del held
    for _ in range(5):
        body = body.deforming(surface.vertices)
        assert not np.shares_memory(part, body.parts[-1])


def test_vertices_of_no_use_are_refused_by_name() -> None:
    surface = ball()
    v = surface.vertices
    bad = v.copy()
    bad[[40, 7], 1] = np.nan, np.inf
    with pytest.raises(ValueError, match=r"vertex 7 is not finite.*inf"):
        surface.deforming(bad)
    far = v.copy()
    far[11, 2] = -2e7
    with pytest.raises(ValueError, match=r"vertex 11 is too far.*-2"):
        surface.deforming(v).deforming(far)
    with pytest.raises(ValueError, match=rf"\({len(v)}, 3\), got \({len(v) - 1}, 3\)"):
        surface.deforming(v[:-1])
    with pytest.raises(ValueError, match="numbers"):
        surface.deforming("vertices")
    loose = vf.Surface.from_arrays(np.vstack([v, [1e9, 0, 0]]), surface.faces)
    after = np.vstack([1.1 * v, [-1e9, 0, 0]])
    assert loose.deforming(after).vertices_after[-1, 0] == -1e9  # no face uses it


def test_a_mesh_whose_seams_open_is_no_longer_closed() -> None:
    """Unwelded: closed as long as corners at one place stay together."""
    surface = ball(0.01, 1)
    soup = vf.Surface.from_arrays(
        surface.vertices[surface.faces].reshape(-1, 3),
        np.arange(3 * len(surface.faces)).reshape(-1, 3),
    )
    together = soup.deforming(1.1 * soup.vertices)
    assert together.closed
    assert together.inside(np.zeros(3))
    torn = soup.vertices.copy()
    torn[5] += 1e-6
    assert not together.deforming(torn).closed
    assert not together.deforming(torn).inside(np.zeros(3))
