"""Label maps: volumes of whole numbers, each of which stands for a structure."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects

from meshes.anatomy import colours, pngs
from meshes.anatomy.colours import Colour, Named
from meshes.errors import MeshError
from meshes.volume import dicom, files, nrrd
from meshes.volume.grid import (
    FloatArray,
    Segment,
    SeveralVolumes,
    Stored,
    Volume,
    checked,
    planes_at_once,
    printable,
)  # fmt: skip
from meshes.volume.labels import label_counts
from meshes.volume.payload import head

Progress = Callable[[float, str], None]
"""Called with the share that is done, 0 to 1, and a text."""

_OR_LAYERS = ", or layers of a segmentation,"

# An image of few grey values differs from voxel to voxel; of a label map with hundreds of regions
# some nine in ten pairs of neighbours are alike.
_FEW, _ALIKE = 30, 0.4

Box = tuple[slice, slice, slice]


@dataclass(frozen=True)
class Label:
    """A structure of a label map.

    Attributes:
        number: its voxels' value. Where layers of a segmentation use a value twice, the segments
            are numbered from 1 in the order of the file instead.
        name: unique in the map; ``label 3`` where neither file nor colour table gives one.
        colour: red, green, blue, 0 to 255; None if not given.
        voxels: how many; a segmentation may name structures without any.
        volume: of its voxels [m³].
        low, high: ``(3,)`` box around its voxels in the frame of the surfaces, RAS [m]; NaN without
            voxels.
    """

    number: int
    name: str
    colour: Colour | None
    voxels: int
    volume: float
    low: FloatArray
    high: FloatArray


@dataclass(frozen=True)
class Part:
    """Where the voxels of a label are: those equal to ``value`` in the ``box`` of a layer."""

    label: Label
    layer: int
    value: int
    box: Box | None


@dataclass(frozen=True)
class LabelMap:
    """A label map as read.

    Attributes:
        layers: volumes ``(i, j, k)`` of one size, which may overlap.
        T_world_voxel: ``(4, 4)`` [m].
        frame: "RAS", or None where the file does not say how the patient lies.
        parts: one a label, by number.
        notes: for the user, a sentence each.
    """

    name: str
    layers: tuple[NDArray[Any], ...]
    T_world_voxel: FloatArray
    frame: str | None
    parts: tuple[Part, ...]
    notes: tuple[str, ...]


def is_map(path: Path) -> bool:
    """Whether a path is read as a label map: a volume, or a folder with PNG files."""
    if path.is_dir():
        return bool(pngs.files(path))
    return path.name.lower().endswith(files.FORMATS)


def read_map(
    path: str | os.PathLike[str],
    *,
    table: str | os.PathLike[str] | None = None,
    spacing: tuple[float, float, float] | None = None,
    progress: Progress | None = None,
) -> LabelMap:
    """A label map: NIfTI, NRRD (3D Slicer's segmentations with all layers), MetaImage, MGH, PNGs.

    Notes are also issued as warnings.

    Args:
        table: a colour table; None: one of the map's name beside it (for PNGs, the only one in the
            folder), if there is one.
        spacing: of a stack of PNG files, between columns, rows and slices [m].

    Raises:
        MeshError: it cannot be read, or is no label map; in one line.
    """
    file = Path(path)
    say = progress or (lambda _share, _text: None)
    found = colours.beside(file) if table is None and file.exists() else table
    rows = colours.read(Path(found)) if found is not None else {}
    try:
        if spacing is not None and not file.is_dir():
            raise MeshError("a spacing is given for stacks of PNG files only")
        volume, segments = _volume(file, rows, spacing, say)
        layers = tuple(volume.values) if volume.values.ndim == 4 else (volume.values,)
        say(0.5, "counting voxels")
        layers = tuple(_whole(layer) for layer in layers)
        counts = [_counts(layer) for layer in layers]
    except MeshError as error:
        text = printable(str(error)).removeprefix(f"{file}: ")
        raise MeshError(f"{file}: {text}") from None
    parts = _parts(layers, counts, volume.T_world_voxel, segments, rows)
    if not any(part.label.voxels for part in parts):
        raise MeshError(f"{file}: no voxel has a label: all are background (0)")
    say(1.0, "read")
    return LabelMap(file.name, layers, volume.T_world_voxel, volume.frame, parts, volume.notes)


def _volume(
    file: Path,
    rows: Mapping[int, Named],
    spacing: tuple[float, float, float] | None,
    say: Progress,
) -> tuple[Volume, Sequence[Segment]]:
    """The volume, whose values may have four dimensions, layers first; and what it names."""
    if file.is_dir():
        if not pngs.files(file):
            raise MeshError("a folder without PNG files is no label map")
        stored, palette = pngs.read(file, rows, spacing, lambda share, text: say(share / 2, text))
        given = [Segment(k, 0, "", colour) for k, colour in palette.items() if k]
        return _noted(checked(stored, file.name)), given
    say(0.0, f"reading {file.name}")
    try:
        start = head(file, 600) if file.exists() else b""
        if start.startswith(b"NRRD000") and not dicom.is_dicom(start):
            return _nrrd(file)
        found = files.read(file)
    except SeveralVolumes as error:
        count = str(error).removeprefix(f"{file}: ").partition(":")[0].removesuffix(_OR_LAYERS)
        raise MeshError(f"{count}: a label map is one; write it into a file of its own") from None
    except OSError as error:
        raise MeshError(f"cannot be read ({error.strerror or error})") from None
    return found, [Segment(value, 0, name, None) for value, name in found.names]


def _nrrd(file: Path) -> tuple[Volume, Sequence[Segment]]:
    try:
        stored, segments = nrrd.layers(file)
    except MeshError:
        raise
    except Exception as error:  # as in `files.read`: a damaged header
        raise MeshError("is damaged: its header makes no sense") from error
    every = stored.values if stored.values.ndim == 4 else stored.values[None]
    volume = checked(
        Stored(every[0], stored.T_world_voxel_mm, stored.frame, stored.notes), file.name
    )
    return replace(_noted(volume), values=every), segments


def _noted(volume: Volume) -> Volume:
    for note in volume.notes:
        warnings.warn(f"{volume.name}: {note}", stacklevel=2)
    return volume


def _whole(values: NDArray[Any]) -> NDArray[Any]:
    """The same as integers in native byte order; NaN is background."""
    values = values.astype(values.dtype.newbyteorder("="), copy=False)
    if values.dtype.kind in "iu":
        return values
    values = np.nan_to_num(values, nan=0.0, posinf=0.5, neginf=0.5)  # infinite: no label
    if (values != np.floor(values)).any():
        raise MeshError(
            "is an image and no label map: it has values that are not whole numbers "
            "(for a surface at a level: vf-sandbox mesh from-volume)"
        )
    if values.max() >= 2.0**31:
        raise MeshError(f"is no label map: its largest value is {values.max():g}")
    return values.astype(np.int32)


def _counts(values: NDArray[Any]) -> dict[int, int]:
    """How many voxels have each label but 0.

    Raises:
        MeshError: too many different values, or negative ones.
    """
    counts = label_counts(values)
    image = "(for a surface at a level: vf-sandbox mesh from-volume)"
    if counts is None:
        raise MeshError(
            f"is an image and no label map: it has more than 500 different values {image}"
        )
    if counts and min(counts) < 0:
        raise MeshError(f"is no label map: it has negative values, such as {min(counts)} {image}")
    if len(counts) > _FEW and (share := _alike(values)) < _ALIKE:
        raise MeshError(
            f"is an image and no label map: of {len(counts)} different values, only "
            f"{100 * share:.0f} % of the voxels have the same as the next one {image}"
        )
    return counts


def _alike(values: NDArray[Any]) -> float:
    """The share of voxels with the value of the next one, where neither is background."""
    alike, both = 0, 0
    step = planes_at_once(values)
    for first in range(0, values.shape[0], step):
        part = values[first : first + step]
        here, there = part[:, :-1], part[:, 1:]
        labelled = (here != 0) & (there != 0)
        both += int(np.count_nonzero(labelled))
        alike += int(np.count_nonzero(labelled & (here == there)))
    return alike / both if both else 1.0


def _parts(
    layers: Sequence[NDArray[Any]],
    counts: Sequence[Mapping[int, int]],
    T: FloatArray,
    segments: Sequence[Segment],
    rows: Mapping[int, Named],
) -> tuple[Part, ...]:
    boxes = [_boxes(layer, sorted(count)) for layer, count in zip(layers, counts, strict=True)]
    given = {(one.layer, one.value): one for one in segments}
    found = [(layer, value) for layer, count in enumerate(counts) for value in sorted(count)]
    # Also the named ones without voxels, but not the unused colours of a palette.
    found = [one for one in given if given[one].name or one in found] + [
        one for one in found if one not in given
    ]
    values = [value for _layer, value in found]
    twice = len(set(values)) < len(values)
    parts: list[Part] = []
    taken: set[str] = set()
    voxel = abs(float(np.linalg.det(T[:3, :3])))
    for order, (layer, value) in enumerate(found, 1):
        number = order if twice else value
        segment, row = given.get((layer, value)), rows.get(value)
        name = (row.name if row else "") or (segment.name if segment else "") or f"label {number}"
        if name in taken:
            name = f"{name} ({number})"
        taken.add(name)
        colour = row.colour if row else segment.colour if segment else None
        box = boxes[layer].get(value) if layer < len(layers) else None
        count = counts[layer].get(value, 0) if layer < len(layers) else 0
        low, high = _extent(box, T)
        label = Label(number, name, colour, count, count * voxel, low, high)
        parts.append(Part(label, layer, value, box))
    return tuple(sorted(parts, key=lambda part: part.label.number))


def _boxes(values: NDArray[Any], labels: Sequence[int]) -> dict[int, Box]:
    """The box of indices of each label."""
    if not labels:
        return {}
    order = np.array([0, *labels]) if labels[0] > 0 else np.array(labels)
    if values.dtype.itemsize <= 2 or labels[-1] < 1 << 16:
        table = np.zeros(order[-1] + 1, dtype=np.int32)
        table[order] = np.arange(len(order))
        compact = table[values]
    else:
        compact = np.searchsorted(order, values).astype(np.int32)
    found = find_objects(compact, len(labels))
    return {label: box for label, box in zip(labels, found, strict=True) if box is not None}


def _extent(box: Box | None, T: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The box in the world around voxels of a box of indices."""
    if box is None:
        return np.full(3, np.nan), np.full(3, np.nan)
    ends = [(side.start - 0.5, side.stop - 0.5) for side in box]
    corners = np.array([(x, y, z) for x in ends[0] for y in ends[1] for z in ends[2]])
    world = corners @ T[:3, :3].T + T[:3, 3]
    return world.min(axis=0), world.max(axis=0)
