"""Meshes from the data files of other installed packages; nothing is downloaded.

The packages themselves are not imported: nilearn takes seconds to import, and pymeshfix is under
the AGPL.
"""

from __future__ import annotations

import importlib.util
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.ndimage import zoom

from meshes import volume
from meshes.content import Arrays
from meshes.errors import MeshError

_MNI = "datasets/data/mni_icbm152_{}_tal_nlin_sym_09a_converted.nii.gz"
_PIAL = "datasets/data/fsaverage5/pial_{}.gii.gz"
BUNNY = "examples/StanfordBunny.ply"
_FINER = 1.75
"""Samples per voxel of the fine brain: a million triangles."""


def folder(package: str) -> Path | None:
    """The folder of an installed package, else None; runs none of its code."""
    spec = importlib.util.find_spec(package)
    return Path(spec.origin).parent if spec is not None and spec.origin else None


def release(package: str) -> str:
    """The package's version, "" if it is not known."""
    try:
        return version(package)
    except PackageNotFoundError:
        return ""


def has_nilearn() -> bool:
    """Whether nilearn's surfaces and nibabel, which reads them, are installed."""
    readers = importlib.util.find_spec("nibabel") is not None
    place = folder("nilearn")
    return readers and place is not None and (place / _PIAL.format("left")).is_file()


def has_bunny() -> bool:
    """Whether an installed package carries the Stanford bunny."""
    place = folder("pymeshfix")
    return place is not None and (place / BUNNY).is_file()


def cortex() -> Arrays:
    """Both hemispheres' pial surface of the average brain fsaverage5: two closed bodies.

    Vertices [m] in MNI305 axes: x to the right, y to the front, z up.
    """
    import nibabel

    sides = []
    for side in ("left", "right"):
        points, triangles = nibabel.load(file("nilearn", _PIAL.format(side))).agg_data()
        sides.append((np.asarray(points, np.float64) * 1e-3, np.asarray(triangles, np.int64)))
    (left, faces), (right, more) = sides
    return np.vstack([left, right]), np.vstack([faces, more + len(left)])


def brain() -> Arrays:
    """The outside of the MNI152 average brain, cerebellum included, at the template's 1 mm."""
    return _outside(_tissue())


def brain_fine() -> Arrays:
    """The same, interpolated linearly to `_FINER` samples per voxel before it is smoothed."""
    coarse = _tissue()
    finer = zoom(coarse.values, _FINER, order=1, grid_mode=True, mode="nearest")
    step = np.array(coarse.values.shape) / np.array(finer.shape)  # [voxel/sample]
    T_voxel_sample = np.diag([*step, 1.0])
    T_voxel_sample[:3, 3] = 0.5 * (step - 1.0)  # the outer faces of the grid coincide
    return _outside(volume.Volume(finer, coarse.T_world_voxel @ T_voxel_sample, coarse.name))


def bunny() -> Arrays:
    """The Stanford bunny as scanned: holes, non-manifold edges. Its y axis becomes z."""
    read = trimesh.load(file("pymeshfix", BUNNY), process=False)
    points = np.asarray(read.vertices, dtype=np.float64)
    standing = np.column_stack([points[:, 0], -points[:, 2], points[:, 1]])
    return standing * _scale(standing), np.asarray(read.faces, dtype=np.int64)


def _scale(points: NDArray[np.float64]) -> float:
    """The scale to the scanned size; copies of the bunny differ in unit."""
    return 0.1557 / float(np.ptp(points, axis=0).max())


def _tissue() -> volume.Volume:
    """Probability of grey or white matter in the MNI152 template."""
    grey, white = (volume.read(file("nilearn", _MNI.format(kind))) for kind in ("gm", "wm"))
    share = (grey.values.astype(np.float32) + white.values.astype(np.float32)) / np.float32(255.0)
    return volume.Volume(share, grey.T_world_voxel, "MNI152")


def _outside(tissue: volume.Volume) -> Arrays:
    # Smoothed by a voxel: the template is rounded to steps, and sulci narrower than that are noise.
    return volume.surface(tissue, 0.5, smooth=1e-3, largest=True)


def file(package: str, name: str) -> Path:
    place = folder(package)
    if place is None or not (place / name).is_file():
        raise MeshError(f"{package} {release(package)} carries no {name}")
    return place / name
