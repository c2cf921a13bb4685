"""What a console asked of the tool: to follow goals as they come, or to go somewhere by itself."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from robots import Arm

SLOWEST = 0.2  # goals to interpolate between are not waited for longer than this [s]
FASTEST = 2e-3  # and come no faster [s]


class Motions:
    """The motion in progress. Poses are of the tip, base frame; times are monotonic [s].

    Attributes:
        kind: "hold", "servo", "interpolate" or "move".
    """

    def __init__(self, model: Arm, lasts: Callable[[pin.SE3, pin.SE3], float]) -> None:
        """Args:
        model: of the arm, for this object's thread.
        lasts: how long a move from one pose to another takes at least [s].
        """
        self.kind = "hold"
        self._model, self._lasts = model, lasts
        self._from = self._to = pin.SE3.Identity()
        self._joints: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
        self._began = self._takes = 0.0

    @property
    def streams(self) -> bool:
        """Whether goals must keep coming."""
        return self.kind in ("servo", "interpolate")

    @property
    def commanded(self) -> bool:
        """Whether there is a goal."""
        return self.kind != "hold"

    def busy(self, now: float) -> bool:
        """Whether a move is under way."""
        return self.kind == "move" and now < self._began + self._takes

    def hold(self) -> None:
        """Go nowhere."""
        self.kind = "hold"

    def servo(self, goal: pin.SE3) -> None:
        """Be at the goal at once."""
        self.kind, self._to = "servo", goal

    def interpolate(self, goal: pin.SE3, tool: pin.SE3, now: float) -> None:
        """Reach the goal in the time until the next one may come."""
        before = self.target(now) if self.kind == "interpolate" else None
        self._takes = min(max(now - self._began, FASTEST), SLOWEST)
        if before is None:
            before, self._takes = tool, 0.02
        self.kind, self._joints = "interpolate", None
        self._from, self._to, self._began = before, goal, now

    def move(self, tool: pin.SE3, goal: pin.SE3, now: float) -> None:
        """Go to a pose: straight, from rest to rest."""
        self.kind, self._joints = "move", None
        self._from, self._to, self._began = tool, goal, now
        self._takes = self._lasts(tool, goal)

    def move_joints(self, goal: NDArray[np.float64], q: NDArray[np.float64], now: float) -> None:
        """Go to joints (n,) from joints q (n,): straight in joint space, from rest to rest."""
        self.kind, self._joints, self._began = "move", (q, goal), now
        # The fastest point of the course is 15/8 as fast as its mean.
        self._takes = float((np.abs(goal - q) / self._model.velocity).max()) * 15.0 / 8.0
        self._takes = max(self._takes, self._lasts(self._model.tip(q), self._model.tip(goal)))

    def target(self, now: float) -> pin.SE3 | None:
        """Where the tip is to be; None: there is no goal."""
        if self.kind == "hold":
            return None
        if self.kind == "servo":
            return self._to
        share = min((now - self._began) / self._takes, 1.0) if self._takes > 0.0 else 1.0
        if self.kind == "move":
            share = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)  # minimum jerk
        if self._joints is not None:
            q, goal = self._joints
            return self._model.tip(q + share * (goal - q))
        start, end = self._from, self._to
        turn = pin.log3(start.rotation.T @ end.rotation)
        return pin.SE3(
            start.rotation @ pin.exp3(share * turn),
            (1.0 - share) * start.translation + share * end.translation,
        )
