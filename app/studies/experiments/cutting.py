"""Removal of bone by a blade, and the deviation of the cut from the plan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.studies.experiments.site import THICKNESS, PlannedCut

FloatArray = NDArray[np.float64]

INTERVAL = 1e-3  # between the measured stations, as in the paper [m]


@dataclass(frozen=True)
class Blade:
    """A box-shaped blade at the tip, aligned with the cut. The sizes are assumed.

    Attributes:
        width: across the cut [m].
        thickness: along the cut [m].
        limit: largest depth below the outer surface, where a shoulder stops the blade [m].
    """

    width: float = 0.6e-3
    thickness: float = 0.4e-3
    limit: float = 5e-3

    def __post_init__(self) -> None:
        for name in ("width", "thickness", "limit"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"the blade's {name} must be positive, got {getattr(self, name)}")


@dataclass(frozen=True)
class Kerf:
    """The cut in cross-sections, one per station; NaN where no bone was cut.

    Attributes:
        stations: (k,) along the planned cut [m].
        left, right: (k,) its sides, positive to the right of the plan [m].
        bottom: (k,) its lowest point, above the inner surface positive [m].
        area: (k,) of bone removed from the cross-section's bounding rectangle [m²].
    """

    stations: FloatArray
    left: FloatArray
    right: FloatArray
    bottom: FloatArray
    area: FloatArray

    @property
    def deviation(self) -> FloatArray:
        """Cutting-path deviation (k,): signed distance of the cut's middle from the plan [m]."""
        return np.asarray(0.5 * (self.left + self.right))

    @property
    def penetration(self) -> FloatArray:
        """Penetration depth (k,) beyond the inner surface; negative: remaining bone [m]."""
        return np.asarray(-self.bottom)


def kerf(
    planned: PlannedCut, tips: ArrayLike, blade: Blade | None = None, below: float = 0.0
) -> Kerf:
    """Remove the bone that the blade swept; measured at every `INTERVAL` along the planned cut.

    Every cross-section is cut by the part of the tip's path that is within half the blade's
    thickness of it; the path is linear between ticks.

    Args:
        planned: the planned cut at the true pose of the bone.
        tips: (n, 3) positions of the tip, same frame [m].
        blade: None: the default one.
        below: height over the outer surface up to which the path counts [m]; 0: where it cuts.
    """
    blade = blade or Blade()
    count = round(planned.length / INTERVAL - 0.49)
    marks = np.asarray(INTERVAL * np.arange(1, count + 1), dtype=np.float64)
    points = np.asarray(tips, dtype=np.float64)
    found = np.full((4, len(marks)), np.nan)
    for k, mark in enumerate(marks):
        origin, along, aside, outward = planned.at(mark)
        p = (points - origin) @ np.stack([along, aside, outward], axis=1)  # (n, 3)
        cut = _between(p, 0.5 * blade.thickness)
        cut = cut[cut[:, 2] < below]
        if not len(cut):
            continue
        found[0, k] = cut[:, 1].min() - 0.5 * blade.width
        found[1, k] = cut[:, 1].max() + 0.5 * blade.width
        found[2, k] = THICKNESS + max(cut[:, 2].min(), -blade.limit)
        found[3, k] = (found[1, k] - found[0, k]) * (THICKNESS - max(found[2, k], 0.0))
    return Kerf(marks, *found)


def _between(p: FloatArray, half: float) -> FloatArray:
    """The corners (m, 3) of the part of a polyline (n, 3) with |first coordinate| ≤ half."""
    x = p[:, 0]
    corners = [p[np.abs(x) <= half]]
    for wall in (-half, half):
        across = np.flatnonzero((x[:-1] - wall) * (x[1:] - wall) < 0.0)
        share = ((wall - x[across]) / (x[across + 1] - x[across]))[:, None]
        corners.append(p[across] + share * (p[across + 1] - p[across]))
    return np.concatenate(corners)
