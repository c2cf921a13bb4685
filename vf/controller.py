"""One tick of the virtual fixture: desired step → planes → QP → verify → step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from math import inf, nan
from time import monotonic
from typing import Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from vf import layout as at
from vf.fixtures import Fixture, MeshFixture
from vf.motion import Motion, placed, seen_from, shifted
from vf.planes import FloatArray, Planes, write_records
from vf.qp import problem
from vf.qp.active_set import left_over
from vf.qp.solver import Solver, backend
from vf.selftest import warm_up
from vf.settings import Settings
from vf.status import Status
from vf.surface import DeformingSurface, Surface
from vf.tick.block import Block
from vf.tick.bodies import check_limits, guards_tool, instrument, tip_alone
from vf.tick.step import Step, Timings, numbers_of, tip_of
from vf.tick.tick import tick

# The unconstrained step may be this many ticks long; the optimum is then shortened to one tick.
# With 1 a tool that a proxy deep behind a wall presses onto it slides slowly, since most of its
# motion is normal to the wall. A larger number makes it faster there and less steady at ridges.
LOOK_AHEAD = 2.0
# A solver is prepared for this many rows: few ticks have more after those that cannot bind are left
# out.
CAPACITY = 128


class Kinematics(Protocol):
    """What the controller needs of an arm; `robots.Arm` has it.

    An arm with an attribute `chain` (see `vf.tick.chain`) is not asked for its kinematics: the tick
    computes them itself. One with `capsules` and their `anchors` besides, as `robots.Arm` has, can
    be guarded as a whole; of any other that is the tip.
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
        ValueError: limits of the arm that are no numbers, or out of range; guard "tool" with an arm
            that has capsules but no chain.
        RuntimeError: a kernel gives a wrong answer on this machine, see `warm_up`.
    """

    _warm = False  # whether this process has every kernel of a tick in memory

    def __init__(
        self, arm: Kinematics, fixtures: Sequence[Fixture], settings: Settings | None = None
    ) -> None:
        self.arm = arm
        self.fixtures = tuple(fixtures)
        self.settings = s = settings or Settings()
        check_limits(arm)
        n = len(arm.lower)
        self._shape = (n,)
        chain = getattr(arm, "chain", None)
        searches = [getattr(fixture, "search", None) for fixture in self.fixtures]
        parts = tip_alone(s.tip_radius)
        whole = [guards_tool(fixture, s.guard) for fixture in self.fixtures]
        if any(whole):
            middle = 0.5 * (np.asarray(arm.lower) + np.asarray(arm.upper))
            parts = instrument(arm, s.tip_radius, s.trocar, middle, True)
        block = self._block = Block(n, chain, searches, parts)
        for f, fixture in enumerate(self.fixtures):
            block.searches[f, at.KEEPS] = fixture.certified
            block.searches[f, at.TOOL] = whole[f]
        table, numbers = block.table, block.numbers
        reach = np.asarray(arm.velocity) * s.dt
        table[at.LOWEST], table[at.HIGHEST] = arm.lower, arm.upper
        table[at.SPEED], table[at.HORIZON] = reach, LOOK_AHEAD * reach
        # A joint of an arm that does not say what it is counts as revolute: that bends more.
        table[at.TURNS] = getattr(arm, "revolute", np.ones(n))
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
        sagitta = 1.5 * problem.sagitta(J, reach, 1.0, table[at.TURNS])
        for place, value in (
            (at.STANDOFF, s.standoff), (at.TIP_RADIUS, s.tip_radius),
            (at.LENGTH, s.rotation_length), (at.DAMPING, s.damping),
            (at.GAIN, s.force_gain), (at.CAP, s.force_cap),
            (at.TIP_REACH, s.tip_speed * s.dt), (at.GUARDED, guarded),
            (at.ASKED, min(asked, default=0.0)), (at.SAGITTA, guarded * sagitta),
            (at.BEYOND, guarded * s.standoff),
            (at.APPROACH, 1.0 if s.approach is None else min(s.approach * s.dt, 1.0)),
        ):  # fmt: skip
            numbers[place] = value
        self._backend = backend(s.solver, n, CAPACITY)
        self._idle = np.zeros(n, dtype=np.int8)
        self._idle.flags.writeable = False
        # Joints and tip of the last tick whose joints could be used; a tick's record has both.
        self._sent: bytes | tuple[FloatArray, pin.SE3] | None = None
        self._moves = 0  # bits: which fixtures moved in the last tick
        self._deforms = 0  # bits: the surfaces of which may deform
        self._surfaces: list[Surface | None] = [None] * len(self.fixtures)
        for f, fixture in enumerate(self.fixtures):
            if isinstance(fixture, MeshFixture):
                self._surfaces[f] = fixture.surface
                if isinstance(fixture.surface, DeformingSurface):
                    self.replace(f, fixture.surface)
        self._moved = (False,) * len(self.fixtures)
        self._count, self._poses = len(self.fixtures), block.poses
        self._tick = _COMPILED.tick
        if not Controller._warm:
            Controller._warm = True  # first: it makes controllers
            try:
                self.warm_up()
            except RuntimeError:
                Controller._warm = False
                raise

    @property
    def surfaces(self) -> tuple[Surface | None, ...]:
        """The surface of each fixture that the ticks see; None: it has none."""
        return tuple(self._surfaces)

    def replace(self, number: int, surface: DeformingSurface) -> None:
        """Let a fixture have another shape of its mesh from the next tick on; some microseconds.

        The first one of a fixture takes memory for its triangles (80 bytes each).

        Args:
            number: of the fixture.
            surface: made by `deforming` from the surface of the fixture, or from one made so.

        Raises:
            ValueError: there is no such fixture, it has no surface, or not of this mesh.
        """
        if not 0 <= number < len(self.fixtures):
            raise ValueError(f"no fixture {number!r}: there are {len(self.fixtures)}, from 0")
        fixture = self.fixtures[number]
        if not isinstance(fixture, MeshFixture):
            raise ValueError(f"fixture {number} has no surface: it is a {type(fixture).__name__}")
        if not isinstance(surface, DeformingSurface):
            raise ValueError(f"fixture {number} needs a surface made by deforming, got {surface!r}")
        if not surface.follows(fixture.surface):
            raise ValueError(
                f"fixture {number} needs a surface made by deforming from its own, not another"
                f" mesh: {surface!r}"
            )
        self._surfaces[number] = surface
        self._deforms |= 1 << number
        self._block.deform(number, surface)
        self._block.sides[number, at.MARGIN] = fixture.margins.margin

    def warm_up(self) -> None:
        """Compile (or load from disk) every kernel a tick may call, and check known answers.

        The first controller of a process does this when it is made, so no tick has to. Takes some
        20 s on the first start of an installation, and a fraction of a second later.

        Raises:
            RuntimeError: a kernel gives a wrong answer on this machine (`vf.check_kernels`).
        """
        sent = self._sent
        warm_up(self)
        self._sent = sent

    def shaped(self, f: int) -> Fixture:
        """Fixture number f on its surface in the shape of the start of the last tick."""
        fixture, surface = self.fixtures[f], self._surfaces[f]
        if not isinstance(surface, DeformingSurface) or not isinstance(fixture, MeshFixture):
            return fixture
        blend = float(self._block.motions[f, at.BLEND]) if self._moved[f] else 0.0
        return fixture.on(surface.shape(blend))

    def step(
        self, q: ArrayLike, target: pin.SE3, motions: Sequence[Motion | None] | None = None
    ) -> Step:
        """One tick from joint positions q (n,) towards the tip pose `target`, base frame.

        With `motions`, one for each fixture (None: it stands still), structures move during the
        tick. A structure that comes to the tool moves it, also where the target is the tip's own
        pose: a tool that is to hold yields, and no more than it has to. Where the arm cannot yield
        that fast the status is OVERTAKEN, the step the one that misses the planes least, and
        `Step.violation` how deep that may be.

        Raises nothing: where q, the target or the motions are not usable, the status is REFUSED.
        The step's `q` is then q itself if only target or motions are not usable, else the `q` of
        the last tick. Before the first tick with usable joints it is the q given (nan if that is
        not an array of numbers), and the tip is the identity.
        """
        started = monotonic()
        # The kernel does not check types: only a float64 array of the right shape may go there.
        if type(q) is not np.ndarray or q.dtype is not _FLOAT or q.shape != self._shape:
            try:
                q = np.array(q, dtype=np.float64)
            except Exception:  # an object may raise anything when converted
                return self._refused(np.full(self._shape, nan), started)
            if q.shape != self._shape:
                return self._refused(q, started)
        block = self._block
        try:
            goal = target.homogeneous if isinstance(target, pin.SE3) else _NO_POSE
        except Exception:  # a subclass, or an SE3 that was never initialised
            goal = _NO_POSE
        if (motions is not None or self._moves) and not self._set_motions(motions):
            goal = _NO_POSE
        m = self._tick(block.address, q, goal, at.BEGIN)
        while m < 0:
            if m <= -at.NO_TARGET:
                T = pin.SE3(block.start[:, :3], block.start[:, 3])
                return self._refused(q, started, T if m == -at.NO_TARGET else None)
            _ANSWERS[-m](self, q)
            m = self._tick(block.address, q, goal, -m)
        step = _new_step(Step)
        record = block.report[: block.head + _RECORD * m].tobytes()
        step.__dict__["_left"] = (record, block.n, started)
        self._sent = record
        return step

    def _set_motions(self, motions: Sequence[Motion | None] | None) -> bool:
        """Write how the fixtures move; False, and all stand still: that is of no use."""
        poses, deforms = self._poses, self._deforms
        moves, bit, place = 0, 1, 0
        usable = True
        try:
            if motions is not None:
                usable = len(motions) == self._count
                for motion in motions:
                    if type(motion) is Motion:
                        poses[place : place + _POSES] = motion.packed
                        moves |= bit
                        if motion.deforms and not deforms & bit:
                            usable = False
                    elif motion is not None:
                        usable = False
                    bit <<= 1
                    place += _MOTION
        except Exception:  # an object may raise anything when iterated, or give too many
            usable = False
        if not usable:
            moves = 0
        if moves != self._moves:
            self._moves = moves
            self._moved = tuple(bool(moves >> f & 1) for f in range(len(self.fixtures)))
            self._block.searches[:, at.MOVES] = self._moved
            self._block.words[at.MOVING] = moves > 0
        return usable

    def _place(self, q: FloatArray) -> None:
        """Pose and Jacobian at q, of an arm without a chain."""
        T, self._block.jacobian[:] = self.arm.kinematics(q.copy())
        self._block.start[:] = T.homogeneous[:3]

    def _place_tried(self, q: FloatArray) -> None:
        T = self.arm.tip(self._block.table[at.TRIAL].copy())
        self._block.tip[:] = T.homogeneous[:3]

    def _look_for_sides(self, q: FloatArray) -> None:
        block = self._block
        for f in range(len(self.fixtures)):
            block.sides[f, at.WITHIN] = self.shaped(f).inside(self._seen(f))

    def _seen(self, f: int) -> FloatArray:
        """Where the tip is at the start of the tick, in the frame of a fixture."""
        return self._block.sides[f, at.SEEN : at.SEEN + 3].copy()

    @property
    def _inside(self) -> tuple[bool, ...]:
        """Which fixtures the tip is inside of."""
        return tuple((self._block.sides[:, at.WITHIN] > 0.0).tolist())

    def _ask_fixtures(self, q: FloatArray) -> None:
        """The planes of all fixtures, from their Python methods."""
        s, block = self.settings, self._block
        radius = float(block.numbers[at.SEARCHED])
        parts, carries = [], []
        for f, within in enumerate(self._inside):
            fixture = self.shaped(f)
            moves = self._moved[f]
            more = float(block.motions[f, at.MORE]) if moves else 0.0
            part = fixture.planes(self._seen(f), radius + more, s.standoff, s.tip_radius, within)
            carry = np.zeros(len(part))
            if moves:
                motion = block.motions[f]
                part, carry = shifted(part, motion[at.SHIFT :][:3], motion[at.SPREAD :][:3])
                part = placed(part, motion[at.TO : at.SPIN], more)
            parts.append(part)
            carries.append(carry)
        count = sum(map(len, parts))
        if count > block.room:
            block.reserve(2 * count)
        first = 0
        for f, part in enumerate(parts):
            write_records(part, f, block.planes[first:])
            margins = getattr(self.fixtures[f], "margins_at", None)
            margin = 0.0 if margins is None else margins(part.triangles)
            block.planes[first : first + len(part), at.KEEP] = s.standoff + margin
            block.planes[first : first + len(part), at.CARRY] = carries[f]
            first += len(part)
        block.words[at.COUNT] = count
        block.numbers[at.REACH] = min((part.radius for part in parts), default=radius)

    def _solve(self, q: FloatArray) -> None:
        """Solve the problem that the active set method left."""
        block = self._block
        count = int(block.words[at.LEFT])
        left = left_over(block.scratch, block.n, count)
        code, u, duals, _iterations = self._backend.solve(*left)
        block.words[at.ANSWER] = code
        block.solution[:] = u
        block.duals[:count] = duals

    def _judge(self, q: FloatArray) -> None:
        """Whether a step that starts inside of a fixture leads out, which planes do not decide."""
        block = self._block
        ends = [block.trials[0].copy() for _ in self.fixtures]
        for f, moves in enumerate(self._moved):
            if moves:
                motion = block.motions[f]
                # Where it is relative to what deforms around it.
                ends[f] = seen_from(motion[at.TO : at.SPIN], ends[f]) - motion[at.SHIFT :][:3]
        block.words[at.ANSWER] = all(
            self.shaped(f).leads_out(self._seen(f), ends[f])
            for f, within in enumerate(self._inside)
            if within
        )

    def _refused(self, q: FloatArray, started: float, T: pin.SE3 | None = None) -> Step:
        q = q.copy()  # the caller's, who may write to it again
        if T is not None:
            self._sent = q, pin.SE3(T)
        elif isinstance(self._sent, bytes):
            q, T = numbers_of(self._sent, at.HEAD, self._block.n), tip_of(self._sent)
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


# What answers each question of a tick.
_ANSWERS: dict[int, Callable[[Controller, FloatArray], None]] = {
    at.PLACED: Controller._place,
    at.SIDED: Controller._look_for_sides,
    at.FOUND: Controller._ask_fixtures,
    at.SOLVED: Controller._solve,
    at.TRIED: Controller._place_tried,
    at.JUDGED: Controller._judge,
}


class _Compiled:
    """The tick, compiled for fixed types when the first controller is made.

    Numba checks every argument of every call; this is not checked: `Controller.step` does it.
    """

    @cached_property
    def tick(self) -> Callable[[int, FloatArray, FloatArray, int], int]:
        return tick.compile("(i8, f8[:], f8[:, ::1], i8)")


_COMPILED = _Compiled()
_FLOAT = np.dtype(np.float64)
_NO_POSE = np.full((4, 4), nan)
_RECORD = 8 * at.PLANE  # bytes
_MOTION, _POSES = 8 * at.MOTION, 8 * at.MORE  # bytes
_new_step = object.__new__
