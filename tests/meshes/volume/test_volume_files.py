"""Every format is placed as the others, whole or refused, and refused for what it is."""

from __future__ import annotations

import gzip
import importlib
import struct
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import nibabel
import numpy as np
import pytest
import trimesh

import meshes
from meshes import volume
from meshes.volume import payload
from tests.support import volume_files as files
from tests.support.volume_files import reason

WRITERS: dict[str, Callable[[Path, np.ndarray, np.ndarray], Path]] = {
    "v.nii": files.write_nifti,
    "v.nii.gz": files.write_nifti,
    "v.img": lambda p, v, T: _pair(p, v, T),
    "v.mgh": files.write_mgh,
    "v.mgz": files.write_mgh,
    "v.nrrd": files.write_nrrd,
    "raw.nrrd": lambda p, v, T: files.write_nrrd(p, v, T, encoding="raw", big=True),
    "bzip2.nrrd": lambda p, v, T: files.write_nrrd(p, v, T, encoding="bzip2", space="LAS"),
    "text.nrrd": lambda p, v, T: files.write_nrrd(p, v, T, encoding="text"),
    "v.nhdr": lambda p, v, T: files.write_nrrd(p, v, T, space="right-anterior-superior"),
    "v.mha": files.write_metaimage,
    "raw.mha": lambda p, v, T: files.write_metaimage(p, v, T, compressed=False, big=True),
    "v.mhd": files.write_metaimage,
}


def _pair(path: Path, values: np.ndarray, T: np.ndarray) -> Path:
    nibabel.save(nibabel.Nifti1Pair(values.astype(np.float32), T), path)
    return path


@pytest.mark.parametrize("grid", files.GRIDS)
def test_nifti_sphere_and_torus(tmp_path: Path, grid: str) -> None:
    shape = (76, 74, 72)
    T = files.affine(files.GRIDS[grid], shape)
    p = files.world_points(T, shape)
    for field, exact, genus in (
        (files.sphere, 4 / 3 * np.pi * 20.0**3, 0),
        (files.torus, 2 * np.pi**2 * 20.0 * 8.0**2, 1),
    ):
        path = files.write_nifti(tmp_path / "v.nii.gz", field(p), T)
        vertices, faces = volume.surface(volume.read(path), 100.0)
        mesh = trimesh.Trimesh(vertices * 1e3, faces, process=False)
        assert mesh.is_volume
        assert mesh.volume == pytest.approx(exact, rel=0.01)  # positive: outwards
        assert mesh.euler_number == 2 - 2 * genus
        np.testing.assert_allclose(mesh.center_mass, files.CENTRE, atol=0.01)
        # Every vertex is on the shape, within the bend of a voxel's edge.
        assert np.abs(field(vertices * 1e3 - files.CENTRE) - 100.0).max() < 0.05


def test_a_plane_field_is_placed_exactly(tmp_path: Path) -> None:
    """A linear field has no interpolation error: the cut lies at its world coordinate."""
    shape = (12, 13, 14)
    T = files.affine(files.TURN @ np.diag([0.7, 1.0, -1.3]), shape)
    p = files.world_points(T, shape)
    path = files.write_nifti(tmp_path / "v.nii", p[..., 0] + files.CENTRE[0], T)
    vertices, faces = volume.surface(volume.read(path), 31.0)
    # What is not on the volume's border lies on x = 31 mm; its normals point to smaller x.
    index = np.linalg.solve(T[:3, :3], (vertices * 1e3 - T[:3, 3]).T).T
    inner = ((index > 1e-3) & (index < np.array(shape) - 1.001)).all(axis=1)
    assert inner.sum() > 50
    np.testing.assert_allclose(vertices[inner, 0], 0.031, atol=1e-8)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    flat = inner[faces].all(axis=1) & (mesh.area_faces > 1e-9)
    np.testing.assert_allclose(mesh.face_normals[flat], np.tile([-1.0, 0, 0], (flat.sum(), 1)),
                               atol=1e-3)  # fmt: skip
    assert mesh.is_watertight


@pytest.mark.parametrize("name", WRITERS)
def test_every_format_is_placed_the_same(tmp_path: Path, name: str) -> None:
    shape = (9, 8, 7)
    linear = files.GRIDS["oblong voxels" if "m" in name else "sheared"]
    T = files.affine(linear @ np.diag([-1.0, 1.0, 1.0]), shape)
    values = np.random.default_rng(0).normal(size=shape)
    read = volume.read(WRITERS[name](tmp_path / name, values, T))
    np.testing.assert_array_equal(read.values, values.astype(np.float32))
    np.testing.assert_allclose(read.T_world_voxel[:3], T[:3] * 1e-3, atol=1e-8)
    assert (read.frame, read.notes) == ("RAS", ())


@pytest.mark.parametrize("name", WRITERS)
def test_a_file_cut_anywhere_is_refused(tmp_path: Path, name: str) -> None:
    shape = (5, 6, 7)
    values = np.round(np.random.default_rng(0).normal(size=shape), 1)
    path = WRITERS[name](tmp_path / name, values, files.affine(np.eye(3), shape))
    data = {"v.mhd": "v.raw", "v.nhdr": "v.bin"}.get(name)
    part = tmp_path / data if data else path
    whole = part.read_bytes()
    # MGH files end with text that is not needed: the voxels end before. A cut in the last number
    # of a text leaves a number.
    length = {"v.mgh": 284 + 4 * values.size, "text.nrrd": whole.rfind(b" ") + 1}.get(
        name, len(whole)
    )
    for size in (*range(0, 700, 7), *range(length // 2, length - 1, 29), length - 1):
        if size < length:
            part.write_bytes(whole[:size])
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                reason(path)


def test_one_of_several_volumes(tmp_path: Path) -> None:
    shape = (4, 5, 6, 3)
    T = files.affine(np.eye(3), shape[:3])
    values = np.random.default_rng(0).integers(0, 200, shape).astype(np.int16)
    fields = {"values": values, "T": T}
    paths = [
        files.write_nifti(tmp_path / "v.nii.gz", **fields),
        files.write_nrrd(tmp_path / "last.nrrd", **fields),
        files.write_nrrd(tmp_path / "first.nrrd", **fields, first_axis=True),
        files.write_nrrd(tmp_path / "text.nrrd", **fields, first_axis=True, encoding="text"),
        files.write_metaimage(tmp_path / "v.mha", **fields),
        files.write_mgh(tmp_path / "v.mgz", **fields),
    ]
    for path in paths:
        for k in range(3):
            np.testing.assert_array_equal(volume.read(path, volume=k).values, values[..., k])
        assert "choose one of 0 to 2 (--volume)" in reason(path)
        assert "there is no volume 3: it holds 3" in reason(path, volume=3)
    alone = files.write_nifti(tmp_path / "one.nii", values[..., :1], T)
    np.testing.assert_array_equal(volume.read(alone).values, values[..., 0])
    assert "there is no volume 1" in reason(alone, volume=1)
    assert "a series of volumes has four dimensions" in reason(
        files.write_nifti(tmp_path / "five.nii", values.reshape(4, 5, 3, 2, 3), T)
    )


def test_where_the_file_does_not_say_how_the_patient_lies_it_is_said(tmp_path: Path) -> None:
    values = np.random.default_rng(0).normal(size=(4, 5, 6)).astype(np.float32)
    T = np.diag([2.0, 2.0, 2.0, 1.0])
    image = nibabel.Nifti1Image(values, None)
    image.set_sform(None, 0)
    image.set_qform(None, 0)
    nibabel.save(image, tmp_path / "none.nii.gz")
    nibabel.save(nibabel.AnalyzeImage(values, T), tmp_path / "analyze.img")
    mgh = bytearray(files.write_mgh(tmp_path / "none.mgh", values, T).read_bytes())
    mgh[28:30] = b"\0\0"
    (tmp_path / "none.mgh").write_bytes(mgh)
    bare = "NRRD0001\ntype: float\ndimension: 3\nsizes: 4 5 6\nencoding: raw\nendian: little\n{}\n"
    raw = values.tobytes(order="F")
    (tmp_path / "none.nrrd").write_bytes(bare.format("spacings: 2 2 2\n").encode() + raw)
    (tmp_path / "size.nrrd").write_bytes(bare.format("").encode() + raw)
    files.write_nrrd(tmp_path / "scanner.nrrd", values, T, space="scanner-xyz")
    (tmp_path / "none.mha").write_bytes(
        b"ObjectType = Image\nNDims = 3\nDimSize = 4 5 6\nElementSpacing = 2 2 2\n"
        b"ElementType = MET_FLOAT\nElementDataFile = LOCAL\n" + raw
    )
    for path in sorted(tmp_path.glob("[ans]*.[!h]*")):
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            read = volume.read(path)
        assert [str(one.message) for one in told] == [f"{path.name}: {x}" for x in read.notes]
        assert read.frame is None
        assert any("left and right are a guess" in note for note in read.notes)
        np.testing.assert_array_equal(read.values, values)
        assert any("1 mm is taken" in note for note in read.notes) == (path.stem == "size")
    both = nibabel.Nifti1Image(values, T)
    both.set_qform(np.diag([-2.0, 2, 2, 1]), 1)
    both.set_sform(T, 1)
    nibabel.save(both, tmp_path / "both.nii")
    with pytest.warns(UserWarning, match="disagree about left and right"):
        assert volume.read(tmp_path / "both.nii").frame == "RAS"


def test_small_files_that_expand_are_refused_by_their_headers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    T = np.eye(4)
    small = np.zeros((4, 4, 4), dtype=np.uint8)
    zeros = gzip.compress(bytes(50_000_000))  # 50 kB
    header = bytearray(files.write_nifti(tmp_path / "v.nii", small, T).read_bytes()[:352])

    def nifti(name: str, sizes: list[int], offset: float = 352.0) -> Path:
        header[40:56] = struct.pack("<8h", len(sizes), *sizes, *[1] * (7 - len(sizes)))
        header[108:112] = struct.pack("<f", offset)
        (tmp_path / name).write_bytes(gzip.compress(bytes(header)) + zeros)
        return tmp_path / name

    assert "more than the 400,000,000 allowed" in reason(nifti("a.nii.gz", [30000, 30000, 30000]))
    assert "more than the 4 GB allowed" in reason(
        nifti("b.nii.gz", [700, 700, 700, 1000]), volume=0
    )
    text = "NRRD0004\ntype: uchar\ndimension: 3\nsizes: {}\nencoding: gzip\n\n"
    (tmp_path / "c.nrrd").write_bytes(text.format("9000 9000 9000").encode() + zeros)
    assert "more than the 400,000,000 allowed" in reason(tmp_path / "c.nrrd")
    (tmp_path / "d.mha").write_bytes(
        b"ObjectType = Image\nNDims = 3\nDimSize = 99999 99999 99999\nCompressedData = True\n"
        b"ElementType = MET_UCHAR\nElementDataFile = LOCAL\n" + zeros
    )
    assert "more than the 400,000,000 allowed" in reason(tmp_path / "d.mha")
    # What is promised is counted, and what follows it is not inflated to its end.
    assert "it is cut off" in reason(nifti("e.nii.gz", [700, 700, 700]))
    inflated: list[int] = []

    def counted(*arguments: object) -> Iterator[bytes]:
        for piece in pieces(*arguments):
            inflated.append(len(piece))
            yield piece

    pieces = payload.chunks
    monkeypatch.setattr(payload, "chunks", counted)
    assert not volume.read(nifti("f.nii.gz", [4, 4, 4])).values.any()
    assert sum(inflated) < 20_000_000
    assert max(inflated) <= 1 << 20


def test_labels(tmp_path: Path) -> None:
    shape = (12, 12, 12)
    T = files.affine(np.eye(3), shape)
    labels = np.zeros(shape, dtype=np.uint8)
    labels[2:6, 2:10, 2:10] = 1
    labels[6:10, 2:10, 2:10] = 7
    extra = (
        "Segment0_ID:=Segment_1\nSegment0_LabelValue:=1\nSegment0_Layer:=0\n"
        "Segment0_Name:=Schläfenbein\nSegment1_LabelValue:=7\nSegment1_Layer:=0\n"
        "Segment1_Name:=Nervus facialis\nSegment2_LabelValue:=7\nSegment2_Layer:=1\n"
        "Segment2_Name:=another layer\n"
    )
    read = volume.read(files.write_nrrd(tmp_path / "v.seg.nrrd", labels, T, extra=extra))
    for label, low in ((1, 1.5), (7, 5.5)):
        vertices, faces = volume.surface(volume.one_label(read, label), volume.MIDDLE)
        mesh = trimesh.Trimesh(vertices * 1e3, faces, process=False)
        assert mesh.is_volume
        sides = np.array([mesh.bounds[0] - T[:3, 3], mesh.bounds[1] - T[:3, 3]])
        np.testing.assert_allclose(sides, [[low, 1.5, 1.5], [low + 4, 9.5, 9.5]], atol=1e-9)
    told = "1 Schläfenbein (256 voxels), 7 Nervus facialis (256 voxels)"
    assert told in volume.describe_values(read)
    with pytest.raises(meshes.MeshError) as caught:
        volume.one_label(read, 5)
    assert (
        f"v.seg.nrrd: no voxel has label 5: its values run from 0 to 7; as labels: {told}"
        in str(caught.value)
    )
    # The same in floating point, as many programs write it; an image has no labels.
    floating = volume.Volume(labels.astype(np.float32), read.T_world_voxel, "f")
    assert "1 (256 voxels), 7 (256 voxels)" in volume.describe_values(floating)
    image = volume.Volume(labels + np.float32(0.25), read.T_world_voxel, "image")
    assert volume.describe_values(image) == "its values run from 0.25 to 7.25"


def test_refusals_name_what_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shape = (8, 9, 10)
    T = files.affine(np.eye(3), shape)
    values = files.sphere(files.world_points(T, shape), 3.0)
    assert "no such file" in reason(tmp_path / "missing.nii")
    for name in ("text.nii", "text.mha", "text.nrrd", "text.mgz"):
        (tmp_path / name).write_text("Dear surgeon,\n" * 100)
        assert "does not begin as a file of its format" in reason(tmp_path / name)
    (tmp_path / "other.tif").write_text("x")
    assert "give a file (.nii, .nii.gz," in reason(tmp_path / "other.tif")
    (tmp_path / "alone.img").write_bytes(bytes(3000))
    assert "its header alone.hdr is not beside it" in reason(tmp_path / "alone.img")
    colour = np.zeros((4, 4, 4), dtype=[("R", "u1"), ("G", "u1"), ("B", "u1")])
    nibabel.save(nibabel.Nifti1Image(colour, np.eye(4)), tmp_path / "rgb.nii.gz")
    assert "colour image (red, green, blue)" in reason(tmp_path / "rgb.nii.gz")
    nibabel.save(nibabel.Nifti1Image(np.zeros((4, 4, 4), "c8"), np.eye(4)), tmp_path / "c.nii")
    assert "complex" in reason(tmp_path / "c.nii")
    layers = np.zeros((4, 4, 4, 3), dtype=np.uint8)
    kinds = "kinds: RGB-color domain domain domain\n"
    files.write_nrrd(tmp_path / "rgb.nrrd", layers, np.eye(4), extra=kinds, first_axis=True)
    assert "colour image" in reason(tmp_path / "rgb.nrrd")
    assert "not a volume" in reason(files.write_nifti(tmp_path / "s.nii", values[:, :, :1], T))
    flat = files.write_nrrd(tmp_path / "flat.nrrd", values, np.diag([1.0, 1.0, 0.0, 1.0]))
    assert "voxels are 1 × 1 × 0 mm" in reason(flat)
    skew = np.eye(4)
    skew[:3, 2] = skew[:3, 1]
    assert "two of its axes" in reason(files.write_nrrd(tmp_path / "skew.nrrd", values, skew))
    nhdr = files.write_nrrd(tmp_path / "v.nhdr", values, T)
    (tmp_path / "v.bin").unlink()
    assert "its voxels are in 'v.bin', which is not beside it" in reason(nhdr)
    # One bit turned in what is compressed: its checksum does not fit.
    turned = bytearray(files.write_nifti(tmp_path / "turned.nii.gz", values, T).read_bytes())
    turned[-6] ^= 1
    (tmp_path / "turned.nii.gz").write_bytes(turned)
    assert "is damaged" in reason(tmp_path / "turned.nii.gz")
    far = bytearray(files.write_nifti(tmp_path / "far.nii", values, T).read_bytes())
    far[108:112] = struct.pack("<f", 9e12)
    (tmp_path / "far.nii").write_bytes(far)
    assert "which is not there" in reason(tmp_path / "far.nii")
    strange = files.write_nrrd(tmp_path / "strange.nrrd", values, T).read_bytes()
    (tmp_path / "strange.nrrd").write_bytes(strange.replace(b"type: double", b"type: \r\x1b[2Jx"))
    assert all(letter.isprintable() for letter in reason(tmp_path / "strange.nrrd"))
    (tmp_path / "empty.nrrd").write_bytes(b"")
    assert reason(tmp_path / "empty.nrrd").endswith("is empty")
    files.write_nrrd(tmp_path / "skip.nrrd", values, T, extra="byte skip: -1\n")
    assert "cannot begin at byte -1" in reason(tmp_path / "skip.nrrd")

    def missing(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr(importlib, "import_module", missing)
    good = files.write_nifti(tmp_path / "good.nii", values, T)
    assert r"pip install 'vf-sandbox[volume]'" in reason(good)


def test_names_that_do_not_tell_and_units(tmp_path: Path) -> None:
    """Browsers unpack .nii.gz and keep the name; metres and microns are read as such."""
    shape = (5, 6, 7)
    T = files.affine(np.eye(3), shape)
    values = np.random.default_rng(0).normal(size=shape).astype(np.float32)
    plain = files.write_nifti(tmp_path / "v.nii", values, T).read_bytes()
    (tmp_path / "plain.nii.gz").write_bytes(plain)
    (tmp_path / "packed.nii").write_bytes(gzip.compress(plain[:900]) + gzip.compress(plain[900:]))
    for name in ("plain.nii.gz", "packed.nii"):
        np.testing.assert_array_equal(volume.read(tmp_path / name).values, values)
    in_metres = T.copy()
    in_metres[:3] *= 1e-3
    read = volume.read(files.write_nifti(tmp_path / "m.nii", values, in_metres, "meter"))
    np.testing.assert_allclose(read.T_world_voxel[:3], T[:3] * 1e-3, atol=1e-9)
    units = 'space units: "um" "um" "um"\n'
    read = volume.read(files.write_nrrd(tmp_path / "u.nrrd", values, T, extra=units))
    np.testing.assert_allclose(read.T_world_voxel[:3], T[:3] * 1e-6, atol=1e-12)
    stored = nibabel.Nifti1Image(np.arange(210, dtype=np.int16).reshape(shape), T)
    stored.header.set_slope_inter(0.5, -1000)
    nibabel.save(stored, tmp_path / "scaled.nii")
    np.testing.assert_array_equal(
        volume.read(tmp_path / "scaled.nii").values, np.arange(210).reshape(shape) * 0.5 - 1000
    )


@pytest.mark.parametrize("space", ["left-anterior-inferior", "RAI", "patient"])
def test_a_space_of_nrrd_that_is_not_understood_is_refused_by_name(
    tmp_path: Path, space: str
) -> None:
    head = (
        "NRRD0004\ntype: uchar\ndimension: 3\nsizes: 2 2 2\nencoding: raw\n"
        f"space: {space}\nspace directions: (1,0,0) (0,1,0) (0,0,1)\n\n"
    )
    path = tmp_path / "v.nrrd"
    path.write_bytes(head.encode() + bytes(8))
    with pytest.raises(meshes.MeshError, match=f"its space is '{space.lower()}': understood are"):
        volume.read(path)
    path.write_bytes(head.replace(space, "scanner-xyz").encode() + bytes(8))
    with pytest.warns(UserWarning, match="does not say how the patient lies"):
        assert volume.read(path).frame is None
