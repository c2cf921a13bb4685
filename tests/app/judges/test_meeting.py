"""Where segments meet a mesh, against Möller and Trumbore over all triangles and dense samples."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import meshes
import vf
from app.judges.meeting import first_meeting, sees
from meshes.builtin.damage import damage
from tests.support.brute import Oracle


def distances(surface: vf.Surface, points: np.ndarray) -> np.ndarray:
    """From points (n, 3) to the surface, over all triangles but those more than 5 mm off."""
    corners = surface.vertices[surface.faces]
    far = np.maximum(corners.min(axis=1) - points[0], points[0] - corners.max(axis=1)).max(axis=1)
    corners = corners[far < 5e-3]
    return np.array(
        [
            np.linalg.norm(
                trimesh.triangles.closest_point(corners, np.tile(p, (len(corners), 1))) - p, axis=1
            ).min()
            for p in points
        ]
    )


@pytest.mark.parametrize("state", ["none", "flipped", "holes", "jittered"])
def test_the_first_segment_that_meets_a_triangle_is_found(state: str) -> None:
    rng = np.random.default_rng(7)
    vertices, faces = damage(state, meshes.arrays("gear"), seed=1)
    surface = vf.Surface.from_arrays(vertices, faces)
    judge = Oracle(vertices, faces)
    found = 0
    for _ in range(60):
        size = rng.choice([1e-4, 1e-3, 1e-2])
        start = vertices[rng.integers(len(vertices))] + rng.normal(size=3) * 3 * size
        path = start + np.vstack([np.zeros(3), np.cumsum(rng.normal(size=(8, 3)) * size, axis=0)])
        cut = [k for k in range(8) if judge.crossings(path[k : k + 2])]
        met = first_meeting(surface, path[:-1], path[1:])
        assert (None if met is None else met.segment) == (cut[0] if cut else None)
        if met is not None:
            found += 1
            assert met.centre
            a, b = path[met.segment], path[met.segment + 1]
            alone = Oracle(vertices, faces[met.triangle : met.triangle + 1])
            assert alone.crossings(np.array([a, b]))
            # The triangle that is met first: up to its point there is nothing else.
            before = met.point - 1e-9 * (b - a) / np.linalg.norm(b - a)
            assert not judge.crossings(np.array([a, before]))
        assert sees(surface, path[0], path[1]) == (0 not in cut)
    assert found > 15


def test_a_segment_that_only_touches_an_edge_or_ends_on_a_face_meets_it() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.25]])
    surface = vf.Surface.from_arrays(vertices, [[0, 1, 2], [2, 1, 3]])
    for a, b in (
        ([0.25, 0.25, 1.0], [0.25, 0.25, 0.0]),  # ends on a face
        ([0.5, 0.5, 1.0], [0.5, 0.5, -1.0]),  # through the shared edge
        ([0.0, 0.0, 1.0], [0.0, 0.0, -1.0]),  # through a corner
        ([0.25, -1.0, 0.0], [0.25, 0.5, 0.0]),  # along a face
    ):
        assert not sees(surface, np.array(a), np.array(b))
    assert sees(surface, np.array([0.25, 0.25, 1.0]), np.array([0.25, 0.25, 5e-324]))


def test_a_segment_meets_any_number_of_triangles() -> None:
    fan = np.array([[np.cos(t), np.sin(t), 0.0] for t in np.linspace(0.0, 6.0, 400)])
    faces = [[0, k, k + 1] for k in range(1, 400)]
    surface = vf.Surface.from_arrays(np.vstack([[0.0, 0.0, 0.0], fan]), faces)
    axis = np.array([0.0, 0.0, 1.0])
    met = first_meeting(surface, axis[None], -axis[None])
    assert met is not None
    np.testing.assert_allclose(met.point, 0.0, atol=1e-12)


def test_a_ball_meets_what_comes_nearer_than_its_radius_unless_it_overlapped_before() -> None:
    rng = np.random.default_rng(3)
    vertices, faces = meshes.arrays("star-prism")
    surface = vf.Surface.from_arrays(vertices, faces)
    radius, outcomes = 5e-4, set()
    for _ in range(60):
        a = vertices[rng.integers(len(vertices))] + rng.normal(size=3) * 6e-4
        b = a + rng.normal(size=3) * 3e-4
        if not sees(surface, a, b):
            continue
        along = a + np.linspace(0.0, 1.0, 40)[:, None] * (b - a)
        gaps = distances(surface, along)
        if np.abs(gaps[[0]] - radius).min() < 1e-7 or abs(gaps.min() - radius) < 1e-5:
            continue  # the samples cannot tell
        want = gaps[0] > radius > gaps.min()
        met = first_meeting(surface, a[None], b[None], radius)
        assert (met is not None) == want
        if met is not None:
            assert not met.centre
        outcomes.add((want, bool(gaps[0] < radius)))
    assert outcomes == {(True, False), (False, False), (False, True)}


def test_a_tip_that_does_not_move_meets_nothing() -> None:
    surface = vf.Surface.from_arrays(*meshes.arrays("cube"))
    on = surface.vertices[:5]
    assert first_meeting(surface, on, on, 1e-3) is None
