"""What a tracker sees of a moving structure, and where the guard believes it to be.

All of it is a function of the time and of the tracker's settings: a run repeats bit for bit.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from math import floor, inf

import numpy as np
import pinocchio as pin

from app.motion.declared import Tracker

LARGEST_ERROR = 3.0  # of a position, over its r.m.s.
HAIR = 1e-9  # of a sample: a sighting that arrives just now has arrived


@dataclass(frozen=True)
class Sighting:
    """A pose that the tracker reported: T_rest_then, when it was true [s], and its number."""

    pose: pin.SE3
    time: float
    number: int


@dataclass(frozen=True)
class Belief:
    """Where the guard believes a structure to be.

    Attributes:
        pose: T_rest_now, as believed.
        age: since the newest sighting was true [s]; inf: it was never seen.
        margin: how far a point of the structure can be from where it is believed [m].
        unpredicted: what the margin would be without the predictor [m].
        stale: whether the tool has to hold.
        predicted: whether the pose is that of the predictor.
        number: of the newest sighting, which is of number / rate [s]; −1: it was never seen.
    """

    pose: pin.SE3
    age: float
    margin: float
    unpredicted: float
    stale: bool
    predicted: bool = False
    number: int = -1


class Tracking:
    """A tracker that looks at a structure.

    Args:
        truth: T_rest_now of the structure at a time [s].
        tracker: its settings.
            The tracker's error displaces the pose and does not turn it.
    """

    def __init__(self, truth: Callable[[float], pin.SE3], tracker: Tracker) -> None:
        self._truth = truth
        self._tracker = tracker
        self._sightings: dict[int, Sighting | None] = {}
        self._worst: dict[int, float] = {}
        self._window = _Window(-1)
        self._kept = floor((tracker.period + tracker.stale + tracker.latency) * tracker.rate) + 1000

    def sighting(self, number: int) -> Sighting | None:
        """What was seen at number / rate; None: it was lost."""
        if number not in self._sightings:
            tracker = self._tracker
            rng = np.random.default_rng((tracker.seed, number))
            seen = None
            if not rng.random() < tracker.dropouts:
                time = number / tracker.rate
                error = rng.normal(scale=tracker.noise / np.sqrt(3.0), size=3)
                length = float(np.linalg.norm(error))
                if length > LARGEST_ERROR * tracker.noise:
                    error *= LARGEST_ERROR * tracker.noise / length
                pose = self._truth(time)
                seen = Sighting(pin.SE3(pose.rotation, pose.translation + error), time, number)
            self._sightings[number] = seen
            if len(self._sightings) > 3 * self._kept:
                self._forget(number)
        return self._sightings[number]

    def _forget(self, last: int) -> None:
        """Drop what is no longer needed around a sighting; it can be computed again."""
        for known in (self._sightings, self._worst):
            for number in [number for number in known if abs(number - last) > self._kept]:
                del known[number]

    def newest(self, time: float) -> Sighting | None:
        """The last sighting that has arrived at a time [s]."""
        tracker = self._tracker
        number = floor((time - tracker.latency) * tracker.rate + HAIR)
        while number >= 0:
            seen = self.sighting(number)
            if seen is not None:
                return seen
            number -= 1
        return None

    def belief(self, time: float) -> Belief:
        """Where the structure is believed to be at a time ≥ 0 [s]."""
        return self._believed(time, self.newest(time))

    def during(self, start: float, end: float) -> tuple[Belief, Belief]:
        """The beliefs at the start and at the end of a tick, both by what is known at its end.

        So a sighting that arrives moves the belief between two ticks, not during one.
        """
        seen, earlier = self.newest(end), self.newest(start)
        if seen is not None and earlier is not None and earlier.number > seen.number:
            seen = earlier  # backwards in time
        first, last = self._believed(start, seen), self._believed(end, seen)
        if first.predicted != last.predicted:
            # What is believed of the end holds for the tick.
            first = replace(first, pose=last.pose, margin=last.margin, predicted=last.predicted)
        return first, last

    def _believed(self, time: float, seen: Sighting | None) -> Belief:
        tracker = self._tracker
        if seen is None:
            # Before the first sighting arrives: where it was at first.
            far = tracker.bound * time
            return Belief(self._truth(0.0), inf, far, far, time > tracker.stale)
        age = time - seen.time
        known = LARGEST_ERROR * tracker.noise
        pose, unpredicted = seen.pose, tracker.bound * age + known
        margin = unpredicted
        predicted = False
        if tracker.predictor == "periodic":
            error = self._error(seen.number)
            before = None if error is None else self._before(time, seen.number)
            if error is not None and before is not None and error + before[1] < margin:
                pose, margin, predicted = before[0], error + before[1], True
        return Belief(pose, age, margin, unpredicted, age > tracker.stale, predicted, seen.number)

    def _before(self, time: float, last: int) -> tuple[pin.SE3, float] | None:
        """Where the structure was a period before, and how far it can have gone since [m].

        Where a sighting was lost, that is where it was at the last one before. So the margin grows
        steadily while no prediction can be made, as without a predictor.
        """
        tracker = self._tracker
        then = time - tracker.period
        between = self._between(then, last)
        if between is not None:
            return between, 0.0
        number = min(floor(then * tracker.rate + HAIR), last)
        while number >= 0 and number > last - self._kept:
            seen = self.sighting(number)
            if seen is not None:
                return seen.pose, tracker.bound * (then - seen.time)
            number -= 1
        return None

    def _between(self, time: float, last: int) -> pin.SE3 | None:
        """The pose at an earlier time, from the sightings around it up to a number."""
        number = floor(time * self._tracker.rate + HAIR)
        if number < 0 or number + 1 > last:
            return None
        a, b = self.sighting(number), self.sighting(number + 1)
        if a is None or b is None:
            return None
        return pin.SE3.Interpolate(a.pose, b.pose, (time - a.time) * self._tracker.rate)

    def _error(self, last: int) -> float | None:
        """Twice the largest error of what was predicted over the last period, of the origin [m].

        None: less than a period has been predicted. What was seen is compared with what was seen a
        period before.
        """
        tracker = self._tracker
        span = floor(tracker.period * tracker.rate)
        window = self._window
        if not window.last <= last <= window.last + span:
            window = self._window = _Window(last - span - 1)
        for number in range(window.last + 1, last + 1):
            window.add(self._found_error(number), number - span)
        known = 2.0 * LARGEST_ERROR * tracker.noise
        enough = window.count >= (1.0 - tracker.dropouts) ** 3 * 0.5 * span
        return 2.0 * window.worst + known + tracker.bound / tracker.rate if enough else None

    def _found_error(self, number: int) -> float:
        """By how much a prediction of a sighting was off [m]; negative: there was none."""
        if number not in self._worst:
            seen = self.sighting(number) if number >= 0 else None
            then = None if seen is None else self._between(seen.time - self._tracker.period, number)
            self._worst[number] = (
                -1.0
                if seen is None or then is None
                else float(np.linalg.norm(seen.pose.translation - then.translation))
            )
        return self._worst[number]


class _Window:
    """The largest of the last errors, each looked at once.

    Attributes:
        last: number of the newest.
        count: how many there are.
    """

    def __init__(self, last: int) -> None:
        self.last, self.count = last, 0
        self._known: deque[int] = deque()
        self._falling: deque[tuple[int, float]] = deque()  # the largest first

    @property
    def worst(self) -> float:
        return self._falling[0][1] if self._falling else 0.0

    def add(self, error: float, first: int) -> None:
        """Add the error of the next number (negative: none), forget those before the first."""
        self.last += 1
        if error >= 0.0:
            self._known.append(self.last)
            while self._falling and self._falling[-1][1] <= error:
                self._falling.pop()
            self._falling.append((self.last, error))
        while self._known and self._known[0] < first:
            self._known.popleft()
        while self._falling and self._falling[0][0] < first:
            self._falling.popleft()
        self.count = len(self._known)
