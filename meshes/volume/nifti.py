"""NIfTI, Analyze and FreeSurfer MGH volumes; nibabel parses the headers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from meshes.errors import MeshError
from meshes.volume.grid import GUESS, FloatArray, Stored, library, one_of, scaled
from meshes.volume.payload import compression, head, voxels

_SINGLE = (b"n+1\0", b"n+2\0")
_PAIR = (b"ni1\0", b"ni2\0")
_MM = {"meter": 1e3, "micron": 1e-3}  # others, "unknown" included: millimetres
_MGH_DATA = 284  # offset of the voxels


def is_nifti(start: bytes) -> bool:
    """Whether the first bytes are those of a NIfTI header, or of an Analyze header."""
    return any(int.from_bytes(start[:4], order) in (348, 540) for order in ("little", "big"))


def is_mgh(start: bytes) -> bool:
    """Whether the first bytes are those of FreeSurfer's MGH: version 1 and positive sizes."""
    sizes = np.frombuffer(start[4:20].ljust(16, b"\0"), dtype=">i4")
    return start[:4] == b"\0\0\0\1" and bool((sizes > 0).all())


def read(file: Path, volume: int | None) -> Stored:
    """A .nii file, or either file of a .hdr and .img pair; gzipped or not.

    Raises:
        MeshError: in one line.
    """
    headers, image = _files(file)
    start = head(headers, 540)
    if len(start) < 348 or not is_nifti(start):
        raise MeshError(f"{headers.name} does not begin with a NIfTI or Analyze header")
    nibabel = library("nibabel")
    second = start[4:8] in (*_SINGLE[1:], *_PAIR[1:])
    magic = start[4:8] if second else start[344:348]
    kind: Any = nibabel.Spm2AnalyzeImage.header_class
    if magic in (*_SINGLE, *_PAIR):
        kind = nibabel.Nifti2Header if second else nibabel.Nifti1Header
    if second and len(start) < 540:
        raise MeshError("it is cut off in its header")
    header = kind(start[: 540 if second else 348], check=False)
    code = int(header["datatype"])
    try:
        dtype = header.get_data_dtype()
    except KeyError:
        raise MeshError(f"its header names data of type {code}, which NIfTI has not") from None
    if dtype.fields is not None:
        raise MeshError("it is a colour image (red, green, blue): a level needs one value a voxel")
    if dtype.kind == "c":
        raise MeshError("its values are complex: write their magnitude into a file first")
    if dtype.kind not in "iuf":
        raise MeshError(f"its voxels are of a type ({code}) that is not read: store bytes instead")
    shape = header.get_data_shape()
    volumes = _volumes(shape)
    single = magic in _SINGLE
    offset = int(header.get_data_offset())
    if offset < (len(start[:540]) if second else 348) * single:
        offset = 544 if second else 352  # zero in some files: directly after the header
    if image == headers and not single:
        raise MeshError("its voxels are in another file (.img), which is not beside it")
    values = voxels(
        image,
        0,
        dtype,
        shape[:3],
        packed=compression(image),
        skip=offset,
        volumes=volumes,
        volume=one_of(volumes, volume, "volumes"),
    )
    slope, intercept = header.get_slope_inter()
    values = scaled(values, 1.0 if slope is None else slope, intercept or 0.0)
    T = np.array(header.get_best_affine(), dtype=np.float64)
    if magic not in (*_SINGLE, *_PAIR):
        return Stored(values, T, None, (GUESS.format("an Analyze file"),))
    T[:3] *= _MM.get(header.get_xyzt_units()[0], 1.0)
    qform, sform = int(header["qform_code"]) > 0, int(header["sform_code"]) > 0
    if not (qform or sform):
        return Stored(values, T, None, (GUESS.format("the file has neither qform nor sform; it"),))
    notes: tuple[str, ...] = ()
    if qform and sform and np.linalg.det(header.get_qform()) * np.linalg.det(T) < 0.0:
        notes = ("its qform and its sform disagree about left and right: the sform is taken",)
    return Stored(values, T, "RAS", notes)


def read_mgh(file: Path, volume: int | None) -> Stored:
    """A FreeSurfer volume, .mgh or .mgz, in scanner coordinates.

    Raises:
        MeshError: in one line.
    """
    kind: Any = library("nibabel").freesurfer.mghformat.MGHHeader
    start = head(file, _MGH_DATA)
    if len(start) < _MGH_DATA:
        raise MeshError("it is cut off in its header")
    header = kind(start[:90], check=False)
    try:
        dtype = header.get_data_dtype()
    except KeyError:
        raise MeshError(f"its header names data of type {int(header['type'])}") from None
    shape = tuple(int(size) for size in header["dims"])
    values = voxels(
        file,
        0,
        dtype.newbyteorder(">"),
        shape[:3],
        packed=compression(file),
        skip=_MGH_DATA,
        volumes=_volumes(shape),
        volume=one_of(_volumes(shape), volume, "volumes"),
    )
    T: FloatArray = np.array(header.get_affine(), dtype=np.float64)
    if int.from_bytes(start[28:30], "big") == 0:  # goodRASFlag
        return Stored(values, T, None, (GUESS.format("the file"),))
    return Stored(values, T, "RAS")


def _volumes(shape: tuple[int, ...]) -> int:
    more = [size for size in shape[3:] if size != 1]
    if len(more) > 1 or min(more, default=1) < 1:
        raise MeshError(
            f"its size is {' × '.join(map(str, shape))}: a series of volumes has four dimensions"
        )
    return more[0] if more else 1


def _files(file: Path) -> tuple[Path, Path]:
    """The file with the header, and the one with the voxels."""
    name = file.name.lower()
    for suffix, other in ((".img.gz", ".hdr"), (".img", ".hdr"), (".hdr", ".img")):
        if name.endswith(suffix):
            stem = file.name[: -len(suffix)]
            for ending in (other, other.upper(), f"{other}.gz"):
                if (file.parent / f"{stem}{ending}").is_file():
                    found = file.parent / f"{stem}{ending}"
                    return (found, file) if other == ".hdr" else (file, found)
            if suffix != ".hdr" and not is_nifti(head(file, 4)):
                raise MeshError(f"its header {stem}.hdr is not beside it")
    return file, file
