"""One box in every format and way of writing it; cut off anywhere it is refused, never smaller."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import meshes
from meshes.formats import TABLE, Format
from tests.support.mesh_files import FILES, POINTS


def volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    a = vertices[faces]
    return float(np.einsum("ij,ij->", a[:, 0], np.cross(a[:, 1], a[:, 2]))) / 6


@pytest.mark.parametrize("entry", TABLE, ids=lambda entry: entry.title)
def test_every_format_is_tested_and_named_where_formats_are_listed(entry: Format) -> None:
    names = [file.removesuffix(".gz") for file, _ in FILES.values()]
    assert any(name.endswith(f".{end}") for name in names for end in entry.ends)
    assert entry.title in (Path(__file__).parents[2] / "docs/anatomy.md").read_text("utf-8")
    assert entry.title in str(meshes.arrays.__doc__)


@pytest.mark.parametrize("name", FILES)
def test_the_box_is_read(tmp_path: Path, name: str) -> None:
    file, data = FILES[name]
    (tmp_path / file).write_bytes(data)
    found = meshes.read(tmp_path / file, unit="mm" if "gl" not in name else None)
    vertices, faces = found.arrays
    assert len(faces) == 12
    assert len(vertices) == 8
    assert {tuple(p) for p in np.round(vertices * 1e3, 4).tolist()} == set(map(tuple, POINTS))
    assert volume(vertices, faces) == pytest.approx(6e-6, rel=1e-6)
    assert found.frame == ("RAS" if name.startswith(("gii", "free")) else None)
    known = {"gl": "m", "3m": "mm", "gi": "mm", "fr": "mm"}.get(name[:2])
    if known:
        assert meshes.read(tmp_path / file).unit == known


@pytest.mark.parametrize("name", FILES)
def test_a_file_cut_off_anywhere_is_never_a_smaller_anatomy(tmp_path: Path, name: str) -> None:
    file, data = FILES[name]
    path = tmp_path / file
    path.write_bytes(data)
    unit = "m" if "gl" in name else "mm"
    whole = meshes.read(path, unit=unit).arrays
    wanted = whole[0][whole[1]]
    step = math.ceil(len(data) / 250)
    taken, reasons = [], set()
    # Every place of a small file and of the end; elsewhere every few bytes.
    for end in (*range(0, len(data) - 60, step), *range(max(len(data) - 60, 0), len(data))):
        path.write_bytes(data[:end])
        try:
            found = meshes.read(path, unit=unit)
        except meshes.MeshError as error:
            reasons.add(str(error).split(": ", 1)[1])
            continue
        vertices, faces = found.arrays
        same = len(faces) == len(wanted) and np.array_equal(vertices[faces], wanted)
        # A last number that is cut is still a number: that is told.
        assert same or any("ends within a line" in note for note in found.notes), end
        taken.append(end)
    # Whole but for what comes after the triangles: line ends, closing words, checksums' padding.
    assert all(end > len(data) - 20 for end in taken), taken
    # In words of the field, not a parser's inside.
    assert not [reason for reason in reasons if "Error" in reason]
