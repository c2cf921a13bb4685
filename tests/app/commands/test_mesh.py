"""`vf-sandbox mesh`: its words, files and exit codes, as a user meets them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

import meshes
from app.__main__ import main
from meshes.builtin.damage import damage
from meshes.save import save


@pytest.fixture
def hurt(tmp_path: Path) -> Path:
    """A torus with flipped and repeated faces, in millimetres."""
    path = tmp_path / "hurt.ply"
    save(path, *damage("duplicated", damage("flipped", meshes.arrays("torus"))), unit="mm")
    return path


def test_check_tells_defects_with_their_meaning(
    hurt: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["mesh", "check", str(hurt), "--unit", "mm"]) == 1
    out, err = capsys.readouterr()
    assert "307 faces repeat another" in out
    assert "307 faces are wound against" in out
    assert "the paper's rule guards the wrong side" in out
    assert "has defects" in out
    assert err == ""
    assert main(["mesh", "check", "torus"]) == 0
    assert "sound" in capsys.readouterr().out


def test_check_as_json_is_json_and_nothing_else(
    hurt: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["mesh", "check", str(hurt), "--json"]) == 1
    out, err = capsys.readouterr()
    report = json.loads(out)
    assert report["triangles"] == 6144 + 307
    assert {f["kind"]: f["count"] for f in report["findings"]}["flipped faces"] == 307
    assert "taken to be in mm" in report["notes"][0]
    assert "taken to be in mm" in err


def test_repair_writes_a_sound_file_in_the_same_unit(
    hurt: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "mended.stl"
    assert main(["mesh", "repair", str(hurt), str(out), "--unit", "mm"]) == 0
    printed = capsys.readouterr().out
    assert "dropped 307 repeated faces" in printed
    assert "turned 307 faces" in printed
    assert "in mm" in printed
    back = trimesh.load(out)
    wanted = trimesh.Trimesh(*meshes.arrays("torus"))
    assert back.is_volume
    assert back.volume == pytest.approx(wanted.volume * 1e9, rel=1e-5)
    assert main(["mesh", "check", str(out), "--unit", "mm"]) == 0
    before = out.read_bytes()
    assert main(["mesh", "repair", str(hurt), str(out)]) == 2
    assert "exists already" in capsys.readouterr().err
    assert out.read_bytes() == before
    assert main(["mesh", "repair", "torus", str(out), "--overwrite"]) == 0
    assert "nothing to repair" in capsys.readouterr().out


def test_repair_says_what_is_left(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sheet = tmp_path / "sheet.off"
    save(sheet, *damage("sheet", meshes.arrays("torus")), unit="mm")
    out = tmp_path / "out.obj"
    assert main(["mesh", "repair", str(sheet), str(out), "--unit", "mm", "--flip"]) == 1
    printed = capsys.readouterr().out
    assert "left: 2 boundary loops" in printed
    assert "turned 1 open patch\n" in printed
    turned = meshes.arrays(out, unit="mm")[1]
    assert np.array_equal(turned[:, [0, 2, 1]], meshes.arrays(sheet, unit="mm")[1])


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["fly"], "unknown command 'fly': choose one of list, check, repair, from-volume, labels"),
        (["check", "torsu"], "did you mean 'torus'"),
        (["check", "torus", "--examine", "-1"], "examine -1 is outside 0 to"),
        (["check", "missing.stl"], "no such file"),
        (["repair", "torus", "out.docx"], "unknown format '.docx'; choose one of .stl"),
        (["repair", "torus", "no/such/folder/out.stl"], "there is no folder"),
        (["repair", "torus", "out.stl", "--tolerance", "wide"], "'wide' is not a length"),
        (
            ["repair", "torus", "out.stl", "--tolerance", "-1mm"],
            "tolerance -1mm is outside 0mm to 10mm",
        ),
        (["repair", "missing.stl", "out.stl"], "no such file"),
    ],
)
def test_mistakes_are_one_line_and_exit_code_2(
    words: list[str],
    reason: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["mesh", *words]) == 2
    err = capsys.readouterr().err
    assert reason in err
    assert err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_list_and_help(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    few = {name: meshes.catalogue()[name] for name in ("skull-coarse", "cube")}
    monkeypatch.setattr(meshes, "catalogue", lambda: few)
    assert main(["mesh", "list"]) == 0
    out = capsys.readouterr().out
    assert "size [mm]" in out
    assert "9,670" in out
    assert "106 × 141 × 107" in out
    assert "Apache-2.0" in out
    assert main(["mesh", "--help"]) == 0
    assert "check" in capsys.readouterr().out
    assert main(["mesh", "check", "--help"]) == 0


def test_the_patient_frame_is_said_asked_for_and_turned(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mesh = meshes.arrays("star-prism")
    silent, out = str(tmp_path / "silent.ply"), tmp_path / "out.stl"
    save(silent, *mesh, unit="mm")
    assert main(["mesh", "check", silent, "--unit", "mm"]) == 0
    assert "3D Slicer would take it as LPS" in capsys.readouterr().out
    assert main(["mesh", "check", silent, "--unit", "mm", "--frame", "ras", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["frame"] == "RAS"
    words = ["mesh", "repair", silent, str(out), "--unit", "mm"]
    assert main([*words, "--write-frame", "lps"]) == 2
    assert "say --frame RAS or --frame LPS" in capsys.readouterr().err
    assert not out.exists()
    assert main([*words, "--frame", "ras", "--write-frame", "lps"]) == 0
    assert "in mm, LPS" in capsys.readouterr().out
    turned = meshes.read(out, unit="mm")
    assert turned.frame == "LPS"
    corners = mesh[0] * (-1, -1, 1)
    np.testing.assert_allclose(turned.arrays[0].min(axis=0), corners.min(axis=0), atol=1e-8)
    np.testing.assert_allclose(turned.arrays[0].max(axis=0), corners.max(axis=0), atol=1e-8)
    assert main(["mesh", "check", str(out), "--unit", "mm", "--frame", "ras"]) == 2
    assert "is in LPS, it says so itself" in capsys.readouterr().err
    # Without a wish nothing is turned, and what the file says stays with it.
    again = tmp_path / "again.obj"
    assert main(["mesh", "repair", str(out), str(again), "--unit", "mm"]) == 0
    kept = meshes.read(again, unit="mm")
    assert kept.frame == "LPS"
    np.testing.assert_allclose(kept.arrays[0].max(axis=0), turned.arrays[0].max(axis=0))
