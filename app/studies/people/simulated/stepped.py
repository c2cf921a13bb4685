"""A session without a clock: its ticks are done one by one, as quickly as they can be computed."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from app.control.loop import ControlLoop
from app.session import Session
from app.settings import Options
from app.studies.people.hand import Hand
from app.studies.people.progress import Progress

FloatArray = NDArray[np.float64]

MESSAGES = 50.0  # of the hand per second, about as a browser sends them [Hz]


class TrialOver(Exception):
    """The trial ended while the operator was moving."""


class SteppedSession(Session):
    """A session whose control loop is not started; `tick` does a tick on the caller's thread."""

    def __init__(self, options: Options) -> None:
        super().__init__(options)
        assert isinstance(self._loop, ControlLoop)
        self._stepped = self._loop

    def start(self) -> None:
        """Do a first tick, so that there is telemetry."""
        self.tick()

    @property
    def now(self) -> float:
        """Time of the ticks [s]."""
        return self.latest().time

    def tick(self) -> None:
        """Do the next tick."""
        self._stepped.tick()

    def _ticked(self, *_: object) -> None:
        """Nobody watches: what happened is in the recording."""


class Follower:
    """The tool as the experiments' operators move it, over a hand on a stepped session.

    The hand moves in steps, `MESSAGES` a second, as that of a person does.
    """

    def __init__(self, session: SteppedSession, hand: Hand, progress: Progress) -> None:
        self._session, self._hand, self._progress = session, hand, progress
        options = session.options
        self._every = max(round(options.rate / MESSAGES), 1)
        self._scale = options.scale
        self._ticks = 0
        self._since = session.now
        hand.recall()
        self._origin = pin.SE3(session.handle)

    def __call__(self, goals: FloatArray) -> FloatArray:
        """The tip (n, 3) after each tick, for its goals (n, 3), base frame [m].

        Raises:
            TrialOver: the goal is reached, or the time is over.
        """
        tips = np.empty_like(goals)
        session, hand, progress, origin = self._session, self._hand, self._progress, self._origin
        for i, goal in enumerate(goals):
            seldom = self._ticks % self._every == 0
            if seldom:
                shift = (goal - origin.translation) / self._scale
                hand.drive(pin.SE3(origin.rotation, origin.translation + shift), held=True)
            self._ticks += 1
            hand.pump()
            session.tick()
            telemetry = session.latest()
            assert telemetry.step is not None
            tips[i] = telemetry.step.tip.translation
            if seldom and progress.see(telemetry.time - self._since, tips[i]):
                raise TrialOver
        return tips
