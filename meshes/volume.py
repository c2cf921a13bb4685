"""From a CT or MR volume to a surface: NIfTI files and DICOM folders, by marching cubes.

World coordinates are those of the file: NIfTI's are RAS (x to the patient's right, y to the front,
z up), DICOM's are LPS and are turned to RAS here, so that the same patient lies the same way
whichever file it came in. Files are in millimetres; what comes out is in metres.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from meshes.errors import MeshError
from meshes.shapes import Arrays
from meshes.topology import topology

FloatArray = NDArray[np.float64]

MOST_VOXELS = 400_000_000  # some 1.6 GB in single precision, and marching cubes takes more
_NIFTI = (".nii", ".nii.gz")
_EVEN = 0.02  # share of the spacing by which a slice may be off: positions are rounded


@dataclass(frozen=True)
class Volume:
    """A scalar field on a grid.

    Attributes:
        values: ``(i, j, k)`` float32; finite.
        T_world_voxel: ``(4, 4)`` from indices (at voxels' centres) to world coordinates [m], RAS.
        name: for the reader.
    """

    values: NDArray[np.float32]
    T_world_voxel: FloatArray
    name: str


def read(path: str | os.PathLike[str], progress: Callable[[str], None] | None = None) -> Volume:
    """A NIfTI file (.nii, .nii.gz) or a folder with the slices of one DICOM series.

    Raises:
        MeshError: not there, not readable, not one three-dimensional volume, or the libraries of
            the extra ``volume`` are not installed; in one line.
    """
    say = progress or (lambda _stage: None)
    file = Path(path)
    try:
        if not file.exists():
            raise MeshError("there is no such file or folder")
        say("reading the volume")
        if file.is_dir():
            values, T = _dicom(file, _library("pydicom"))
        elif file.name.lower().endswith(_NIFTI):
            values, T = _nifti(file, _library("nibabel"))
        else:
            raise MeshError(f"give a NIfTI file ({', '.join(_NIFTI)}) or a folder of DICOM slices")
        return _checked(values, T, file.name)
    except MeshError as error:
        raise MeshError(f"{file}: {error}") from None
    # Whatever a damaged file makes the readers raise, the file is what is wrong.
    except Exception as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise MeshError(f"{file}: cannot be read as a volume ({reason})") from error


def surface(
    volume: Volume,
    level: float,
    *,
    smooth: float = 0.0,
    largest: bool = False,
    progress: Callable[[str], None] | None = None,
) -> Arrays:
    """The surface where the values pass ``level``: vertices ``(n, 3)`` [m], world, and faces.

    Closed (what reaches the volume's border is cut flat within a voxel of it) and wound outwards:
    normals point from values above the level to values below. Marching cubes of Lewiner et al.

    Args:
        smooth: standard deviation of a Gaussian before it [m]; better than decimating after.
        largest: keep only the piece with the largest bounding box.

    Raises:
        MeshError: the level lies outside the volume's values, or scikit-image is not installed.
    """
    say = progress or (lambda _stage: None)
    if not (np.isfinite(level) and np.isfinite(smooth) and smooth >= 0.0):
        raise MeshError(f"level must be finite and smooth zero or more, not {level} and {smooth}")
    measure = _library("skimage.measure")
    low, high = float(volume.values.min()), float(volume.values.max())
    if not low < level < high:
        raise MeshError(
            f"{volume.name}: no surface at level {level:g}: its values run from {low:g} to {high:g}"
        )
    values = volume.values
    if smooth:
        say("smoothing")
        spacing = np.linalg.norm(volume.T_world_voxel[:3, :3], axis=0)  # [m/voxel]
        values = gaussian_filter(values, smooth / spacing)
        if not values.min() < level < values.max():
            raise MeshError(f"{volume.name}: nothing of level {level:g} is left after smoothing")
    say("marching cubes")
    # A value that is exactly the level makes faces without area.
    threshold = np.float32(level)
    while (values == threshold).any():
        threshold = np.nextafter(threshold, np.float32(np.inf))
    padded = np.pad(values, 1, constant_values=min(low, float(values.min())))
    points, faces, _normals, _values = measure.marching_cubes(
        padded, float(threshold), allow_degenerate=False
    )
    points = points.astype(np.float64) - 1.0
    vertices = points @ volume.T_world_voxel[:3, :3].T + volume.T_world_voxel[:3, 3]
    triangles = np.ascontiguousarray(faces, dtype=np.int64)
    # All around is below the level, so that the whole has positive volume if it looks outwards.
    # Measured, because the library's word for it and mirrored grids turn it in turn.
    a, b, c = (vertices - vertices.mean(axis=0))[triangles].transpose(1, 0, 2)
    if np.einsum("ij,ij->", a, np.cross(b, c)) < 0.0:
        triangles = np.ascontiguousarray(triangles[:, ::-1])
    if largest:
        say("largest piece")
        triangles = _largest(vertices, triangles)
    used = np.zeros(len(vertices), dtype=bool)
    used[triangles] = True
    return vertices[used], (np.cumsum(used) - 1)[triangles]


def _largest(vertices: FloatArray, faces: NDArray[np.int64]) -> NDArray[np.int64]:
    component = topology(faces, len(vertices)).components
    count = int(component.max()) + 1
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, component, vertices[faces].min(axis=1))
    np.maximum.at(high, component, vertices[faces].max(axis=1))
    return faces[component == int(np.linalg.norm(high - low, axis=1).argmax())]


def _library(name: str) -> ModuleType:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise MeshError(
            f"{name.partition('.')[0]} is not installed: volumes need the extra 'volume' "
            "(pip install 'vf-sandbox[volume]')"
        ) from error


def _checked(values: NDArray[Any], T_mm: FloatArray, name: str) -> Volume:
    if values.ndim != 3 or min(values.shape) < 2:
        raise MeshError(f"its shape is {values.shape}, not a volume of three dimensions")
    if values.size > MOST_VOXELS:
        raise MeshError(f"{values.size:,} voxels are more than the {MOST_VOXELS:,} allowed")
    if not np.isfinite(values).all():
        raise MeshError(f"{int((~np.isfinite(values)).sum()):,} voxels are not finite")
    T = np.array(T_mm, dtype=np.float64)
    T[:3] *= 1e-3  # [mm] -> [m]
    if not np.isfinite(T).all() or abs(np.linalg.det(T[:3, :3])) < 1e-18:
        raise MeshError("its grid has no volume: the affine is singular or not finite")
    return Volume(np.ascontiguousarray(values, dtype=np.float32), T, name)


def _nifti(file: Path, nibabel: ModuleType) -> tuple[NDArray[Any], FloatArray]:
    image = nibabel.load(file)
    shape = image.shape
    while len(shape) > 3 and shape[-1] == 1:
        shape = shape[:-1]
    if len(shape) != 3:
        raise MeshError(f"its shape is {image.shape}, not one volume: take one out of the series")
    # Before the values are read: the header may claim anything.
    if int(np.prod(shape, dtype=np.float64)) > MOST_VOXELS:
        raise MeshError(f"{image.shape} voxels are more than the {MOST_VOXELS:,} allowed")
    # "unknown" is millimetres in practice.
    scale = {"meter": 1e3, "micron": 1e-3}.get(image.header.get_xyzt_units()[0], 1.0)
    T = np.array(image.affine, dtype=np.float64)
    T[:3] *= scale
    return np.asarray(image.get_fdata(dtype=np.float32)).reshape(shape), T


def _dicom(folder: Path, pydicom: ModuleType) -> tuple[NDArray[Any], FloatArray]:
    """Slices sorted along their normal, rescaled; LPS turned to RAS."""
    slices = []
    for file in sorted(folder.iterdir()):
        if not file.is_file():
            continue
        try:
            slices.append(pydicom.dcmread(file))
        except pydicom.errors.InvalidDicomError:
            continue  # notes, previews
    slices = [one for one in slices if "PixelData" in one and "ImagePositionPatient" in one]
    if len(slices) < 2:
        raise MeshError(f"{len(slices)} DICOM slices with pixels and a position; two are needed")
    series = {str(getattr(one, "SeriesInstanceUID", "")) for one in slices}
    if len(series) > 1:
        raise MeshError(f"{len(series)} series in one folder: give a folder with one of them")
    first = slices[0]
    across, down = np.reshape(np.asarray(first.ImageOrientationPatient, dtype=np.float64), (2, 3))
    row_spacing, column_spacing = (float(value) for value in first.PixelSpacing)  # [mm]
    for one in slices:
        if (one.Rows, one.Columns) != (first.Rows, first.Columns) or not np.allclose(
            np.asarray(one.ImageOrientationPatient, dtype=np.float64), [*across, *down], atol=1e-4
        ):
            raise MeshError("its slices differ in size or orientation")
    if first.Rows * first.Columns * len(slices) > MOST_VOXELS:
        raise MeshError(f"more than the {MOST_VOXELS:,} voxels allowed")
    positions = np.array([one.ImagePositionPatient for one in slices], dtype=np.float64)
    height = positions @ np.cross(across, down)
    order = np.argsort(height)
    steps = np.diff(height[order])
    step = float(np.median(steps))
    if not (step > 0.0 and (abs(steps - step) <= _EVEN * step).all()):
        raise MeshError(
            f"its slices are not evenly spaced ({steps.min():.4g} … {steps.max():.4g} mm): "
            "some are missing or repeated"
        )
    start, end = positions[order[0]], positions[order[-1]]
    T_lps = np.eye(4)
    T_lps[:3, 0] = across * column_spacing  # index i runs along a row
    T_lps[:3, 1] = down * row_spacing
    # From the positions themselves: a tilted gantry shears the grid.
    T_lps[:3, 2] = (end - start) / (len(slices) - 1)
    T_lps[:3, 3] = start
    planes = [
        slices[k].pixel_array.astype(np.float32) * np.float32(getattr(slices[k], "RescaleSlope", 1))
        + np.float32(getattr(slices[k], "RescaleIntercept", 0))
        for k in order
    ]
    if any(plane.ndim != 2 for plane in planes):
        raise MeshError("its slices are not single grey images")
    # (slice, row, column) -> (column, row, slice)
    return np.stack(planes).transpose(2, 1, 0), np.diag([-1.0, -1.0, 1.0, 1.0]) @ T_lps
