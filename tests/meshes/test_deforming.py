"""Deforming meshes: sound at every phase, periodic, in the magnitudes of the literature."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import meshes
from meshes.builtin.deforming import deforming_names

NAMES = ("heart", "liver", "vessel")
PHASES = np.arange(16) / 16
MOVES = {"heart": (8.0, 11.0), "liver": (14.0, 20.0), "vessel": (0.6, 3.0)}  # [mm] at most
RATES = {"heart": (1.0, 1.7), "liver": (0.2, 0.33), "vessel": (1.0, 1.7)}  # [Hz]


def test_the_names_are_in_the_catalogue() -> None:
    assert deforming_names() == NAMES
    for name in NAMES:
        one = meshes.deforming(name)
        vertices, faces = meshes.arrays(name)
        np.testing.assert_array_equal(vertices, one.vertices)
        np.testing.assert_array_equal(faces, one.faces)
        assert vertices.flags.writeable  # a copy: the caller's own
    with pytest.raises(meshes.MeshError, match="'skull' does not deform: choose one of heart, liv"):
        meshes.deforming("skull")


@pytest.mark.parametrize("name", NAMES)
def test_the_rest_shape_is_healthy_and_that_of_phase_0(name: str) -> None:
    one = meshes.deforming(name)
    report = meshes.health(one.vertices, one.faces, examine=10**9)
    assert report.findings == ()
    assert report.exact
    np.testing.assert_allclose(one.shape(0.0), one.vertices, atol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_it_is_a_sound_closed_surface_over_the_whole_cycle(name: str) -> None:
    one = meshes.deforming(name)
    rest = trimesh.Trimesh(one.vertices, one.faces, process=False)
    for phase in PHASES:
        mesh = trimesh.Trimesh(one.shape(phase), one.faces, process=False)
        assert mesh.is_volume
        assert mesh.volume == pytest.approx(rest.volume, rel=0.4)
        # No triangle is crushed or turned against those around it.
        assert (mesh.area_faces / rest.area_faces).min() > 0.4
        assert mesh.face_adjacency_angles.max() < np.radians(60)
    for phase in PHASES[::5]:
        assert meshes.health(one.shape(phase), one.faces, examine=10**9).sound


@pytest.mark.parametrize("name", NAMES)
def test_no_triangles_cross_each_other_at_any_phase(name: str) -> None:
    """Judged by CGAL, with exact arithmetic."""
    cgal = pytest.importorskip("igl.copyleft.cgal")
    one = meshes.deforming(name)
    folded = np.array(one.vertices)
    folded[:, 2] *= np.where(folded[:, 0] > 0, -0.3, 1.0)  # half of it turned inside out
    assert len(cgal.remesh_self_intersections(folded, one.faces, detect_only=True)[2]) > 0
    for phase in PHASES:
        found = cgal.remesh_self_intersections(one.shape(phase), one.faces, detect_only=True)[2]
        assert len(found) == 0, phase


@pytest.mark.parametrize("name", NAMES)
def test_it_is_periodic_and_its_magnitudes_are_those_of_anatomy(name: str) -> None:
    one = meshes.deforming(name)
    np.testing.assert_allclose(one.shape(0.3), one.shape(7.3), atol=1e-12)
    np.testing.assert_allclose(one.shape(0.9), one.shape(-0.1), atol=1e-12)
    away = [np.linalg.norm(one.shape(p) - one.vertices, axis=1) for p in np.arange(100) / 100]
    low, high = MOVES[name]
    assert low < 1e3 * np.max(away) < high
    slow, fast = RATES[name]
    assert slow <= 1 / one.period <= fast
    assert one.modes.shape == (len(one.harmonics), *one.vertices.shape)


@pytest.mark.parametrize("name", NAMES)
def test_rates_and_the_fastest_vertex_are_those_of_the_shapes(name: str) -> None:
    one = meshes.deforming(name)
    step = 1e-5
    fastest = 0.0
    for phase in np.arange(64) / 64:
        numeric = (one.amplitudes(phase + step) - one.amplitudes(phase - step)) / (2 * step)
        np.testing.assert_allclose(one.rates(phase), numeric, atol=1e-4)
        moved = one.shape(phase + step) - one.shape(phase - step)
        speed = np.linalg.norm(moved, axis=1).max() / (2 * step)  # [m/cycle]
        fastest = max(fastest, float(speed))
    assert one.fastest(1.0) == pytest.approx(fastest, rel=0.05)
    assert one.fastest() == pytest.approx(one.fastest(1.0) / one.period)
    assert one.fastest() < 0.1  # [m/s]


def test_breathing_pauses_after_expiration_and_the_heart_beats_with_high_harmonics() -> None:
    liver = meshes.deforming("liver")
    phases = np.arange(200) / 200
    depth = np.array([liver.amplitudes(p)[0] for p in phases])
    assert depth.max() == pytest.approx(1.0)
    assert (depth < 0.1).mean() > 0.3  # a third of the cycle near rest; cos² has a fifth
    assert (depth > 0.9).mean() < 0.2
    heart = meshes.deforming("heart")
    squeeze = np.array([heart.amplitudes(p)[0] for p in phases])
    assert 0.25 < phases[squeeze.argmax()] < 0.4  # end of systole
    power = np.abs(np.fft.rfft(squeeze))
    assert power[6:].max() > 0.002 * power[1]
    assert (len(heart.harmonics[0]) - 1) / heart.period > 20  # [Hz]


def test_a_vessel_widens_by_a_tenth_of_its_diameter() -> None:
    vessel = meshes.deforming("vessel")
    middle = np.abs(vessel.vertices[:, 0]) < 1.5e-3
    across = [np.ptp(vessel.shape(p)[middle, 1]) for p in np.arange(50) / 50]
    assert across[0] == pytest.approx(12e-3, rel=0.02)  # it lies a little aslant
    assert max(across) / across[0] == pytest.approx(1.1, abs=0.005)
