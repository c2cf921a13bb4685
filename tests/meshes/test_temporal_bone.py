"""The temporal bone: named structures in sizes and distances of anatomy, closed and apart."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

import meshes

FOUND = meshes.structures("temporal-bone")
BY_NAME = {one.name: one for one in FOUND}
SMALL = ("facial nerve", "chorda tympani", "malleus", "incus", "stapes", "semicircular canals")


def mesh(name: str) -> trimesh.Trimesh:
    return trimesh.Trimesh(BY_NAME[name].vertices, BY_NAME[name].faces, process=False)


def test_the_set_has_names_colours_and_margins() -> None:
    assert list(BY_NAME) == ["bone", *SMALL, "sigmoid sinus", "dura"]
    assert BY_NAME["bone"].margin is None  # to be cut
    for one in FOUND[1:]:
        assert one.margin is not None
        assert 0.5e-3 <= one.margin <= 3e-3
    assert len({one.colour for one in FOUND}) == len(FOUND)


@pytest.mark.parametrize("name", list(BY_NAME))
def test_each_is_one_closed_sound_body(name: str) -> None:
    one = BY_NAME[name]
    report = meshes.health(one.vertices, one.faces, examine=10**9)
    assert report.exact
    assert report.sound, [finding.text for finding in report.findings]
    assert report.watertight
    assert report.components == 1
    assert mesh(name).volume > 0
    # The stapes is a ring; three loops on a vestibule cross each other once more.
    assert report.genus == {"stapes": 1, "semicircular canals": 4}.get(name, 0)


@pytest.mark.parametrize("name", SMALL)
def test_small_structures_are_1_to_3_mm_thick(name: str) -> None:
    """Four times volume by area is the diameter of a long tube, two thirds that of a ball."""
    solid = mesh(name)
    assert 0.7e-3 < 4 * solid.volume / solid.area < 3e-3
    assert np.ptp(solid.vertices, axis=0).max() < 26e-3


def test_structures_stand_apart_and_the_drill_finds_them_in_its_cavity() -> None:
    points = {name: mesh(name).sample(8_000, seed=0) for name in BY_NAME if name != "bone"}
    for one, other in itertools.combinations(points, 2):
        apart = cKDTree(points[one]).query(points[other])[0].min()
        assert apart > 0.4e-3, (one, other)
    bone = mesh("bone")
    low, high = bone.bounds
    for name, where in points.items():
        assert (where > low).all(), name
        assert (where < high).all(), name
    # Straight down the middle of the cavity nothing is in the way for 19 mm.
    down = np.column_stack([np.full(20, -2e-3), np.zeros(20), np.linspace(16e-3, -3e-3, 20)])
    assert not bone.contains(down).any()
    nearest = {name: cKDTree(where).query(down[-1])[0] for name, where in points.items()}
    for name in ("facial nerve", "chorda tympani", "incus", "semicircular canals"):
        assert nearest[name] < 8e-3


def test_some_are_chosen_by_name() -> None:
    stages: list[tuple[float, str]] = []
    found = meshes.structures(
        "temporal-bone",
        ["incus", "dura"],
        progress=lambda share, text: stages.append((share, text)),
    )
    assert [one.name for one in found] == ["incus", "dura"]
    assert stages[-1] == (1.0, "2 structures")
    np.testing.assert_array_equal(found[0].vertices, BY_NAME["incus"].vertices)
    with pytest.raises(meshes.MeshError, match="no structure 'anvil': choose of bone, facial"):
        meshes.structures("temporal-bone", ["anvil"])
