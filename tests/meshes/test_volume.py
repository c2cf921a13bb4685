"""Volumes of known shapes come out with their volume, where they are, the right way round."""

from __future__ import annotations

import importlib
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

import meshes
from app.__main__ import main
from meshes import volume

nibabel = pytest.importorskip("nibabel", reason="needs the extra 'volume'")
pydicom = pytest.importorskip("pydicom", reason="needs the extra 'volume'")
pytest.importorskip("skimage", reason="needs the extra 'volume'")

CENTRE = np.array([31.3, -12.7, 55.1])  # [mm], world
TURN = Rotation.from_euler("xyz", [25, -40, 70], degrees=True).as_matrix()


def affine(linear: np.ndarray, shape: tuple[int, int, int]) -> np.ndarray:
    """4 × 4 [mm] that brings the grid's middle to CENTRE."""
    T = np.eye(4)
    T[:3, :3] = linear
    T[:3, 3] = CENTRE - linear @ ((np.array(shape) - 1) / 2)
    return T


GRIDS = {
    "straight": np.eye(3),
    "left-handed": np.diag([-1.0, 1.0, 1.0]),
    "oblique": TURN,
    "oblique, left-handed": TURN @ np.diag([1.0, 1.0, -1.0]),
    "axes exchanged": np.eye(3)[[2, 0, 1]],
    "oblong voxels": TURN @ np.diag([0.8, 1.0, 1.25]),
    "sheared": np.array([[1.0, 0.2, 0.0], [0.0, 1.0, 0.15], [0.0, 0.0, 1.0]]),
}


def world_points(T: np.ndarray, shape: tuple[int, int, int]) -> np.ndarray:
    """World positions [mm] (i, j, k, 3) of the voxels, relative to CENTRE."""
    index = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1)
    return index @ T[:3, :3].T + T[:3, 3] - CENTRE


def sphere(p: np.ndarray, radius: float = 20.0) -> np.ndarray:
    """100 + the depth below the surface [mm]: level 100 is the sphere."""
    return 100.0 + radius - np.linalg.norm(p, axis=-1)


def torus(p: np.ndarray, ring: float = 20.0, radius: float = 8.0) -> np.ndarray:
    around = np.hypot(p[..., 0], p[..., 1]) - ring
    return 100.0 + radius - np.hypot(around, p[..., 2])


def write_nifti(path: Path, values: np.ndarray, T: np.ndarray, unit: str = "mm") -> Path:
    image = nibabel.Nifti1Image(values.astype(np.float32), T)
    image.header.set_xyzt_units(unit)
    nibabel.save(image, path)
    return path


@pytest.mark.parametrize("grid", GRIDS)
def test_nifti_sphere_and_torus(tmp_path: Path, grid: str) -> None:
    shape = (76, 74, 72)
    T = affine(GRIDS[grid], shape)
    p = world_points(T, shape)
    for field, exact, genus in (
        (sphere, 4 / 3 * np.pi * 20.0**3, 0),
        (torus, 2 * np.pi**2 * 20.0 * 8.0**2, 1),
    ):
        path = write_nifti(tmp_path / "v.nii.gz", field(p), T)
        vertices, faces = volume.surface(volume.read(path), 100.0)
        mesh = trimesh.Trimesh(vertices * 1e3, faces, process=False)
        assert mesh.is_volume
        assert mesh.volume == pytest.approx(exact, rel=0.01)  # positive: outwards
        assert mesh.euler_number == 2 - 2 * genus
        np.testing.assert_allclose(mesh.center_mass, CENTRE, atol=0.01)
        # Every vertex is on the shape, within the bend of a voxel's edge.
        assert np.abs(field(vertices * 1e3 - CENTRE) - 100.0).max() < 0.05


def test_a_plane_field_is_placed_exactly(tmp_path: Path) -> None:
    """A linear field has no interpolation error: the cut lies at its world coordinate."""
    shape = (12, 13, 14)
    T = affine(TURN @ np.diag([0.7, 1.0, -1.3]), shape)
    p = world_points(T, shape)
    path = write_nifti(tmp_path / "v.nii", p[..., 0] + CENTRE[0], T)
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


def write_dicom(
    folder: Path, values: np.ndarray, T_ras: np.ndarray, slope: float, intercept: float
) -> None:
    """One file a slice k of (i, j, k) values, in an order that says nothing, by the standard."""
    T = np.diag([-1.0, -1.0, 1.0, 1.0]) @ T_ras  # LPS
    folder.mkdir(exist_ok=True)
    spacing = np.linalg.norm(T[:3, :3], axis=0)
    names = np.random.default_rng(0).permutation(values.shape[2])
    series = f"1.2.826.0.1.3680043.8.498.{sum(folder.name.encode())}"
    for k in range(values.shape[2]):
        one = pydicom.dataset.Dataset()
        one.file_meta = pydicom.dataset.FileMetaDataset()
        one.file_meta.TransferSyntaxUID = pydicom.uid.ExplicitVRLittleEndian
        one.file_meta.MediaStorageSOPClassUID = pydicom.uid.CTImageStorage
        one.file_meta.MediaStorageSOPInstanceUID = f"{series}.{k + 1}"
        one.SOPClassUID, one.SOPInstanceUID = pydicom.uid.CTImageStorage, f"{series}.{k + 1}"
        one.SeriesInstanceUID = series
        one.Modality = "CT"
        one.Rows, one.Columns = values.shape[1], values.shape[0]
        one.PixelSpacing = [f"{spacing[1]:.6f}", f"{spacing[0]:.6f}"]  # between rows, columns
        one.ImageOrientationPatient = [
            f"{x:.9f}" for x in (*(T[:3, 0] / spacing[0]), *(T[:3, 1] / spacing[1]))
        ]
        one.ImagePositionPatient = [f"{x:.6f}" for x in (T @ [0, 0, k, 1])[:3]]
        one.SamplesPerPixel, one.PhotometricInterpretation = 1, "MONOCHROME2"
        one.BitsAllocated, one.BitsStored, one.HighBit, one.PixelRepresentation = 16, 16, 15, 1
        one.RescaleSlope, one.RescaleIntercept = slope, intercept
        stored = np.round((values[:, :, k].T - intercept) / slope).astype("<i2")
        one.PixelData = stored.tobytes()
        one.save_as(folder / f"IM{names[k]:04d}", enforce_file_format=True)


@pytest.mark.parametrize("grid", ["straight", "oblique", "oblong voxels", "left-handed"])
def test_dicom_is_placed_as_the_same_nifti(tmp_path: Path, grid: str) -> None:
    shape = (58, 52, 50)
    T = affine(GRIDS[grid], shape)
    values = 10 * torus(world_points(T, shape), 14.0, 6.0)
    write_dicom(tmp_path / "series", values, T, slope=0.5, intercept=-1024.0)
    (tmp_path / "series" / "notes.txt").write_text("nothing to see")
    read = volume.read(tmp_path / "series")
    vertices, faces = volume.surface(read, 1000.0)
    mesh = trimesh.Trimesh(vertices * 1e3, faces, process=False)
    assert mesh.is_volume
    assert mesh.volume == pytest.approx(2 * np.pi**2 * 14.0 * 36.0, rel=0.01)
    assert np.abs(torus(vertices * 1e3 - CENTRE, 14.0, 6.0) - 100.0).max() < 0.1


def test_units_smoothing_and_the_largest_piece(tmp_path: Path) -> None:
    shape = (60, 60, 60)
    T = affine(np.eye(3), shape)
    p = world_points(T, shape)
    both = np.maximum(sphere(p, 15.0), sphere(p - [22.0, 22.0, 22.0], 3.0))
    in_metres = T.copy()
    in_metres[:3] *= 1e-3
    read = volume.read(write_nifti(tmp_path / "m.nii", both, in_metres, "meter"))
    np.testing.assert_allclose(read.T_world_voxel[:3, 3], T[:3, 3] * 1e-3, atol=1e-9)
    vertices, faces = volume.surface(read, 100.0)
    assert meshes.health(vertices, faces, examine=0).components == 2
    vertices, faces = volume.surface(read, 100.0, largest=True)
    report = meshes.health(vertices, faces, examine=0)
    assert (report.components, report.count("unused vertices")) == (1, 0)
    assert report.volume == pytest.approx(4 / 3 * np.pi * 0.015**3, rel=0.01)
    rng = np.random.default_rng(3)
    noisy = volume.Volume(
        (both + rng.normal(size=both.shape)).astype(np.float32), read.T_world_voxel, "noisy"
    )
    rough = volume.surface(noisy, 100.0, largest=True)
    fine = volume.surface(noisy, 100.0, smooth=1.5e-3, largest=True)
    off = [
        np.abs(np.linalg.norm(v - CENTRE * 1e-3, axis=1) - 0.015).mean() for v, _ in (rough, fine)
    ]
    assert off[1] < 0.4 * off[0]


def test_a_body_across_the_border_is_closed_and_a_mask_has_no_flat_faces(tmp_path: Path) -> None:
    shape = (30, 30, 30)
    mask = (sphere(world_points(affine(np.eye(3), shape), shape), 18.0) > 100.0).astype(float)
    read = volume.Volume(mask.astype(np.float32), np.diag([1e-3, 1e-3, 1e-3, 1.0]), "mask")
    for level in (0.5, 1e-3):
        report = meshes.health(*volume.surface(read, level), examine=0)
        assert report.watertight
        assert report.volume > 0
    # Levels that voxels have exactly.
    stairs = volume.Volume(np.round(sphere(world_points(affine(np.eye(3), shape), shape), 10.0))
                           .astype(np.float32), read.T_world_voxel, "stairs")  # fmt: skip
    report = meshes.health(*volume.surface(stairs, 100.0), examine=0)
    assert report.watertight
    assert report.count("degenerate faces") == 0


def test_refusals_are_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def reason(path: Path) -> str:
        with pytest.raises(meshes.MeshError) as caught:
            volume.read(path)
        assert "\n" not in str(caught.value)
        assert path.name in str(caught.value)
        return str(caught.value)

    shape = (8, 9, 10)
    T = affine(np.eye(3), shape)
    values = sphere(world_points(T, shape), 3.0)
    assert "no such file" in reason(tmp_path / "missing.nii")
    (tmp_path / "text.nii").write_text("Dear surgeon,\n" * 100)
    assert "cannot be read" in reason(tmp_path / "text.nii")
    (tmp_path / "other.mha").write_text("x")
    assert "give a NIfTI file (.nii, .nii.gz) or a folder" in reason(tmp_path / "other.mha")
    whole = write_nifti(tmp_path / "cut.nii", values, T).read_bytes()
    (tmp_path / "cut.nii").write_bytes(whole[: len(whole) // 2])
    assert "cannot be read" in reason(tmp_path / "cut.nii")
    huge = bytearray(whole)
    huge[40:48] = np.array([3, 30000, 30000, 30000], dtype="<i2").tobytes()
    (tmp_path / "huge.nii").write_bytes(huge)
    assert "more than the 400,000,000 allowed" in reason(tmp_path / "huge.nii")
    assert "not one volume" in reason(
        write_nifti(tmp_path / "series.nii", np.stack([values, values], axis=-1), T)
    )
    assert "not finite" in reason(write_nifti(tmp_path / "nan.nii", values * np.nan, T))
    (tmp_path / "empty").mkdir()
    assert "0 DICOM slices" in reason(tmp_path / "empty")
    write_dicom(tmp_path / "gap", values, T, 1.0, 0.0)
    inner = np.random.default_rng(0).permutation(shape[2])[4]  # as write_dicom names it
    (tmp_path / "gap" / f"IM{inner:04d}").unlink()
    assert "not evenly spaced" in reason(tmp_path / "gap")
    write_dicom(tmp_path / "two", values, T, 1.0, 0.0)
    write_dicom(tmp_path / "more", values, T, 1.0, 0.0)
    for file in (tmp_path / "more").iterdir():
        file.rename(tmp_path / "two" / f"x{file.name}")
    assert "2 series" in reason(tmp_path / "two")
    read = volume.read(write_nifti(tmp_path / "good.nii", values, T))
    for level in (1e9, -1e9, np.nan):
        with pytest.raises(meshes.MeshError, match="level"):
            volume.surface(read, level)

    def missing(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr(importlib, "import_module", missing)
    assert r"pip install 'vf-sandbox[volume]'" in reason(tmp_path / "good.nii")


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shape = (50, 50, 50)
    T = affine(TURN @ np.diag([1.0, 1.0, -1.0]), shape)
    source = write_nifti(tmp_path / "v.nii.gz", sphere(world_points(T, shape), 18.0), T)
    out = tmp_path / "ball.stl"
    words = ["mesh", "from-volume", str(source), str(out), "--level", "100"]
    assert main([*words, "--smooth", "0.2mm", "--largest"]) == 0
    printed = capsys.readouterr().out
    assert "50 × 50 × 50 voxels of 1 × 1 × 1 mm" in printed
    mesh = trimesh.load(out)
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * 18.0**3, rel=0.01)
    np.testing.assert_allclose(mesh.center_mass, CENTRE, atol=0.01)
    assert main(words) == 2
    assert "exists already" in capsys.readouterr().err
    assert (
        main(["mesh", "from-volume", str(source), str(tmp_path / "x.ply"), "--level", "900"]) == 2
    )
    err = capsys.readouterr().err
    assert "no surface at level 900: its values run from" in err
    assert err.count("\n") == 1
    assert not (tmp_path / "x.ply").exists()
