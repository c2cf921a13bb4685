"""Placing under the arm, and the lighter copy to draw."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
import scipy.spatial.transform
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


def corner_points(vertices: np.ndarray) -> np.ndarray:
    """A few odd vertices, to follow them through a transform."""
    return vertices[:: max(1, len(vertices) // 7)]


@pytest.mark.parametrize(
    ("up", "own"),
    [
        ("z", (0, 0, 1)), ("-z", (0, 0, -1)), ("y", (0, 1, 0)),
        ("-y", (0, -1, 0)), ("x", (1, 0, 0)), ("-x", (-1, 0, 0)),
    ],
)  # fmt: skip
def test_the_side_named_faces_the_tool_and_nothing_is_mirrored(
    up: str, own: tuple[int, int, int]
) -> None:
    vertices, _ = meshes.arrays("l-block")
    T_base_tip = pin.SE3(np.eye(3), np.array([0.1, -0.2, 0.3]))
    T = meshes.Placement(up=up).pose(vertices, T_base_tip)
    np.testing.assert_array_equal(T[:3, :3] @ own, [0, 0, 1])
    assert np.linalg.det(T[:3, :3]) == 1.0
    placed = meshes.transformed(T, vertices)
    height = np.ptp(vertices @ np.array(own))
    np.testing.assert_allclose(placed[:, 2].max(), 0.285, atol=1e-12)
    np.testing.assert_allclose(placed[:, 2].min(), 0.285 - height, atol=1e-12)
    middle = 0.5 * (placed.min(axis=0) + placed.max(axis=0))
    np.testing.assert_allclose(middle[:2], [0.1, -0.2], atol=1e-12)


def test_turns_are_about_the_base_axes_one_after_the_other() -> None:
    angles = (0.3, -1.1, 2.0)
    # scipy's small letters are turns about fixed axes, in their order.
    fixed = scipy.spatial.transform.Rotation.from_euler("xyz", angles).as_matrix()
    np.testing.assert_allclose(meshes.Placement(rotate=angles).rotation, fixed, atol=1e-12)
    up = meshes.Placement(up="y").rotation
    both = meshes.Placement(rotate=angles, up="y").rotation
    np.testing.assert_allclose(both, fixed @ up, atol=1e-12)


def test_a_place_named_is_where_the_meshs_origin_goes() -> None:
    vertices, _ = meshes.arrays("skull-coarse")
    at, rotate = (0.01, -0.02, -0.15), (0.0, 0.0, np.pi / 2)
    T = meshes.Placement(at, rotate).pose(vertices, np.eye(4))
    np.testing.assert_array_equal(T[:3, 3], at)
    some = corner_points(vertices)
    moved = np.column_stack([-some[:, 1], some[:, 0], some[:, 2]]) + at
    np.testing.assert_allclose(meshes.transformed(T, some), moved, atol=1e-15)


def test_the_planned_path_moves_with_the_skull() -> None:
    vertices, faces = meshes.arrays("skull")
    T = meshes.Placement(rotate=(0.4, -0.2, 1.0), up="-y").pose(vertices, np.eye(4))
    path = meshes.transformed(T, meshes.planned_path("skull"))
    skull = trimesh.Trimesh(meshes.transformed(T, vertices) * 1e3, faces, process=False)
    for p in path[::10] * 1e3:  # [mm]
        near = trimesh.triangles.closest_point(skull.triangles, np.tile(p, (len(faces), 1)))
        # The path is on the smooth surface, of which the mesh's chords run microns short.
        assert np.linalg.norm(near - p, axis=1).min() < 0.05


def test_every_skull_has_the_planned_path_and_other_meshes_say_so() -> None:
    skulls = [name for name in meshes.names() if name.startswith("skull")]
    assert len(skulls) >= 5
    for name in skulls:
        path = meshes.planned_path(name)
        assert path.shape == (31, 3)
        steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
        np.testing.assert_allclose(steps.sum(), 0.030, rtol=1e-3)
    for name in ("cube", "no such mesh"):
        with pytest.raises(meshes.MeshError, match=rf"no path.*{name}.*skull, skull-coarse"):
            meshes.planned_path(name)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"up": "w"}, "'w'.*choose one of z, -z, y"),
        ({"at": (0.0, float("nan"), 0.0)}, "at must be three finite numbers"),
        ({"at": (0.0, 0.0, -120.0)}, "-120 m is more than 2 m"),
        ({"rotate": (0.0, float("inf"), 0.0)}, "rotate must be three finite numbers"),
        ({"rotate": (0.0, 1.0)}, "rotate must be three"),
    ],
)
def test_refuses_what_is_no_placement(wrong: dict, words: str) -> None:
    with pytest.raises(meshes.MeshError, match=words):
        meshes.Placement(**wrong)


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
    shown = meshes.display(vertices, faces, limit=20_000, exact=50_000)
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
    shown = meshes.display(soup, np.arange(9_000).reshape(-1, 3), limit=1_000, exact=0)
    assert shown.decimated
    assert 0 < len(shown.faces) <= 1_000


def test_limit_must_leave_something() -> None:
    vertices, faces = meshes.arrays("cube")
    with pytest.raises(ValueError, match="limit"):
        meshes.display(vertices, faces, limit=0)
