"""Reading a volume: the file's first bytes choose the reader."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from pathlib import Path

from meshes.errors import MeshError
from meshes.volume import dicom, metaimage, nifti, nrrd
from meshes.volume.grid import SeveralVolumes, Stored, Volume, checked, printable
from meshes.volume.payload import head

FORMATS = (
    ".nii", ".nii.gz", ".hdr", ".img", ".img.gz", ".mgh", ".mgz", ".nrrd", ".nhdr", ".mha", ".mhd"
)  # fmt: skip


def read(
    path: str | os.PathLike[str],
    *,
    volume: int | None = None,
    progress: Callable[[str], None] | None = None,
) -> Volume:
    """A NIfTI, Analyze, MGH, NRRD or MetaImage file, or DICOM slices (a folder, or one file).

    `Volume.notes` are also issued as warnings.

    Args:
        volume: which one of a file with several, such as a time series; from 0.

    Raises:
        MeshError: not there, damaged or cut off, too large, not one volume of one value a voxel, or
            the libraries of the extra ``volume`` are not installed; in one line.
    """
    say = progress or (lambda _stage: None)
    file = Path(path)
    try:
        if not file.exists():
            raise MeshError("there is no such file or folder")
        say("reading the volume")
        found = checked(_stored(file, volume), file.name)
    except MeshError as error:
        kind = SeveralVolumes if isinstance(error, SeveralVolumes) else MeshError
        raise kind(f"{file}: {printable(str(error))}") from None
    except OSError as error:
        raise MeshError(f"{file}: cannot be read ({error.strerror or error})") from None
    # Any other exception of the readers is caused by a damaged header.
    except Exception as error:
        raise MeshError(f"{file}: is damaged: its header makes no sense") from error
    for note in found.notes:
        warnings.warn(f"{file.name}: {note}", stacklevel=2)
    return found


def _stored(file: Path, volume: int | None) -> Stored:
    if file.is_dir():
        return dicom.read(file, volume)
    name = file.name.lower()
    start = head(file, 600)
    if not start:
        raise MeshError("is empty")
    if dicom.is_dicom(start) or name.endswith(dicom.SUFFIXES):
        return dicom.read(file, volume)
    if start.startswith(b"NRRD000"):
        return nrrd.read(file, volume)
    if metaimage.is_metaimage(start):
        return metaimage.read(file, volume)
    if nifti.is_nifti(start) or name.endswith((".img", ".img.gz")):
        return nifti.read(file, volume)
    if nifti.is_mgh(start):
        return nifti.read_mgh(file, volume)
    if name.endswith(FORMATS):
        raise MeshError("is damaged: it does not begin as a file of its format")
    raise MeshError(
        f"is no volume that is read: give a file ({', '.join(FORMATS)}) or a folder of DICOM slices"
    )
