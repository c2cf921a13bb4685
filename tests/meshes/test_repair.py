"""Repair brings damaged closed meshes back, counts what it did and moves nothing."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

import meshes
import vf
from meshes.builtin.damage import SHARE, damage, kinds
from meshes.checks.health import health
from meshes.checks.repair import repair

Mesh = tuple[np.ndarray, np.ndarray]
NAMES = ("torus", "gear", "gyroid", "skull-coarse", "cube")


def injected(mesh: Mesh) -> int:
    return max(1, round(SHARE * len(mesh[1])))


def one_ulp(mesh: Mesh, seed: int = 0) -> Mesh:
    """A soup in single precision, every coordinate one representable number up, down or neither."""
    vertices, faces = damage("unwelded", mesh)
    rng = np.random.default_rng(seed)
    single = vertices.astype(np.float32)
    towards = rng.choice([-np.inf, np.inf], single.shape).astype(np.float32)
    moved = np.where(rng.random(single.shape) < 0.6, np.nextafter(single, towards), single)
    return moved.astype(np.float64), faces


def assert_same_solid(result: meshes.Repaired, mesh: Mesh, rel: float = 1e-12) -> None:
    """By trimesh alone: closed, consistently wound, of the same volume and Euler number."""
    wanted = trimesh.Trimesh(*mesh, process=False)
    back = trimesh.Trimesh(*result.arrays, process=False)
    assert back.is_volume
    assert back.volume == pytest.approx(wanted.volume, rel=rel)
    assert back.euler_number == wanted.euler_number


@pytest.mark.parametrize("name", meshes.names()[1:2] + meshes.names()[5:])
def test_a_clean_mesh_stays_as_it_is(name: str) -> None:
    vertices, faces = meshes.arrays(name)
    result = repair(vertices, faces, tolerance=0.0)
    assert not result.changes.any
    assert np.array_equal(result.vertices, vertices)
    assert np.array_equal(result.faces, faces)
    # The default tolerance may join what lies within a millionth; the solid stays.
    assert_same_solid(repair(vertices, faces), (vertices, faces), rel=1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_unwelded_flipped_duplicated_and_inverted_meshes_come_back(name: str) -> None:
    mesh = meshes.arrays(name)
    count, corners = injected(mesh), 3 * len(mesh[1])

    result = repair(*damage("unwelded", mesh), tolerance=0.0)
    assert result.changes.welded == corners - len(mesh[0])
    assert result.changes.lines()[1:] == ()
    assert_same_solid(result, mesh)

    result = repair(*damage("flipped", mesh, 3), tolerance=0.0)
    assert result.changes.flipped == count
    assert len(result.changes.lines()) == 1
    assert np.array_equal(result.vertices, mesh[0])
    assert_same_solid(result, mesh)

    result = repair(*damage("duplicated", mesh, 3), tolerance=0.0)
    assert result.changes.duplicates == count
    assert len(result.changes.lines()) == 1
    assert_same_solid(result, mesh)

    result = repair(*damage("inside-out", mesh), tolerance=0.0)
    assert result.changes.turned_bodies == 1
    assert_same_solid(result, mesh)


@pytest.mark.parametrize("name", ["torus", "gear", "skull-coarse", "sphere"])
def test_jitter_of_one_ulp_is_welded_within_the_tolerance(name: str) -> None:
    mesh = meshes.arrays(name)
    rough = one_ulp(mesh)
    result = repair(*rough)
    size = float(np.linalg.norm(np.ptp(mesh[0], axis=0)))
    assert len(result.vertices) == len(mesh[0])
    assert 0 < result.changes.farthest < 1e-6 * size
    assert_same_solid(result, mesh, rel=1e-5)
    # Nothing else moved: every vertex is one that came in.
    given_ = {tuple(row) for row in rough[0].tolist()}
    assert all(tuple(row) in given_ for row in result.vertices.tolist())


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("seed", [1, 2])
def test_everything_at_once(name: str, seed: int) -> None:
    mesh = meshes.arrays(name)
    hurt = damage("duplicated", damage("flipped", damage("inside-out", mesh), seed), seed)
    result = repair(*one_ulp(hurt, seed))
    assert_same_solid(result, mesh, rel=1e-5)
    assert all(" a seam" in line for line in result.changes.left)  # flat by themselves
    assert health(*result.arrays, examine=0).count("flipped faces") == 0


def test_stray_slivers_go_and_stitches_stay() -> None:
    mesh = meshes.arrays("torus")
    result = repair(*damage("slivers", mesh, 4))
    assert result.changes.degenerate == injected(mesh)
    assert_same_solid(result, mesh)
    assert np.array_equal(result.faces, mesh[1])
    # A tetrahedron with a T-junction on one edge, closed by a face without area.
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0, 0]]) * 1e-2
    faces = np.array([[0, 2, 1], [0, 4, 3], [4, 1, 3], [1, 2, 3], [0, 3, 2], [0, 1, 4]])
    result = repair(corners, faces)
    assert not result.changes.any
    assert result.changes.left == ("1 face without area that closes a seam",)
    assert trimesh.Trimesh(*result.arrays, process=False).is_watertight


def test_what_cannot_be_mended_is_left_and_told() -> None:
    mesh = meshes.arrays("torus")
    holed = damage("holes", mesh, 1)
    result = repair(*holed)
    report = health(*holed)
    assert np.array_equal(result.faces, holed[1])
    loops = report.count("boundary loops")
    assert any(f"{loops:,} boundary loops" in line for line in result.changes.left)
    wings = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1]]) * 1e-2
    result = repair(wings, np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]]))
    assert any("1 edge with more than two faces" in line for line in result.changes.left)
    assert len(result.faces) == 3
    line = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0]]) * 1e-2
    result = repair(line, np.array([[0, 1, 2], [0, 0, 1]]))
    assert (len(result.faces), result.changes.degenerate, result.changes.unused) == (0, 2, 3)
    assert result.changes.left == ("nothing: no face had any area",)


def test_fins_agree_across_an_edge_of_two_only() -> None:
    ball = trimesh.creation.icosphere(1, 0.01)
    around = ball.vertex_neighbors[0]
    vertices = np.vstack([ball.vertices, 1.1 * ball.vertices[0]])
    tip = len(vertices) - 1
    # Each is on an edge of the ball; all walk the edge that they share from the tip to the ball.
    fins = np.array([[0, there, tip] for there in around[:3]])
    for count, turned in ((1, []), (2, [1]), (3, [])):
        faces = np.vstack([ball.faces, fins[:count]])
        result = repair(vertices, faces, tolerance=0.0)
        assert health(vertices, faces, examine=0).count("flipped faces") == len(turned)
        assert (result.changes.flipped, result.changes.turned_patches) == (len(turned), 0)
        wanted = fins[:count].copy()
        wanted[turned] = wanted[turned][:, [0, 2, 1]]
        assert np.array_equal(result.faces, np.vstack([ball.faces, wanted]))


def test_flip_turns_open_patches_only() -> None:
    sheet = damage("sheet", meshes.arrays("torus"))
    straight, turned = repair(*sheet), repair(*sheet, flip=True)
    assert np.array_equal(straight.faces[:, [0, 2, 1]], turned.faces)
    assert (straight.changes.turned_patches, turned.changes.turned_patches) == (0, 1)
    closed = meshes.arrays("torus")
    assert not repair(*closed, flip=True).changes.any


def test_cavities_stay_cavities() -> None:
    outer, inner = trimesh.creation.icosphere(2, 0.03), trimesh.creation.icosphere(2, 0.02)
    vertices = np.vstack([outer.vertices, inner.vertices])
    faces = np.vstack([outer.faces, inner.faces[:, ::-1] + len(outer.vertices)])
    wanted = outer.volume - inner.volume
    for hurt in (faces, faces[:, ::-1], damage("flipped", (vertices, faces), 1)[1]):
        result = repair(vertices, hurt)
        assert trimesh.Trimesh(*result.arrays, process=False).volume == pytest.approx(wanted)
    two = np.vstack([outer.faces, inner.faces + len(outer.vertices)])
    assert not repair(vertices, two).changes.any


@given(
    kind=st.sampled_from(kinds()),
    name=st.sampled_from(["torus", "cube", "star-prism"]),
    seed=st.integers(0, 1000),
)
@settings(max_examples=40, deadline=None)
def test_repair_of_anything_is_valid_moves_nothing_and_is_done_once(
    kind: str, name: str, seed: int
) -> None:
    hurt = damage(kind, meshes.arrays(name), seed)
    before = hurt[0].copy(), hurt[1].copy()
    result = repair(*hurt)
    assert all(np.array_equal(a, b) for a, b in zip(hurt, before, strict=True))
    vf.Surface.from_arrays(*result.arrays)
    places = {tuple(row) for row in hurt[0].tolist()}
    assert all(tuple(row) in places for row in result.vertices.tolist())
    dropped = result.changes.degenerate + result.changes.duplicates
    assert len(result.faces) == len(hurt[1]) - dropped
    again = repair(*result.arrays, tolerance=0.0)
    assert (again.changes.flipped, again.changes.turned_bodies) == (0, 0)
    assert (again.changes.welded, again.changes.duplicates, again.changes.unused) == (0, 0, 0)


def test_a_surface_will_do_and_a_bad_tolerance_is_named() -> None:
    mesh = damage("flipped", meshes.arrays("torus"))
    a, b = repair(*mesh), repair(vf.Surface.from_arrays(*mesh))
    assert np.array_equal(a.faces, b.faces)
    with pytest.raises(ValueError, match="-1"):
        repair(*mesh, tolerance=-1.0)
