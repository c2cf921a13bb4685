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
from numba import njit
from numpy.typing import ArrayLike, NDArray

from vf.fixtures import ON_SURFACE, RULES, Fixture, MeshFixture
from vf.haptics import force
from vf.planes import FloatArray, Planes
from vf.qp import ConstrainedLeastSquares, Solution, Solver
from vf.surface import Surface

# A target farther than this from the base is a mistake, not a wish [m].
FARTHEST = 10.0
# Rows are tightened by this against the planes that are verified, ten times OSQP's tolerance, so
# that a tick in contact does not miss by rounding [m].
HAIR = 1e-6
# Share of what is missing to the standoff that a tick wins back.
RECOVERY = 0.5
# Missing less than this share of the standoff is rounding, not a state to report.
NEGLIGIBLE = 0.1
SWEEPS = 16
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

    Raises:
        ValueError: a value that is not finite or out of its range.
    """

    dt: float = 1e-3
    standoff: float = 20e-6
    tip_radius: float = 0.0
    rotation_length: float = 0.05
    damping: float = 1e-7
    force_gain: float = 150.0
    force_cap: float = 4.0

    def __post_init__(self) -> None:
        strict = {"dt", "standoff", "rotation_length", "damping"}
        for field in fields(self):
            value = getattr(self, field.name)
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
        if not _usable(goal, R_goal):
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

        distance, deficit = _assemble(
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
        limits = _at_limits(q_new, self.arm.lower, self.arm.upper)
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

        The optimum is first shortened, all joints alike, to what they can do in a tick: it obeys
        the rows at any length, and the tip heads for where it will end. Tried in this order: that;
        the same with the rows moved by the linearisation error just seen; ever shorter parts of it;
        standing still.
        """
        pace = _pace(solution.dq, self._reach)
        dq = pace * solution.dq
        if not dq.any():
            return q, T, 1.0
        T_new = self.arm.tip(q + dq)
        if self._allowed(T_new, x, planes, inside):
            return q + dq, T_new, 1.0
        error = T_new.translation - x - J[:3] @ dq
        second = self._solve(rows, (bounds - planes.normals @ error) / pace)
        if second.solver is not Solver.INFEASIBLE:
            q_second = q + _pace(second.dq, self._reach) * second.dq
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
        if not _obeys(planes.normals, planes.offsets, planes.radius, x, y):
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


@njit(cache=True, nogil=True)
def _usable(p, R):  # type: ignore[no-untyped-def]
    """Whether p (3,) is near enough and R (3, 3) a rotation: finite, orthonormal, right-handed."""
    for k in range(3):
        if not abs(p[k]) < FARTHEST:
            return False
    for i in range(3):
        for j in range(3):
            dot = R[i, 0] * R[j, 0] + R[i, 1] * R[j, 1] + R[i, 2] * R[j, 2]
            if not abs(dot - (1.0 if i == j else 0.0)) < 1e-4:
                return False
    det = (
        R[0, 0] * (R[1, 1] * R[2, 2] - R[1, 2] * R[2, 1])
        - R[0, 1] * (R[1, 0] * R[2, 2] - R[1, 2] * R[2, 0])
        + R[0, 2] * (R[1, 0] * R[2, 1] - R[1, 1] * R[2, 0])
    )
    return det > 0.0


@njit(cache=True, nogil=True)
def rotation_log(R, w):  # type: ignore[no-untyped-def]
    """Rotation vector w (3,) [rad] of the rotation matrix R (3, 3), up to half a turn."""
    w[0] = 0.5 * (R[2, 1] - R[1, 2])
    w[1] = 0.5 * (R[0, 2] - R[2, 0])
    w[2] = 0.5 * (R[1, 0] - R[0, 1])
    sine = np.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    cosine = 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0)
    angle = np.arctan2(sine, cosine)
    if cosine > -0.99:
        scale = angle / sine if sine > 1e-12 else 1.0
        for k in range(3):
            w[k] *= scale
        return
    # Near half a turn the skew part vanishes; (R + Rᵀ)/2 − cos·I = (1 − cos) a aᵀ does not.
    k = 0
    for j in range(1, 3):
        if R[j, j] > R[k, k]:
            k = j
    sign = 1.0 if w[k] >= 0.0 else -1.0
    norm = 0.0
    for j in range(3):
        w[j] = 0.5 * (R[j, k] + R[k, j]) - (cosine if j == k else 0.0)
        norm += w[j] * w[j]
    scale = sign * angle / np.sqrt(norm)
    for j in range(3):
        w[j] *= scale


@njit(cache=True, nogil=True)
def _prepare(  # type: ignore[no-untyped-def]
    J, x, R, goal, R_goal, radius, length, q, lowest, highest, task, desired, lower, upper
):
    """Weighted task Jacobian, clamped desired step, and the joint bounds of this tick."""
    n = J.shape[1]
    turn = np.empty((3, 3))
    w = np.empty(3)
    for i in range(3):
        for j in range(3):
            turn[i, j] = R_goal[i, 0] * R[j, 0] + R_goal[i, 1] * R[j, 1] + R_goal[i, 2] * R[j, 2]
    rotation_log(turn, w)
    move = 0.0
    spin = 0.0
    for k in range(3):
        desired[k] = goal[k] - x[k]
        desired[3 + k] = length * w[k]
        move += desired[k] * desired[k]
        spin += desired[3 + k] * desired[3 + k]
    move = np.sqrt(move)
    spin = np.sqrt(spin)
    for k in range(3):
        if move > radius:
            desired[k] *= radius / move
        if spin > radius:
            desired[3 + k] *= radius / spin
    for j in range(n):
        for k in range(3):
            task[k, j] = J[k, j]
            task[3 + k, j] = length * J[3 + k, j]
        # A joint pushed beyond its limit may stay or come back, so that zero is always allowed.
        lower[j] = min(lowest[j] - q[j], 0.0)
        upper[j] = max(highest[j] - q[j], 0.0)


@njit(cache=True, nogil=True)
def _rows(normals, offsets, points, rules, x, J, standoff, tip_radius, rows, bounds):  # type: ignore[no-untyped-def]
    """Rows n·J Δq ≥ b of the planes; returns the nearest point's distance and the worst deficit.

    A tool below the standoff is asked to come out by a share of what is missing. Walls closer than
    two standoffs cannot both be obeyed, so the requests are first reconciled in the tip's space:
    alternating projections give a motion v, and no row asks for more than v does.
    """
    m = normals.shape[0]
    n = J.shape[1]
    nearest = np.inf
    deficit = 0.0
    for i in range(m):
        d2 = 0.0
        height = 0.0
        level = 0.0
        for k in range(3):
            d2 += (x[k] - points[i, k]) ** 2
            height += normals[i, k] * x[k]
            level += normals[i, k] * points[i, k]
        nearest = min(nearest, d2)
        for j in range(n):
            rows[i, j] = normals[i, 0] * J[0, j] + normals[i, 1] * J[1, j] + normals[i, 2] * J[2, j]
        if rules[i] == 4:
            bounds[i] = 0.0
            continue
        missing = level + standoff + tip_radius - height
        deficit = max(deficit, missing)
        # A plane moved beyond the standoff is obeyed, but being on it is nothing to recover from.
        missing = max(missing, min(offsets[i] - height, 0.0)) + HAIR
        bounds[i] = RECOVERY * missing if missing > 0.0 else missing
    nearest = np.sqrt(nearest)
    if deficit + HAIR <= 0.0:
        return nearest, deficit
    v0 = v1 = v2 = 0.0
    for _ in range(SWEEPS):
        moved = False
        for i in range(m):
            gap = bounds[i] - (normals[i, 0] * v0 + normals[i, 1] * v1 + normals[i, 2] * v2)
            if gap > 1e-10:
                v0 += gap * normals[i, 0]
                v1 += gap * normals[i, 1]
                v2 += gap * normals[i, 2]
                moved = True
        if not moved:
            break
    share = 1.0
    for i in range(m):
        gain = normals[i, 0] * v0 + normals[i, 1] * v1 + normals[i, 2] * v2
        if gain < bounds[i]:
            if bounds[i] < 0.0:
                share = min(share, bounds[i] / gain)
            elif gain < 0.0:
                share = 0.0
    for i in range(m):
        if bounds[i] > 0.0:
            gain = normals[i, 0] * v0 + normals[i, 1] * v1 + normals[i, 2] * v2
            bounds[i] = min(bounds[i], max(share * gain, 0.0))
    return nearest, deficit


@njit(cache=True, nogil=True)
def _assemble(  # type: ignore[no-untyped-def]
    J, x, R, goal, R_goal, radius, length, q, lowest, highest,
    normals, offsets, points, rules, standoff, tip_radius,
    task, desired, lower, upper, rows, bounds,
):  # fmt: skip
    """The whole problem of a tick in one call from Python: `_prepare`, then `_rows`."""
    _prepare(
        J, x, R, goal, R_goal, radius, length, q, lowest, highest,
        task, desired, lower, upper,
    )  # fmt: skip
    return _rows(normals, offsets, points, rules, x, J, standoff, tip_radius, rows, bounds)


@njit(cache=True, nogil=True)
def _pace(dq, reach):  # type: ignore[no-untyped-def]
    """Largest share ≤ 1 of the joint step dq (n,) with every joint within its reach (n,)."""
    share = 1.0
    for j in range(dq.shape[0]):
        if abs(dq[j]) * share > reach[j]:
            share = reach[j] / abs(dq[j])
    return share


@njit(cache=True, nogil=True)
def _at_limits(q, lower, upper):  # type: ignore[no-untyped-def]
    """−1 where a joint is at its lower limit, +1 at its upper one, else 0."""
    limits = np.zeros(q.shape[0], dtype=np.int8)
    for j in range(q.shape[0]):
        if q[j] >= upper[j]:
            limits[j] = 1
        elif q[j] <= lower[j]:
            limits[j] = -1
    return limits


@njit(cache=True, nogil=True)
def _obeys(normals, offsets, radius, x, y):  # type: ignore[no-untyped-def]
    """Whether the tip y is in the ball around x and on the allowed side of every plane."""
    d2 = (y[0] - x[0]) ** 2 + (y[1] - x[1]) ** 2 + (y[2] - x[2]) ** 2
    if not d2 <= radius * radius:
        return False
    for i in range(normals.shape[0]):
        slack = normals[i, 0] * y[0] + normals[i, 1] * y[1] + normals[i, 2] * y[2] - offsets[i]
        if not slack >= 0.0:
            return False
    return True
