"""Scenes of several structures: what becomes of their files."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import meshes
import robots
from app.scene import scene as scenes
from app.scene import worker
from app.scene.structures import files_of, read
from app.settings import MOST, Options
from app.structure import Structure
from tests.support import label_files, structured


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return structured.balls(tmp_path_factory.mktemp("balls"))


@pytest.fixture(scope="module")
def label_map(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return label_files.write_seg_nrrd(tmp_path_factory.mktemp("map") / "head.seg.nrrd")


def quiet(_text: str) -> None:
    pass


def test_structures_stand_where_the_mesh_s_frame_has_them(folder: Path) -> None:
    said: list[str] = []
    options = structured.options(folder, rotate=(0.0, 0.0, 1.0))
    scene = scenes.build(options, 1, said.append, warm=False)
    assert [own.name for own in scene.options.anatomy] == ["cube", *structured.NAMES]
    assert scene.surfaces == (scene.surface, *(one.surface for one in scene.structures))
    T = scene.T_base_mesh
    for name, built in zip(structured.NAMES, scene.structures, strict=True):
        centre = T[:3, :3] @ structured.CENTRES[name] + T[:3, 3]
        away = np.linalg.norm(built.surface.vertices - centre, axis=1)
        assert away.max() == pytest.approx(structured.RADIUS, abs=1e-7)
        assert built.surface.closed
        assert built.fronts_only
        assert any(name in text for text in said)
        # The start is clear of all of them.
        tip = np.array(scene.T_base_start.translation)
        assert built.surface.nearest(tip)[0] > structured.MARGINS[name]


def test_the_tool_starts_clear_of_a_structure_that_is_where_it_would_start(folder: Path) -> None:
    alone = scenes.build(structured.options(folder, structures=()), 1, warm=False)
    vertices, faces = meshes.arrays(str(folder / "dura.stl"), unit="mm")
    inverse = np.linalg.inv(alone.T_base_mesh)
    centre = inverse[:3, :3] @ alone.T_base_start.translation + inverse[:3, 3]
    path = folder.parent / "in-the-way.stl"
    moved = vertices - vertices.mean(axis=0) + centre
    meshes.save(path, moved, faces, unit="mm", overwrite=True)
    for margin in (0.0, 3e-3):
        own = Structure(str(path), margin=margin, unit="mm")
        scene = scenes.build(structured.options(folder, structures=(own,)), 1, warm=False)
        (built,) = scene.structures
        tip = np.array(scene.T_base_start.translation)
        assert not built.surface.inside(tip)
        assert built.surface.nearest(tip)[0] > margin


def test_a_folder_has_a_structure_a_file_and_is_read_the_same_again(folder: Path) -> None:
    options = Options(structures=(Structure(str(folder), margin=1e-3, unit="mm"),))
    found, mesh, structures = read(options, quiet)
    assert mesh is None
    assert [own.name for own in found.structures] == sorted(structured.NAMES)
    assert {own.margin for own in found.structures} == {1e-3}
    again, _, same = read(found, quiet)
    assert again == found
    for one, other in zip(structures, same, strict=True):
        np.testing.assert_array_equal(one.vertices, other.vertices)
    some = replace(found, structures=found.structures[1:])
    assert read(some, quiet)[0] == some


def test_a_label_map_has_a_structure_a_label_with_its_colour(label_map: Path) -> None:
    found, _, structures = read(Options(structures=(Structure(str(label_map)),)), quiet)
    assert [own.name for own in found.structures] == list(label_files.NAMES.values())
    for own, number in zip(found.structures, label_files.NAMES, strict=True):
        red, green, blue = label_files.COLOURS[number]
        assert own.colour == f"#{red:02x}{green:02x}{blue:02x}"
        assert own.margin == 0.0
    assert read(found, quiet)[0] == found
    assert len(structures) == 4
    # Chosen by number and by name, in the user's order, with the user's colour.
    chosen = (
        Structure(f"{label_map}:tube", colour="#000001"),
        Structure(f"{label_map}:1", name="kidney"),
        Structure(f"{label_map}:LEFT kidney"),
    )
    some, _, _ = read(Options(structures=chosen), quiet)
    assert [(own.label, own.name, own.colour) for own in some.structures] == [
        ("tube", "tube", "#000001"),
        ("Left kidney", "kidney", "#c81e28"),
        ("Left kidney", "Left kidney", "#c81e28"),
    ]
    assert read(some, quiet)[0] == some


def test_a_label_can_be_the_mesh_and_without_a_mesh_the_first_is(label_map: Path) -> None:
    given = Structure(str(label_map), margin=1e-3)
    scene = scenes.build(Options(mesh="none", robot="point", structures=(given,)), 1, warm=False)
    options = scene.options
    assert options.mesh == f"{label_map}:Left kidney"
    assert (options.margin, options.colour) == (1e-3, "#c81e28")
    assert [own.name for own in options.structures] == ["sheet", "tube", "drop"]
    again = scenes.build(options, 1, warm=False)
    assert again.options == options
    for one, other in zip(scene.surfaces, again.surfaces, strict=True):
        assert one.checksum == other.checksum
    assert scenes.settled(Options(mesh="none", structures=(given,)), scene).mesh == options.mesh


@pytest.mark.parametrize(
    ("structure", "words"),
    [
        (Structure("none.stl"), "none.stl"),
        (Structure("MAP:bone"), "no label 'bone'.*choose of 1 Left kidney, 2 sheet"),
        (Structure("MAP:77"), "no label '77'"),
        (Structure("BALLS:skin"), "no structure 'skin': choose of dura, nerve, vessel"),
        (Structure("cube:x"), "no structure 'x'"),
    ],
)
def test_what_is_not_there_is_refused(
    structure: Structure, words: str, folder: Path, label_map: Path
) -> None:
    file = {"MAP": str(label_map), "BALLS": str(folder)}.get(structure.file, structure.file)
    with pytest.raises(meshes.MeshError, match=words):
        read(Options(structures=(replace(structure, file=file),)), quiet)


def test_no_mesh_and_no_structure_or_too_many_are_refused(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(meshes.MeshError, match="neither a mesh nor a structure"):
        read(Options(mesh="none"), quiet)
    many = Options(structures=(Structure(str(folder), unit="mm"),) * (MOST // 2))
    with pytest.raises(meshes.MeshError, match=f"at most {MOST}"):
        read(many, quiet)


def test_a_structure_in_the_other_patient_frame_is_turned(tmp_path: Path) -> None:
    vertices, faces = meshes.arrays("l-block")
    for name, frame in (("mesh", "RAS"), ("same", "RAS"), ("other", "LPS")):
        meshes.save(tmp_path / f"{name}.ply", vertices, faces, unit="mm", frame=frame)
    options = Options(
        mesh=str(tmp_path / "mesh.ply"), unit="mm", robot="point",
        structures=tuple(Structure(str(tmp_path / f"{n}.ply")) for n in ("same", "other")),
    )  # fmt: skip
    scene = scenes.build(options, 1, warm=False)
    same, other = (one.surface.vertices for one in scene.structures)
    np.testing.assert_allclose(same, scene.surface.vertices, atol=1e-12)
    T = scene.T_base_mesh
    own = (scene.surface.vertices - T[:3, 3]) @ T[:3, :3]
    turned = own * [-1.0, -1.0, 1.0]
    np.testing.assert_allclose((other - T[:3, 3]) @ T[:3, :3], turned, atol=1e-12)


def test_structures_are_repaired_with_the_mesh(folder: Path, tmp_path: Path) -> None:
    vertices, faces = meshes.arrays(str(folder / "dura.stl"), unit="mm")
    path = tmp_path / "twisted.ply"
    meshes.save(path, vertices, np.vstack([faces[5:], faces[:5, ::-1]]), unit="mm")
    options = structured.options(folder, structures=(Structure(str(path), unit="mm"),))
    broken = scenes.build(options, 1, warm=False)
    assert not broken.structures[0].surface.closed
    assert any("twisted" in note for note in broken.notes)
    mended = scenes.build(replace(options, repair=True), 1, warm=False)
    assert mended.structures[0].surface.closed


def test_large_structures_are_decimated_for_drawing_alone() -> None:
    options = Options(mesh="cube", robot="point", structures=(Structure("skull-fine"),))
    scene = scenes.build(options, 1, warm=False)
    (built,) = scene.structures
    assert len(built.surface.faces) > 900_000
    assert len(built.faces_shown) <= 150_000
    assert built.decimated


def test_a_scene_is_built_aside_with_all_its_files_counted(folder: Path) -> None:
    options = structured.options(folder)
    files = files_of(options)
    assert files == ("cube", *(str(folder / f"{name}.stl") for name in structured.NAMES))
    assert files_of(Options(mesh="none", structures=(Structure(str(folder)),))) == tuple(
        sorted(str(path) for path in folder.iterdir())
    )
    assert worker.allowance(*files).seconds > worker.allowance("cube").seconds + 179.0
    arm = robots.load("point")
    aside = worker.build(options, 3, arm)
    here = scenes.build(options, 3, warm=False)
    assert aside.arm is arm
    assert aside.options == here.options
    for one, other in zip(aside.surfaces, here.surfaces, strict=True):
        assert one.checksum == other.checksum
    assert len(pickle.dumps(aside.options)) < 10_000
