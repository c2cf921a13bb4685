"""The patient frame of a file is read where it stands, written, and never changed unasked."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import meshes
from meshes import frames
from meshes.formats import WRITABLE


@pytest.mark.parametrize("kind", WRITABLE)
@pytest.mark.parametrize("frame", ["RAS", "LPS", None])
def test_the_frame_comes_back_and_nothing_is_turned(
    tmp_path: Path, kind: str, frame: str | None
) -> None:
    vertices, faces = meshes.arrays("star-prism")
    path = tmp_path / f"m.{kind}"
    meshes.save(path, vertices, faces, unit="m", frame=frame)
    back = meshes.read(path, unit="m")
    assert back.frame == frame
    np.testing.assert_allclose(back.arrays[0][back.arrays[1]], vertices[faces], atol=1e-8)
    # As 3D Slicer looks for it: these very letters, early in the file.
    assert (f"SPACE={frame}".encode() in path.read_bytes()[:400]) == (frame is not None)


def test_the_user_says_what_the_file_does_not(tmp_path: Path) -> None:
    mesh = meshes.arrays("cube")
    meshes.save(tmp_path / "silent.ply", *mesh)
    meshes.save(tmp_path / "says.ply", *mesh, frame="RAS")
    assert meshes.read(tmp_path / "silent.ply", unit="mm", frame="lps").frame == "LPS"
    assert meshes.read(tmp_path / "says.ply", unit="mm", frame="RAS").frame == "RAS"
    with pytest.raises(meshes.MeshError, match=r"says.ply: is in RAS, it says so .* not in LPS"):
        meshes.read(tmp_path / "says.ply", unit="mm", frame="LPS")
    with pytest.raises(meshes.MeshError, match="unknown frame 'RIA': choose one of RAS, LPS"):
        meshes.read(tmp_path / "silent.ply", unit="mm", frame="RIA")
    with pytest.raises(meshes.MeshError, match="unknown frame 'x'"):
        meshes.save(tmp_path / "other.ply", *mesh, frame="x")
    assert not (tmp_path / "other.ply").exists()


def test_half_a_turn_about_z_and_back_is_exact() -> None:
    points = np.random.default_rng(1).normal(size=(50, 3))
    turned = frames.half_turn(points)
    np.testing.assert_array_equal(turned, points @ np.diag([-1.0, -1.0, 1.0]))
    np.testing.assert_array_equal(frames.half_turn(turned), points)
    assert not np.signbit(frames.half_turn(np.zeros((1, 3)))).any()


@pytest.mark.parametrize(
    ("comment", "reason"),
    [
        ("SPACE=LAS", "says SPACE=LAS: only RAS and LPS are read"),
        ("space = rai", "says SPACE=RAI: only RAS and LPS are read"),
        ("SPACE=LPS SPACE=LAS", "says SPACE=LPS and SPACE=LAS: only one frame"),
    ],
)
def test_a_frame_that_is_not_read_is_refused_by_name(
    tmp_path: Path, comment: str, reason: str
) -> None:
    path = tmp_path / "m.obj"
    path.write_text(f"# {comment}\nv 0 0 0\nv 20 0 0\nv 0 20 0\nf 1 2 3\n")
    with pytest.raises(meshes.MeshError, match=reason):
        meshes.read(path, unit="mm")
