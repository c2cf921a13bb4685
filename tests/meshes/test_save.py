"""What is written comes back: by our loader exactly, and by trimesh."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import trimesh

import meshes
from meshes.formats import WRITABLE
from meshes.save import save


@pytest.mark.parametrize("kind", WRITABLE)
@pytest.mark.parametrize("unit", ["m", "mm", "in"])
def test_round_trip(tmp_path: Path, kind: str, unit: str) -> None:
    vertices, faces = meshes.arrays("gear")
    path = tmp_path / f"gear.{kind}"
    save(path, vertices, faces, unit=unit)
    back, back_faces = meshes.arrays(path, unit=None if kind == "glb" else unit)
    exact = kind in ("ply", "obj", "off")
    np.testing.assert_allclose(
        back[back_faces], vertices[faces], rtol=0, atol=1e-16 if exact else 1e-8
    )
    if exact:
        assert np.array_equal(back_faces, faces)
    other = trimesh.load(path, force="mesh", process=False)
    scale = 1.0 if kind == "glb" else 1 / meshes.UNITS[unit]
    np.testing.assert_allclose(other.extents, np.ptp(vertices, axis=0) * scale, rtol=1e-6)
    assert list(tmp_path.iterdir()) == [path]


def test_metres_are_bit_exact(tmp_path: Path) -> None:
    vertices, faces = meshes.arrays("skull-coarse")
    for kind in ("ply", "obj", "off"):
        save(tmp_path / f"m.{kind}", vertices, faces, unit="m")
        assert np.array_equal(meshes.arrays(tmp_path / f"m.{kind}", unit="m")[0], vertices)


def test_refusals_leave_no_file(tmp_path: Path) -> None:
    mesh = meshes.arrays("cube")
    path = tmp_path / "cube.stl"
    save(path, *mesh)
    size = path.stat().st_size
    with pytest.raises(meshes.MeshError, match="exists already"):
        save(path, *mesh)
    save(path, *meshes.arrays("torus"), overwrite=True)
    assert path.stat().st_size != size
    with pytest.raises(meshes.MeshError, match=r"unknown format '.docx'; choose one of .stl"):
        save(tmp_path / "cube.docx", *mesh)
    with pytest.raises(meshes.MeshError, match="unknown unit 'ell': choose one of m, cm"):
        save(tmp_path / "other.stl", *mesh, unit="ell")
    with pytest.raises(meshes.MeshError, match="no folder"):
        save(tmp_path / "no" / "cube.stl", *mesh)
    with pytest.raises(meshes.MeshError, match="not finite"):
        save(tmp_path / "other.stl", mesh[0] * np.nan, mesh[1])
    assert list(tmp_path.iterdir()) == [path]


def test_a_new_file_is_as_readable_as_any(tmp_path: Path) -> None:
    save(tmp_path / "cube.ply", *meshes.arrays("cube"))
    (tmp_path / "plain").touch()
    modes = {os.stat(tmp_path / name).st_mode for name in ("cube.ply", "plain")}
    assert len(modes) == 1
