"""DICOM series: a folder of slices, or one enhanced multi-frame file; LPS becomes RAS."""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from meshes.errors import MeshError
from meshes.volume.grid import LPS_TO_RAS, Stored, check_size, library, one_of
from meshes.volume.stack import Slice, stacked

# Names such as IM0001, 1.2.840.113619.2, slice.dcm, head.CT.12.IMA.
_SLICE_NAME = re.compile(r"(^[^.]+$|\.(dcm|dicom|dic|ima|img|\d+)$)", re.IGNORECASE)
SUFFIXES = (".dcm", ".dicom", ".ima")
_OTHERS = (b"\x89PNG", b"\xff\xd8\xff", b"GIF8", b"%PDF", b"PK\3\4", b"\x1f\x8b", b"BM")
_IMPLICIT = (b"\x08\0", b"\x02\0")  # first group of files without preamble
_LOCALIZER = "LOCALIZER"
_STANDARD = "1.2.840.10008."
_IN_SPACE = (0x00209057, 0x00200032)  # InStackPositionNumber, ImagePositionPatient


@dataclass(frozen=True)
class _Frame:
    """A slice, its data set and frame, and the rescaling of its pixels."""

    slice: Slice
    dataset: Any
    frame: int
    slope: float
    intercept: float
    group: tuple[int, ...] = ()  # time point, echo and so on


def is_dicom(start: bytes) -> bool:
    """Whether the first bytes are those of a DICOM file."""
    return start[128:132] == b"DICM"


def read(path: Path, volume: int | None) -> Stored:
    """The one series in a folder, or in a multi-frame file.

    Raises:
        MeshError: a slice that is damaged or missing, none at all, several series, slices that make
            no grid, or pixels that cannot be decoded; in one line.
    """
    library("pydicom")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of minor violations of the standard
        # Decoders only warn of a truncated image and fill it up.
        warnings.filterwarnings("error", message="End of file reached")
        files = sorted(one for one in path.iterdir() if one.is_file()) if path.is_dir() else [path]
        datasets = [(file.name, found) for file in files if (found := _dataset(file)) is not None]
        datasets, notes = _images(datasets, path)
        frames = [frame for name, one in datasets for frame in _frames(name, one)]
        if len(frames) == 1 and not path.is_dir():
            raise MeshError("it is a single slice: give the folder that its series is in")
        frames = _one_group(frames, volume)
        stack = stacked([frame.slice for frame in frames])
        values = _values([frames[k] for k in stack.order])
    notes += _fewer(datasets, len(frames)) + stack.notes
    columns, rows = frames[0].slice.size
    check_size((columns, rows, len(stack.at)))
    if stack.notes:
        lower = np.minimum(stack.at.astype(np.int64), len(values) - 2)
        share = (stack.at - lower).astype(np.float32)[:, None, None]
        planes = np.empty((len(lower), rows, columns), dtype=np.float32)
        for k, at in enumerate(lower):
            planes[k] = (1.0 - share[k]) * values[at] + share[k] * values[at + 1]
        values = planes
    # (slice, row, column) -> (column, row, slice)
    return Stored(values.transpose(2, 1, 0), LPS_TO_RAS @ stack.T_lps_voxel, "RAS", notes)


def _dataset(file: Path) -> Any:
    """A data set, or None for a file that is neither DICOM nor named as a slice."""
    pydicom = library("pydicom")
    with open(file, "rb") as stream:
        start = stream.read(4096)
    if not is_dicom(start) and not (start[:2] in _IMPLICIT and _SLICE_NAME.search(file.name)):
        if file.name.startswith(".") or not _SLICE_NAME.search(file.name) or _other(start):
            return None
        raise MeshError(f"{file.name} is damaged: it does not begin as a DICOM file")
    try:
        dataset = pydicom.dcmread(file, force=not is_dicom(start))
    # Any exception of the reader is caused by a damaged file.
    except Exception as error:
        raise MeshError(f"{file.name} is damaged: it is not DICOM to its end") from error
    kind = _kind(dataset)
    # A class without a name, or with a truncated number.
    if kind.startswith(_STANDARD) or _STANDARD.startswith(kind):
        raise MeshError(f"{file.name} is damaged in its header, or of an unknown class {kind!r}")
    if "TransferSyntaxUID" not in dataset.file_meta:  # old files without a preamble
        implicit, little = dataset.original_encoding
        uid = pydicom.uid
        dataset.file_meta.TransferSyntaxUID = (
            uid.ImplicitVRLittleEndian
            if implicit
            else uid.ExplicitVRLittleEndian
            if little
            else uid.ExplicitVRBigEndian
        )
    return dataset


def _other(start: bytes) -> bool:
    """Whether a file begins as text, an image or a document."""
    if start.startswith(_OTHERS):
        return True
    printable = set(start) - set(range(32)) | {9, 10, 13}
    return bool(start) and set(start) <= printable


def _images(
    datasets: list[tuple[str, Any]], path: Path
) -> tuple[list[tuple[str, Any]], tuple[str, ...]]:
    """The slices of the one series, and notes."""
    slices, left, other = [], 0, 0
    for name, one in datasets:
        kind = _kind(one)
        if "Segmentation" in kind and "Image" not in kind:
            raise MeshError(f"{name} is a DICOM segmentation: save it as a label map (NRRD, NIfTI)")
        if "Image Storage" not in kind and "Rows" not in one:
            other += 1  # reports, plans, presentation states, directories
            continue
        if "PixelData" not in one and "FloatPixelData" not in one:
            raise MeshError(f"{name} has no pixels: it is cut off, or they were taken out")
        if "MOSAIC" in one.get("ImageType", ""):
            raise MeshError(f"{name} has all slices in one picture (mosaic): convert it to NIfTI")
        placed = "ImagePositionPatient" in one or "PerFrameFunctionalGroupsSequence" in one
        if not placed and int(one.get("NumberOfFrames") or 1) > 1:
            raise MeshError(f"{name} is a multi-frame image that gives its frames no positions")
        if not placed or _LOCALIZER in one.get("ImageType", ""):
            left += 1
            continue
        slices.append((name, one))
    if not slices:
        if not path.is_dir():
            kind = f" but {_kind(datasets[0][1])}" if datasets else ""
            raise MeshError(f"it is no DICOM slice with pixels and a position{kind}")
        folders = any(inner.is_dir() for inner in path.iterdir())
        raise MeshError(
            f"0 DICOM slices with pixels and a position among {len(datasets)} DICOM files"
            + (": give one of the folders in it" if folders else "")
        )
    series = Counter(str(one.get("SeriesInstanceUID", "")) for _name, one in slices)
    if len(series) > 1:
        titles = {
            str(one.get("SeriesInstanceUID", "")): str(
                one.get("SeriesDescription", "") or "unnamed"
            )
            for _name, one in slices
        }
        found = ", ".join(f"{titles[uid]}: {count}" for uid, count in series.most_common(5))
        raise MeshError(
            f"{len(series)} series in one folder ({found}): give a folder with one of them"
        )
    notes = (f"images left out, without a position or localizers: {left}",) if left else ()
    return slices, notes


def _kind(dataset: Any) -> str:
    uid = dataset.get("SOPClassUID") or getattr(dataset.file_meta, "MediaStorageSOPClassUID", "")
    return str(getattr(uid, "name", uid))


def _fewer(datasets: list[tuple[str, Any]], count: int) -> tuple[str, ...]:
    """A note where the series gives a larger number of images than there are."""
    first = datasets[0][1]
    said = first.get("ImagesInAcquisition") or first.get("NumberOfSlices")
    if isinstance(said, int) and said > count and len(datasets) == count:
        return (f"the series says that it has {said} images; {count} are here",)
    return ()


def _frames(name: str, dataset: Any) -> Iterator[_Frame]:
    if int(dataset.get("SamplesPerPixel") or 1) != 1:
        raise MeshError(f"{name} is a colour image: a level needs one value a voxel")
    if "ModalityLUTSequence" in dataset:
        raise MeshError(f"{name} gives its values by a table (Modality LUT), which is not read")
    size = (int(dataset.Columns), int(dataset.Rows))
    if "PerFrameFunctionalGroupsSequence" not in dataset:
        place = [name, *(_number_list(name, dataset, key) for key in _PLACE)]
        yield _Frame(
            _slice(place, size), dataset, 0, _number(dataset, "RescaleSlope", 1.0),
            _number(dataset, "RescaleIntercept", 0.0),
        )  # fmt: skip
        return
    own = dataset.PerFrameFunctionalGroupsSequence
    count = int(dataset.get("NumberOfFrames") or 1)
    if len(own) != count:
        raise MeshError(f"{name} promises {count} frames and describes {len(own)}")
    # The file's dimensions other than those in space.
    dimensions = [
        n
        for n, one in enumerate(dataset.get("DimensionIndexSequence") or ())
        if one.get("DimensionIndexPointer") not in _IN_SPACE
    ]
    shared: Any = next(iter(dataset.get("SharedFunctionalGroupsSequence") or ()), {})
    for k, groups in enumerate(own):
        frame = f"frame {k + 1} of {name}"

        def group(key: str, groups: Any = groups) -> Any:
            return next(iter(groups.get(key) or shared.get(key) or ()), {})

        place = [frame]
        for key, sequence in zip(_PLACE, _GROUPS, strict=True):
            place.append(_number_list(frame, group(sequence), key))
        values = group("PixelValueTransformationSequence")
        numbers = np.atleast_1d(group("FrameContentSequence").get("DimensionIndexValues", ()))
        others = tuple(int(numbers[n]) for n in dimensions if n < len(numbers))
        yield _Frame(
            _slice(place, size), dataset, k, _number(values, "RescaleSlope", 1.0),
            _number(values, "RescaleIntercept", 0.0), others,
        )  # fmt: skip


def _one_group(frames: list[_Frame], volume: int | None) -> list[_Frame]:
    """The frames of one time point, echo or phase."""
    groups = sorted({frame.group for frame in frames})
    if len(frames) < 2 * len(groups):  # each frame by itself: no series of volumes
        groups = [()]
    chosen = groups[one_of(len(groups), volume, "volumes (time points, echoes or phases)")]
    return [frame for frame in frames if len(groups) == 1 or frame.group == chosen]


_PLACE = ("ImagePositionPatient", "ImageOrientationPatient", "PixelSpacing")
_GROUPS = ("PlanePositionSequence", "PlaneOrientationSequence", "PixelMeasuresSequence")
_LENGTHS = {"ImagePositionPatient": 3, "ImageOrientationPatient": 6, "PixelSpacing": 2}


def _slice(place: list[Any], size: tuple[int, int]) -> Slice:
    name, position, directions, spacing = place
    # PixelSpacing: between rows first, then between columns.
    return Slice(position, directions[:3], directions[3:], (spacing[1], spacing[0]), size, name)


def _number_list(name: str, dataset: Any, key: str) -> np.ndarray:
    value = dataset.get(key)
    found = np.array([] if value is None else value, dtype=np.float64).ravel()
    if len(found) != _LENGTHS[key]:
        raise MeshError(f"{name} has no {key} of {_LENGTHS[key]} numbers")
    return found


def _number(dataset: Any, key: str, default: float) -> float:
    value = dataset.get(key)
    return default if value is None or value == "" else float(value)


def _values(frames: list[_Frame]) -> np.ndarray:
    """(slice, row, column) rescaled values of the frames in their order."""
    pixels = library("pydicom.pixels")
    columns, rows = frames[0].slice.size
    check_size((columns, rows, len(frames)))
    values = np.empty((len(frames), rows, columns), dtype=np.float32)
    datasets: dict[int, list[int]] = {}
    for k, frame in enumerate(frames):
        datasets.setdefault(id(frame.dataset), []).append(k)
    for members in datasets.values():
        dataset = frames[members[0]].dataset
        places = {frames[k].frame: k for k in members}
        done = 0
        try:
            for number, plane in enumerate(pixels.iter_pixels(dataset)):
                if number in places:
                    k = places[number]
                    values[k] = plane * np.float64(frames[k].slope) + frames[k].intercept
                    done += 1
        # Any exception of the decoders is caused by damaged pixels.
        except Exception as error:
            raise MeshError(_reason(dataset, frames[members[0]].slice.name)) from error
        if done != len(members):
            raise MeshError(f"{frames[members[0]].slice.name} is damaged: {done} frames are there")
    return values


def _reason(dataset: Any, name: str) -> str:
    syntax = dataset.file_meta.get("TransferSyntaxUID", "")
    title = str(getattr(syntax, "name", syntax))
    try:
        available = library("pydicom.pixels").get_decoder(syntax).is_available
    except NotImplementedError:
        return f"{name} holds pixels as '{title}', which are not read"
    if not available:
        return (
            f"{name} holds pixels as '{title}': the extra 'volume' brings the decoder "
            "(pip install 'vf-sandbox[volume]')"
        )
    return f"{name} is damaged: its pixels cannot be decoded, or end early"
