"""Every catalogue mesh against closed forms and trimesh's own judgement."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh

import meshes
from meshes.content import Arrays

SHAPES = (
    "cube",
    "sphere",
    "cylinder",
    "cone",
    "torus",
    "gear",
    "l-block",
    "canal-block",
    "stairs",
    "star-prism",
    "thin-plate",
    "saddle-slab",
    "gyroid",
)
ORGANS = ("heart", "liver", "vessel")  # they deform: tests/meshes/test_deforming.py
SKULLS = ("skull-closed", "skull", "skull-coarse", "skull-fused", "skull-precut")


def solid(name: str) -> trimesh.Trimesh:
    vertices, faces = meshes.arrays(name)
    return trimesh.Trimesh(vertices, faces, process=False)


def ngon(sides: int) -> float:
    """Area of the regular polygon in the unit circle."""
    return sides / 2 * math.sin(2 * math.pi / sides)


def torus_of_polygons(R: float, r: float, around: int, section: int) -> float:
    """Volume of a polygonal ring by Pappus, with the polygon round the axis instead of a circle."""
    # Turning a region about an axis in straight steps scales every shell alike.
    return 2 * math.pi * R * ngon(section) * r**2 * ngon(around) / math.pi


# [m³], the exact volumes of the polyhedra where they have a closed form
VOLUMES = {
    "cube": 0.040**3,
    "cylinder": ngon(72) * 0.020**2 * 0.040,
    "cone": ngon(72) * 0.020**2 * 0.040 / 3,
    "torus": torus_of_polygons(0.030, 0.010, 96, 32),
    "thin-plate": 0.100**2 * 0.0005,
    "stairs": 0.010 * 0.006 * (1 + 2 + 3 + 4 + 5) * 0.040,
    "canal-block": (0.040**2 - ngon(24) * (0.0045 / math.cos(math.pi / 24)) ** 2) * 0.025,
    "l-block": (0.040 * 0.015 + 0.025 * 0.015) * 0.030,
    "star-prism": 7 * 0.040 * 0.018 * math.sin(math.pi / 7) * 0.020,
}


def test_names_are_the_full_set() -> None:
    assert meshes.names()[0] == "skull-closed"
    assert set(meshes.names()) == {*SHAPES, *ORGANS, *SKULLS, "skull-fine"}
    assert tuple(meshes.catalogue())[: len(meshes.names())] == meshes.names()
    for name, entry in meshes.catalogue().items():
        assert entry.name == name
        assert entry.source
        assert entry.licence
        assert entry.about.endswith(".")


@pytest.mark.parametrize("name", SHAPES + ORGANS + SKULLS)
def test_is_a_closed_outward_solid_of_one_body(name: str) -> None:
    mesh = solid(name)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0
    assert mesh.area_faces.min() > 0
    assert len(np.unique(mesh.faces)) == len(mesh.vertices)
    assert len(np.unique(mesh.vertices, axis=0)) == len(mesh.vertices)
    # One component, told by the face graph, not by the kernel that made it.
    labels = trimesh.graph.connected_component_labels(
        mesh.face_adjacency, node_count=len(mesh.faces)
    )
    assert labels.max() == 0


@pytest.mark.parametrize("name", SHAPES)
def test_shapes_have_a_sensible_number_of_triangles(name: str) -> None:
    vertices, faces = meshes.arrays(name)
    assert vertices.dtype == np.float64
    assert np.issubdtype(faces.dtype, np.integer)
    assert 500 <= len(faces) <= 20_000
    assert 0.03 < np.linalg.norm(np.ptp(vertices, axis=0)) < 0.2  # [m]


@pytest.mark.parametrize("name", VOLUMES)
def test_volume_is_the_closed_form(name: str) -> None:
    assert solid(name).volume == pytest.approx(VOLUMES[name], rel=1e-9)


def test_sphere_volume_within_its_discretisation() -> None:
    ball = solid("sphere")
    np.testing.assert_allclose(np.linalg.norm(ball.vertices, axis=1), 0.030, rtol=1e-12)
    exact = 4 / 3 * math.pi * 0.030**3
    assert 0.995 * exact < ball.volume < exact


def test_saddle_slab_volume_and_faces() -> None:
    slab = solid("saddle-slab")
    # Shifting in z keeps volume, and the bend has whole periods.
    assert slab.volume == pytest.approx(0.096**2 * 0.008, rel=1e-3)
    x, y, z = slab.vertices.T
    wave = 0.006 * np.sin(2 * np.pi * x / 0.032) * np.sin(2 * np.pi * y / 0.032)
    top = z - wave > 0.0039
    np.testing.assert_allclose(z[top] - wave[top], 0.004, atol=1e-9)
    assert np.ptp(wave[top]) == pytest.approx(0.012, rel=0.01)


def test_gear_has_eighteen_teeth_between_root_and_tip() -> None:
    gear = solid("gear")
    radius = np.hypot(gear.vertices[:, 0], gear.vertices[:, 1])
    assert radius.max() == pytest.approx(0.040, rel=1e-9)
    assert 0.007 * math.cos(math.pi / 48) - 1e-12 < radius.min() < 0.007 + 1e-12  # a 48-gon
    # Round the pitch circle, tooth and gap alternate, half a pitch each (no backlash): which
    # points of it lie under a triangle of the top face?
    angles = (np.arange(720) + 0.5) * 2 * np.pi / 720
    points = 0.036 * np.column_stack([np.cos(angles), np.sin(angles)])
    top = gear.triangles[gear.triangles[:, :, 2].min(axis=1) > 0.00749][:, :, :2]
    a, b, c = top.transpose(1, 0, 2)
    inside = np.zeros(len(points), dtype=bool)
    for i, p in enumerate(points):
        sides = np.column_stack([_cross(q - p, r - p) for q, r in ((a, b), (b, c), (c, a))])
        inside[i] = (sides >= 0).all(axis=1).any()
    assert np.count_nonzero(inside != np.roll(inside, 1)) == 36
    assert inside.mean() == pytest.approx(0.5, abs=0.03)


def _cross(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]


@pytest.mark.parametrize(
    ("name", "genus"),
    [
        *((name, 0) for name in ("cube", "sphere", "cylinder", "cone", "l-block", "stairs")),
        *((name, 0) for name in ("star-prism", "thin-plate", "saddle-slab", *ORGANS)),
        ("torus", 1),
        ("gear", 1),  # its bore
        ("canal-block", 1),
        ("skull-closed", 0),
        ("skull", 2),  # fontanelle and suture; the opening below makes it a bowl, not a tunnel
        ("skull-coarse", 2),
        ("skull-fused", 1),  # the fontanelle alone
        ("skull-precut", 3),  # and the slot
    ],
)
def test_genus(name: str, genus: int) -> None:
    vertices, faces = meshes.arrays(name)
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    euler = len(vertices) - len(np.unique(edges, axis=0)) + len(faces)
    assert euler == 2 - 2 * genus


def test_gyroid_lies_on_its_level_set_or_the_ball() -> None:
    gyroid = solid("gyroid")
    x, y, z = (2 * np.pi / 0.020 * gyroid.vertices).T
    level = np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x)
    on_level = np.abs(level) < 0.08
    on_ball = np.abs(np.linalg.norm(gyroid.vertices, axis=1) - 0.025) < 0.0001
    assert (on_level | on_ball).all()
    # By symmetry the solid takes half of space.
    assert gyroid.volume == pytest.approx(0.5 * 4 / 3 * np.pi * 0.025**3, rel=0.02)


def test_generators_repeat_exactly() -> None:
    first: Arrays = meshes.arrays("gear")
    again: Arrays = meshes.arrays("gear")
    assert np.array_equal(first[0], again[0])
    assert np.array_equal(first[1], again[1])
