"""Slices of one series as a regular grid: sorted, checked, resampled where spacings differ."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from meshes.errors import MeshError
from meshes.volume.grid import FloatArray

_EVEN = 0.02  # relative tolerance of equal steps: positions are rounded
_ON_GRID = 0.05  # tolerance of a slice's position on the grid, as a share of the spacing
_ALIGNED = 0.1  # tolerance of a slice's lateral position, as a share of a pixel
_GAP = 1.5  # a step of more than this times its neighbours is a gap


@dataclass(frozen=True)
class Slice:
    """The pose of a slice in DICOM's patient coordinates (LPS) [mm].

    Attributes:
        position: ``(3,)`` centre of the first pixel.
        across, down: ``(3,)`` unit vectors along a row and along a column.
        spacing: between columns, and between rows.
        size: columns and rows.
        name: of its file or frame.
    """

    position: FloatArray
    across: FloatArray
    down: FloatArray
    spacing: tuple[float, float]
    size: tuple[int, int]
    name: str


@dataclass(frozen=True)
class Stack:
    """Slices as a regular grid.

    Attributes:
        order: indices of the slices along their normal.
        T_lps_voxel: ``(4, 4)`` from (column, row, plane) to LPS [mm].
        at: ``(planes,)`` the position of each plane among the ordered slices, not whole where it
            is interpolated.
        notes: for the user.
    """

    order: list[int]
    T_lps_voxel: FloatArray
    at: FloatArray
    notes: tuple[str, ...]


def stacked(slices: list[Slice]) -> Stack:
    """The grid of slices given in any order.

    Raises:
        MeshError: fewer than two, of different size or direction, repeated, missing between others,
            or shifted sideways.
    """
    if len(slices) < 2:
        raise MeshError(f"DICOM slices with pixels and a position: {len(slices)}, two are needed")
    first = slices[0]
    directions = np.stack([first.across, first.down])
    square = np.allclose(directions @ directions.T, np.eye(2), atol=1e-3)
    if not square or not 0.0 < min(first.spacing) <= max(first.spacing) < np.inf:
        raise MeshError(f"{first.name}: its rows and columns make no grid of right angles")
    for one in slices:
        same = (
            one.size == first.size
            and np.allclose(one.spacing, first.spacing, rtol=1e-3)
            and np.allclose([one.across, one.down], [first.across, first.down], atol=1e-4)
        )
        if not same:
            raise MeshError(
                f"{one.name} differs from {first.name} in size, pixel spacing or direction: "
                "they are not slices of one volume"
            )
    normal = np.cross(first.across, first.down)
    heights = np.array([one.position for one in slices]) @ normal
    if not np.isfinite(heights).all():
        raise MeshError("its slices have positions that are not finite")
    order = np.argsort(heights, kind="stable")
    heights = heights[order]
    steps = np.diff(heights)
    usual = float(np.median(steps))
    k = int(steps.argmin())
    if steps[k] <= _EVEN * usual:
        raise MeshError(
            f"{slices[order[k]].name} and {slices[order[k + 1]].name} lie in the same place: "
            "slices are repeated, or of several time points, echoes or phases; give one of them"
        )
    _refuse_gaps(steps, [slices[k].name for k in order])
    start, end = slices[order[0]].position, slices[order[-1]].position
    share = (heights - heights[0]) / (heights[-1] - heights[0])
    off = np.array([slices[k].position for k in order]) - (start + share[:, None] * (end - start))
    if np.linalg.norm(off, axis=1).max() > _ALIGNED * min(first.spacing):
        raise MeshError(
            f"its slices are shifted sideways against each other by up to "
            f"{np.linalg.norm(off, axis=1).max():.3g} mm"
        )
    planes = len(slices)
    even = bool(abs(share * (planes - 1) - np.arange(planes)).max() <= _ON_GRID)
    at = np.arange(planes, dtype=np.float64)
    notes: tuple[str, ...] = ()
    if not even:
        planes = 1 + int(np.ceil((heights[-1] - heights[0]) / steps.min() - _EVEN))
        at = np.interp(np.linspace(0.0, 1.0, planes), share, at)
        step = (heights[-1] - heights[0]) / (planes - 1)
        notes = (
            f"its slices lie {steps.min():.4g} to {steps.max():.4g} mm apart along their "
            f"normal: resampled to planes every {step:.4g} mm, linearly between neighbours",
        )
    T = np.eye(4)
    T[:3, 0] = first.across * first.spacing[0]
    T[:3, 1] = first.down * first.spacing[1]
    # From the positions themselves: a tilted gantry shears the grid.
    T[:3, 2] = (end - start) / (planes - 1)
    T[:3, 3] = start
    return Stack([int(k) for k in order], T, at, notes)


def _refuse_gaps(steps: FloatArray, names: list[str]) -> None:
    """Raise `MeshError` for a long step between shorter ones; a change of spacing is no gap."""
    begins = np.flatnonzero(np.r_[True, abs(np.diff(steps)) > _EVEN * steps[:-1]])
    ends = np.r_[begins[1:], len(steps)]
    for begin, end in zip(begins.tolist(), ends.tolist(), strict=True):
        around = [float(steps[k]) for k in (begin - 1, end) if 0 <= k < len(steps)]
        enclosed = len(around) == 2
        if (enclosed or end - begin == 1) and around and steps[begin] > _GAP * max(around):
            raise MeshError(
                f"slices are missing: {names[begin]} and {names[begin + 1]} lie "
                f"{steps[begin]:.4g} mm apart, the slices beside them {max(around):.4g} mm"
            )
