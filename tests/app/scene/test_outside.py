"""Whether only front faces of a mesh are visible from outside."""

from __future__ import annotations

import numpy as np
import trimesh

from app.scene.outside import shows_fronts_only


def ball(radius: float = 1.0, at: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> trimesh.Trimesh:
    made = trimesh.creation.icosphere(subdivisions=2, radius=radius)
    made.apply_translation(at)
    return made


def inverted(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, mesh.faces[:, ::-1], process=False)


def joined(*parts: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.util.concatenate(parts)


def test_back_faces_are_culled_only_where_none_is_visible_from_outside() -> None:
    flipped, opened = ball(), ball()
    faces = flipped.faces.copy()
    faces[7] = faces[7, ::-1]
    flipped = trimesh.Trimesh(flipped.vertices, faces, process=False)
    opened = trimesh.Trimesh(opened.vertices, opened.faces[1:], process=False)
    soup = trimesh.Trimesh(*trimesh.triangles.to_kwargs(ball().triangles).values(), process=False)
    cases = {
        "a ball": (ball(), True),
        "two": (joined(ball(), ball(0.5, (3.0, 0.0, 0.0))), True),
        "far from the origin": (ball(1.0, (50.0, -20.0, 7.0)), True),
        "inside out": (inverted(ball()), False),
        "one of two inside out": (joined(ball(), inverted(ball(0.5, (3.0, 0.0, 0.0)))), False),
        "a face turned over": (flipped, False),
        "a hole": (opened, False),
        "corners not shared": (soup, False),
        "faces twice": (joined(ball(), ball()), True),  # two bodies in one place
    }
    for name, (mesh, expected) in cases.items():
        shown = shows_fronts_only(np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int64))
        assert shown == expected, name
        if shown:
            # Oracle: the first face that a ray from outside meets is a front face.
            rng = np.random.default_rng(0)
            eyes = rng.normal(size=(200, 3))
            eyes = mesh.bounds.mean(axis=0) + 9.0 * eyes / np.linalg.norm(eyes, axis=1)[:, None]
            aims = rng.choice(mesh.vertices, 200) + rng.normal(scale=0.1, size=(200, 3))
            first = mesh.ray.intersects_first(eyes, aims - eyes)
            met = first >= 0
            turned = np.einsum("ij,ij->i", mesh.face_normals[first[met]], (aims - eyes)[met])
            assert met.sum() > 50
            assert (turned < 0.0).all(), name
    assert not shows_fronts_only(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64))
