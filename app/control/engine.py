"""Computes one tick after the other, without thread or clock; used by the loop and by a replay."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import meshes
import vf
from app.control.autopilot import Script
from app.control.messages import Command, LoopStats, State, Telemetry
from app.control.priority import just_below
from app.devices import protocols
from app.devices.simulated import SimulatedArm
from app.motion.course import Course
from app.motion.movement import Guarded, Movement
from app.motion.refits import Guide
from app.settings import Options
from app.structure import Structure
from robots import Arm

log = logging.getLogger(__name__)
Told = tuple[list[vf.Motion | None], ...]  # of `vf.Controller.step`; empty: nothing moves


@dataclass(frozen=True)
class Plant:
    """All data of a tick, used by the engine's thread only and replaced as a whole between ticks.

    Attributes:
        arm: the arm's model; its Pinocchio buffers belong to the engine's thread from here on.
        controller: built on that arm, warmed up.
        q0: (n,) start configuration, its tip in free space.
        surface: the anatomy, arm base frame.
        planned_path: (k, 3) the planned cut on it, arm base frame [m]; None: there is none.
        clearance: distance from the surface at which the tip counts as free [m].
        scene: version of the session's scene.
        dt: length of a tick [s].
        stale_after: a held drag without a newer command for this long holds the tool [s].
        autopilot: the scripted proxy of this scene.
        options: the settings it was made with.
        scene_options: the settings its scene was built with, which may differ from `options`.
        structures: the surfaces beside the anatomy, arm base frame, as in `options`.
        courses: how each of these moves, the anatomy first; None: it stands still. Empty: all do.
        added: margins that a registration adds to those of all structures; None: nothing.
    """

    arm: Arm
    controller: vf.Controller
    q0: NDArray[np.float64]
    surface: vf.Surface
    planned_path: NDArray[np.float64] | None
    clearance: float
    scene: int
    dt: float
    stale_after: float
    autopilot: Script
    options: Options
    scene_options: Options
    structures: tuple[vf.Surface, ...] = ()
    courses: tuple[Course | None, ...] = ()
    added: meshes.MarginMap | None = None

    @property
    def surfaces(self) -> tuple[vf.Surface, ...]:
        """Those of all structures, the anatomy first, in the order of `Options.anatomy`."""
        return self.surface, *self.structures

    @property
    def guarded(self) -> list[tuple[Structure, vf.Surface]]:
        """The structures that are guarded, in the order of the controller's fixtures."""
        return guarded(self.options, self.surfaces)

    def movement(self) -> Movement:
        """How the structures move; for one thread."""
        return Movement(self.courses, self.scene_options.tracker)

    def guide(self) -> Guide:
        """Tells the controller how they move; for one thread."""
        return Guide(self.movement(), self.surfaces, just_below)

    def told(self, guide: Guide, start: float, end: float) -> Guarded:
        """What the controller is told of the tick between two phases [s]."""
        return guide.during(
            self.controller, [own.guarded for own in self.options.anatomy], start, end
        )

    def motions(self, of_structures: Sequence[vf.Motion | None]) -> list[vf.Motion | None]:
        """One for each of the controller's fixtures, from those of all structures."""
        pairs = zip(self.options.anatomy, of_structures, strict=True)
        found = [motion for own, motion in pairs if own.guarded]
        # A corridor lies on the mesh.
        return found + [of_structures[0]] * (len(self.controller.fixtures) - len(found))

    def is_free(self, p_base: NDArray[np.float64]) -> bool:
        """Whether a tip at p_base (3,) is outside of all that is guarded and rests, and clear."""
        return all(is_free(one, p_base, self.clearance) for _, one in self.guarded)


@dataclass(frozen=True)
class Orders:
    """All that the session orders of the engine, as one value, so that reading it is atomic.

    `steps` and `resets` are running totals: the engine compares them with what it has done, so it
    may miss intermediate values. The engine does not use `scale` and `lock_orientation`, which map
    the handle to the target; they are here to be recorded. While `moving`, the structures that have
    a motion move on, at `pace` times their speed; so does the time of their tracker. Nor does the
    engine use `state`, the operating state of an arm that is elsewhere; empty: there is none.
    """

    plant: Plant
    command: Command
    paused: bool = False
    steps: int = 0
    resets: int = 0
    autopilot: bool = False
    scale: float = 1.0
    lock_orientation: bool = False
    moving: bool = True
    pace: float = 1.0
    state: str = ""


def is_free(surface: vf.Surface, p_base: NDArray[np.float64], clearance: float) -> bool:
    """Whether a tip at p_base (3,) is outside the anatomy and farther than clearance [m]."""
    if surface.nearest(p_base)[0] <= clearance:
        return False
    return not (surface.closed and surface.inside(p_base))


def guarded(options: Options, surfaces: Sequence[vf.Surface]) -> list[tuple[Structure, vf.Surface]]:
    """The structures that are guarded: their settings and surfaces.

    Args:
        surfaces: of all structures, in the order of `Options.anatomy`.
    """
    pairs = zip(options.anatomy, surfaces, strict=True)
    return [(own, surface) for own, surface in pairs if own.guarded]


class Engine:
    """Executes orders tick by tick; holds joints, tick count and the orders seen last."""

    def __init__(
        self, orders: Orders, state: State | None = None, arm: protocols.Arm | None = None
    ) -> None:
        """Start at the plant's start, or continue from a state whose last orders these were.

        Args:
            arm: measured before each tick and moved by it; None: a simulated one.
        """
        self.seen = orders
        self._plant = orders.plant
        self._q = _frozen(orders.plant.q0 if state is None else state.q)
        self._arm = SimulatedArm(self._q) if arm is None else arm
        self._steps = orders.steps
        self._resets = orders.resets
        self._tick = 0
        self._sequence = orders.command.sequence
        self._silent = 0
        self._autopilot_since: int | None = None
        self._step: vf.Step | None = None
        self._target: pin.SE3 | None = None
        self._stale = False
        self._failed = False
        self._known = True  # whether the arm's joints are known
        self._simulated = isinstance(self._arm, SimulatedArm)
        self._q_measured: NDArray[np.float64] | None = None
        self._origin: pin.SE3 | None = None  # the tip's pose when the last tick began
        self._guide = self._plant.guide()
        self._phase = self._phase_before = 0.0
        self._lost = False
        self.failures = 0  # ticks in which the controller raised: the tool holds, status HELD
        if state is not None:
            self._tick = state.tick
            self._steps = state.steps
            self._silent = state.silent
            self._autopilot_since = state.autopilot_since
            self._target = state.target
            self._stale = state.stale
            self._step = state.step
            self._phase = self._phase_before = state.phase
        self._tip: pin.SE3 = self._plant.arm.tip(self._q)

    @property
    def state(self) -> State:
        """The present state; only for the thread that calls `advance`."""
        return State(
            q=self._q,
            tick=self._tick,
            steps=self._steps,
            silent=self._silent,
            autopilot_since=self._autopilot_since,
            target=self._target,
            stale=self._stale,
            step=self._step,
            phase=self._phase,
        )

    @property
    def counts(self) -> tuple[int, int, int | None]:
        """Of `state`: steps, silent, autopilot_since."""
        return self._steps, self._silent, self._autopilot_since

    def advance(self, orders: Orders, stats: LoopStats) -> tuple[Telemetry, bool]:
        """Do the next tick, or none while paused; returns the telemetry, and whether it ticked.

        Does not raise: if the controller raises, the tool holds.
        """
        self.seen = orders
        moved = self._adopt(orders)
        self._measure()
        ticks = True
        if orders.paused:
            ticks = self._steps < orders.steps
            self._steps += ticks
        else:
            self._steps = orders.steps
        if not orders.autopilot:
            self._autopilot_since = None
        command = orders.command
        if command.sequence != self._sequence:
            self._sequence = command.sequence
            self._silent = 0
        elif ticks:
            # Counted in ticks, not read from a clock, so that a replay holds at the same tick.
            self._silent += 1
        if ticks:
            self._run(orders)
        elif moved:
            self._target = None
            # Paused: compute the planes of the new plant, move nothing.
            self._hold(self._told(0.0), yields=False)
        return self.look(orders, stats), ticks

    def look(self, orders: Orders, stats: LoopStats) -> Telemetry:
        """The present telemetry."""
        return Telemetry(
            tick=self._tick,
            time=self._tick * self._plant.dt,
            q=self._q,
            target=self._target,
            step=self._step,
            stats=stats,
            scene=self._plant.scene,
            sequence=self._sequence,
            paused=orders.paused,
            autopilot=orders.autopilot,
            stale=self._stale,
            origin=self._origin,
            phase=self._phase,
            phase_before=self._phase_before,
            lost=self._lost,
            known=self._known,
            measured=self._q_measured,
        )

    def _adopt(self, orders: Orders) -> bool:
        """Apply a new plant or a reset between two ticks; returns whether there was one."""
        new, old = orders.plant, self._plant
        if new is old and orders.resets == self._resets:
            return False
        if orders.resets != self._resets:
            self._resets = orders.resets
            self._move_to(_frozen(new.q0))
            self._autopilot_since = None
            # What comes from elsewhere does not begin anew.
            if new.scene != old.scene or not self._guide.movement.streams:
                self._phase = self._phase_before = 0.0
        elif new.scene != old.scene:
            self._measure()
            stays = new.arm.name == old.arm.name and len(new.q0) == len(self._q)
            free = stays and new.is_free(new.arm.tip(self._q).translation)
            if not free or _stuck(new, self._q):
                self._move_to(_frozen(new.q0))
            self._autopilot_since = None
            self._phase = self._phase_before = 0.0
        if new.scene != old.scene:
            self._guide = new.guide()
        self._plant = new
        self._tip = new.arm.tip(self._q)
        self._failed = False
        return True

    def _measure(self) -> None:
        """Read the arm's joints; keep the last ones if they are not known."""
        q = self._arm.measured()
        self._known = q is not None and q.shape == self._q.shape
        if self._known and q is not self._q:
            assert q is not None
            self._q = _frozen(q)
            self._tip = self._plant.arm.tip(self._q)
        self._q_measured = self._q if self._known and not self._simulated else None

    def _move_to(self, q: NDArray[np.float64]) -> None:
        self._q = q
        self._arm.servo(q)

    def _run(self, orders: Orders) -> None:
        plant, command = self._plant, orders.command
        self._stale = self._lost = False
        motions = self._told(orders.pace if orders.moving else 0.0)
        if orders.autopilot:
            if self._autopilot_since is None:
                self._autopilot_since = self._tick
            self._target = plant.autopilot.pose((self._tick - self._autopilot_since) * plant.dt)
        else:
            self._stale = command.held and self._silent * plant.dt > plant.stale_after
            self._target = None if command.clutch or self._stale else command.target
        if self._lost:
            self._target = None
        self._tick += 1
        self._origin = self._tip
        if self._target is None or not self._known:
            self._hold(motions)
            return
        try:
            step = plant.controller.step(self._q, self._target, *motions)
        except Exception:
            self._fail()
            return
        self._move_to(_frozen(step.q))
        self._step = step
        self._tip = step.tip

    def _told(self, pace: float) -> Told:
        """Let the structures move for a tick; returns what the controller is told of it."""
        if not self._guide.movement.moves:
            return ()
        before = self._phase_before = self._phase
        self._phase = before + pace * self._plant.dt
        try:
            told = self._plant.told(self._guide, before, self._phase)
        except Exception:
            self._lost = True  # where they are is not known
            if not self._failed:
                self._failed = True
                log.exception("the motion of structures could not be computed; the tool holds")
            return ()
        self._lost = told.stale
        return (self._plant.motions(told.motions),)

    def _hold(self, motions: Told = (), yields: bool = True) -> None:
        """Compute planes and distance at the tip without moving: zero force, the same joints.

        But a tool that structures come to yields, if it may.
        """
        plant = self._plant
        try:
            tip = plant.arm.tip(self._q)
            step = plant.controller.step(self._q, tip, *motions)
        except Exception:
            self._fail()
            return
        if motions and yields and self._known and step.status is not vf.Status.REFUSED:
            self._move_to(_frozen(step.q))
            self._tip = step.tip
            held = (self._stale or self._lost) and step.status is not vf.Status.OVERTAKEN
            status = vf.Status.HELD if held else step.status
            self._step = step.held(self._q, step.tip, status)
            return
        # The recovery from below the standoff must not move a tool that is told to hold.
        obeyed = self._known and not self._stale
        self._step = step.held(self._q, tip, step.status if obeyed else vf.Status.HELD)

    def _fail(self) -> None:
        self.failures += 1
        if not self._failed:
            self._failed = True
            log.exception("the controller raised; the tool holds (further ones are only counted)")
        if self._step is not None and self._step.q.shape == self._q.shape:
            tip = self._plant.arm.tip(self._q)
            self._step = self._step.held(self._q, tip, vf.Status.HELD)
        else:
            self._step = None


def _stuck(plant: Plant, q: NDArray[np.float64]) -> bool:
    """Whether a part of a guarded instrument is in the mesh at joints q (n,): nothing moves it."""
    if not plant.options.guards_tool:
        return False
    step = plant.controller.step(q, plant.arm.tip(q))
    return bool(step.status is vf.Status.HELD)


def _frozen(array: NDArray[np.float64]) -> NDArray[np.float64]:
    if array.flags.writeable:
        array = np.array(array, dtype=float)
        array.flags.writeable = False
    return array
