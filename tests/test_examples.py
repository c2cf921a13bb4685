"""The examples in docs/examples run as they stand, and print what they are there to show."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "docs/examples"
EXAMPLES = sorted(FOLDER.glob("*.py"))
# What each prints: numbers that hang on the method, not on the machine.
SHOWN = {
    "01_planes.py": [
        r"2\.000 mm from the surface, planes: 1",
        r"allowed 1\.97\d mm",
        r"2\d µm are left",
    ],
    "02_own_arm.py": [r"0 ms  SOLVED    19\.8\d\d mm, planes: 0", r"rests 2[01] µm", r"1\.50 N"],
    "03_own_fixture.py": [
        r"down: .* 30\.02\) mm, held by planes of the mesh: [1-9]\d*, of the port: 0",
        r"aside: .*, held by planes of the mesh: 0, of the port: [1-9]",
    ],
    "04_headless_session.py": [r"2[01] µm off", r"crossed the mesh: no", r"\d{3} ticks recorded"],
    "05_batch.py": [r"4000 points, [1-9]\d* of them inside", r"planes: median 1, at most \d+"],
    "06_damaged_mesh.py": [
        r"clean, rule paper: 0 of 40",
        r"flipped faces, rule paper: [1-9]\d* of 40",
        r"flipped faces, rule certified: 0 of 40",
    ],
    "07_instrument.py": [
        r"psm, 6 joints\n  blade       radius  1\.50 mm, axis   8\.7 mm, moves with wrist_yaw",
        r"shaft       radius  4\.17 mm, axis 104\.4 mm, moves with pitch and roll",
        r"ur5, 6 joints\n  probe       radius  2\.50 mm, axis  97\.5 mm",
        r"needle      radius  1\.60 mm, axis  43\.1 mm, moves with z",
    ],
    "10_own_device.py": [
        r"before: DISABLED",
        r"now: ENABLED, True set-points",
        r"rests 0\.[1-3] mm off the surface, force 0\.[4-9] N",
        r"crossed the mesh: no",
    ],
    "08_moving_structure.py": [
        r"1500 ms  \w+ +lifted 3\.5\d mm",
        r"never closer than 0\.52 mm",
        r"knocked: OVERTAKEN, up to 2\d mm deep",
    ],
    "09_deforming_structure.py": [
        r"600 ms  SOLVED     lifted 2\.\d\d mm",
        r"never closer than [12]\d µm",
    ],
}


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.name)
def test_an_example_shows_what_it_says(
    path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(path), run_name="__main__")
    said = capsys.readouterr().out
    for words in SHOWN[path.name]:
        assert re.search(words, said), f"{words!r} is not in:\n{said}"


def test_the_examples_are_numbered_and_listed() -> None:
    assert [int(path.name[:2]) for path in EXAMPLES] == list(range(1, len(EXAMPLES) + 1))
    listed = re.findall(r"\]\((\d\d_\w+\.py)\)", (FOLDER / "README.md").read_text("utf-8"))
    assert listed == [path.name for path in EXAMPLES]
