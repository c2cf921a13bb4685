"""One tick of the virtual fixture: desired step → planes → QP → verify → step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import inf, nan
from time import monotonic
from typing import Any, NamedTuple, Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from vf import layout
from vf.fixtures import RULES, Fixture, MeshFixture
from vf.planes import FloatArray, Planes, planes_of, write_records
from vf.qp import problem
from vf.qp.active_set import left_over
from vf.qp.solver import Solver, backend, check_solver
from vf.rules.corridor import CorridorFixture
from vf.selftest import check_kernels
from vf.status import Status
from vf.surface import Surface
from vf.tick.block import Block
from vf.tick.tick import tick
from vf.tree.pdtree import nearest_face_freely

# The optimum is sought this many ticks ahead and then shortened to one. A tool pressed on a wall by
# a proxy deep behind it spends its speed on the wall and crawls along it; looking farther makes it
# quicker there, and jumpier over ridges.
LOOK_AHEAD = 2.0
# A solver is prepared for this many rows: more than few ticks have after what cannot bind is left
# out.
CAPACITY = 128


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
        solver: one of `vf.SOLVERS`, for what the exact shortcuts do not settle.

    Raises:
        ValueError: a value that is no number or out of its range, or an unknown solver.
    """

    dt: float = 1e-3
    standoff: float = 20e-6
    tip_radius: float = 0.0
    rotation_length: float = 0.05
    damping: float = 1e-7
    force_gain: float = 150.0
    force_cap: float = 4.0
    tip_speed: float = inf
    solver: str = "osqp"

    def __post_init__(self) -> None:
        check_solver(self.solver)
        for name, (low, high, unit) in RANGES.items():
            value = getattr(self, name)
            try:
                # A float whatever kind of number came: kernels are compiled anew for any other.
                number = float(value)
            except (TypeError, ValueError):
                number = nan
            if not low <= number <= high:
                raise ValueError(
                    f"{name} must be a number from {low:g} to {high:g}{unit}, got {value!r}"
                )
            object.__setattr__(self, name, number)


# Lowest and highest value and the unit of each of the `Settings` that is a number.
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

    def __getattr__(self, name: str) -> Any:
        """Fields are cut out of the tick's record when they are first asked for.

        A tick makes a step, but few look at all of it: ten arrays cost more than the tick.
        """
        if name not in _CUT:
            raise AttributeError(f"'Step' object has no attribute '{name}'")
        value = self.__dict__[name] = _CUT[name](*self.__dict__["_left"])
        return value


def _numbers(record: bytes, first: int, count: int) -> FloatArray:
    """Numbers of the record of a step, read-only like the record itself."""
    return np.frombuffer(record, np.float64, count, 8 * first)


def _number(record: bytes, place: int) -> float:
    return float(_numbers(record, place, 1)[0])


def _cut_tip(record: bytes) -> pin.SE3:
    T = _numbers(record, layout.REPORT_TIP, 12).reshape(3, 4)
    return pin.SE3(T[:, :3], T[:, 3])


def _records(record: bytes, n: int) -> FloatArray:
    """The planes (m, PLANE)."""
    return _numbers(record, layout.HEAD + 2 * n, -1).reshape(-1, layout.PLANE)


def _cut_planes(record: bytes, n: int) -> Planes:
    planes = planes_of(_records(record, n), _number(record, layout.REPORT_ALLOWED))
    for array in vars(planes).values():
        if isinstance(array, np.ndarray):
            array.flags.writeable = False
    return planes


def _cut_timings(record: bytes, started: float) -> Timings:
    placed, found, solved, ended = _numbers(record, layout.REPORT_MARKS, 4).tolist()
    return Timings(
        placed - started, found - placed, solved - found, ended - solved, ended - started
    )


# What makes each field of a step out of what a tick left: its record, n, and when it began [s].
_CUT: dict[str, Callable[[bytes, int, float], Any]] = {
    "q": lambda record, n, _: _numbers(record, layout.HEAD, n),
    "tip": lambda record, n, _: _cut_tip(record),
    "planes": lambda record, n, _: _cut_planes(record, n),
    "force": lambda record, n, _: _numbers(record, layout.REPORT_FORCE, 3),
    "status": lambda record, n, _: Status(int(_number(record, layout.REPORT_STATUS))),
    "solver": lambda record, n, _: Solver(int(_number(record, layout.REPORT_SOLVER))),
    "multipliers": lambda record, n, _: _read_only(_records(record, n)[:, layout.PUSH].copy()),
    "radius": lambda record, n, _: _number(record, layout.REPORT_RADIUS),
    "distance": lambda record, n, _: _number(record, layout.REPORT_DISTANCE),
    "limits": lambda record, n, _: _read_only(
        _numbers(record, layout.HEAD + n, n).astype(np.int8)
    ),
    "timings": lambda record, n, started: _cut_timings(record, started),
}  # fmt: skip


class Kinematics(Protocol):
    """What the controller needs of an arm; `robots.Arm` has it.

    An arm with an attribute `chain` (see `vf.tick.chain`) is not asked for its kinematics: the tick
    computes them itself.
    """

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
        ValueError: limits of the arm that are no numbers, or out of range.
        RuntimeError: a kernel gives a wrong answer on this machine, see `warm_up`.
    """

    _warm = False  # whether this process has every kernel of a tick in memory

    def __init__(
        self, arm: Kinematics, fixtures: Sequence[Fixture], settings: Settings | None = None
    ) -> None:
        self.arm = arm
        self.fixtures = tuple(fixtures)
        self.settings = s = settings or Settings()
        _check_limits(arm)
        n = len(arm.lower)
        self._shape = (n,)
        chain = getattr(arm, "chain", None)
        block = self._block = Block(
            n, chain, [getattr(fixture, "search", None) for fixture in self.fixtures]
        )
        for f, fixture in enumerate(self.fixtures):
            block.searches[f, layout.KEEPS] = fixture.certified
        table, numbers = block.table, block.numbers
        reach = np.asarray(arm.velocity) * s.dt
        table[layout.LOWEST], table[layout.HIGHEST] = arm.lower, arm.upper
        table[layout.SPEED], table[layout.HORIZON] = reach, LOOK_AHEAD * reach
        # A joint of an arm that does not say what it is counts as revolute: that bends more.
        table[layout.TURNS] = getattr(arm, "revolute", np.ones(n))
        # Whether a fixture promises anything of the tip's path, and not only of where it ends.
        guarded = any(
            getattr(fixture, "search", None) is not None
            or (fixture.certified and not isinstance(fixture, MeshFixture))
            for fixture in self.fixtures
        )
        asked = [f.radius for f in self.fixtures if f.radius is not None]
        # The ball searched is larger than the motion sphere by what the path of a step at full
        # speed leaves its chord; a step that bends more is shortened.
        _, J = arm.kinematics(0.5 * (arm.lower + arm.upper))
        sagitta = 1.5 * problem.sagitta(J, reach, 1.0, table[layout.TURNS])
        for place, value in (
            (layout.STANDOFF, s.standoff), (layout.TIP_RADIUS, s.tip_radius),
            (layout.LENGTH, s.rotation_length), (layout.DAMPING, s.damping),
            (layout.GAIN, s.force_gain), (layout.CAP, s.force_cap),
            (layout.TIP_REACH, s.tip_speed * s.dt), (layout.GUARDED, guarded),
            (layout.ASKED, min(asked, default=0.0)), (layout.SAGITTA, guarded * sagitta),
            (layout.BEYOND, guarded * s.standoff),
        ):  # fmt: skip
            numbers[place] = value
        self._backend = backend(s.solver, n, CAPACITY)
        self._idle = np.zeros(n, dtype=np.int8)
        self._idle.flags.writeable = False
        # Joints and tip of the last tick whose joints could be used; a tick's record has both.
        self._sent: bytes | tuple[FloatArray, pin.SE3] | None = None
        self._tick = _COMPILED.tick
        self._answers = {
            layout.PLACED: self._place,
            layout.SIDED: self._look_for_sides,
            layout.FOUND: self._ask_fixtures,
            layout.SOLVED: self._solve,
            layout.TRIED: self._place_tried,
            layout.JUDGED: self._judge,
        }
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
        started = monotonic()
        # The kernel reads what it is given as it is: only what is known for numbers goes there.
        if type(q) is not np.ndarray or q.dtype is not _FLOAT or q.shape != self._shape:
            try:
                q = np.array(q, dtype=np.float64)
            except Exception:  # whatever it does that is no array when it is asked for numbers
                return self._refused(np.full(self._shape, nan), started)
            if q.shape != self._shape:
                return self._refused(q, started)
        block = self._block
        try:
            goal = target.homogeneous if isinstance(target, pin.SE3) else _NO_POSE
        except Exception:  # a class of somebody's own, or one without its beginning
            goal = _NO_POSE
        m = self._tick(block.address, q, goal, layout.BEGIN)
        while m < 0:
            if m <= -layout.NO_TARGET:
                T = pin.SE3(block.start[:, :3], block.start[:, 3])
                return self._refused(q, started, T if m == -layout.NO_TARGET else None)
            self._answers[-m](q)
            m = self._tick(block.address, q, goal, -m)
        step = _new_step(Step)
        record = block.report[: block.head + _RECORD * m].tobytes()
        step.__dict__["_left"] = (record, block.n, started)
        self._sent = record
        return step

    def _place(self, q: FloatArray) -> None:
        """Where the tip is, of an arm that says so itself."""
        T, self._block.jacobian[:] = self.arm.kinematics(q.copy())
        self._block.start[:] = T.homogeneous[:3]

    def _place_tried(self, q: FloatArray) -> None:
        T = self.arm.tip(self._block.table[layout.TRIAL].copy())
        self._block.tip[:] = T.homogeneous[:3]

    def _look_for_sides(self, q: FloatArray) -> None:
        block = self._block
        x = block.places[0].copy()
        for f, fixture in enumerate(self.fixtures):
            block.sides[f, layout.SEEN : layout.SEEN + 3] = x
            block.sides[f, layout.WITHIN] = fixture.inside(x)

    @property
    def _inside(self) -> tuple[bool, ...]:
        """Which fixtures the tip is inside of."""
        return tuple((self._block.sides[:, layout.WITHIN] > 0.0).tolist())

    def _ask_fixtures(self, q: FloatArray) -> None:
        """The planes of all fixtures, from themselves."""
        s, block = self.settings, self._block
        x = block.places[0].copy()
        radius = float(block.numbers[layout.SEARCHED])
        parts = [
            fixture.planes(x, radius, s.standoff, s.tip_radius, within)
            for fixture, within in zip(self.fixtures, self._inside, strict=True)
        ]
        count = sum(map(len, parts))
        if count > block.room:
            block.reserve(2 * count)
        first = 0
        for f, part in enumerate(parts):
            write_records(part, f, block.planes[first:])
            first += len(part)
        block.words[layout.COUNT] = count
        block.numbers[layout.REACH] = min((part.radius for part in parts), default=radius)

    def _solve(self, q: FloatArray) -> None:
        """What the shortcuts left, by the solver."""
        block = self._block
        count = int(block.words[layout.LEFT])
        left = left_over(block.scratch, block.n, count)
        code, u, duals, _iterations = self._backend.solve(*left)
        block.words[layout.ANSWER] = code
        block.solution[:] = u
        block.duals[:count] = duals

    def _judge(self, q: FloatArray) -> None:
        """What planes cannot say of a tip that starts inside of something: whether it leads out."""
        block = self._block
        x, y = block.places[0].copy(), block.trials[0].copy()
        block.words[layout.ANSWER] = all(
            fixture.leads_out(x, y)
            for fixture, within in zip(self.fixtures, self._inside, strict=True)
            if within
        )

    def _refused(self, q: FloatArray, started: float, T: pin.SE3 | None = None) -> Step:
        q = q.copy()  # the caller's, who may write to it again
        if T is not None:
            self._sent = q, pin.SE3(T)
        elif isinstance(self._sent, bytes):
            q, T = _numbers(self._sent, layout.HEAD, self._block.n), _cut_tip(self._sent)
        elif self._sent is not None:
            q, T = self._sent[0], pin.SE3(self._sent[1])
        zero = np.zeros(3)
        none = np.zeros(0)
        planes = Planes.none(0.0)
        for array in (q, zero, none, planes.normals, planes.offsets, planes.points):
            array.flags.writeable = False
        elapsed = monotonic() - started
        return Step(
            q, T if T is not None else pin.SE3.Identity(), planes, zero,
            Status.REFUSED, Solver.IDLE, none, 0.0, inf, self._idle,
            Timings(elapsed, 0.0, 0.0, 0.0, elapsed),
        )  # fmt: skip


def _check_limits(arm: Kinematics) -> None:
    """ValueError unless all limits are finite, with lower ≤ upper and speeds above zero."""
    lower, upper, speed = (np.asarray(v, float) for v in (arm.lower, arm.upper, arm.velocity))
    most = problem.JOINT_RANGE
    if not ((-most <= lower) & (lower <= upper) & (upper <= most)).all():
        raise ValueError(
            f"an arm's position limits must be numbers within ±{most:g} rad or m, lower ≤ upper,"
            f" got {lower} and {upper}"
        )
    if not ((speed > 0.0) & (speed <= most)).all():
        raise ValueError(
            f"an arm's speed limits must be above zero and at most {most:g} rad/s or m/s, got"
            f" {speed}: a joint that is not to move is no joint"
        )


def _read_only(array: Any) -> Any:
    array.flags.writeable = False
    return array


class _Compiled:
    """The tick, compiled for fixed types when the first controller is made.

    Numba looks at every argument of every call; nobody looks here: `Controller.step` sees to it.
    """

    @cached_property
    def tick(self) -> Callable[[int, FloatArray, FloatArray, int], int]:
        return tick.compile("(i8, f8[:], f8[:, ::1], i8)")


_COMPILED = _Compiled()
_FLOAT = np.dtype(np.float64)
_NO_POSE = np.full((4, 4), nan)
_RECORD = 8 * layout.PLANE  # bytes
_new_step = object.__new__
