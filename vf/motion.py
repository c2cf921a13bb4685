"""How a structure moves during a tick."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from vf.kernels import njit
from vf.planes import LARGEST, FloatArray, Planes, Rule, checked_blend, checked_length

# A rotation may be off orthonormal by this; it is made orthonormal where it is off by more than
# rounding.
ORTHONORMAL = 1e-4
ROUNDED = 1e-14
# A structure turns by less than this in a tick [rad]: beyond, its path is not known.
LARGEST_TURN = 3.0
NUMBERS = 30  # of a motion, see `Motion.record`


class Motion:
    """The pose of a fixture's frame at the start and at the end of a tick, in the arm's base frame.

    The surface, path or planes of the fixture are in that frame. In between the frame moves with a
    constant twist, or its origin in a straight line and its axes at a constant rate: what a tick
    promises holds for either. Where one tick ends the next should begin: the very same pose, or the
    side on which the tool is has to be looked up again.

    Args:
        start, end: T_base_structure at the start and at the end of the tick.
        margin: added to the margins of the fixture in this tick [m], as for a structure whose
            place is known to within that length, which a tool that cannot keep it is overtaken by.
            The certified rule alone uses it.
        growth: of the margin since the last tick [m]: the tool is led out by that much faster.
        blend: of a `DeformingSurface`, how far it is on its way from the one shape to the other at
            the start and at the end of the tick, each from 0 to 1. In between vertices move
            straight, in the frame of the structure.

    Raises:
        ValueError: not a pose, not finite, too far from the base, its rotation is not one, or from
            start to end it turns by 3 rad or more, or margin or growth is no length, or a blend is
            not from 0 to 1.
    """

    __slots__ = ("deforms", "packed", "record")

    # (30,) rows of the rotation, then the translation, at start and end; how far it turns [rad]
    # and, a bound, its origin goes [m]; margin and growth [m]; blends at start and end.
    record: FloatArray
    packed: bytes  # of the record
    deforms: bool  # whether a blend is not 0

    def __init__(
        self,
        start: pin.SE3,
        end: pin.SE3,
        margin: float = 0.0,
        growth: float = 0.0,
        blend: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        record = np.empty(NUMBERS)
        try:
            early, late = blend
            fine = type(start) is pin.SE3 and type(end) is pin.SE3 and _COMPILED.fill(
                start.homogeneous, end.homogeneous, float(margin), float(growth), float(early),
                float(late), record,
            )  # fmt: skip
        except Exception:  # an object may raise anything when it is converted
            fine = False
        if not fine:
            record[:] = _checked(start, end, margin, growth, blend)
        record.flags.writeable = False
        object.__setattr__(self, "record", record)
        object.__setattr__(self, "packed", record.tobytes())
        object.__setattr__(self, "deforms", record[28] != 0.0 or record[29] != 0.0)

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

    @property
    def blend(self) -> tuple[float, float]:
        return float(self.record[28]), float(self.record[29])

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Motion) and self.packed == other.packed

    def __hash__(self) -> int:
        return hash(self.packed)

    def __reduce__(self) -> tuple[Any, ...]:
        return Motion, (self.start, self.end, self.margin, self.growth, self.blend)

    def __repr__(self) -> str:
        return f"Motion({self.record[9:12].tolist()} → {self.record[21:24].tolist()} m)"


def _checked(start: Any, end: Any, margin: Any, growth: Any, blend: Any) -> FloatArray:
    """The numbers of a motion, with its poses made orthonormal; ValueError as `Motion` says."""
    poses = np.concatenate([_numbers("start", start), _numbers("end", end)])
    R0, R1 = poses[:9].reshape(3, 3), poses[12:21].reshape(3, 3)
    turn = float(np.linalg.norm(pin.log3(R0.T @ R1)))
    if turn >= LARGEST_TURN:
        raise ValueError(
            f"a structure must turn by less than {LARGEST_TURN:g} rad in a tick, got {turn:.3g}"
        )
    drift = _drift(float(np.linalg.norm(poses[21:] - poses[9:12])), turn)
    margins = [checked_length("margin", margin), checked_length("growth", growth)]
    return np.concatenate([poses, [turn, drift], margins, _blends(blend)])


@njit(cache=True)
def _drift(way, turn):  # type: ignore[no-untyped-def]
    """How far the origin goes at most [m]: of a constant twist its path is longer than the way."""
    return way * (1.0 + 0.25 * turn * turn)


@njit(cache=True)
def _fill(start, end, margin, growth, early, late, record):  # type: ignore[no-untyped-def]
    """Fill the record of a motion from two poses (4, 4); False: something is not as it should be.

    That is then said by `_checked`, or put right: a rotation that is orthonormal to `ORTHONORMAL`.
    """
    for pose, place in ((start, 0), (end, 12)):
        for i in range(3):
            if not abs(pose[i, 3]) <= LARGEST:
                return False
            record[place + 9 + i] = pose[i, 3]
            for j in range(3):
                record[place + 3 * i + j] = pose[i, j]
                dot = pose[0, i] * pose[0, j] + pose[1, i] * pose[1, j] + pose[2, i] * pose[2, j]
                if not abs(dot - (1.0 if i == j else 0.0)) <= ROUNDED:
                    return False
        det = (
            pose[0, 0] * (pose[1, 1] * pose[2, 2] - pose[1, 2] * pose[2, 1])
            - pose[0, 1] * (pose[1, 0] * pose[2, 2] - pose[1, 2] * pose[2, 0])
            + pose[0, 2] * (pose[1, 0] * pose[2, 1] - pose[1, 1] * pose[2, 0])
        )
        if not det > 0.0:
            return False
    trace = 0.0
    way = 0.0
    for i in range(3):
        way += (end[i, 3] - start[i, 3]) ** 2
        for k in range(3):
            trace += start[k, i] * end[k, i]
    sine2 = 0.0
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        skew = 0.0
        for c in range(3):
            skew += start[c, k] * end[c, j] - start[c, j] * end[c, k]
        sine2 += 0.25 * skew * skew
    turn = np.arctan2(np.sqrt(sine2), 0.5 * (trace - 1.0))
    fine = turn < LARGEST_TURN and 0.0 <= margin <= LARGEST and 0.0 <= growth <= LARGEST
    record[24], record[25] = turn, _drift(np.sqrt(way), turn)
    record[26], record[27], record[28], record[29] = margin, growth, early, late
    return fine and 0.0 <= early <= 1.0 and 0.0 <= late <= 1.0


class _Compiled:
    """Compiled for fixed types when the first motion is made, and not checked at every call."""

    @cached_property
    def fill(self) -> Callable[..., bool]:
        return _fill.compile("(f8[:, :], f8[:, :], f8, f8, f8, f8, f8[::1])")


_COMPILED = _Compiled()


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


def _blends(blend: Any) -> list[float]:
    try:
        start, end = blend
    except (TypeError, ValueError):
        raise ValueError(
            f"the blend of a motion must be two numbers, at its start and its end, got {blend!r}"
        ) from None
    return [checked_blend("blend at the start", start), checked_blend("blend at the end", end)]


def shifted(planes: Planes, shift: FloatArray, spread: FloatArray) -> tuple[Planes, FloatArray]:
    """Planes where they have to be for a surface that deforms, and how far each was moved (m,) [m].

    What they cover is displaced by `shift` (3,), give or take `spread` (3,).
    """
    wide = np.abs(planes.normals) @ spread
    if planes.floors is not None:
        # The plane that lets a tool inside get no deeper covers nothing: it goes along.
        wide = np.where((planes.rules == Rule.EXIT) & (planes.floors == -np.inf), 0.0, wide)
    along = planes.normals @ shift + wide
    moved = replace(
        planes,
        offsets=planes.offsets + along,
        points=planes.points + shift + wide[:, None] * planes.normals,
        floors=None if planes.floors is None else planes.floors + along,
    )
    return moved, along


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
