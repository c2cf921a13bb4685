"""Tests every tick for a crossing of the anatomy by the tip, independently of rule and planes.

Of anatomy that moves: where it truly is, whatever the guard believes. The tip's path is seen from
the moving structure.
"""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import vf
from app.control.engine import Orders, Plant
from app.control.messages import Telemetry
from app.control.priority import VIEW_PRIORITY, raise_thread_priority
from app.judges.meeting import Meeting, first_meeting
from app.motion.deformed import first_of_shapes
from app.motion.forms import Form
from app.motion.movement import Movement

log = logging.getLogger(__name__)

PERIOD = 0.05  # between two batches of ticks [s]
BEHIND = 20_000  # capacity of the queue [ticks]


@dataclass(frozen=True)
class Crossing:
    """A tick in which the tool's tip met the mesh.

    Attributes:
        tick: its number.
        scene: version of the scene it happened in.
        rule: the rule in force.
        triangle: the triangle met, the caller's index.
        point: (3,) where, arm base frame [m].
        before: (3,) the tip's centre at the start of that tick, before the crossing [m].
        phase: of the motion of structures at the end of that tick [s].
        centre: whether the tip's centre crossed the triangle; False: only its ball (of the tip
            radius) overlapped the triangle.
        structure: name of the structure whose triangle it is.
    """

    tick: int
    scene: int
    rule: str
    triangle: int
    point: NDArray[np.float64]
    before: NDArray[np.float64]
    centre: bool
    structure: str = ""
    phase: float = 0.0


class Watch:
    """Tests the tip's segment of every tick against the mesh.

    The control thread calls `take` after each tick, which only appends to a queue. A separate
    thread does the test, mostly in compiled code without the interpreter lock.

    Attributes:
        crossing: the first one since the last reset or change of scene; None: none. A crossing of
            the centre replaces an overlap of the ball.
        contacts: in how many ticks since then the tip came to meet what is guarded, or crossed it.
        missed: ticks that were not tested because the queue was full.
        past: the newest ticks.
    """

    def __init__(self, kept: int = 0) -> None:
        """`kept` is how many of the newest ticks are kept."""
        self.past: deque[Telemetry] = deque(maxlen=kept)
        self.crossing: Crossing | None = None
        self.contacts = 0
        self.missed = 0
        self._movement: tuple[int, Movement] | None = None  # and the scene it is of
        self._queue: deque[tuple[Orders, Telemetry, bool]] = deque()
        self._newest: Orders | None = None
        self._episode: tuple[int, int] | None = None  # resets and scene of the current batch
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="watch", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def close(self) -> None:
        """Test what is left in the queue, and end. Safe to call twice, or before `start`."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()

    def take(self, orders: Orders, telemetry: Telemetry, ticked: bool) -> None:
        """From the control thread, after every advance of the engine. Never waits, never raises."""
        if not ticked and orders is self._newest:
            return  # paused: nothing happened
        self._newest = orders
        if ticked:
            self.past.append(telemetry)
        if len(self._queue) < BEHIND:
            self._queue.append((orders, telemetry, ticked))
        else:
            self.missed += 1

    def miss(self, ticks: int) -> None:
        """That many ticks were lost before they came here."""
        self.missed += ticks

    def look(self) -> None:
        """Test the ticks taken so far; for the watch's own thread, or if it was not started."""
        queue = self._queue
        batch: list[tuple[Orders, Telemetry]] = []
        for _ in range(len(queue)):
            orders, telemetry, ticked = queue.popleft()
            episode = orders.resets, orders.plant.scene
            if episode != self._episode:
                # A reset or a new scene clears the crossing.
                self._judge(batch)
                batch = []
                self._episode, self.crossing, self.contacts = episode, None, 0
            if batch and batch[-1][0].plant is not orders.plant:
                self._judge(batch)
                batch = []
            if ticked and telemetry.step is not None and telemetry.origin is not None:
                batch.append((orders, telemetry))
        self._judge(batch)

    def _judge(self, batch: list[tuple[Orders, Telemetry]]) -> None:
        """Find the meetings in ticks of one plant."""
        if not batch:
            return
        plant = batch[0][0].plant
        ways = self._ways(plant, [telemetry for _, telemetry in batch])
        radius = plant.options.tip_radius
        met_in: set[int] = set()
        for way in ways:
            met_in |= way.meetings(radius)
        self.contacts += len(met_in)
        known = self.crossing
        if not met_in or (known is not None and known.centre):
            return
        radius = 0.0 if known is not None else radius
        while (found := _first(ways, radius)) is not None:
            way, met = found
            telemetry = batch[met.segment][1]
            assert telemetry.origin is not None
            self.crossing = Crossing(
                tick=telemetry.tick,
                scene=plant.scene,
                rule=plant.options.rule,
                triangle=met.triangle,
                point=way.placed(met),
                before=np.array(telemetry.origin.translation),
                centre=met.centre,
                structure=way.name,
                phase=telemetry.phase,
            )
            if met.centre:
                return
            # Only the ball met it: look for a crossing of the centre.
            ways = [one.since(met.segment) for one in ways]
            batch, radius = batch[met.segment :], 0.0

    def _ways(self, plant: Plant, ticks: list[Telemetry]) -> list[_Way]:
        """The tip's way in these ticks of a plant, for each structure that is guarded."""
        if self._movement is None or self._movement[0] != plant.scene:
            self._movement = plant.scene, plant.movement()
        movement = self._movement[1]
        starts = np.array([t.origin.translation for t in ticks if t.origin is not None])
        ends = np.array([t.step.tip.translation for t in ticks if t.step is not None])
        if not movement.moves:
            return [_Way(str(own.name), one, starts, ends) for own, one in plant.guarded]
        phases = np.array([[t.phase_before, t.phase] for t in ticks])
        poses = [[movement.truth(phase) for phase in pair] for pair in phases]
        ways = []
        for k, (own, surface) in enumerate(zip(plant.options.anatomy, plant.surfaces, strict=True)):
            if not own.guarded:
                continue
            before, after = [pair[0][k] for pair in poses], [pair[1][k] for pair in poses]
            form = movement.forms[k]
            ways.append(
                _Way(
                    str(own.name), surface, _seen_from(before, starts), _seen_from(after, ends),
                    after,
                    tuple(form.during(*pair) for pair in phases) if form is not None else (),
                    form,
                )
            )  # fmt: skip
        return ways

    def _run(self) -> None:
        # Like the page's threads, it must not be preempted while it holds the interpreter lock.
        raise_thread_priority(VIEW_PRIORITY)
        while not self._stop.wait(PERIOD):
            try:
                self.look()
            except Exception:
                log.exception("the watch for crossings failed")
                self.missed += 1
        self.look()


@dataclass(frozen=True)
class _Way:
    """The tip's way, as a structure sees it.

    Attributes:
        name: of the structure.
        starts, ends: (n, 3) of the tip in every tick, in the frame in which the structure rests.
        poses: T_rest_now of the structure at the end of each; empty: it stands still.
        shapes: between which shapes it is in each, see `app.motion.forms.Form.during`.
        form: its shapes; None: it keeps its own.
    """

    name: str
    surface: vf.Surface
    starts: NDArray[np.float64]
    ends: NDArray[np.float64]
    poses: Sequence[pin.SE3 | None] = ()
    shapes: Sequence[tuple[int, tuple[float, float]]] = ()
    form: Form | None = None

    def since(self, tick: int) -> _Way:
        """From that tick on."""
        return replace(
            self, starts=self.starts[tick:], ends=self.ends[tick:], poses=self.poses[tick:],
            shapes=self.shapes[tick:],
        )  # fmt: skip

    def first(self, radius: float) -> Meeting | None:
        """The first tick in which a tip of this radius [m] comes to meet the structure."""
        if self.form is not None:
            return first_of_shapes(
                self.surface, self.form, self.shapes, self.starts, self.ends, radius
            )
        return first_meeting(self.surface, self.starts, self.ends, radius)

    def meetings(self, radius: float) -> set[int]:
        """All ticks in which a tip of this radius [m] comes to meet the structure."""
        found: set[int] = set()
        first = 0
        while first < len(self.starts):
            met = self.since(first).first(radius)
            if met is None:
                break
            first += met.segment
            found.add(first)
            first += 1
        return found

    def placed(self, met: Meeting) -> NDArray[np.float64]:
        """(3,) where it met the structure, base frame."""
        pose = self.poses[met.segment] if self.poses else None
        return met.point if pose is None else np.asarray(pose.act(met.point))


def _seen_from(poses: Sequence[pin.SE3 | None], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points (n, 3), each in the frame of its pose."""
    pairs = zip(poses, points, strict=True)
    return np.array([x if pose is None else pose.actInv(x) for pose, x in pairs])


def _first(ways: Sequence[_Way], radius: float) -> tuple[_Way, Meeting] | None:
    """The first meeting with any structure that is guarded; None: there is none."""
    first: tuple[_Way, Meeting] | None = None
    for way in ways:
        met = way.first(radius)
        if met is not None and (first is None or met.segment < first[1].segment):
            first = way, met
    return first
