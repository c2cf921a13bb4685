"""One tick of the virtual fixture: desired step → planes → QP → verify → step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from enum import IntEnum
from math import inf, nan
from time import perf_counter
from typing import Any, NamedTuple, Protocol, cast

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from vf import problem
from vf.corridor import CorridorFixture
from vf.cover import BUDGET, YIELD, Buffer
from vf.fixtures import RULES, Filling, Fixture, MeshFixture
from vf.pdtree import nearest_face_freely
from vf.planes import FloatArray, Planes
from vf.problem import JOINT_RANGE
from vf.qp import ConstrainedLeastSquares, Solver
from vf.qp_kernels import attempt
from vf.selftest import check_kernels
from vf.surface import Surface

# Missing less than this share of the standoff is rounding, not a state to report.
NEGLIGIBLE = 0.1
# The optimum is sought this many ticks ahead and then shortened to one. A tool pressed on a wall by
# a proxy deep behind it spends its speed on the wall and crawls along it; looking farther makes it
# quicker there, and jumpier over ridges.
LOOK_AHEAD = 2.0
BISECTIONS = 12
# How often a step is shortened to where the true tip keeps to the motion sphere and to its speed.
SHORTER = 4


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
        ValueError: a value that is no number or out of its range.
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
        for field in fields(self):
            value = getattr(self, field.name)
            low, high, unit = RANGES[field.name]
            try:
                # A float whatever kind of number came: kernels are compiled anew for any other.
                number = float(value)
            except (TypeError, ValueError):
                number = nan
            if not low <= number <= high:
                raise ValueError(
                    f"{field.name} must be a number from {low:g} to {high:g}{unit}, got {value!r}"
                )
            object.__setattr__(self, field.name, number)


# Lowest and highest value and the unit of each of the `Settings`.
RANGES = {
    "dt": (1e-6, 10.0, " s"),
    "standoff": (1e-9, 1.0, " m"),
    "tip_radius": (0.0, 1.0, " m"),
    "rotation_length": (1e-6, 1e3, " m/rad"),
    "damping": (1e-15, 1e3, " m²"),
    "force_gain": (0.0, 1e6, " N/m"),
    "force_cap": (0.0, 1e6, " N"),
    "tip_speed": (1e-9, inf, " m/s"),
}


@dataclass(frozen=True, init=False)
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

    @staticmethod
    def _reported(fields: dict[str, Any]) -> Step:
        """A step whose further fields are cut out of a report when they are first asked for.

        A tick makes a step, but few look at all of it: ten arrays cost as much as the solver.
        """
        step = object.__new__(Step)
        step.__dict__.update(fields)
        return step

    def __getattr__(self, name: str) -> Any:
        if name not in _CUT:
            raise AttributeError(f"'Step' object has no attribute '{name}'")
        fields = self.__dict__
        out, n, m = fields["_out"], len(fields["q"]), fields["_m"]
        value: Any
        if name == "timings":
            value = Timings(*fields["_times"])
        elif name == "force":
            value = out[:3]
        elif name == "limits":
            value = out[3 : 3 + n].astype(np.int8)
        elif name == "multipliers":
            value = out[3 + n : 3 + n + m]
        else:
            at = 3 + n + m
            normals, offsets, points, triangles, rules = np.split(
                out[at:], [3 * m, 4 * m, 7 * m, 8 * m]
            )
            value = Planes(
                normals.reshape(m, 3),
                offsets,
                points.reshape(m, 3),
                _read_only(triangles.astype(np.int64)),
                _read_only(rules.astype(np.int64)),
                fields["_reach"],
            )
        if name == "limits":
            _read_only(value)
        fields[name] = value
        return value


_CUT = ("planes", "force", "multipliers", "limits", "timings")


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

    `step` depends on its arguments and the settings alone (but for what it returns where the joints
    are of no use): a recorded run repeats bit for bit on the same machine. Not thread-safe (it owns
    solver workspaces, and its arm's).

    Raises:
        RuntimeError: a kernel gives a wrong answer on this machine, see `warm_up`.
    """

    _warm = False  # whether this process has every kernel of a tick in memory

    def __init__(
        self, arm: Kinematics, fixtures: Sequence[Fixture], settings: Settings | None = None
    ) -> None:
        self.arm = arm
        self.fixtures = tuple(fixtures)
        self.settings = settings or Settings()
        n = len(arm.lower)
        self._tip_reach = self.settings.tip_speed * self.settings.dt
        self._qp = ConstrainedLeastSquares(n)
        self._table = np.zeros((problem.TABLE, n))
        self._table[problem.LOWEST] = arm.lower
        self._table[problem.HIGHEST] = arm.upper
        self._table[problem.REACH] = self._reach = arm.velocity * self.settings.dt
        self._table[problem.HORIZON] = LOOK_AHEAD * self._reach
        self._lower, self._upper = self._table[problem.LOWER], self._table[problem.UPPER]
        s = self.settings
        self._numbers = np.zeros(problem.NUMBERS)
        # Whether a fixture promises anything of the tip's path, and not only of where it ends.
        guarded = any(getattr(fixture, "fills", False) for fixture in self.fixtures)
        self._numbers[problem.STANDOFF : problem.BULGE] = (
            s.standoff, s.tip_radius, s.rotation_length, s.damping, s.force_gain, s.force_cap,
            self._tip_reach, guarded,
        )  # fmt: skip
        # A joint of an arm that does not say what it is counts as revolute: that bends more.
        revolute = getattr(arm, "revolute", np.ones(n))
        self._table[problem.REVOLUTE] = revolute
        # The ball searched is larger than the motion sphere by what the path of a step at full
        # speed leaves its chord; a step that bends more is shortened.
        _, J = arm.kinematics(0.5 * (arm.lower + arm.upper))
        self._bulge = 1.5 * problem.sagitta(J, self._reach, 1.0, self._table[problem.REVOLUTE])
        self._bulge *= guarded
        self._beyond = guarded * self.settings.standoff
        queries = max(len(self.fixtures), 1)
        self._reserve(queries * BUDGET)
        self._buffer = Buffer(queries)
        self._filling = [cast(Filling, f) for f in self.fixtures if getattr(f, "fills", False)]
        asked = [f.radius for f in self.fixtures if f.radius is not None]
        self._asked = min(asked) if asked else None
        self._idle = np.zeros(n, dtype=np.int8)
        self._idle.flags.writeable = False
        # Which side a tip was on. A checked step stays on its side, so only a tip that no step of
        # ours led to is looked up; the answer is the same, only the time is not.
        self._known: tuple[bytes, tuple[bool, ...]] = (b"", ())
        # The last joints that a tick returned, and their tip: where the arm was sent.
        self._sent: tuple[FloatArray, pin.SE3] | None = None
        self._keeps_side = all(fixture.certified for fixture in self.fixtures)
        if not Controller._warm:
            Controller._warm = True  # first: it makes controllers
            try:
                self.warm_up()
            except RuntimeError:
                Controller._warm = False
                raise

    def warm_up(self) -> None:
        """Compile (or load from disk) every kernel a tick can meet, and check known answers.

        The first controller of a process does this when it is made, so no tick has to. Takes some
        20 s on the first start of an installation, and a fraction of a second later.

        Raises:
            RuntimeError: a kernel gives a wrong answer on this machine (`vf.check_kernels`).
        """
        check_kernels()
        sent = self._sent
        q = 0.5 * (self.arm.lower + self.arm.upper)
        T = self.arm.tip(q)
        corners = np.array([[0, 0, -1], [9, 0, -8], [-9, 9, -8], [-9, -9, -8]], dtype=float)
        faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])
        for centre in (
            T.translation,
            T.translation + np.array([0.0, 0.0, 3e-3]),
        ):  # outside, inside
            surface = Surface.from_arrays(corners * 1e-3 + centre, faces)
            # What `Surface.nearest` goes on with in the middle of a large ball, hardly elsewhere.
            tree = surface.tree
            nearest_face_freely(tree.nodes, tree.corners, T.translation.copy(), inf, -1)
            # And what only a step out of a body asks.
            MeshFixture(surface).leads_out(T.translation, T.translation + 0.01)
            for rule in RULES:
                fixture = MeshFixture(surface, rule)
                controller = Controller(self.arm, [fixture], self.settings)
                goal = T.copy()
                goal.translation = T.translation - [0.0, 0.0, 4e-3]
                state = q
                for _ in range(40):
                    state = controller.step(state, goal).q
        along = np.array([0.01, 0.0, 0.0])
        walls = CorridorFixture([T.translation - along, T.translation + along], [0.0, 0.0, -1.0])
        Controller(self.arm, [walls, walls], self.settings).step(q, T)
        self.step(q, T)
        self._sent = sent

    def step(self, q: ArrayLike, target: pin.SE3) -> Step:
        """One tick from joint positions q (n,) towards the tip pose `target`, base frame.

        Raises nothing: what cannot be used as one or the other is REFUSED. The step's `q` is then q
        itself if the target was of no use, and the `q` of the last tick if the joints were. Only
        where there was no tick with usable joints yet is it what came in (not a number where that
        is no array), and the tip the identity.
        """
        started = perf_counter()
        s = self.settings
        try:
            q = np.array(q, dtype=np.float64)
        except Exception:  # whatever it does that is no array when it is asked for numbers
            return self._refused(np.full(len(self._reach), nan), started)
        # Rounding of the sines of larger angles would be as large as what is guarded.
        if q.shape != self._reach.shape or not sum(map(abs, q.tolist())) <= JOINT_RANGE:
            return self._refused(q, started)
        T, J = self.arm.kinematics(q)
        if not isinstance(target, pin.SE3):
            return self._refused(q, started, T)
        x = T.translation
        pose, goal = T.homogeneous, target.homogeneous
        time_kinematics = perf_counter()

        radius = self._asked or self._farthest(J)
        inside = self._sides(q, x)
        planes: Planes | None = None
        # The ball searched reaches a standoff beyond the motion sphere, or a step to its rim could
        # end right at a triangle outside, and as far as the path may leave the chord; more than a
        # quarter of the radius would cost more planes than a longer step is worth.
        searched = radius + min(self._bulge, 0.25 * radius) + self._beyond
        found = None if True in inside else self._filled(x, searched)
        if found is not None:
            half: Planes | Buffer = self._buffer
            m, reach = found
        else:
            half = planes = self._planes(x, searched, inside)
            m, reach = len(planes), planes.radius
            if m > self._qp.rows:
                self._reserve(2 * m)
        # The step ends within the motion sphere, and its path within what was searched for it.
        allowed_radius = min(reach, radius)
        floors = half.floors if half.floors is not None else self._none[:m]
        farthest = reach - self._beyond if reach >= searched else reach
        limits = (farthest, min(allowed_radius, self._tip_reach))
        time_planes = perf_counter()

        q_new = np.empty(len(q))
        code, count, distance, deficit, moves = problem.plan(
            q, pose, J, goal, half.normals, half.offsets, half.points, half.rules, m,
            allowed_radius, self._table, self._numbers, self._rows, self._bounds,
            self._qp.scratch, self._qp.multipliers, q_new,
        )  # fmt: skip
        if code < 0:
            return self._refused(q, started, T)
        solver, _ = self._qp.complete(code, count, self._lower, self._upper)
        if solver is Solver.INFEASIBLE and deficit > 0.0:
            # Recovery may be more than the joints can do; standing still never is.
            np.minimum(self._bounds[:m], 0.0, out=self._bounds[:m])
            solver = self._solve(self._bounds, m)
            count = -1
        if count:
            moves = problem.move(q, J, self._qp.scratch, self._table, self._numbers, q_new)
        time_qp = perf_counter()

        share = 1.0
        if moves:
            T_new = self.arm.tip(q_new)
            pose_new = T_new.homogeneous
        else:
            q_new, T_new, pose_new = q, T, pose
        multipliers = self._qp.multipliers
        out = np.empty(3 + len(q) + (m if planes is not None else 10 * m))
        allowed = problem.report(
            q_new, pose, pose_new, goal,
            half.normals, half.offsets, half.points, half.triangles, half.rules, floors, m,
            *limits, self._table, self._numbers, multipliers, moves, planes is None, out,
        )  # fmt: skip
        if moves and not (allowed and self._no_deeper(T_new, x, inside)):
            multipliers = multipliers.copy()
            kept = planes if planes is not None else self._buffer.cut(m, reach)
            q_new, T_new, share = self._less(q, T, T_new, x, J, kept, floors, limits, inside)
            problem.report(
                q_new, pose, T_new.homogeneous, goal,
                half.normals, half.offsets, half.points, half.triangles, half.rules, floors, m,
                *limits, self._table, self._numbers, multipliers, False, planes is None, out,
            )  # fmt: skip
        q_new.setflags(write=False)  # half the time of `flags.writeable`
        out.setflags(write=False)
        if True in inside:
            status = Status.INSIDE
        elif share == 0.0 or solver is Solver.INFEASIBLE:
            status = Status.HELD
        elif deficit > NEGLIGIBLE * s.standoff:
            status = Status.RECOVERING
        elif share < 1.0:
            status = Status.SHORTENED
        else:
            status = Status.SOLVED
        self._sent = q_new, T_new
        if self._keeps_side and status is not Status.INSIDE:
            self._known = (q_new.tobytes(), inside)
        fields: dict[str, Any] = {
            "q": q_new, "tip": T_new, "status": status, "solver": solver,
            "radius": radius, "distance": distance, "_out": out, "_m": m, "_reach": allowed_radius,
        }  # fmt: skip
        if planes is not None:
            for array in (planes.normals, planes.offsets, planes.points):
                array.flags.writeable = False
            fields["planes"] = replace(planes, radius=allowed_radius)
        done = perf_counter()
        fields["_times"] = (
            time_kinematics - started,
            time_planes - time_kinematics,
            time_qp - time_planes,
            done - time_qp,
            done - started,
        )
        return Step._reported(fields)

    def _reserve(self, rows: int) -> None:
        """Room for that many planes."""
        self._qp.reserve(rows)
        self._rows = np.empty((rows, self._qp.n))
        self._bounds = np.empty(rows)
        self._none = np.full(rows, -inf)  # floors of planes that have none

    def _farthest(self, J: FloatArray) -> float:
        """The motion sphere where no fixture asks for one: as far as a tick can go."""
        return max(problem.farthest(J, self._reach), 2.0 * self.settings.standoff)

    def _sides(self, q: FloatArray, x: FloatArray) -> tuple[bool, ...]:
        key = q.tobytes()
        if self._known[0] != key:
            self._known = (key, tuple(fixture.inside(x) for fixture in self.fixtures))
        return self._known[1]

    def _filled(self, x: FloatArray, radius: float) -> tuple[int, float] | None:
        """What all fixtures say, in the buffer: how many planes, and the radius they are valid in.

        None where one of them cannot answer that way.
        """
        if len(self._filling) < len(self.fixtures):
            return None
        s, buffer = self.settings, self._buffer
        standoff = s.standoff
        while True:
            m, reach = 0, radius
            spaces = []
            for fixture in self._filling:
                found = fixture.fill(buffer, m, x, radius, standoff, s.tip_radius)
                if found is None:
                    return None
                if len(self._filling) > 1:
                    space = problem.space(buffer.normals, buffer.points, m, m + found[0], x)
                    spaces.append(space - s.tip_radius)
                m += found[0]
                reach = min(reach, found[1])
            # Between two fixtures, below the standoff of both: as near to the farther one as to the
            # nearer one, like between two walls of one fixture.
            if standoff < s.standoff or sum(space < standoff for space in spaces) < 2:
                return m, reach
            standoff = min(spaces)
            if not standoff > YIELD:
                return m, reach

    def _planes(self, x: FloatArray, radius: float, inside: tuple[bool, ...]) -> Planes:
        """What all fixtures say, together."""
        s = self.settings
        parts = [
            fixture.planes(x, radius, s.standoff, s.tip_radius, within)
            for fixture, within in zip(self.fixtures, inside, strict=True)
        ]
        return parts[0] if len(parts) == 1 else _join(parts, radius)

    def _solve(self, bounds: FloatArray, m: int) -> Solver:
        """The problem that `plan` left, with other bounds."""
        numbers, table = self._numbers, self._table
        code, count = attempt(
            table[: problem.LOWER], numbers[: problem.STANDOFF], self.settings.damping,
            self._rows, bounds, self._lower, self._upper, table[problem.HORIZON],
            m, self._qp.scratch, self._qp.multipliers,
        )  # fmt: skip
        return self._qp.complete(code, count, self._lower, self._upper)[0]

    def _less(
        self,
        q: FloatArray,
        T: pin.SE3,
        T_tried: pin.SE3,
        x: FloatArray,
        J: FloatArray,
        planes: Planes,
        floors: FloatArray,
        limits: tuple[float, float],
        inside: tuple[bool, ...],
    ) -> tuple[FloatArray, pin.SE3, float]:
        """Where the optimum may not be taken: joint positions that may, their pose, and the share.

        The optimum was shortened, all joints alike, to what they can do in a tick and what the tip
        may: it obeys the rows at any length, and the tip heads for where it will end. Tried in this
        order: the same a little shorter, where only the true tip went farther than the linear one;
        with the rows moved by the linearisation error just seen; ever shorter parts of the first;
        standing still. The true tip of what is taken obeys every plane and the ball, and so does
        its path from here.
        """
        paced = problem.pace(self._qp.dq, self._reach, J, self._tip_reach)
        dq = paced * self._qp.dq
        m = len(planes)
        y = T_tried.translation
        revolute = self._table[problem.REVOLUTE]
        guarded = self._numbers[problem.GUARDED] > 0.0

        def allowed(T_new: pin.SE3, share: float) -> bool:
            bulge = problem.sagitta(J, dq, share, revolute) if guarded else 0.0
            return self._allowed(T_new, x, planes, floors, limits, bulge, inside)

        length = float(np.linalg.norm(y - x))
        if length > limits[1]:
            for _ in range(SHORTER):
                shorter = (1.0 - 1e-9) * limits[1] / length
                q_new = self._within_limits(q, q + shorter * dq)
                T_new = self.arm.tip(q_new)
                if allowed(T_new, shorter):
                    return q_new, T_new, 1.0
                dq = shorter * dq
                length = float(np.linalg.norm(T_new.translation - x))
                if length <= limits[1]:
                    break
        error = y - x - J[:3] @ (paced * self._qp.dq)
        bounds = (self._bounds[:m] - planes.normals @ error) / paced
        if self._solve(bounds, m) is not Solver.INFEASIBLE:
            q_second = np.empty(len(q))
            problem.move(q, J, self._qp.scratch, self._table, self._numbers, q_second)
            T_new = self.arm.tip(q_second)
            bulge = float(self._numbers[problem.BULGE])
            if self._allowed(T_new, x, planes, floors, limits, bulge, inside):
                return q_second, T_new, 1.0
        low, high = 0.0, 1.0
        best = (q, T, 0.0)
        for _ in range(BISECTIONS):
            share = 0.5 * (low + high)
            q_new = self._within_limits(q, q + share * dq)
            T_new = self.arm.tip(q_new)
            if allowed(T_new, share):
                best = (q_new, T_new, share)
                low = share
            else:
                high = share
        return best

    def _within_limits(self, q: FloatArray, q_new: FloatArray) -> FloatArray:
        """q_new (n,), no joint farther beyond its limits than it is at q."""
        lowest = np.minimum(self.arm.lower, q)
        highest = np.maximum(self.arm.upper, q)
        return np.clip(q_new, lowest, highest)

    def _allowed(
        self,
        T_new: pin.SE3,
        x: FloatArray,
        planes: Planes,
        floors: FloatArray,
        limits: tuple[float, float],
        bulge: float,
        inside: tuple[bool, ...],
    ) -> bool:
        y = T_new.translation
        if not problem.obeys(
            planes.normals, planes.offsets, floors, len(planes), *limits, x, y, bulge
        ):
            return False
        return self._no_deeper(T_new, x, inside)

    def _no_deeper(self, T_new: pin.SE3, x: FloatArray, inside: tuple[bool, ...]) -> bool:
        """What planes cannot say of a tip that starts inside of something."""
        y = T_new.translation
        return all(
            fixture.leads_out(x, y)
            for fixture, within in zip(self.fixtures, inside, strict=True)
            if within
        )

    def _refused(self, q: FloatArray, started: float, T: pin.SE3 | None = None) -> Step:
        if T is not None:
            self._sent = q, T
        elif self._sent is not None:
            q, T = self._sent[0], pin.SE3(self._sent[1])
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


def _read_only(array: Any) -> Any:
    array.flags.writeable = False
    return array


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
        np.concatenate(
            [p.floors if p.floors is not None else np.full(len(p), -inf) for p in parts]
        ),
    )
