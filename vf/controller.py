"""One tick of the virtual fixture: desired step → planes → QP → verify → step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from enum import IntEnum
from math import inf, isfinite
from time import perf_counter
from typing import NamedTuple, Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from vf.fixtures import ON_SURFACE, RULES, Fixture, MeshFixture
from vf.haptics import force
from vf.planes import FloatArray, Planes
from vf.problem import assemble, at_limits, obeys, pace, usable
from vf.qp import ConstrainedLeastSquares, Solution, Solver
from vf.surface import Surface

# Missing less than this share of the standoff is rounding, not a state to report.
NEGLIGIBLE = 0.1
# The optimum is sought this many ticks ahead and then shortened to one. A tool pressed on a wall by
# a proxy deep behind it spends its speed on the wall and crawls along it; looking farther makes it
# quicker there, and jumpier over ridges.
LOOK_AHEAD = 2.0
BISECTIONS = 12


class Status(IntEnum):
    """What became of a tick. Whatever it is, no unchecked motion was made."""

    SOLVED = 0  # the optimum was checked and taken
    SHORTENED = 1  # only a part of the step passed the check
    HELD = 2  # no step passed the check, or there was none: the tool stays
    RECOVERING = 3  # below the standoff: led out again, never deeper
    INSIDE = 4  # the tool is inside the anatomy
    REFUSED = 5  # the target or the joint vector is not usable: the tool stays


class Timings(NamedTuple):
    """Time spent by parts of a tick [s]."""

    kinematics: float
    planes: float  # query and choice of planes
    qp: float
    verify: float
    total: float


@dataclass(frozen=True)
class Settings:
    """What does not change from tick to tick.

    Attributes:
        dt: period of the control loop [s].
        standoff: distance kept between tool and surface [m].
        tip_radius: of the spherical cutter [m].
        rotation_length: weighs rotation against translation [m/rad].
        damping: λ, weighs joint motion [m²].
        force_gain: haptic stiffness K [N/m].
        force_cap: largest haptic force [N].
        tip_speed: a tick moves the tip by tip_speed × dt at most [m/s]; inf: only the joints' own
            speed limits count.

    Raises:
        ValueError: a value that is not finite (but for `tip_speed`) or out of its range.
    """

    dt: float = 1e-3
    standoff: float = 20e-6
    tip_radius: float = 0.0
    rotation_length: float = 0.05
    damping: float = 1e-7
    force_gain: float = 150.0
    force_cap: float = 4.0
    tip_speed: float = inf

    def __post_init__(self) -> None:
        strict = {"dt", "standoff", "rotation_length", "damping", "tip_speed"}
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name == "tip_speed" and value == inf:
                continue
            if not isfinite(value) or value < 0.0 or (value == 0.0 and field.name in strict):
                kind = "positive" if field.name in strict else "zero or more"
                raise ValueError(f"{field.name} must be finite and {kind}, got {value!r}")


@dataclass(frozen=True)
class Step:
    """What a tick did. Arrays are read-only; poses in the arm's base frame.

    Attributes:
        q: (n,) joint positions to command [rad or m].
        tip: T_base_tip at q.
        planes: the half-spaces that were verified at the new tip.
        force: (3,) haptic force [N].
        status: what became of the tick.
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


class Kinematics(Protocol):
    """What the controller needs of an arm; `robots.Arm` has it."""

    @property
    def lower(self) -> FloatArray: ...
    @property
    def upper(self) -> FloatArray: ...
    @property
    def velocity(self) -> FloatArray: ...
    def tip(self, q: ArrayLike) -> pin.SE3: ...
    def kinematics(self, q: ArrayLike) -> tuple[pin.SE3, FloatArray]: ...


class Controller:
    """Drives an arm's tip towards a target as far as the fixtures allow.

    `step` depends on its arguments and the settings alone: a recorded run repeats bit for bit on
    the same machine. Not thread-safe (it owns solver workspaces, and its arm's).
    """

    def __init__(
        self, arm: Kinematics, fixtures: Sequence[Fixture], settings: Settings | None = None
    ) -> None:
        self.arm = arm
        self.fixtures = tuple(fixtures)
        self.settings = settings or Settings()
        n = len(arm.lower)
        self._reach = arm.velocity * self.settings.dt
        self._tip_reach = self.settings.tip_speed * self.settings.dt
        self._horizon = LOOK_AHEAD * self._reach
        self._qp = ConstrainedLeastSquares(n)
        self._task = np.empty((6, n))
        self._desired = np.empty(6)
        self._lower = np.empty(n)
        self._upper = np.empty(n)
        self._idle = np.zeros(n, dtype=np.int8)
        self._idle.flags.writeable = False
        # Which side a tip was on. A checked step stays on its side, so only a tip that no step of
        # ours led to is looked up; the answer is the same, only the time is not.
        self._known: tuple[bytes, tuple[bool, ...]] = (b"", ())
        self._keeps_side = all(fixture.certified for fixture in self.fixtures)

    def warm_up(self) -> None:
        """Compile (or load from disk) every kernel a tick can meet.

        Takes some 20 s on the first start of an installation, and a fraction of a second later.
        """
        q = 0.5 * (self.arm.lower + self.arm.upper)
        T = self.arm.tip(q)
        corners = np.array([[0, 0, -1], [9, 0, -8], [-9, 9, -8], [-9, -9, -8]], dtype=float)
        faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])
        for centre in (
            T.translation,
            T.translation + np.array([0.0, 0.0, 3e-3]),
        ):  # outside, inside
            surface = Surface.from_arrays(corners * 1e-3 + centre, faces)
            for rule in RULES:
                fixture = MeshFixture(surface, rule)
                controller = Controller(self.arm, [fixture], self.settings)
                goal = T.copy()
                goal.translation = T.translation - [0.0, 0.0, 4e-3]
                state = q
                for _ in range(40):
                    state = controller.step(state, goal).q
        self.step(q, T)

    def step(self, q: ArrayLike, target: pin.SE3) -> Step:
        """One tick from joint positions q (n,) towards the tip pose `target`, base frame."""
        started = perf_counter()
        s = self.settings
        q = np.array(q, dtype=np.float64)
        if q.shape != self.arm.lower.shape or not isfinite(q.dot(q)):
            return self._refused(q, started)
        T, J = self.arm.kinematics(q)
        x = T.translation.copy()
        goal, R_goal = target.translation, target.rotation
        if not usable(goal, R_goal):
            return self._refused(q, started, T)
        known = time_kinematics = perf_counter()

        radius = self._radius(J)
        inside = self._sides(q, x)
        parts = [
            fixture.planes(x, radius, s.standoff, s.tip_radius, within)
            for fixture, within in zip(self.fixtures, inside, strict=True)
        ]
        planes = parts[0] if len(parts) == 1 else _join(parts, radius)
        m = len(planes)
        rows = np.empty((m, len(q)))
        bounds = np.empty(m)
        time_planes = perf_counter()

        distance, deficit = assemble(
            J, x, T.rotation, goal, R_goal, planes.radius, s.rotation_length,
            q, self.arm.lower, self.arm.upper,
            planes.normals, planes.offsets, planes.points, planes.rules, s.standoff, s.tip_radius,
            self._task, self._desired, self._lower, self._upper, rows, bounds,
        )  # fmt: skip
        recovering = deficit > NEGLIGIBLE * s.standoff
        solution = self._solve(rows, bounds)
        if solution.solver is Solver.INFEASIBLE and deficit > 0.0:
            # Recovery may be more than the joints can do; standing still never is.
            np.minimum(bounds, 0.0, out=bounds)
            solution = self._solve(rows, bounds)
        time_qp = perf_counter()

        q_new, T_new, share = self._verify(q, T, x, J, planes, rows, bounds, solution, inside)
        q_new.flags.writeable = False
        p_new = T_new.translation
        if any(inside):
            status = Status.INSIDE
        elif share == 0.0 or solution.solver is Solver.INFEASIBLE:
            status = Status.HELD
        elif recovering:
            status = Status.RECOVERING
        elif share < 1.0:
            status = Status.SHORTENED
        else:
            status = Status.SOLVED
        if self._keeps_side and status is not Status.INSIDE:
            self._known = (q_new.tobytes(), inside)
        limits = at_limits(q_new, self.arm.lower, self.arm.upper)
        F = force(p_new, goal, s.force_gain, s.force_cap)
        for array in (
            F, limits, solution.multipliers, planes.normals, planes.offsets, planes.points
        ):  # fmt: skip
            array.flags.writeable = False
        done = perf_counter()
        return Step(
            q_new,
            T_new,
            planes,
            F,
            status,
            solution.solver,
            solution.multipliers,
            radius,
            distance,
            limits,
            Timings(
                time_kinematics - started,
                time_planes - known,
                time_qp - time_planes,
                done - time_qp,
                done - started,
            ),
        )

    def _radius(self, J: FloatArray) -> float:
        """The smallest motion sphere the fixtures ask for; as far as a tick can go if none does."""
        asked = [f.radius for f in self.fixtures if f.radius is not None]
        if asked:
            return min(asked)
        columns = np.sqrt(np.einsum("ij,ij->j", J[:3], J[:3]))
        return max(float(columns @ self._reach), 2.0 * self.settings.standoff)

    def _sides(self, q: FloatArray, x: FloatArray) -> tuple[bool, ...]:
        key = q.tobytes()
        if self._known[0] != key:
            self._known = (key, tuple(fixture.inside(x) for fixture in self.fixtures))
        return self._known[1]

    def _solve(self, rows: FloatArray, bounds: FloatArray) -> Solution:
        return self._qp.solve(
            self._task, self._desired, self.settings.damping,
            rows, bounds, self._lower, self._upper, self._horizon,
        )  # fmt: skip

    def _verify(
        self,
        q: FloatArray,
        T: pin.SE3,
        x: FloatArray,
        J: FloatArray,
        planes: Planes,
        rows: FloatArray,
        bounds: FloatArray,
        solution: Solution,
        inside: tuple[bool, ...],
    ) -> tuple[FloatArray, pin.SE3, float]:
        """Joint positions whose true tip obeys every plane and the ball, its pose, and the share.

        The optimum is first shortened, all joints alike, to what they can do in a tick and what
        the tip may: it obeys the rows at any length, and the tip heads for where it will end.
        Tried in this order: that; the same with the rows moved by the linearisation error just
        seen; ever shorter parts of it; standing still.
        """
        paced = pace(solution.dq, self._reach, J, self._tip_reach)
        dq = paced * solution.dq
        if not dq.any():
            return q, T, 1.0
        T_new = self.arm.tip(q + dq)
        if self._allowed(T_new, x, planes, inside):
            return q + dq, T_new, 1.0
        error = T_new.translation - x - J[:3] @ dq
        second = self._solve(rows, (bounds - planes.normals @ error) / paced)
        if second.solver is not Solver.INFEASIBLE:
            share = pace(second.dq, self._reach, J, self._tip_reach)
            q_second = q + share * second.dq
            T_new = self.arm.tip(q_second)
            if self._allowed(T_new, x, planes, inside):
                return q_second, T_new, 1.0
        low, high = 0.0, 1.0
        best = (q, T, 0.0)
        for _ in range(BISECTIONS):
            share = 0.5 * (low + high)
            T_new = self.arm.tip(q + share * dq)
            if self._allowed(T_new, x, planes, inside):
                best = (q + share * dq, T_new, share)
                low = share
            else:
                high = share
        return best

    def _allowed(
        self, T_new: pin.SE3, x: FloatArray, planes: Planes, inside: tuple[bool, ...]
    ) -> bool:
        y = T_new.translation
        if not obeys(planes.normals, planes.offsets, planes.radius, x, y):
            return False
        for fixture, within in zip(self.fixtures, inside, strict=True):
            # Outside, or at least no deeper (the plane alone would allow a detour), and not on the
            # surface, where no plane can tell the sides apart.
            if within:
                depth = fixture.depth(y)
                if depth < ON_SURFACE or (fixture.inside(y) and depth > fixture.depth(x)):
                    return False
        return True

    def _refused(self, q: FloatArray, started: float, T: pin.SE3 | None = None) -> Step:
        zero = np.zeros(3)
        none = np.zeros(0)
        planes = Planes.none(0.0)
        for array in (q, zero, none, planes.normals, planes.offsets, planes.points):
            array.flags.writeable = False
        elapsed = perf_counter() - started
        return Step(
            q, T if T is not None else pin.SE3.Identity(), planes, zero,
            Status.REFUSED, Solver.IDLE, none, 0.0, inf, self._idle,
            Timings(elapsed, 0.0, 0.0, 0.0, elapsed),
        )  # fmt: skip


def _join(parts: Sequence[Planes], radius: float) -> Planes:
    """All planes of several fixtures, valid in the smallest of their balls."""
    if not parts:
        return Planes.none(radius)
    return Planes(
        np.concatenate([p.normals for p in parts]),
        np.concatenate([p.offsets for p in parts]),
        np.concatenate([p.points for p in parts]),
        np.concatenate([p.triangles for p in parts]),
        np.concatenate([p.rules for p in parts]),
        min(p.radius for p in parts),
    )
