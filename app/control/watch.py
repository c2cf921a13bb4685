"""Watches every tick for a tip that met the mesh, whatever rule or planes there were."""

from __future__ import annotations

import logging
import threading
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.control.engine import Orders
from app.control.loop import VIEW_PRIORITY, prefer_this_thread
from app.control.messages import Telemetry
from app.judges.meeting import first_meeting

log = logging.getLogger(__name__)

PERIOD = 0.05  # between two looks at what the ticks did [s]
BEHIND = 20_000  # ticks that may wait to be looked at


@dataclass(frozen=True)
class Crossing:
    """A tick in which the tool's tip met the mesh.

    Attributes:
        tick: its number.
        scene: version of the scene it happened in.
        rule: the one in force then.
        triangle: the triangle met, the caller's index.
        point: (3,) where, arm base frame [m].
        before: (3,) the tip's centre at the start of that tick, where it had crossed nothing [m].
        centre: whether the centre of the tip crossed the triangle; False: the tip has a radius,
            and its ball came to overlap it.
    """

    tick: int
    scene: int
    rule: str
    triangle: int
    point: NDArray[np.float64]
    before: NDArray[np.float64]
    centre: bool


class Watch:
    """Tests the segment of every tick, from where the tip was to where it went, against the mesh.

    The control thread calls `take` after each tick: a look at a length and an append. A thread of
    its own does the rest, without the interpreter for most of it.

    Attributes:
        crossing: the first one since the last reset or change of scene; None: none. A ball that
            came to overlap the mesh gives way to the first crossing of its centre.
        missed: ticks that nobody looked at because this thread fell behind by `BEHIND` of them.
    """

    def __init__(self) -> None:
        self.crossing: Crossing | None = None
        self.missed = 0
        self._queue: deque[tuple[Orders, Telemetry, bool]] = deque()
        self._newest: Orders | None = None
        self._stay: tuple[int, int] | None = None  # resets and scene of the ticks being looked at
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="watch", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def close(self) -> None:
        """Look at what is still waiting, and end. Safe to call twice, or before `start`."""
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

    def look(self) -> None:
        """Look at the ticks taken so far; for the watch's own thread, or where there is none."""
        queue = self._queue
        batch: list[tuple[Orders, Telemetry]] = []
        for _ in range(len(queue)):
            orders, telemetry, ticked = queue.popleft()
            stay = orders.resets, orders.plant.scene
            if stay != self._stay:
                # The tool was put somewhere, or the mesh was: what was crossed before is history.
                self._judge(batch)
                batch = []
                self._stay, self.crossing = stay, None
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
        met = first_meeting(plant.surface, starts, ends, radius)
        while met is not None:
            telemetry = batch[met.segment][1]
            self.crossing = Crossing(
                tick=telemetry.tick,
                scene=plant.scene,
                rule=plant.options.rule,
                triangle=met.triangle,
                point=met.point,
                before=starts[met.segment],
                centre=met.centre,
            )
            if met.centre:
                return
            # The ball met it: does the centre follow?
            starts, ends = starts[met.segment :], ends[met.segment :]
            batch = batch[met.segment :]
            met = first_meeting(plant.surface, starts, ends)

    def _run(self) -> None:
        # As the page's threads, it may not be put aside with the interpreter in its hands.
        prefer_this_thread(VIEW_PRIORITY)
        while not self._stop.wait(PERIOD):
            try:
                self.look()
            except Exception:
                log.exception("the watch for crossings failed")
                self.missed += 1
        self.look()
