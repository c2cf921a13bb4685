"""What a tick did: fields read on demand from the bytes of its report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import nan
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from vf import layout as at
from vf.planes import FloatArray, Planes, planes_of, write_records
from vf.qp.solver import Solver
from vf.status import Status


class Timings(NamedTuple):
    """Time spent by parts of a tick [s]."""

    kinematics: float
    planes: float  # query and choice of planes
    qp: float
    verify: float
    total: float


@dataclass(frozen=True, init=False)
class Step:
    """What a tick did. Arrays are read-only; poses in the arm's base frame.

    Attributes:
        q: (n,) joint positions to command [rad or m].
        tip: T_base_tip at q.
        planes: the half-spaces that were verified at the new tip; of a structure that moves as
            they stand at the end of the tick.
        force: (3,) haptic force [N].
        status: outcome of the tick.
        solver: how the optimum was found.
        multipliers: (m,) how far each plane pushed the tip back from where it would go [m].
        radius: of the motion sphere [m]; `planes.radius` is what was allowed of it.
        distance: from the tick's start to the nearest plane's closest point [m]; inf: none. That
            of a structure that moves is where it is at the end of the tick.
        limits: (n,) −1 at a joint's lower position limit, +1 at its upper one, else 0.
        timings: where the time went [s].
        violation: with the status OVERTAKEN, how deep the anatomy may be in the tool at most [m]:
            at some place within this distance the tool would be free. Of a body that overlaps the
            anatomy when the tick begins it is how deep it is at the end of the tick. Of a structure
            that is known to within `Motion.margin` it is how deep the true one may be. Else 0.
    """

    q: FloatArray
    tip: pin.SE3
    planes: Planes
    force: FloatArray
    status: Status
    solver: Solver
    multipliers: FloatArray
    radius: float
    distance: float
    limits: NDArray[np.int8]
    timings: Timings
    violation: float

    def __init__(
        self,
        q: FloatArray,
        tip: pin.SE3,
        planes: Planes,
        force: FloatArray,
        status: Status,
        solver: Solver,
        multipliers: FloatArray,
        radius: float,
        distance: float,
        limits: NDArray[np.int8],
        timings: Timings,
        violation: float = 0.0,
    ) -> None:
        self.__dict__.update(
            q=q, tip=tip, planes=planes, force=force, status=status, solver=solver,
            multipliers=multipliers, radius=radius, distance=distance, limits=limits,
            timings=timings, violation=violation,
        )  # fmt: skip

    def __getattr__(self, name: str) -> Any:
        """Fields are made from the tick's record at their first use.

        Few callers need all fields of every step, and ten arrays take longer than the tick itself.
        """
        if name not in _CUT:
            raise AttributeError(f"'Step' object has no attribute '{name}'")
        value = self.__dict__[name] = _CUT[name](*self.__dict__["_left"])
        return value

    @property
    def packed(self) -> tuple[bytes, int, float]:
        """What `unpacked` makes an equal step of: its record, n, and when the tick began [s].

        The record is REPORT of `vf.layout` with the planes behind it, 8 bytes a number. Fields of
        planes that are None are written as what they mean: −inf for floors, 0 for the others.
        """
        left: tuple[bytes, int, float] | None = self.__dict__.get("_left")
        return _record_of(self) if left is None else left

    @staticmethod
    def unpacked(record: bytes, n: int, started: float) -> Step:
        """The step of `packed`; its arrays are parts of the record."""
        step = object.__new__(Step)
        step.__dict__["_left"] = (record, n, started)
        return step

    def held(self, q: FloatArray, tip: pin.SE3, status: Status) -> Step:
        """This step for a tool that stays at the joints q (n,), with its tip there: no force."""
        record, n, started = self.packed
        whole = np.frombuffer(bytearray(record), np.float64)
        whole[at.HEAD : at.HEAD + n] = q
        whole[at.REPORT_TIP : at.REPORT_TIP + 12] = tip.homogeneous[:3].ravel()
        whole[at.REPORT_FORCE : at.REPORT_FORCE + 3] = 0.0
        whole[at.REPORT_STATUS] = status
        return Step.unpacked(whole.tobytes(), n, started)


def numbers_of(record: bytes, first: int, count: int) -> FloatArray:
    """Numbers of the record of a step, read-only like the record itself."""
    return np.frombuffer(record, np.float64, count, 8 * first)


def _number(record: bytes, place: int) -> float:
    return float(numbers_of(record, place, 1)[0])


def tip_of(record: bytes) -> pin.SE3:
    T = numbers_of(record, at.REPORT_TIP, 12).reshape(3, 4)
    return pin.SE3(T[:, :3], T[:, 3])


def _records(record: bytes, n: int) -> FloatArray:
    """The planes (m, PLANE)."""
    return numbers_of(record, at.HEAD + 2 * n, -1).reshape(-1, at.PLANE)


def _cut_planes(record: bytes, n: int) -> Planes:
    planes = planes_of(_records(record, n), _number(record, at.REPORT_ALLOWED))
    for array in vars(planes).values():
        if isinstance(array, np.ndarray):
            array.flags.writeable = False
    return planes


def _cut_timings(record: bytes, started: float) -> Timings:
    placed, found, solved, ended = numbers_of(record, at.REPORT_MARKS, 4).tolist()
    return Timings(
        placed - started, found - placed, solved - found, ended - solved, ended - started
    )


def _record_of(step: Step) -> tuple[bytes, int, float]:
    """`Step.packed` of a step that was made of its fields."""
    n, m, planes = len(step.limits), len(step.planes), step.planes
    whole = np.zeros(at.HEAD + 2 * n + at.PLANE * m)
    whole[[at.REPORT_STATUS, at.REPORT_SOLVER]] = step.status, step.solver
    whole[at.REPORT_RADIUS], whole[at.REPORT_ALLOWED] = step.radius, planes.radius
    whole[at.REPORT_DISTANCE] = step.distance
    whole[at.REPORT_VIOLATION] = step.violation
    whole[at.REPORT_MARKS : at.REPORT_MARKS + 4] = np.cumsum(step.timings[:4])
    whole[at.REPORT_FORCE : at.REPORT_FORCE + 3] = step.force
    whole[at.REPORT_TIP : at.REPORT_TIP + 12] = step.tip.homogeneous[:3].ravel()
    whole[at.HEAD : at.HEAD + n] = step.q if step.q.shape == (n,) else nan
    whole[at.HEAD + n : at.HEAD + 2 * n] = step.limits
    rows = whole[at.HEAD + 2 * n :].reshape(m, at.PLANE)
    write_records(planes, 0, rows)
    if planes.capsules is not None:
        rows[:, at.CAPSULE] = planes.capsules
    if planes.fixtures is not None:
        rows[:, at.FIXTURE] = planes.fixtures
    if planes.of_axis is not None:
        rows[:, at.POINT] = planes.of_axis
    rows[:, at.PUSH] = step.multipliers
    return whole.tobytes(), n, 0.0


# How each field is made from a tick's record, the number of joints n, and when it began [s].
_CUT: dict[str, Callable[[bytes, int, float], Any]] = {
    "q": lambda record, n, _: numbers_of(record, at.HEAD, n),
    "tip": lambda record, n, _: tip_of(record),
    "planes": lambda record, n, _: _cut_planes(record, n),
    "force": lambda record, n, _: numbers_of(record, at.REPORT_FORCE, 3),
    "status": lambda record, n, _: Status(int(_number(record, at.REPORT_STATUS))),
    "solver": lambda record, n, _: Solver(int(_number(record, at.REPORT_SOLVER))),
    "multipliers": lambda record, n, _: _read_only(_records(record, n)[:, at.PUSH].copy()),
    "radius": lambda record, n, _: _number(record, at.REPORT_RADIUS),
    "distance": lambda record, n, _: _number(record, at.REPORT_DISTANCE),
    "violation": lambda record, n, _: _number(record, at.REPORT_VIOLATION),
    "limits": lambda record, n, _: _read_only(
        numbers_of(record, at.HEAD + n, n).astype(np.int8)
    ),
    "timings": lambda record, n, started: _cut_timings(record, started),
}  # fmt: skip


def _read_only(array: Any) -> Any:
    array.flags.writeable = False
    return array
