"""How a structure moves during a tick."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from vf.planes import LARGEST, FloatArray, Planes, checked_length

# A rotation may be off orthonormal by this; it is made orthonormal where it is off by more than
# rounding.
ORTHONORMAL = 1e-4
ROUNDED = 1e-14
# A structure turns by less than this in a tick [rad]: beyond, its path is not known.
LARGEST_TURN = 3.0


class Motion:
    """The pose of a fixture's frame at the start and at the end of a tick, in the arm's base frame.

    The surface, path or planes of the fixture are in that frame. In between the frame moves with a
    constant twist, or its origin in a straight line and its axes at a constant rate: what a tick
    promises holds for either. Where one tick ends the next should begin: the very same pose, or the
    side on which the tool is has to be looked up again.

    Args:
        start, end: T_base_structure at the start and at the end of the tick.
        margin: added to the margins of the fixture in this tick [m], as for a structure whose
            place is known to within that length. The certified rule alone uses it.
        growth: of the margin since the last tick [m]: the tool is led out by that much faster.

    Raises:
        ValueError: not a pose, not finite, too far from the base, its rotation is not one, or from
            start to end it turns by 3 rad or more, or margin or growth is no length.
    """

    __slots__ = ("packed", "record")

    # (28,) rows of the rotation, then the translation, at start and end; how far it turns [rad]
    # and, a bound, its origin goes [m]; margin and growth [m].
    record: FloatArray
    packed: bytes  # of the record

    def __init__(
        self, start: pin.SE3, end: pin.SE3, margin: float = 0.0, growth: float = 0.0
    ) -> None:
        poses = np.concatenate([_numbers("start", start), _numbers("end", end)])
        R0, R1 = poses[:9].reshape(3, 3), poses[12:21].reshape(3, 3)
        turn = float(np.linalg.norm(pin.log3(R0.T @ R1)))
        if turn >= LARGEST_TURN:
            raise ValueError(
                f"a structure must turn by less than {LARGEST_TURN:g} rad in a tick, got {turn:.3g}"
            )
        # Of a constant twist the origin's path is longer than the way.
        drift = float(np.linalg.norm(poses[21:] - poses[9:12])) * (1.0 + 0.25 * turn * turn)
        margins = [checked_length("margin", margin), checked_length("growth", growth)]
        record = np.concatenate([poses, [turn, drift], margins])
        record.flags.writeable = False
        object.__setattr__(self, "record", record)
        object.__setattr__(self, "packed", record.tobytes())

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError("a Motion does not change: make another")

    @property
    def start(self) -> pin.SE3:
        return pin.SE3(self.record[:9].reshape(3, 3).copy(), self.record[9:12].copy())

    @property
    def end(self) -> pin.SE3:
        return pin.SE3(self.record[12:21].reshape(3, 3).copy(), self.record[21:24].copy())

    @property
    def margin(self) -> float:
        return float(self.record[26])

    @property
    def growth(self) -> float:
        return float(self.record[27])

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Motion) and self.packed == other.packed

    def __hash__(self) -> int:
        return hash(self.packed)

    def __reduce__(self) -> tuple[Any, ...]:
        return Motion, (self.start, self.end, self.margin, self.growth)

    def __repr__(self) -> str:
        return f"Motion({self.record[9:12].tolist()} → {self.record[21:24].tolist()} m)"


def _numbers(name: str, pose: Any) -> FloatArray:
    """The twelve numbers of a pose, its rotation orthonormal."""
    if not isinstance(pose, pin.SE3):
        raise ValueError(f"the {name} of a motion must be a pinocchio.SE3, got {pose!r}")
    R, t = np.array(pose.rotation), np.array(pose.translation)
    if not (np.abs(t) <= LARGEST).all():
        raise ValueError(f"the {name} of a motion must be within ±{LARGEST:g} m, got {t.tolist()}")
    off = float(np.abs(R.T @ R - np.eye(3)).max())
    if not off <= ORTHONORMAL or np.linalg.det(R) < 0.0:
        raise ValueError(f"the {name} of a motion must have a rotation matrix, got {R.tolist()}")
    for _ in range(3):
        if off <= ROUNDED:
            break
        R = 0.5 * R @ (3.0 * np.eye(3) - R.T @ R)
        off = float(np.abs(R.T @ R - np.eye(3)).max())
    return np.concatenate([R.ravel(), t])


def seen_from(pose: FloatArray, x: FloatArray) -> FloatArray:
    """A point (3,) of the base frame in the frame of a pose, twelve numbers as in a record."""
    return np.asarray((x - pose[9:]) @ pose[:9].reshape(3, 3))


def placed(planes: Planes, pose: FloatArray, more: float) -> Planes:
    """Planes of the frame of a pose in the base frame, valid in a ball that is less by `more`."""
    R, t = pose[:9].reshape(3, 3), pose[9:]
    normals = planes.normals @ R.T
    rise = normals @ t
    return replace(
        planes,
        normals=normals,
        offsets=planes.offsets + rise,
        points=planes.points @ R.T + t,
        floors=None if planes.floors is None else planes.floors + rise,
        radius=max(planes.radius - more, 0.0),
    )
