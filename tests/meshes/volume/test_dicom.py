"""DICOM series: placed as the same NIfTI, whole or refused, resampled where spacings differ."""

from __future__ import annotations

import copy
import warnings
from pathlib import Path

import gdcm
import numpy as np
import pydicom
import pytest
import trimesh

from meshes import volume
from tests.support import volume_files as files
from tests.support.volume_files import reason


def ball(shape: tuple[int, int, int] = (9, 8, 7)) -> tuple[np.ndarray, np.ndarray]:
    T = files.affine(np.diag([0.8, 1.0, 1.5]), shape)
    return np.round(10 * files.sphere(files.world_points(T, shape), 3.0)), T


@pytest.mark.parametrize("grid", ["straight", "oblique", "oblong voxels", "left-handed"])
@pytest.mark.parametrize("frames", ["slices", "frames"])
def test_a_series_is_placed_as_the_same_nifti(tmp_path: Path, grid: str, frames: str) -> None:
    shape = (58, 52, 50)
    T = files.affine(files.GRIDS[grid], shape)
    values = 10 * files.torus(files.world_points(T, shape), 14.0, 6.0)
    slices = files.dicom_slices(values, T, slope=0.5, intercept=-1024.0)
    if frames == "slices":
        path = files.write_dicom(tmp_path / "series", slices)
        (path / "notes.txt").write_text("nothing to see")
    else:
        path = tmp_path / "enhanced.dcm"
        files.enhanced(slices).save_as(path, enforce_file_format=True)
    read = volume.read(path)
    assert (read.frame, read.notes) == ("RAS", ())
    vertices, faces = volume.surface(read, 1000.0)
    mesh = trimesh.Trimesh(vertices * 1e3, faces, process=False)
    assert mesh.is_volume
    assert mesh.volume == pytest.approx(2 * np.pi**2 * 14.0 * 36.0, rel=0.01)
    assert np.abs(files.torus(vertices * 1e3 - files.CENTRE, 14.0, 6.0) - 100.0).max() < 0.1


def test_each_slice_and_frame_has_its_own_rescale(tmp_path: Path) -> None:
    values, T = ball()
    slices = files.dicom_slices(values, T)
    for k, one in enumerate(slices):
        one.RescaleSlope, one.RescaleIntercept = 1 + k, -k
    wanted = values * (1 + np.arange(7)) - np.arange(7)
    read = volume.read(files.write_dicom(tmp_path / "series", slices))
    # The last index of the grid runs along the slices' normal.
    np.testing.assert_array_equal(np.sort(read.values, axis=2), np.sort(wanted, axis=2))
    files.enhanced(slices).save_as(tmp_path / "e.dcm", enforce_file_format=True)
    np.testing.assert_array_equal(volume.read(tmp_path / "e.dcm").values, read.values)


@pytest.mark.parametrize("which", [0, 3, 6])
@pytest.mark.parametrize("kind", ["slices", "compressed"])
def test_a_slice_cut_anywhere_is_refused(tmp_path: Path, which: int, kind: str) -> None:
    """Also the first and the last: without them the anatomy would end early."""
    values, T = ball()
    path = files.write_dicom(tmp_path / "series", files.dicom_slices(values, T))
    if kind == "compressed":
        compress(path, gdcm.TransferSyntax.JPEGLosslessProcess14_1)
    one = sorted(path.iterdir())[which]
    whole = one.read_bytes()
    # The last four bytes of a compressed one follow the mark of its end.
    end = len(whole) - 4 * (kind == "compressed")
    for size in (*range(0, 500, 3), *range(500, end, 23), end - 2, end - 1):
        one.write_bytes(whole[:size])
        assert one.name in reason(path)
    one.write_bytes(whole)
    assert volume.read(path).values.shape == values.shape
    one.write_bytes(bytes(len(whole)))
    assert f"{one.name} is damaged" in reason(path)


def test_an_enhanced_file_cut_anywhere_is_refused(tmp_path: Path) -> None:
    values, T = ball()
    path = tmp_path / "e.dcm"
    files.enhanced(files.dicom_slices(values, T)).save_as(path, enforce_file_format=True)
    whole = path.read_bytes()
    for size in (*range(0, len(whole), 31), len(whole) - 2, len(whole) - 1):
        path.write_bytes(whole[:size])
        reason(path)


def compress(folder: Path, syntax: int) -> None:
    for file in folder.iterdir():
        reader, change, writer = gdcm.ImageReader(), gdcm.ImageChangeTransferSyntax(), None
        reader.SetFileName(str(file))
        assert reader.Read()
        change.SetTransferSyntax(gdcm.TransferSyntax(syntax))
        change.SetInput(reader.GetImage())
        assert change.Change()
        writer = gdcm.ImageWriter()
        writer.SetFileName(str(file))
        writer.SetFile(reader.GetFile())
        writer.SetImage(change.GetOutput())
        assert writer.Write()


@pytest.mark.parametrize(
    ("name", "uid"),
    [
        ("JPEGLosslessProcess14_1", "1.2.840.10008.1.2.4.70"),
        ("JPEGLosslessProcess14", "1.2.840.10008.1.2.4.57"),
        ("JPEGLSLossless", "1.2.840.10008.1.2.4.80"),
        ("JPEG2000Lossless", "1.2.840.10008.1.2.4.90"),
        ("RLELossless", "1.2.840.10008.1.2.5"),
    ],
)
def test_compressed_series_are_read(tmp_path: Path, name: str, uid: str) -> None:
    values, T = ball((24, 20, 4))
    slices = files.dicom_slices(values - 1100, T, intercept=-1024.0)
    plain = volume.read(files.write_dicom(tmp_path / "plain", slices))
    folder = files.write_dicom(tmp_path / "packed", slices)
    compress(folder, getattr(gdcm.TransferSyntax, name))
    assert pydicom.dcmread(folder / "IM0000").file_meta.TransferSyntaxUID == uid
    np.testing.assert_array_equal(volume.read(folder).values, plain.values)


def test_one_of_the_time_points_of_an_enhanced_file(tmp_path: Path) -> None:
    """Told apart by the file's dimensions, in whatever order the frames stand."""
    values, T = ball()
    both = files.dicom_slices(values, T) + files.dicom_slices(values + 50, T)
    order = np.random.default_rng(2).permutation(len(both)).tolist()
    one = files.enhanced([both[k] for k in order], shuffled=False)
    pointers = ("StackID", "InStackPositionNumber", "TemporalPositionIndex")
    one.DimensionIndexSequence = pydicom.Sequence([pydicom.Dataset() for _ in pointers])
    for item, name in zip(one.DimensionIndexSequence, pointers, strict=True):
        item.DimensionIndexPointer = pydicom.datadict.tag_for_keyword(name)
    for frame, k in zip(one.PerFrameFunctionalGroupsSequence, order, strict=True):
        content = pydicom.Dataset()
        content.DimensionIndexValues = [1, k % 7 + 1, k // 7 + 1]
        frame.FrameContentSequence = pydicom.Sequence([content])
    path = tmp_path / "e.dcm"
    one.save_as(path, enforce_file_format=True)
    assert "holds 2 volumes (time points, echoes or phases): choose one of 0 to 1" in reason(path)
    plain = volume.read(files.write_dicom(tmp_path / "plain", files.dicom_slices(values, T)))
    for k in range(2):
        np.testing.assert_array_equal(volume.read(path, volume=k).values, plain.values + 50 * k)
    del one.DimensionIndexSequence
    one.save_as(path, enforce_file_format=True)
    assert "lie in the same place" in reason(path)


def at_heights(heights: np.ndarray, tilt: float = 0.0) -> list[pydicom.Dataset]:
    """Slices of a ball of 15 mm around (0, 0, 30) LPS, shifted by ``tilt`` of their height."""
    x, y = np.arange(40.0) - 20.0, np.arange(40.0) - 20.0
    slices = files.dicom_slices(np.zeros((40, 40, len(heights))), np.eye(4))
    for one, z in zip(slices, heights, strict=True):
        one.ImageOrientationPatient = [1, 0, 0, 0, 1, 0]
        one.ImagePositionPatient = [-20.0, f"{-20.0 + tilt * (z - 30.0):.4f}", f"{z:.4f}"]
        distance = np.sqrt(x[None] ** 2 + (y[:, None] + tilt * (z - 30.0)) ** 2 + (z - 30.0) ** 2)
        one.PixelData = np.round(100 * (15.0 - distance)).astype("<i2").tobytes()
    return slices


@pytest.mark.parametrize("tilt", [0.0, 0.3])
def test_two_spacings_are_resampled_and_said(tmp_path: Path, tilt: float) -> None:
    """Fine through the base and coarse above; also with a tilted gantry, and jittering."""
    heights = np.r_[np.arange(8, 30, 2.0), np.arange(30, 60, 3.0)]
    for name, at in (
        ("two", heights),
        ("jitter", heights + np.random.default_rng(0).uniform(-0.15, 0.15, len(heights))),
    ):
        folder = files.write_dicom(tmp_path / name, at_heights(at, tilt))
        with pytest.warns(UserWarning, match="resampled to planes every"):
            read = volume.read(folder)
        assert "mm apart along their normal: resampled" in read.notes[0]
        vertices, faces = volume.surface(read, 0.0)
        mesh = trimesh.Trimesh(vertices * 1e3, faces, process=False)
        assert mesh.is_volume
        # RAS: x and y turned. Between slices 3 mm apart a sphere is a polygon.
        off = np.linalg.norm(vertices * 1e3 - [0.0, 0.0, 30.0], axis=1) - 15.0
        assert np.abs(off).max() < 0.5
        assert mesh.volume == pytest.approx(4 / 3 * np.pi * 15**3, rel=0.03)


def test_gaps_and_repetitions_are_refused_as_what_they_are(tmp_path: Path) -> None:
    two = np.r_[np.arange(10, 30, 2.0), np.arange(30, 60, 3.0)]
    every = np.arange(10, 50, 2.0)
    for n, heights in enumerate(
        (
            np.delete(every, 5),
            np.delete(every, [5, 6]),
            np.delete(every, 1),
            np.delete(every, -2),
            np.delete(every, [4, 12]),
            np.delete(every, [5, 7, 9]),
            np.delete(two, 4),
            np.delete(two, 15),
        )
    ):
        folder = files.write_dicom(tmp_path / f"gap{n}", at_heights(heights))
        said = reason(folder)
        assert "slices are missing: IM" in said
        assert "mm apart, the slices beside them" in said
    twice = at_heights(np.r_[every, every])
    assert "lie in the same place" in reason(files.write_dicom(tmp_path / "twice", twice))
    shifted = at_heights(every)
    shifted[7].ImagePositionPatient = [-17.0, -20.0, shifted[7].ImagePositionPatient[2]]
    assert "shifted sideways" in reason(files.write_dicom(tmp_path / "shifted", shifted))
    turned = at_heights(every)
    turned[7].ImageOrientationPatient = [1, 0, 0, 0, 0.6, 0.8]
    assert "differs from" in reason(files.write_dicom(tmp_path / "turned", turned))


def test_what_is_in_a_folder_beside_the_series(tmp_path: Path) -> None:
    values, T = ball()
    slices = files.dicom_slices(values, T)
    folder = files.write_dicom(tmp_path / "series", slices)
    plain = volume.read(folder)
    (folder / "README").write_text("Patient: anonymous\n")
    (folder / ".DS_Store").write_bytes(bytes(range(256)))
    (folder / "Thumbs.db").write_bytes(b"\xd0\xcf\x11\xe0" + bytes(50))
    (folder / "preview").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(50))
    report = copy.deepcopy(slices[0])
    for key in ("PixelData", "Rows", "Columns", "ImagePositionPatient"):
        delattr(report, key)
    report.SOPClassUID = report.file_meta.MediaStorageSOPClassUID = pydicom.uid.BasicTextSRStorage
    report.save_as(folder / "SR0001", enforce_file_format=True)
    (folder / "other").mkdir()
    np.testing.assert_array_equal(volume.read(folder).values, plain.values)
    scout = copy.deepcopy(slices[0])
    scout.ImageType = ["ORIGINAL", "PRIMARY", "LOCALIZER"]
    scout.SeriesInstanceUID = "1.2.3"
    scout.save_as(folder / "IM9999", enforce_file_format=True)
    with pytest.warns(UserWarning, match="without a position or localizers: 1"):
        assert volume.read(folder).values.shape == plain.values.shape
    # Files without preamble, as old archives hold them.
    bare = tmp_path / "bare"
    bare.mkdir()
    for n, one in enumerate(slices):
        one.file_meta.TransferSyntaxUID = pydicom.uid.ImplicitVRLittleEndian
        one.save_as(bare / f"{n}", enforce_file_format=True)
        content = (bare / f"{n}").read_bytes()
        (bare / f"{n}").write_bytes(content[content.index(b"\x08\0\x16\0") :])
    np.testing.assert_array_equal(volume.read(bare).values, plain.values)


def test_refusals_name_what_it_is(tmp_path: Path) -> None:
    values, T = ball()
    slices = files.dicom_slices(values, T)
    (tmp_path / "empty").mkdir()
    assert "0 DICOM slices" in reason(tmp_path / "empty")
    folder = files.write_dicom(tmp_path / "series", slices)
    assert "give one of the folders in it" in reason(tmp_path)
    assert "it is a single slice: give the folder" in reason(folder / "IM0000")
    other = copy.deepcopy(slices[0])
    other.SeriesInstanceUID, other.SeriesDescription = "1.2.3", "Bone 0.6"
    other.save_as(folder / "IM9999", enforce_file_format=True)
    assert "2 series in one folder (unnamed: 7, Bone 0.6: 1)" in reason(folder)
    (folder / "IM9999").unlink()
    assert "there is no volume 1" in reason(folder, volume=1)
    mosaic = files.dicom_slices(values, T)
    for one in mosaic:
        one.ImageType = ["ORIGINAL", "PRIMARY", "M", "ND", "MOSAIC"]
    assert "all slices in one picture" in reason(files.write_dicom(tmp_path / "mosaic", mosaic))
    one = files.dicom_slices(values, T)[0]
    del one.ImagePositionPatient
    one.save_as(tmp_path / "placeless.dcm", enforce_file_format=True)
    assert "no DICOM slice with pixels and a position but CT Image" in reason(
        tmp_path / "placeless.dcm"
    )
    colour = files.dicom_slices(values, T)
    for one in colour:
        one.SamplesPerPixel, one.PhotometricInterpretation, one.PlanarConfiguration = 3, "RGB", 0
    assert "colour image" in reason(files.write_dicom(tmp_path / "rgb", colour))
    cine = files.dicom_slices(values, T)[0]
    cine.NumberOfFrames = 3
    del cine.ImagePositionPatient
    cine.save_as(tmp_path / "cine.dcm", enforce_file_format=True)
    assert "gives its frames no positions" in reason(tmp_path / "cine.dcm")
    fewer = files.enhanced(slices)
    fewer.NumberOfFrames = 9
    fewer.save_as(tmp_path / "fewer.dcm", enforce_file_format=True)
    assert "promises 9 frames and describes 7" in reason(tmp_path / "fewer.dcm")
    unknown = files.write_dicom(tmp_path / "mpeg", slices)
    for file in unknown.iterdir():
        content = file.read_bytes()
        file.write_bytes(content.replace(b"1.2.840.10008.1.2.1\0", b"1.2.840.10008.1.2.9\0"))
    reason(unknown)
    for one in slices:
        one.ImagesInAcquisition = 12
    with pytest.warns(UserWarning, match="says that it has 12 images; 7 are here"):
        volume.read(files.write_dicom(tmp_path / "part", slices))


def test_nothing_is_warned_of_that_is_not_told(tmp_path: Path) -> None:
    values, T = ball()
    slices = files.dicom_slices(values, T)
    slices[0].PatientBirthDate = "19600101"
    folder = files.write_dicom(tmp_path / "series", slices)
    one = next(file for file in folder.iterdir() if b"19600101" in file.read_bytes())
    one.write_bytes(one.read_bytes().replace(b"19600101", b"1960-x-1"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        volume.read(folder)
