"""A command and a scenario ask for the unit of a mesh file that could be in two."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import meshes
from app.__main__ import main
from app.scenarios.file import read
from app.scene.scene import build
from app.settings import Options
from tests.support.mesh_files import tetrahedron


def test_commands_ask_for_the_unit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(tetrahedron(tmp_path / "tip.obj", 4.95))
    for words in (
        ["mesh", "check", path],
        ["mesh", "repair", path, str(tmp_path / "out.ply")],
        ["verify", "--mesh", path],
        ["bench", "meshes", "--mesh", path],
        ["--mesh", path, "--port", "0"],
    ):
        assert main(words) == 2
        said = " ".join(capsys.readouterr().err.split())
        sizes = "4.95 mm from corner to corner if in mm or 4.95 m from corner to corner if in m"
        assert f"{sizes}: give --unit mm or" in said
    assert not (tmp_path / "out.ply").exists()
    assert main(["mesh", "check", path, "--unit", "mm"]) == 0


def test_a_scenario_says_the_unit_of_its_mesh(tmp_path: Path) -> None:
    tetrahedron(tmp_path / "tip.obj", 4.95)
    file = tmp_path / "s.json"
    content = {"format": 1, "name": "tip", "about": "A tip.", "mesh": "tip.obj", "robot": "point"}
    file.write_text(json.dumps(content))
    with pytest.raises(meshes.UnitNeeded, match='in a scenario "unit"'):
        build(read(file).applied(Options()), 1)
    file.write_text(json.dumps({**content, "unit": "mm"}))
    scene = build(read(file).applied(Options()), 1)
    assert scene.surface.size < 0.01
