"""`mesh from-volume`: what it writes, what it says, what it refuses."""

from __future__ import annotations

from pathlib import Path

import nibabel
import numpy as np
import pytest
import trimesh

from app.__main__ import main
from tests.support import volume_files as files


def test_a_surface_at_a_level(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shape = (42, 42, 42)
    T = files.affine(files.TURN @ np.diag([1.0, 1.0, -1.0]), shape)
    field = files.sphere(files.world_points(T, shape), 18.0)
    source = files.write_nifti(tmp_path / "v.nii.gz", field, T)
    out = tmp_path / "ball.stl"
    words = ["mesh", "from-volume", str(source), str(out), "--level", "100"]
    assert main([*words, "--smooth", "0.2mm", "--largest"]) == 0
    captured = capsys.readouterr()
    assert "42 × 42 × 42 voxels of 1 × 1 × 1 mm" in captured.out
    assert "RAS (x to the patient's right" in captured.out
    assert "guess" not in captured.err
    assert b"SPACE=RAS" in out.read_bytes()[:80]
    mesh = trimesh.load(out)
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * 18.0**3, rel=0.01)
    np.testing.assert_allclose(mesh.center_mass, files.CENTRE, atol=0.01)
    assert main(words) == 2
    assert "exists already" in capsys.readouterr().err
    other = ["mesh", "from-volume", str(source), str(tmp_path / "x.ply")]
    for more, text in (
        (["--level", "900"], "no surface at level 900: its values run from"),
        ([], "give --level, or --label for a label map: its values run from"),
        (["--level", "1", "--label", "1"], "not both"),
        (["--label", "3"], "no voxel has label 3"),
        (["--level", "100", "--volume", "1"], "there is no volume 1: it holds one volume: 0"),
    ):
        assert main([*other, *more]) == 2
        err = capsys.readouterr().err
        assert text in err
        assert err.count("\n") == 1
    assert not (tmp_path / "x.ply").exists()


def test_a_label_of_a_volume_that_does_not_say_how_the_patient_lies(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    labels = np.zeros((8, 8, 8, 2), dtype=np.uint8)
    labels[2:6, 2:6, 2:6, 1] = 4
    image = nibabel.Nifti1Image(labels, None)
    image.set_sform(None, 0)
    image.set_qform(None, 0)
    nibabel.save(image, tmp_path / "labels.nii")
    out = tmp_path / "four.ply"
    words = ["mesh", "from-volume", str(tmp_path / "labels.nii"), str(out)]
    assert main(words) == 2
    assert "holds 2 volumes: choose one of 0 to 1 (--volume)" in capsys.readouterr().err
    assert main([*words, "--volume", "1", "--label", "4"]) == 0
    captured = capsys.readouterr()
    assert "neither qform nor sform" in captured.err
    assert "left and right are a guess" in captured.err
    assert "left and right a guess" in captured.out
    assert "RAS" not in captured.out
    assert b"SPACE" not in out.read_bytes()[:300]
    assert trimesh.load(out).is_volume
