"""The judge finds what passes a surface or leaves the corridor, by brute force the same."""

import itertools

import numpy as np
import pytest

import meshes
from app.judges import exact
from app.studies.experiments import judge


@pytest.mark.slow
def test_crossings_are_those_of_brute_force() -> None:
    vertices, faces = meshes.arrays("sphere")
    rng = np.random.default_rng(4)
    for _ in range(5):
        # A walk about the surface, across it and back.
        points = np.array([0.0, 0.0, 30e-3]) + np.cumsum(rng.normal(scale=4e-4, size=(300, 3)), 0)
        found = judge.crossings(vertices, faces, points)
        corners = vertices[faces]
        low, high = corners.min(axis=1), corners.max(axis=1)
        expected = 0
        for a, b in itertools.pairwise(points):
            near = ((low <= np.maximum(a, b)) & (high >= np.minimum(a, b))).all(axis=1)
            expected += sum(exact.meets(a, b, triangle) for triangle in corners[near])
        assert found == expected
        assert found > 0


def test_touching_counts_and_staying_away_does_not() -> None:
    vertices = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]) * 1e-2
    faces = np.array([[0, 1, 2]])
    touching = np.array([[1e-3, 1e-3, 1e-3], [1e-3, 2e-3, 0.0]])
    assert judge.crossings(vertices, faces, touching) == 1
    assert judge.crossings(vertices, faces, touching + np.array([0.0, 0.0, 1e-15])) == 0
    assert judge.crossings(vertices, faces, touching[:1]) == 0


def test_leaving_the_corridor_counts_once_it_was_entered() -> None:
    y = np.linspace(0.0, 0.03, 31)
    path = np.stack([0.0 * y, y, -8.0 * y**2], axis=1)
    points = np.zeros((6, 3))
    points[:, 0] = np.array([1.4, 1.2, 0.9, 1.0, 1.1, -1.3]) * 1e-3
    assert judge.outside(path, points, 1e-3) == 2
    assert judge.outside(path, points[:2], 1e-3) == 0


def test_heights_over_a_sphere_are_those_of_its_radius() -> None:
    vertices, faces = meshes.arrays("sphere")
    radius = np.linalg.norm(vertices, axis=1).max()
    flat = radius - np.linalg.norm(vertices[faces].mean(axis=1), axis=1).min()  # of its facets
    rng = np.random.default_rng(2)
    points = rng.normal(size=(300, 3))
    points *= (radius * rng.uniform(0.5, 1.5, size=300) / np.linalg.norm(points, axis=1))[:, None]
    found = judge.heights(vertices, faces, points)
    wanted = np.linalg.norm(points, axis=1) - radius
    assert ((found >= wanted - 1e-12) & (found <= wanted + flat + 1e-12)).all()
    assert (np.sign(found) == np.sign(wanted))[np.abs(wanted) > flat].all()
    assert {1.0, -1.0} <= set(np.sign(found))
