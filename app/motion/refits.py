"""Surfaces between the shapes of structures that deform, made in another thread before their turn.

A pair of shapes is the same whatever was before it, so a replay computes the same ticks.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from functools import partial

import vf
from app.motion.movement import Guarded, Movement

IDLE = 0.5  # after which the thread of a worker ends [s]
Below = Callable[[], Callable[[], None]]


class Guide:
    """Tells a controller of a scene where the structures are, and what shape they have.

    For one thread. While a pair of shapes is in force the next one is made in another thread; a
    tick whose pair is not ready waits for it.

    Args:
        movement: of the scene.
        surfaces: of all structures where they rest, in its order.
        below: called by a thread that may have to wait for what it asks for; another one calls
            the result before it makes that.
    """

    def __init__(self, movement: Movement, surfaces: Sequence[vf.Surface], below: Below) -> None:
        self.movement = movement
        self._chains = {
            k: _Chain(movement, k, surfaces[k], below)
            for k, form in enumerate(movement.forms)
            if form is not None
        }

    def during(
        self, controller: vf.Controller, guarded: Sequence[bool], start: float, end: float
    ) -> Guarded:
        """What the controller is told of the tick between two phases; it has the surfaces then.

        Args:
            guarded: which of the structures are, in the order of the controller's fixtures.
        """
        told = self.movement.during(start, end)
        fixture = 0
        for k, (pair, held) in enumerate(zip(told.shapes, guarded, strict=False)):
            if held and pair is not None:
                surface = self._chains[k].surface(pair)
                if controller.surfaces[fixture] is not surface:
                    controller.replace(fixture, surface)
            fixture += held
        return told


class _Chain:
    """The surfaces of one structure."""

    def __init__(self, movement: Movement, structure: int, rest: vf.Surface, below: Below) -> None:
        self._movement, self._structure, self._rest = movement, structure, rest
        self._worker = _Worker(below)
        # Ready, or nearly, when the first tick asks for it.
        self._made = {0: self._worker.submit(partial(self._make, 0, None))}

    def surface(self, pair: int) -> vf.DeformingSurface:
        """That of a pair of shapes; the next one is made meanwhile."""
        made = self._made
        if pair not in made:
            made.clear()
            made[pair] = self._worker.submit(partial(self._make, pair, None))
        if pair + 1 not in made:
            now = made[pair]
            for other in [other for other in made if other != pair]:
                del made[other]
            made[pair + 1] = self._worker.submit(partial(self._make, pair + 1, now))
        return made[pair].result()

    def _make(self, pair: int, before: Future[vf.DeformingSurface] | None) -> vf.DeformingSurface:
        first, last = self._movement.ends(self._structure, pair)
        # One thread: what is before it is done.
        start = self._rest.deforming(first) if before is None else before.result()
        return start.deforming(last)


Job = tuple["Future[vf.DeformingSurface]", Callable[[], vf.DeformingSurface], Callable[[], None]]


class _Worker:
    """Does one job after the other in a thread, which ends when there is none for long."""

    def __init__(self, below: Below) -> None:
        self._below = below
        self._jobs: queue.SimpleQueue[Job] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._runs = False

    def submit(self, work: Callable[[], vf.DeformingSurface]) -> Future[vf.DeformingSurface]:
        """Its result, or what it raises, to come."""
        job: Future[vf.DeformingSurface] = Future()
        below = self._below()
        with self._lock:
            self._jobs.put((job, work, below))
            if not self._runs:
                self._runs = True
                threading.Thread(target=self._run, name="shapes", daemon=True).start()
        return job

    def _run(self) -> None:
        while True:
            try:
                job, work, begin = self._jobs.get(timeout=IDLE)
            except queue.Empty:
                with self._lock:
                    if self._jobs.empty():
                        self._runs = False
                        return
                continue
            try:
                begin()
                job.set_result(work())
            except BaseException as error:
                job.set_exception(error)
