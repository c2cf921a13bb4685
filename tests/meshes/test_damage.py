"""Damage done on purpose: every kind does what its name says, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import meshes
import vf
from meshes.builtin.damage import SHARE, damage, kinds

NAMES = ("cube", "torus", "gear", "skull-coarse")


def whole(name: str = "torus") -> tuple[np.ndarray, np.ndarray]:
    return meshes.arrays(name)


def cyclic(faces: np.ndarray) -> set[tuple[int, int, int]]:
    """Faces as a set, whichever corner comes first; the winding counts."""
    first = faces.argmin(axis=1)
    return {tuple(np.roll(f, -k)) for f, k in zip(faces.tolist(), first, strict=True)}


def places(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Corners (m, 3, 3), the same whatever the vertices are called."""
    return vertices[faces]


def closed(vertices: np.ndarray, faces: np.ndarray) -> bool:
    return vf.Surface.from_arrays(vertices, faces).closed


@pytest.mark.parametrize("kind", kinds())
@pytest.mark.parametrize("name", NAMES)
def test_every_kind_gives_a_mesh_and_leaves_its_input_alone(name, kind):
    vertices, faces = whole(name)
    vertices_before, faces_before = vertices.copy(), faces.copy()
    v, f = damage(kind, (vertices, faces), seed=3)
    assert np.array_equal(vertices, vertices_before)
    assert np.array_equal(faces, faces_before)
    assert not np.shares_memory(v, vertices)
    assert not np.shares_memory(f, faces)
    assert v.dtype == np.float64
    assert v.shape[1:] == (3,)
    assert np.isfinite(v).all()
    assert f.dtype == np.int64
    assert f.shape[1:] == (3,)
    assert f.min() >= 0
    assert f.max() < len(v)


@pytest.mark.parametrize("kind", kinds())
def test_a_seed_gives_the_same_damage_again(kind):
    for a, b in zip(damage(kind, whole(), 5), damage(kind, whole(), 5), strict=True):
        assert np.array_equal(a, b)


@pytest.mark.parametrize(
    "kind", ["flipped", "holes", "duplicated", "jittered", "slivers", "fin", "interpenetrating"]
)
def test_another_seed_gives_another_damage(kind):
    (v1, f1), (v2, f2) = damage(kind, whole(), 5), damage(kind, whole(), 6)
    assert not (np.array_equal(v1, v2) and np.array_equal(f1, f2))


def test_none_changes_nothing():
    for a, b in zip(damage("none", whole()), whole(), strict=True):
        assert np.array_equal(a, b)


def test_unwelded_keeps_every_corner_in_place_and_shares_none():
    vertices, faces = whole()
    v, f = damage("unwelded", (vertices, faces))
    assert len(v) == 3 * len(faces)
    assert len(np.unique(f)) == f.size
    assert np.array_equal(places(v, f), places(vertices, faces))


def test_flipped_turns_five_percent():
    vertices, faces = whole()
    v, f = damage("flipped", (vertices, faces))
    assert np.array_equal(v, vertices)
    turned = (f != faces).any(axis=1)
    assert turned.sum() == round(SHARE * len(faces))
    assert cyclic(f[turned]) == cyclic(faces[turned][:, ::-1])
    assert not closed(v, f)  # next to a flipped face the winding number tells no inside


def test_inside_out_turns_every_face():
    vertices, faces = whole()
    v, f = damage("inside-out", (vertices, faces))
    assert cyclic(f) == cyclic(faces[:, ::-1])
    before, after = (trimesh.Trimesh(*m, process=False).volume for m in ((vertices, faces), (v, f)))
    assert after == pytest.approx(-before)
    assert closed(v, f)


def test_holes_delete_five_percent():
    vertices, faces = whole()
    v, f = damage("holes", (vertices, faces))
    assert len(faces) - len(f) == round(SHARE * len(faces))
    assert cyclic(f) < cyclic(faces)
    assert not closed(v, f)


def test_duplicated_repeats_five_percent_some_turned():
    vertices, faces = whole()
    _, f = damage("duplicated", (vertices, faces))
    extra = f[len(faces) :]
    assert np.array_equal(f[: len(faces)], faces)
    assert len(extra) == round(SHARE * len(faces))
    same = cyclic(extra) & cyclic(faces)
    turned = cyclic(extra) & cyclic(faces[:, ::-1])
    assert same
    assert turned
    assert len(same) + len(turned) == len(extra)


def test_jitter_moves_each_corner_by_itself_and_little():
    vertices, faces = whole()
    v, f = damage("jittered", (vertices, faces))
    size = np.linalg.norm(np.ptp(vertices, axis=0))
    moved = np.abs(places(v, f) - places(vertices, faces))
    assert 0.9e-5 * size < moved.max() <= 1.0001e-5 * size
    assert len(np.unique(v, axis=0)) == len(v)  # no two corners meet any more
    assert not closed(v, f)


def test_slivers_have_next_to_no_area():
    vertices, faces = whole()
    v, f = damage("slivers", (vertices, faces))
    assert np.array_equal(f[: len(faces)], faces)
    extra = f[len(faces) :]
    assert len(extra) == round(SHARE * len(faces))
    corners = v[extra]
    doubled = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    assert (doubled < 1e-8 * edges).all()
    repeated = (extra[:, 0] == extra[:, 2]).sum()
    assert repeated == -(-len(extra) // 5)  # two corners in one
    assert (doubled[extra[:, 0] != extra[:, 2]] > 0).any()  # and needles that have some area


def test_a_fin_is_a_sheet_without_thickness_through_the_surface():
    vertices, faces = whole()
    v, f = damage("fin", (vertices, faces))
    assert len(f) == len(faces) + 2
    corners = v[len(vertices) :]
    assert len(corners) == 4
    # Flat, and a tenth of the size wide and high.
    assert np.linalg.matrix_rank(corners - corners.mean(axis=0), tol=1e-9) == 2
    size = np.linalg.norm(np.ptp(vertices, axis=0))
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
    assert sides == pytest.approx(0.1 * size)
    assert np.linalg.norm(vertices - corners.mean(axis=0), axis=1).min() < 1e-12  # on a vertex
    assert not closed(v, f)


def test_interpenetrating_bodies_are_two_that_cut_each_other():
    vertices, faces = whole("sphere")
    v, f = damage("interpenetrating", (vertices, faces))
    n = len(vertices)
    first, second = v[:n], v[n:]
    assert np.array_equal(first, vertices)
    assert np.array_equal(f[len(faces) :], faces + n)
    # Rigidly moved: distances kept, and not a mirror image.
    assert np.linalg.norm(second[1:] - second[:-1], axis=1) == pytest.approx(
        np.linalg.norm(first[1:] - first[:-1], axis=1)
    )
    assert trimesh.Trimesh(second, faces, process=False).volume > 0
    depth = np.linalg.norm(second, axis=1)  # of the other's corners in the first ball, radius 30 mm
    assert (depth < 0.025).any()
    assert (depth > 0.035).any()
    assert closed(v, f)


@pytest.mark.parametrize("name", NAMES)
def test_a_sheet_is_the_upper_part_and_open(name):
    vertices, faces = whole(name)
    v, f = damage("sheet", (vertices, faces))
    assert 0.4 * len(faces) < len(f) < 0.9 * len(faces)
    kept = v[f].mean(axis=1)[:, 2]
    gone = np.array([vertices[list(t)].mean(axis=0)[2] for t in cyclic(faces) - cyclic(f)])
    assert kept.min() >= gone.max()
    assert not closed(v, f)


def test_an_unknown_kind_lists_the_choices():
    with pytest.raises(ValueError, match="unknown damage 'rusty'") as error:
        damage("rusty", whole())
    assert all(kind in str(error.value) for kind in kinds())


def test_a_tiny_mesh_is_damaged_as_well():
    box = trimesh.creation.box((0.02, 0.02, 0.02))
    mesh = (np.array(box.vertices), np.array(box.faces))
    assert len(damage("holes", mesh)[1]) == 11
    assert (damage("flipped", mesh)[1] != mesh[1]).any(axis=1).sum() == 1
