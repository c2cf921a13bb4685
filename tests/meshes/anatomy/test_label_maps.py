"""Labels: numbers, names, colours, volumes and extents of every format; refusals by name."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

import meshes
from meshes.volume import grid
from tests.support import label_files as maps
from tests.support import volume_files as files


def box_in_world(box: tuple[slice, ...], T_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Low and high [m] of the outer corners of voxels, corner by corner."""
    corners = [
        T_mm[:3, :3] @ (x, y, z) + T_mm[:3, 3]
        for x in (box[0].start - 0.5, box[0].stop - 0.5)
        for y in (box[1].start - 0.5, box[1].stop - 0.5)
        for z in (box[2].start - 0.5, box[2].stop - 0.5)
    ]
    return np.min(corners, axis=0) * 1e-3, np.max(corners, axis=0) * 1e-3


def assert_is_the_map(found: tuple[meshes.Label, ...], T_mm: np.ndarray) -> None:
    assert [one.number for one in found] == [1, 2, 5, 9]
    for one in found:
        assert one.voxels == np.count_nonzero(one.number == maps.LABELS)
        assert one.volume == pytest.approx(one.voxels * abs(np.linalg.det(T_mm[:3, :3])) * 1e-9)
        low, high = box_in_world(maps.BOXES[one.number], T_mm)
        np.testing.assert_allclose(one.low, low, atol=1e-9)
        np.testing.assert_allclose(one.high, high, atol=1e-9)


def named(found: tuple[meshes.Label, ...]) -> dict[int, str]:
    return {one.number: one.name for one in found}


def coloured(found: tuple[meshes.Label, ...]) -> dict[int, tuple[int, int, int] | None]:
    return {one.number: one.colour for one in found}


def test_a_segmentation_of_3d_slicer_has_names_and_colours(tmp_path: Path) -> None:
    found = meshes.labels(maps.write_seg_nrrd(tmp_path / "case.seg.nrrd"))
    assert_is_the_map(found, maps.T_MM)
    assert named(found) == maps.NAMES
    assert coloured(found) == maps.COLOURS


@pytest.mark.parametrize("first_axis", [True, False])
@pytest.mark.parametrize("encoding", ["gzip", "raw", "text"])
def test_layers_of_a_segmentation_overlap(tmp_path: Path, first_axis: bool, encoding: str) -> None:
    layers = np.zeros((*maps.SHAPE, 2), dtype=np.uint8)
    layers[2:20, 2:20, 2:20, 0] = 1
    layers[5:9, 5:9, 5:9, 1] = 1
    layers[22:24, 5:9, 5:9, 0] = 2
    keys = maps.slicer_keys(
        [(0, 1, "organ", (1, 2, 3)), (1, 1, "tumour", (4, 5, 6)), (0, 2, "duct", (7, 8, 9))]
    )
    path = files.write_nrrd(
        tmp_path / "x.seg.nrrd", layers, maps.T_MM, encoding=encoding, extra=keys,
        first_axis=first_axis,
    )  # fmt: skip
    found = meshes.labels(path)
    # The value 1 stands for two segments: they are numbered in the file's order.
    assert named(found) == {1: "organ", 2: "tumour", 3: "duct"}
    assert [one.voxels for one in found] == [18**3, 4**3, 32]
    assert coloured(found) == {1: (1, 2, 3), 2: (4, 5, 6), 3: (7, 8, 9)}
    parts = meshes.structures(path, ["tumour", 3])
    assert [one.name for one in parts] == ["tumour", "duct"]
    low, high = box_in_world((slice(5, 9),) * 3, maps.T_MM)
    assert (parts[0].vertices > low - 1e-4).all()
    assert (parts[0].vertices < high + 1e-4).all()


@pytest.mark.parametrize("first_axis", [True, False])
def test_segmentations_of_slicer_before_5_have_a_layer_of_ones_a_segment(
    tmp_path: Path, first_axis: bool
) -> None:
    layers = np.stack([maps.LABELS == 1, maps.LABELS == 5], axis=3).astype(np.uint8)
    keys = maps.slicer_keys([(0, 0, "kidney", (1, 2, 3)), (0, 0, "tube", (4, 5, 6))])
    keys = "".join(f"{line}\n" for line in keys.split("\n") if line and "Layer" not in line)
    keys = "".join(f"{line}\n" for line in keys.split("\n") if line and "LabelValue" not in line)
    path = files.write_nrrd(
        tmp_path / "old.seg.nrrd", layers, maps.T_MM, extra=keys, first_axis=first_axis
    )
    found = meshes.labels(path)
    assert named(found) == {1: "kidney", 2: "tube"}
    assert [one.voxels for one in found] == [960, 16]
    assert coloured(found) == {1: (1, 2, 3), 2: (4, 5, 6)}


def test_several_volumes_that_are_no_segmentation_are_refused(tmp_path: Path) -> None:
    series = np.stack([maps.LABELS, maps.LABELS], axis=3)
    path = files.write_nrrd(tmp_path / "s.nrrd", series, maps.T_MM)
    with pytest.raises(meshes.MeshError, match="holds 2 volumes: a label map is one") as caught:
        meshes.labels(path)
    assert "--volume" not in str(caught.value)
    nifti = files.write_nifti(tmp_path / "s.nii", series, maps.T_MM)
    with pytest.raises(meshes.MeshError, match=r"s\.nii: holds 2 volumes: a label map is one"):
        meshes.labels(nifti)


@pytest.mark.parametrize("ending", ["nii.gz", "mha", "nrrd", "mgz"])
@pytest.mark.parametrize(
    ("table", "text"),
    [(".ctbl", maps.CTBL), (".txt", maps.SNAP), (".lut", maps.FREESURFER), ("", "")],
    ids=["slicer", "snap", "freesurfer", "none"],
)
def test_a_colour_table_beside_the_map_names_its_labels(
    tmp_path: Path, ending: str, table: str, text: str
) -> None:
    path = tmp_path / f"head.{ending}"
    write = {"nii.gz": files.write_nifti, "mha": files.write_metaimage, "nrrd": files.write_nrrd}
    write.get(ending, files.write_mgh)(path, maps.LABELS, maps.T_MM)
    if table:
        (tmp_path / f"head{table}").write_text(text)
    found = meshes.labels(path)
    if ending != "mgz":  # single precision
        assert_is_the_map(found, maps.T_MM)
    if not table:
        assert named(found) == {k: f"label {k}" for k in maps.NAMES}
        assert set(coloured(found).values()) == {None}
        return
    blanks = table == ".txt"
    assert named(found) == {k: n if blanks else n.replace(" ", "_") for k, n in maps.NAMES.items()}
    assert coloured(found) == maps.COLOURS
    # One that is given comes before one that lies beside.
    other = tmp_path / "other.ctbl"
    other.write_text("5 vessel 9 8 7 255\n")
    assert named(meshes.labels(path, table=other))[5] == "vessel"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("1 liver 300 0 0 255\n", "line 1, '1 liver 300 0 0 255', is not a row"),
        ("# only a comment\n", "a colour table without rows"),
        ("1 a 1 2 3 4\n1 b 1 2 3 4\n", "line 2: the number 1 has a row already"),
        ("hello\n", "line 1, 'hello', is not a row of a colour table"),
    ],
)
def test_what_is_no_colour_table_is_refused(tmp_path: Path, text: str, reason: str) -> None:
    path = files.write_nifti(tmp_path / "head.nii", maps.LABELS, maps.T_MM)
    (tmp_path / "head.ctbl").write_text(text)
    with pytest.raises(meshes.MeshError, match=r"head\.ctbl") as caught:
        meshes.labels(path)
    assert reason in str(caught.value)


@pytest.mark.parametrize("kind", ["P", "L", "RGB"])
def test_a_stack_of_pngs(tmp_path: Path, kind: str) -> None:
    folder = maps.write_pngs(tmp_path / "slices", kind)
    if kind != "P":
        (folder / "names.ctbl").write_text(maps.CTBL)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = meshes.labels(folder, spacing=(5e-4, 6e-4, 7e-4))
        plain = meshes.labels(folder)
    # Columns to the patient's left, rows to the back: LPS, as pictures of CT are shown.
    assert_is_the_map(found, np.diag([-0.5, -0.6, 0.7, 1.0]))
    assert_is_the_map(plain, np.diag([-1.0, -1.0, 1.0, 1.0]))
    assert coloured(found) == maps.COLOURS
    assert found[0].name == ("label 1" if kind == "P" else "Left_kidney")
    notes = [str(one.message) for one in caught]
    assert sum("left and right are a guess" in note for note in notes) == 2
    assert sum("do not say how large" in note for note in notes) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert {one.frame for one in meshes.structures(folder, [9])} == {None}


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_stacks_of_pngs_that_are_none_are_refused(tmp_path: Path) -> None:
    folder = maps.write_pngs(tmp_path / "slices", "RGB")
    with pytest.raises(meshes.MeshError, match="a colour table has to say which label"):
        meshes.labels(folder)
    (folder / "a.ctbl").write_text("1 a 200 30 40 255\n2 b 0 255 0 255\n5 c 17 34 51 255\n")
    with pytest.raises(meshes.MeshError, match="the colour 250 250 5 is not in the colour table"):
        meshes.labels(folder)
    (folder / "a.ctbl").write_text(maps.CTBL)
    whole = (folder / "slice7.png").read_bytes()
    for cut in (0, 20, len(whole) // 2):
        (folder / "slice7.png").write_bytes(whole[:cut])
        with pytest.raises(meshes.MeshError, match=r"slice7\.png"):
            meshes.labels(folder)


def test_a_segment_without_voxels_is_listed_and_not_chosen(tmp_path: Path) -> None:
    keys = maps.slicer_keys([(0, 1, "a", (1, 2, 3)), (0, 3, "empty", (1, 2, 3))])
    path = files.write_nrrd(
        tmp_path / "x.seg.nrrd", (maps.LABELS == 1).astype(np.uint8), maps.T_MM, extra=keys
    )
    found = meshes.labels(path)
    assert named(found) == {1: "a", 3: "empty"}
    assert found[1].voxels == 0
    assert np.isnan(found[1].low).all()
    assert [one.name for one in meshes.structures(path)] == ["a"]
    with pytest.raises(meshes.MeshError, match="no voxel has the label 3, 'empty'"):
        meshes.structures(path, ["empty"])


def test_equal_names_are_told_apart(tmp_path: Path) -> None:
    keys = maps.slicer_keys([(0, k, "vessel", (1, 2, 3)) for k in maps.NAMES])
    path = files.write_nrrd(tmp_path / "x.seg.nrrd", maps.LABELS, maps.T_MM, extra=keys)
    assert list(named(meshes.labels(path)).values()) == [
        "vessel", "vessel (2)", "vessel (5)", "vessel (9)",
    ]  # fmt: skip


def test_numbers_of_any_size_and_float_maps_are_read(tmp_path: Path) -> None:
    values = np.zeros(maps.SHAPE)
    values[2:5, 3:7, 4:8], values[9:11, 3:7, 4:8] = 12175, 70001
    values[0, 0, 0] = np.nan
    for kind in (np.float32, np.int32):
        path = tmp_path / f"{np.dtype(kind).name}.nii.gz"
        files.write_nifti(
            path, np.nan_to_num(values).astype(kind) if kind is np.int32 else values, maps.T_MM
        )
        assert {one.number: one.voxels for one in meshes.labels(path)} == {12175: 48, 70001: 32}


def images() -> dict[str, tuple[np.ndarray, str]]:
    rng = np.random.default_rng(0)
    return {
        "fractions": (rng.random(maps.SHAPE), "values that are not whole numbers"),
        "infinite": (np.where(maps.LABELS == 1, np.inf, 0.0), "not whole numbers"),
        "ct": (rng.integers(-1000, 3000, maps.SHAPE).astype(np.int16), "more than 500 different"),
        "grey": (rng.integers(0, 90, maps.SHAPE).astype(np.uint8), "only 1 % of the voxels"),
        "negative": (maps.LABELS.astype(np.int16) - 1, "negative values, such as -1"),
        "empty": (np.zeros(maps.SHAPE, dtype=np.uint8), "all are background"),
    }


@pytest.mark.parametrize("name", list(images()))
def test_what_is_no_label_map_is_refused_by_name(tmp_path: Path, name: str) -> None:
    values, why = images()[name]
    path = files.write_nifti(tmp_path / f"{name}.nii", values, maps.T_MM)
    for read in (meshes.labels, meshes.structures):
        with pytest.raises(meshes.MeshError) as caught:
            read(path)
        text = str(caught.value)
        assert why in text
        assert text.startswith(f"{path}: ")
        assert "\n" not in text


def test_a_map_of_many_small_regions_is_read(tmp_path: Path) -> None:
    """Regions of 3 × 3 × 3 voxels, each with its own label: two of three neighbours are alike."""
    i, j, k = (np.arange(n) // 3 for n in maps.SHAPE)
    values = (1 + i[:, None, None] * 72 + j[:, None] * 8 + k).astype(np.int16) % 400
    path = files.write_nifti(tmp_path / "regions.nii", values, maps.T_MM)
    assert len(meshes.labels(path)) == 399


def test_files_that_cannot_be_read_are_refused(tmp_path: Path) -> None:
    path = maps.write_seg_nrrd(tmp_path / "x.seg.nrrd")
    path.write_bytes(path.read_bytes()[:-30])
    with pytest.raises(meshes.MeshError, match=r"x\.seg\.nrrd: it is cut off"):
        meshes.labels(path)
    with pytest.raises(meshes.MeshError, match="no such file"):
        meshes.labels(tmp_path / "missing.nii")
    with pytest.raises(meshes.MeshError, match="a folder without PNG files"):
        meshes.labels(tmp_path)
    ply = tmp_path / "mesh.ply"
    meshes.save(ply, *meshes.arrays("cube"), unit="mm", frame=None, overwrite=False)
    with pytest.raises(meshes.MeshError, match="no volume that is read"):
        meshes.labels(ply)


def test_layers_that_are_too_many_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    layers = np.zeros((*maps.SHAPE, 3), dtype=np.uint8)
    path = files.write_nrrd(
        tmp_path / "x.nrrd", layers, maps.T_MM, extra=maps.slicer_keys([(0, 1, "a", (0, 0, 0))])
    )
    monkeypatch.setattr("meshes.volume.payload.MOST_VOXELS", 2 * int(np.prod(maps.SHAPE)))
    assert 2 * int(np.prod(maps.SHAPE)) < grid.MOST_VOXELS
    with pytest.raises(meshes.MeshError, match="its 3 volumes are 51,480 voxels"):
        meshes.labels(path)
