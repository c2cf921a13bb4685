"""`mesh labels`: the table it prints, and what it refuses."""

from __future__ import annotations

from pathlib import Path

import pytest

from app.__main__ import main
from tests.support import label_files as maps
from tests.support import volume_files as files


def test_the_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = maps.write_seg_nrrd(tmp_path / "case.seg.nrrd")
    assert main(["mesh", "labels", str(path)]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    head, *rows, last = out.splitlines()
    assert head.split() == ["number", "name", "colour", "voxels", "volume", "extent", "[mm]"]
    assert len(rows) == 4
    assert rows[0].split()[:4] == ["1", "Left", "kidney", "#c81e28"]
    assert rows[0].split()[4:6] == ["960", "960"]
    assert "mm³" in rows[0]
    assert rows[3].split()[:4] == ["9", "drop", "#fafa05", "1"]
    assert last.endswith("case.seg.nrrd: 4 labels")


def test_volumes_from_a_millilitre_on_and_a_colour_table(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = files.write_nifti(tmp_path / "x.nii", maps.LABELS, maps.T_MM * [[2], [2], [2], [1]])
    table = tmp_path / "names.txt"
    table.write_text(maps.SNAP)
    assert main(["mesh", "labels", str(path), "--table", str(table)]) == 0
    rows = capsys.readouterr().out.splitlines()
    assert "7.68 ml" in rows[1]
    assert "Left kidney" in rows[1]
    assert "960 mm³" in rows[2]


def test_pngs_take_a_spacing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = maps.write_pngs(tmp_path / "slices", "P")
    assert main(["mesh", "labels", str(folder), "--spacing", "0.5mm,0.5mm,2mm"]) == 0
    out, err = capsys.readouterr()
    assert "5 × 4 × 24" in out
    assert "left and right are a guess" in err
    assert "do not say how large" not in err


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["missing.nii"], "missing.nii: there is no such file"),
        (["cube.nii", "--spacing", "1,1,1"], "has no unit"),
        (["cube.nii", "--table", "none.txt"], "none.txt: the colour table cannot be read"),
    ],
)
def test_mistakes_are_one_line_and_exit_code_2(
    words: list[str],
    why: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    files.write_nifti(tmp_path / "cube.nii", maps.LABELS, maps.T_MM)
    assert main(["mesh", "labels", *words]) == 2
    err = capsys.readouterr().err
    assert why in err
    assert err.count("\n") == 1
