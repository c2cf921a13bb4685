"""Volumes of known shapes, written in every format by the formats' own descriptions."""

from __future__ import annotations

import bz2
import gzip
import zlib
from pathlib import Path

import nibabel
import numpy as np
import pydicom
import pytest
from pydicom.uid import CTImageStorage, EnhancedCTImageStorage, ExplicitVRLittleEndian
from scipy.spatial.transform import Rotation

import meshes
from meshes import volume

CENTRE = np.array([31.3, -12.7, 55.1])  # [mm], world
TURN = Rotation.from_euler("xyz", [25, -40, 70], degrees=True).as_matrix()
LPS = np.diag([-1.0, -1.0, 1.0, 1.0])

GRIDS = {
    "straight": np.eye(3),
    "left-handed": np.diag([-1.0, 1.0, 1.0]),
    "oblique": TURN,
    "oblique, left-handed": TURN @ np.diag([1.0, 1.0, -1.0]),
    "axes exchanged": np.eye(3)[[2, 0, 1]],
    "oblong voxels": TURN @ np.diag([0.8, 1.0, 1.25]),
    "sheared": np.array([[1.0, 0.2, 0.0], [0.0, 1.0, 0.15], [0.0, 0.0, 1.0]]),
}


def affine(linear: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """4 × 4 [mm] that brings the grid's middle to CENTRE."""
    T = np.eye(4)
    T[:3, :3] = linear
    T[:3, 3] = CENTRE - linear @ ((np.array(shape) - 1) / 2)
    return T


def world_points(T: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
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
    if values.dtype.kind == "f":
        values = values.astype(np.float32)
    image = nibabel.Nifti1Image(values, T)
    image.header.set_xyzt_units(unit)
    nibabel.save(image, path)
    return path


def write_mgh(path: Path, values: np.ndarray, T: np.ndarray) -> Path:
    nibabel.save(nibabel.MGHImage(values.astype(np.float32), T), path)
    return path


def write_nrrd(
    path: Path,
    values: np.ndarray,
    T: np.ndarray,
    *,
    encoding: str = "gzip",
    space: str = "left-posterior-superior",
    big: bool = False,
    extra: str = "",
    first_axis: bool = False,
) -> Path:
    """Three dimensions; or four, the series last, or first where ``first_axis`` says so."""
    signs = {"left-posterior-superior": LPS, "LAS": np.diag([-1.0, 1, 1, 1])}.get(space, np.eye(4))
    own = signs @ T
    vectors = ["(" + ",".join(f"{x:.17g}" for x in own[:3, axis]) + ")" for axis in range(3)]
    sizes = list(values.shape)
    if values.ndim == 4:
        vectors.insert(0 if first_axis else 3, "none")
        if first_axis:
            values = np.moveaxis(values, 3, 0)
            sizes = list(values.shape)
    values = values.astype(np.float64 if values.dtype.kind == "f" else values.dtype)
    names = {"float64": "double", "uint8": "uchar", "int16": "short", "uint32": "uint"}
    kind = names[values.dtype.name]
    raw = values.astype(values.dtype.newbyteorder(">" if big else "<")).tobytes(order="F")
    if encoding == "text":
        raw = " ".join(map(repr, values.ravel(order="F").tolist())).encode()
    packed = {"gzip": gzip.compress, "bzip2": bz2.compress}.get(encoding, bytes)(raw)
    origin = ",".join(f"{x:.17g}" for x in own[:3, 3])
    header = (
        f"NRRD0005\n# written by hand\ntype: {kind}\ndimension: {len(sizes)}\nspace: {space}\n"
        f"sizes: {' '.join(map(str, sizes))}\nspace directions: {' '.join(vectors)}\n"
        f"endian: {'big' if big else 'little'}\nencoding: {encoding}\n"
        f"space origin: ({origin})\n{extra}"
    )
    if path.suffix == ".nhdr":
        data = path.with_suffix(".bin")
        data.write_bytes(packed)
        path.write_text(header + f"data file: {data.name}\n")
    else:
        path.write_bytes(header.encode() + b"\n" + packed)
    return path


def write_metaimage(
    path: Path, values: np.ndarray, T: np.ndarray, *, compressed: bool = True, big: bool = False
) -> Path:
    own = LPS @ T
    spacing = np.linalg.norm(own[:3, :3], axis=0)
    n = values.ndim
    directions, origin, spacings = np.eye(n), np.zeros(n), np.ones(n)
    directions[:3, :3] = (own[:3, :3] / spacing).T  # one axis a row
    origin[:3], spacings[:3] = own[:3, 3], spacing
    values = values.astype(np.float64 if values.dtype.kind == "f" else values.dtype)
    kind = {"float64": "DOUBLE", "uint8": "UCHAR", "int16": "SHORT"}[values.dtype.name]
    raw = values.astype(values.dtype.newbyteorder(">" if big else "<")).tobytes(order="F")
    packed = zlib.compress(raw) if compressed else raw

    def text(numbers: np.ndarray) -> str:
        return " ".join(f"{x:.17g}" for x in numbers.ravel())

    data = path.with_suffix(".raw").name if path.suffix == ".mhd" else "LOCAL"
    header = (
        f"ObjectType = Image\nNDims = {n}\nBinaryData = True\n"
        f"BinaryDataByteOrderMSB = {big}\nCompressedData = {compressed}\n"
        f"TransformMatrix = {text(directions)}\nOffset = {text(origin)}\n"
        f"ElementSpacing = {text(spacings)}\nDimSize = {' '.join(map(str, values.shape))}\n"
        f"ElementType = MET_{kind}\nElementDataFile = {data}\n"
    )
    if data == "LOCAL":
        path.write_bytes(header.encode() + packed)
    else:
        path.write_text(header)
        (path.parent / data).write_bytes(packed)
    return path


def dicom_slices(
    values: np.ndarray, T_ras: np.ndarray, slope: float = 1.0, intercept: float = 0.0
) -> list[pydicom.Dataset]:
    """A data set a plane k of (i, j, k) values, by the standard."""
    T = LPS @ T_ras
    spacing = np.linalg.norm(T[:3, :3], axis=0)
    series = pydicom.uid.generate_uid(entropy_srcs=["series", str(T_ras.tobytes())])
    found = []
    for k in range(values.shape[2]):
        one = pydicom.Dataset()
        one.file_meta = pydicom.dataset.FileMetaDataset()
        one.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
        one.file_meta.MediaStorageSOPClassUID = one.SOPClassUID = CTImageStorage
        one.SOPInstanceUID = f"{series[:50]}.{k + 1}"
        one.file_meta.MediaStorageSOPInstanceUID = one.SOPInstanceUID
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
        one.PixelData = np.round((values[:, :, k].T - intercept) / slope).astype("<i2").tobytes()
        found.append(one)
    return found


def write_dicom(folder: Path, slices: list[pydicom.Dataset]) -> Path:
    """One file a slice, IM0000 and so on, in an order that says nothing."""
    folder.mkdir(exist_ok=True)
    for name, one in zip(
        np.random.default_rng(0).permutation(len(slices)).tolist(), slices, strict=True
    ):
        one.save_as(folder / f"IM{name:04d}", enforce_file_format=True)
    return folder


_COPIED = (
    "SeriesInstanceUID", "Modality", "Rows", "Columns", "SamplesPerPixel",
    "PhotometricInterpretation", "BitsAllocated", "BitsStored", "HighBit", "PixelRepresentation",
)  # fmt: skip


def enhanced(slices: list[pydicom.Dataset], shuffled: bool = True) -> pydicom.Dataset:
    """The same slices as the frames of one enhanced CT."""

    def item(**values: object) -> pydicom.Sequence:
        inner = pydicom.Dataset()
        for key, value in values.items():
            setattr(inner, key, value)
        return pydicom.Sequence([inner])

    order = list(range(len(slices)))
    if shuffled:
        order = np.random.default_rng(1).permutation(len(slices)).tolist()
    first = slices[0]
    one = pydicom.Dataset()
    one.file_meta = pydicom.dataset.FileMetaDataset()
    one.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    one.file_meta.MediaStorageSOPClassUID = one.SOPClassUID = EnhancedCTImageStorage
    one.file_meta.MediaStorageSOPInstanceUID = one.SOPInstanceUID = first.SOPInstanceUID
    for key in _COPIED:
        setattr(one, key, getattr(first, key))
    one.NumberOfFrames = len(slices)
    shared = pydicom.Dataset()
    shared.PixelMeasuresSequence = item(PixelSpacing=first.PixelSpacing)
    shared.PlaneOrientationSequence = item(ImageOrientationPatient=first.ImageOrientationPatient)
    one.SharedFunctionalGroupsSequence = pydicom.Sequence([shared])
    frames = []
    for k in order:
        frame = pydicom.Dataset()
        frame.PlanePositionSequence = item(ImagePositionPatient=slices[k].ImagePositionPatient)
        frame.PixelValueTransformationSequence = item(
            RescaleSlope=slices[k].RescaleSlope, RescaleIntercept=slices[k].RescaleIntercept
        )
        frames.append(frame)
    one.PerFrameFunctionalGroupsSequence = pydicom.Sequence(frames)
    one.PixelData = b"".join(slices[k].PixelData for k in order)
    return one


def reason(path: Path, **options: int) -> str:
    """The reason a volume is refused with: one line that begins with its path."""
    with pytest.raises(meshes.MeshError) as caught:
        volume.read(path, **options)
    text = str(caught.value)
    assert "\n" not in text
    assert text.startswith(str(path))
    return text
