"""How far a trial is: which part of its path is done, or which targets are touched."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from app.studies.people.tasks import Goal

FloatArray = NDArray[np.float64]

HOLD = 0.3  # the tip must stay so long at a target [s]
TOUCH = 1.5e-3  # of a target, from its middle [m]
ASIDE = 4e-3  # a tip farther from the path than this does not get on [m]
AHEAD = 2e-3  # nor one that skips more than this of it [m]
ABOVE = 1.5e-3  # nor one higher than this above the bone, in tracing [m]
END = 0.5e-3  # so much of the path may be left [m]


class Progress:
    """Watches the tip until the goal is reached, or the time is over.

    Attributes:
        goal: of the trial.
        limit: time after which it is over [s].
        time: of the trial so far [s].
        station: how far along the path it is [m].
        touched: number of targets touched.
    """

    def __init__(self, goal: Goal, limit: float) -> None:
        self.goal = goal
        self.limit = limit
        self.time = 0.0
        self.station = 0.0
        self.touched = 0
        self._since: float | None = None  # the tip is at the target
        self._frame: tuple[FloatArray, ...] = ()  # of the path at the station, until it moves on

    @property
    def completed(self) -> bool:
        """Whether the goal is reached."""
        if self.goal.planned is None:
            return self.touched >= len(self.goal.targets)
        return self.station >= self.goal.planned.length - END

    @property
    def over(self) -> bool:
        """Whether the trial ends."""
        return self.completed or self.time >= self.limit

    @property
    def share(self) -> float:
        """How much of it is done, 0 to 1."""
        if self.goal.planned is None:
            return self.touched / max(len(self.goal.targets), 1)
        return 1.0 if self.completed else self.station / self.goal.planned.length

    @property
    def aim(self) -> FloatArray:
        """(3,) where the tip is to go next: a target, or the path where it is to be gone on."""
        if self.goal.planned is None:
            return np.asarray(self.goal.targets[min(self.touched, len(self.goal.targets) - 1)])
        point, _, _, outward = self.goal.planned.at(self.station)
        return np.asarray(point - self.goal.depth * outward)

    def see(self, time: float, tip: FloatArray) -> bool:
        """The tip (3,) at a time since the start [s], times rising; returns `over`."""
        if not self.over:
            self.time = time
            if self.goal.planned is None:
                self._see_target(time, tip)
            else:
                self._see_path(tip)
        return self.over

    def _see_target(self, time: float, tip: FloatArray) -> None:
        if np.linalg.norm(tip - self.aim) > TOUCH:
            self._since = None
        elif self._since is None:
            self._since = time
        elif time - self._since >= HOLD:
            self.touched, self._since = self.touched + 1, None

    def _see_path(self, tip: FloatArray) -> None:
        planned = self.goal.planned
        assert planned is not None
        if not self._frame:
            self._frame = planned.at(self.station)
        # The path bends little within `AHEAD`.
        point, along, aside, outward = self._frame
        off = tip - point
        ahead, lateral, height = float(off @ along), float(off @ aside), float(off @ outward)
        lowest = -0.5 * self.goal.depth if self.goal.task == "cutting" else ABOVE
        if 0.0 < ahead <= AHEAD and abs(lateral) <= ASIDE and height <= lowest:
            self.station = min(self.station + ahead, planned.length)
            self._frame = ()
