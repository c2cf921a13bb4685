"""Volumes: values on a grid, its pose, and the checks that all readers share."""

from __future__ import annotations

import importlib
import math
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.errors import MeshError

FloatArray = NDArray[np.float64]

MOST_VOXELS = 400_000_000
MOST_BYTES = 4_000_000_000  # of voxels in one file, uncompressed
SLAB = 2_000_000  # voxels processed at a time
LPS_TO_RAS = np.diag([-1.0, -1.0, 1.0, 1.0])
GUESS = (
    "{} does not say how the patient lies in it: left and right are a guess, "
    "and so are front and top"
)


@dataclass(frozen=True)
class Volume:
    """A scalar field on a grid.

    Attributes:
        values: ``(i, j, k)``, of the file's integer type, or float32 where the file scales them.
            NaN counts as minus infinity.
        T_world_voxel: ``(4, 4)`` from indices (at voxels' centres) to world coordinates [m].
        name: of the file.
        frame: "RAS", the patient frame of the world coordinates; None where the file does not give
            it and the axes are a guess.
        notes: for the user, a sentence each.
        names: names of labels, if the file gives them.
    """

    values: NDArray[Any]
    T_world_voxel: FloatArray
    name: str
    frame: str | None = "RAS"
    notes: tuple[str, ...] = ()
    names: tuple[tuple[int, str], ...] = ()


@dataclass(frozen=True)
class Segment:
    """A structure that a label map names.

    Attributes:
        value: of its voxels.
        layer: index of the volume that holds them: layers may overlap.
        name: as the file has it.
        colour: red, green, blue, 0 to 255; None if the file gives none.
    """

    value: int
    layer: int
    name: str
    colour: tuple[int, int, int] | None


class SeveralVolumes(MeshError):
    """A file holds several volumes and none is chosen."""


@dataclass(frozen=True)
class Stored:
    """The result of a format's reader: a `Volume` in millimetres, not checked."""

    values: NDArray[Any]
    T_world_voxel_mm: FloatArray
    frame: str | None
    notes: tuple[str, ...] = ()
    names: tuple[tuple[int, str], ...] = ()


@dataclass(frozen=True)
class Extent:
    """The range of a volume's values.

    Attributes:
        low, high: the least and the greatest finite value.
        count: of finite values.
        below: whether some are NaN or minus infinity.
        above: whether some are infinity.
    """

    low: float
    high: float
    count: int
    below: bool
    above: bool


def planes_at_once(values: NDArray[Any]) -> int:
    """The number of planes of the first index that hold about `SLAB` voxels."""
    return max(1, SLAB // (values.shape[1] * values.shape[2]))


def extent(values: NDArray[Any]) -> Extent:
    """The range of values ``(i, j, k)``."""
    low, high, count, below, above = np.inf, -np.inf, 0, False, False
    step = values.shape[0] if values.dtype.kind != "f" else planes_at_once(values)
    for first in range(0, values.shape[0], step):
        part = values[first : first + step]
        if part.dtype.kind == "f" and not (finite := np.isfinite(part)).all():
            above |= bool((part == np.inf).any())
            below |= bool((np.isnan(part) | (part == -np.inf)).any())
            part = part[finite]
        count += part.size
        if part.size:
            low, high = min(low, float(part.min())), max(high, float(part.max()))
    return Extent(low, high, count, below, above)


def checked(stored: Stored, name: str) -> Volume:
    """A volume in metres.

    Raises:
        MeshError: not three dimensions of two or more voxels, or a degenerate grid.
    """
    values = stored.values
    check_size(values.shape)
    values = values.astype(values.dtype.newbyteorder("="), copy=False)
    if values.dtype.kind == "f":
        with np.errstate(over="ignore"):  # beyond single precision: infinite
            values = values.astype(np.float32, copy=False)
    T = np.array(stored.T_world_voxel_mm, dtype=np.float64)
    T[:3] *= 1e-3  # [mm] -> [m]
    steps = np.linalg.norm(T[:3, :3], axis=0)
    if not np.isfinite(T).all() or not (steps > 1e-9).all() or not (steps < 1.0).all():
        sides = " × ".join(f"{1e3 * step:.4g}" for step in steps)
        raise MeshError(f"its voxels are {sides} mm: each side must be between 1e-6 and 1000 mm")
    if abs(np.linalg.det(T[:3, :3] / steps)) < 1e-6:
        raise MeshError("its grid has no volume: two of its axes point the same way")
    if np.abs(T[:3, 3]).max() > 1e3:
        raise MeshError(f"it lies {np.abs(T[:3, 3]).max():.4g} m from the origin: at most 1000 m")
    return Volume(values, T, name, stored.frame, stored.notes, stored.names)


def check_size(shape: tuple[int, ...]) -> None:
    """Raise `MeshError` for a shape that is no volume, or too large a one."""
    if len(shape) != 3 or min(shape) < 2:
        raise MeshError(
            f"its size is {_times(shape)} voxels, not a volume of two and more in each direction"
        )
    count = math.prod(shape)
    if count > MOST_VOXELS:
        raise MeshError(
            f"its {_times(shape)} are {count:,} voxels, more than the {MOST_VOXELS:,} allowed"
        )


def scaled(values: NDArray[Any], slope: float, intercept: float) -> NDArray[Any]:
    """``slope * values + intercept``: the values themselves for 1 and 0, float32 otherwise.

    Raises:
        MeshError: a slope or intercept that is not finite, or a slope of zero.
    """
    if (slope, intercept) == (1.0, 0.0):
        return values
    if not (np.isfinite([slope, intercept]).all() and slope != 0.0):
        raise MeshError(f"its values are scaled by {slope:g} and shifted by {intercept:g}")
    result = np.empty(values.shape, dtype=np.float32, order="F")
    for k in range(values.shape[-1]):
        result[..., k] = values[..., k].astype(np.float64) * slope + intercept
    return result


def one_of(count: int, chosen: int | None, what: str) -> int:
    """The index of the volume to read from a file with ``count`` of them.

    Raises:
        SeveralVolumes: none chosen of several.
        MeshError: out of range.
    """
    if chosen is None and count == 1:
        return 0
    if chosen is None:
        raise SeveralVolumes(f"holds {count} {what}: choose one of 0 to {count - 1} (--volume)")
    if not 0 <= chosen < count:
        are = f"{count} {what}: 0 to {count - 1}" if count > 1 else "one volume: 0"
        raise MeshError(f"there is no volume {chosen}: it holds {are}")
    return chosen


def library(name: str) -> ModuleType:
    """A module of the extra ``volume``.

    Raises:
        MeshError: it is not installed.
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise MeshError(
            f"{name.partition('.')[0]} is not installed: this needs the extra 'volume' "
            "(pip install 'vf-sandbox[volume]')"
        ) from error


def printable(text: str) -> str:
    """A text from a file with its control characters replaced by blanks."""
    return "".join(letter if letter.isprintable() else " " for letter in text)


def _times(shape: tuple[int, ...]) -> str:
    return " × ".join(map(str, shape))
