"""What a tick did: fields read on demand from the bytes of its report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from vf import layout as at
from vf.planes import FloatArray, Planes, planes_of
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
        planes: the half-spaces that were verified at the new tip.
        force: (3,) haptic force [N].
        status: outcome of the tick.
        solver: how the optimum was found.
        multipliers: (m,) how far each plane pushed the tip back from where it would go [m].
        radius: of the motion sphere [m]; `planes.radius` is what was allowed of it.
        distance: from the tick's start to the nearest plane's closest point [m]; inf: none.
        limits: (n,) −1 at a joint's lower position limit, +1 at its upper one, else 0.
        timings: where the time went [s].
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
    ) -> None:
        self.__dict__.update(
            q=q, tip=tip, planes=planes, force=force, status=status, solver=solver,
            multipliers=multipliers, radius=radius, distance=distance, limits=limits,
            timings=timings,
        )  # fmt: skip

    def __getattr__(self, name: str) -> Any:
        """Fields are made from the tick's record at their first use.

        Few callers need all fields of every step, and ten arrays take longer than the tick itself.
        """
        if name not in _CUT:
            raise AttributeError(f"'Step' object has no attribute '{name}'")
        value = self.__dict__[name] = _CUT[name](*self.__dict__["_left"])
        return value


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
    "limits": lambda record, n, _: _read_only(
        numbers_of(record, at.HEAD + n, n).astype(np.int8)
    ),
    "timings": lambda record, n, started: _cut_timings(record, started),
}  # fmt: skip


def _read_only(array: Any) -> Any:
    array.flags.writeable = False
    return array
