"""Placing under the arm, and the lighter copy to draw."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
import trimesh

import meshes


@pytest.mark.parametrize("name", ["skull-coarse", "torus", "stairs"])
def test_top_ends_below_the_tip(name: str) -> None:
    vertices, _ = meshes.arrays(name)
    rng = np.random.default_rng(7)
    T = pin.SE3.Random()
    T.translation = rng.normal(size=3)
    placed = meshes.place(vertices, T, gap=0.02)
    assert placed[:, 2].max() == pytest.approx(T.translation[2] - 0.02, abs=1e-12)
    for axis in (0, 1):
        middle = (placed[:, axis].max() + placed[:, axis].min()) / 2
        assert middle == pytest.approx(T.translation[axis], abs=1e-12)
    # A translation and nothing else, and the input is untouched.
    np.testing.assert_allclose(placed - placed[0], vertices - vertices[0], atol=1e-12)
    assert np.array_equal(vertices, meshes.arrays(name)[0])


def test_default_gap_and_matrix_pose() -> None:
    vertices, _ = meshes.arrays("cube")
    T = np.eye(4)
    T[:3, 3] = (0.01, 0.02, -0.1237)
    placed = meshes.place(vertices, T)
    assert placed[:, 2].max() == pytest.approx(-0.1387, abs=1e-12)
    np.testing.assert_allclose(meshes.placement(vertices, T), [0.01, 0.02, -0.1587], atol=1e-12)


def test_the_planned_cut_moves_with_the_skull() -> None:
    vertices, _ = meshes.arrays("skull-coarse")
    T = np.eye(4)
    T[:3, 3] = (0.1, -0.2, 0.3)
    offset = meshes.placement(vertices, T)
    np.testing.assert_allclose(meshes.place(vertices, T), vertices + offset, atol=1e-15)


@pytest.mark.parametrize("pose", [np.eye(3), np.full((4, 4), np.nan), [1, 2, 3]])
def test_refuses_what_is_no_pose(pose: object) -> None:
    vertices, _ = meshes.arrays("cube")
    with pytest.raises(ValueError, match="T_base_tip_neutral"):
        meshes.place(vertices, pose)  # type: ignore[arg-type]


@pytest.mark.parametrize("points", [np.empty((0, 3)), np.zeros((4, 2))])
def test_refuses_no_vertices(points: np.ndarray) -> None:
    with pytest.raises(meshes.MeshError, match="shape"):
        meshes.place(points, np.eye(4))


def test_small_meshes_are_drawn_as_they_are() -> None:
    vertices, faces = meshes.arrays("cube")
    shown = meshes.display(vertices, faces)
    assert shown.vertices is vertices
    assert shown.faces is faces
    assert not shown.decimated


def test_large_meshes_are_drawn_lighter_in_the_same_place() -> None:
    vertices, faces = meshes.arrays("skull")
    shown = meshes.display(vertices, faces, limit=20_000)
    assert shown.decimated
    assert 18_000 <= len(shown.faces) <= 20_000
    assert 0 <= shown.faces.min() <= shown.faces.max() < len(shown.vertices)
    for full, light in (
        (vertices.min(0), shown.vertices.min(0)),
        (vertices.max(0), shown.vertices.max(0)),
    ):
        np.testing.assert_allclose(light, full, atol=0.0005)
    full_solid = trimesh.Trimesh(vertices, faces, process=False)
    light_solid = trimesh.Trimesh(shown.vertices, shown.faces, process=False)
    assert light_solid.area == pytest.approx(full_solid.area, rel=0.01)
    assert np.array_equal(faces, meshes.arrays("skull")[1])


def test_a_soup_that_cannot_collapse_is_thinned() -> None:
    rng = np.random.default_rng(3)
    soup = rng.uniform(-0.05, 0.05, (9_000, 3))
    shown = meshes.display(soup, np.arange(9_000).reshape(-1, 3), limit=1_000)
    assert shown.decimated
    assert 0 < len(shown.faces) <= 1_000


def test_limit_must_leave_something() -> None:
    vertices, faces = meshes.arrays("cube")
    with pytest.raises(ValueError, match="limit"):
        meshes.display(vertices, faces, limit=0)
