"""Messages between threads: immutable values without references to mutable state."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import vf

STATES = ("", "DISABLED", "ENABLED", "PAUSED", "FAULT")
"""Operating states of an arm, in messages and recordings by their index; empty: no devices."""


@dataclass(frozen=True)
class Command:
    """The operator's input to the control loop; the newest value counts.

    Attributes:
        target: goal of the tool tip (the proxy), arm base frame; None holds the tool.
        sequence: grows by one with every command of a session.
        clutch: pressed: the tool holds, the force is zero.
        held: the operator is dragging right now, so commands must keep arriving.
        stamp: monotonic time at which the command was made [s].
    """

    target: pin.SE3 | None
    sequence: int
    clutch: bool = False
    held: bool = False
    stamp: float = 0.0


@dataclass(frozen=True)
class LoopStats:
    """Timing of the control thread over about the last second."""

    rate: float = 0.0  # achieved [Hz]
    tick_median: float = 0.0  # time spent in one tick [s]
    tick_worst: float = 0.0  # [s]
    late_p99: float = 0.0  # 99th percentile of the start's delay behind its deadline [s]
    late_worst: float = 0.0  # [s]
    overruns: int = 0  # ticks since the start that ended after the next deadline
    counts: dict[vf.Status, int] = field(default_factory=dict)  # ticks by status since the start


@dataclass(frozen=True)
class Telemetry:
    """The result of one tick.

    Attributes:
        tick: number of the tick since the session's start.
        time: simulated time, tick × dt [s].
        q: (n,) joint positions after the tick.
        target: the proxy the tick was driven by (None: held).
        step: what the controller did; None before the first tick and while paused at start.
        scene: version of the session's scene (arm and mesh) the tick ran in.
        sequence: of the newest command seen.
        origin: pose of the tip when the tick began, `step.tip` of the one before but for a reset or
            a change of scene in between; None: not known.
        phase: time of the motion of structures at the end of the tick [s], see
            `app.motion.movement`.
        phase_before: at its start [s].
        lost: whether the tool held because a structure was last seen too long ago.
        known: whether the arm's joints were known when the tick began.
        measured: (n,) the joints that the arm measured then; None: it is a simulated one, or they
            were not known.
    """

    tick: int
    time: float
    q: NDArray[np.float64]
    target: pin.SE3 | None
    step: vf.Step | None
    stats: LoopStats
    scene: int
    sequence: int
    paused: bool
    autopilot: bool
    stale: bool
    origin: pin.SE3 | None = None
    phase: float = 0.0
    phase_before: float = 0.0
    lost: bool = False
    known: bool = True
    measured: NDArray[np.float64] | None = None


@dataclass(frozen=True)
class State:
    """The engine's state between two ticks, besides the orders it saw last.

    Attributes:
        q: (n,) joints.
        tick: number of the last tick.
        steps: how many of the single steps ordered are done.
        silent: ticks since the newest command arrived.
        autopilot_since: tick at which the autopilot was switched on; None: it is off.
        target: the proxy of the last tick.
        stale: whether the last tick held because the command was too old.
        step: the controller's last result.
        phase: time of the motion of structures [s].
    """

    q: NDArray[np.float64]
    tick: int
    steps: int
    silent: int
    autopilot_since: int | None
    target: pin.SE3 | None
    stale: bool
    step: vf.Step | None = None
    phase: float = 0.0
