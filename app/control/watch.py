"""Tests every tick for a crossing of the anatomy by the tip, independently of rule and planes."""

from __future__ import annotations

import logging
import threading
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.control.engine import Orders, Plant
from app.control.messages import Telemetry
from app.control.priority import VIEW_PRIORITY, raise_thread_priority
from app.judges.meeting import Meeting, first_meeting

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


class Watch:
    """Tests the tip's segment of every tick against the mesh.

    The control thread calls `take` after each tick, which only appends to a queue. A separate
    thread does the test, mostly in compiled code without the interpreter lock.

    Attributes:
        crossing: the first one since the last reset or change of scene; None: none. A crossing of
            the centre replaces an overlap of the ball.
        missed: ticks that were not tested because the queue was full.
    """

    def __init__(self) -> None:
        self.crossing: Crossing | None = None
        self.missed = 0
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
                self._episode, self.crossing = episode, None
            if batch and batch[-1][0].plant is not orders.plant:
                self._judge(batch)
                batch = []
            if ticked and telemetry.step is not None and telemetry.origin is not None:
                batch.append((orders, telemetry))
        self._judge(batch)

    def _judge(self, batch: list[tuple[Orders, Telemetry]]) -> None:
        """Find the first meeting in ticks of one plant."""
        known = self.crossing
        if not batch or (known is not None and known.centre):
            return
        plant = batch[0][0].plant
        starts = np.array([t.origin.translation for _, t in batch if t.origin is not None])
        ends = np.array([t.step.tip.translation for _, t in batch if t.step is not None])
        radius = 0.0 if known is not None else plant.options.tip_radius
        while (found := _first(plant, starts, ends, radius)) is not None:
            name, met = found
            telemetry = batch[met.segment][1]
            self.crossing = Crossing(
                tick=telemetry.tick,
                scene=plant.scene,
                rule=plant.options.rule,
                triangle=met.triangle,
                point=met.point,
                before=starts[met.segment],
                centre=met.centre,
                structure=name,
            )
            if met.centre:
                return
            # Only the ball met it: look for a crossing of the centre.
            starts, ends = starts[met.segment :], ends[met.segment :]
            batch, radius = batch[met.segment :], 0.0

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


def _first(
    plant: Plant, starts: NDArray[np.float64], ends: NDArray[np.float64], radius: float
) -> tuple[str, Meeting] | None:
    """The first meeting with any structure that is guarded, and its name; None: there is none."""
    first: tuple[str, Meeting] | None = None
    for own, surface in plant.guarded:
        met = first_meeting(surface, starts, ends, radius)
        if met is not None and (first is None or met.segment < first[1].segment):
            first = str(own.name), met
    return first
