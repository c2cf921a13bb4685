"""Half-spaces: what every fixture hands to the controller."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum
from math import isfinite, nan
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vf.layout import CAPSULE, FIXTURE, FLOOR, FOOT, NORMAL, OFFSET, POINT, RULE, TRIANGLE

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

# Coordinates and lengths beyond this are refused [m]: rounding would be as large as a standoff, and
# far beyond it squares overflow.
LARGEST = 1e7
# Bound on the rounding error of n·z, a few operations on coordinates up to one metre [m].
ROUND = 1e-14


def checked_point(x: ArrayLike) -> FloatArray:
    """x as (3,) float64; ValueError unless it is three finite numbers within ±`LARGEST`."""
    p = np.asarray(x, dtype=np.float64)
    if p.shape != (3,) or not isfinite(p[0] + p[1] + p[2]):
        raise ValueError(f"a point must be three finite numbers, got {x!r}")
    if not (abs(p[0]) <= LARGEST and abs(p[1]) <= LARGEST and abs(p[2]) <= LARGEST):
        raise ValueError(f"a point must be within ±{LARGEST:g} m of the origin, got {x!r}")
    return p


def checked_ends(x: ArrayLike) -> FloatArray:
    """x as (3,) or, for the ends of an axis, (2, 3) float64; ValueError as `checked_point`."""
    p = np.asarray(x, dtype=np.float64)
    if p.shape == (2, 3):
        for end in p:
            checked_point(end)
        return p
    return checked_point(x)


def checked_length(name: str, value: float, positive: bool = False) -> float:
    """A length [m] as a float; ValueError unless it is ≥ 0 (or > 0) and at most `LARGEST`.

    A float whatever kind of number came: kernels are compiled anew for any other.
    """
    try:
        length = float(value)
    except (TypeError, ValueError):
        raise ValueError(f"the {name} must be a number of metres, got {value!r}") from None
    if not (isfinite(length) and (length > 0.0 or (length == 0.0 and not positive))):
        kind = "positive" if positive else "zero or more"
        raise ValueError(f"the {name} must be finite and {kind} in metres, got {value!r}")
    if length > LARGEST:
        raise ValueError(f"the {name} must be at most {LARGEST:g} m, got {value!r}")
    return length


def checked_blend(name: str, blend: float) -> float:
    """A blend as a float; ValueError unless it is from 0 to 1."""
    try:
        value = float(blend)
    except (TypeError, ValueError):
        value = nan
    if not 0.0 <= value <= 1.0:
        raise ValueError(f"the {name} must be a number from 0 to 1, got {blend!r}")
    return value


class Rule(IntEnum):
    """Why a plane is there. FACE, RIDGE and VALLEY are the paper's Conditions 1, 2 and 3."""

    NAIVE = 0  # face plane without any condition (the paper's Fig. 2d)
    FACE = 1  # Condition 1: face plane, closest point inside the face
    RIDGE = 2  # Condition 2: normal along x minus the closest point
    VALLEY = 3  # Condition 3: face plane, closest point on a valley edge
    EXIT = 4  # the tool is inside the anatomy: only motion towards the way out
    CORRIDOR = 5  # a wall of the corridor along a planned path
    NEAREST = 6  # at the nearest point of the mesh, facing the tool
    SAMPLED = 7  # of a distance field that is sampled and interpolated


@dataclass(frozen=True)
class Planes:
    """Half-spaces n·y ≥ o on the centre y of the tool tip, in the frame of the mesh.

    A plane of a capsule holds for both ends of its axis.

    Attributes:
        normals: (m, 3) unit vectors to the allowed side.
        offsets: (m,) [m].
        points: (m, 3) the closest points that gave the planes [m].
        triangles: (m,) index of the face that gave each plane; −1 where it was no face.
        rules: (m,) values of `Rule`.
        radius: the planes are valid for steps that end within this distance of x [m]: the
            radius asked for, or less where the plane budget was spent.
        floors: (m,) what a *curved* path must not sink below anywhere on its way: with n·p ≥ floor
            for all planes and |p − x| ≤ radius, the tip at p touches nothing [m]. At most the
            offsets; −inf where a plane does not say; None: none does.
        capsules: (m,) number of the body of the instrument that a plane holds, 0: the tip; None:
            all of them the tip.
        fixtures: (m,) number of the controller's fixture that a plane is of; None: of one alone.
        of_axis: (m,) whether a plane holds the ends of its capsule's axis, and not the centre of
            the tip, from which the first capsule's axis may end apart; None: none does.
    """

    normals: FloatArray
    offsets: FloatArray
    points: FloatArray
    triangles: IntArray
    rules: IntArray
    radius: float
    floors: FloatArray | None = None
    capsules: IntArray | None = None
    fixtures: IntArray | None = None
    of_axis: BoolArray | None = None

    def __len__(self) -> int:
        return len(self.offsets)

    @staticmethod
    def none(radius: float) -> Planes:
        """No constraint but the ball of the given radius [m]."""
        empty = np.empty((0, 3))
        index = np.empty(0, dtype=np.int64)
        return Planes(empty, np.empty(0), empty, index, index, radius)

    def slack(self, y: FloatArray) -> FloatArray:
        """Signed room n·y − o of a tip centre y (3,) at every plane, (m,) [m]."""
        return self.normals @ y - self.offsets

    def of_tip(self) -> Planes:
        """Those that hold the centre of the tip alone."""
        if self.of_axis is None or not self.of_axis.any():
            return self
        kept = ~self.of_axis
        arrays: dict[str, Any] = {
            name: array[kept] for name, array in vars(self).items() if isinstance(array, np.ndarray)
        }
        return replace(self, **arrays)


def planes_of(records: FloatArray, radius: float) -> Planes:
    """Planes valid in `radius` [m] from their records (m, PLANE), as arrays of their own."""
    whole = records[:, [TRIANGLE, RULE, CAPSULE, FIXTURE]].astype(np.int64)
    return Planes(
        records[:, NORMAL : NORMAL + 3].copy(),
        records[:, OFFSET].copy(),
        records[:, FOOT : FOOT + 3].copy(),
        whole[:, 0].copy(),
        whole[:, 1].copy(),
        radius,
        records[:, FLOOR].copy(),
        whole[:, 2].copy(),
        whole[:, 3].copy(),
        records[:, POINT] > 0.0,
    )


def write_records(planes: Planes, fixture: int, records: FloatArray) -> None:
    """The planes as the first of the records (≥ m, PLANE), all of the tip and of one fixture."""
    written = records[: len(planes)]
    written[:] = 0.0
    written[:, NORMAL : NORMAL + 3] = planes.normals
    written[:, OFFSET] = planes.offsets
    written[:, FOOT : FOOT + 3] = planes.points
    written[:, TRIANGLE] = planes.triangles
    written[:, RULE] = planes.rules
    written[:, FLOOR] = -np.inf if planes.floors is None else planes.floors
    written[:, FIXTURE] = fixture
