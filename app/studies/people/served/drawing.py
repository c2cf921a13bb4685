"""Layer: what is to be done in a trial: a line, or targets."""

from __future__ import annotations

import numpy as np
import viser
from numpy.typing import NDArray

from app.studies.people.progress import TOUCH, Progress
from app.studies.people.tasks import Goal
from app.view import palette
from app.view.camera import View
from app.view.drawing import nodes
from app.view.units import to_buffer, to_view

FloatArray = NDArray[np.float64]

AHEAD, DONE, AIM = (230, 120, 20), (0, 158, 115), (213, 94, 0)
LIFT = 0.3e-3  # of a line above the bone [m]
FROM = np.array([0.62, -0.30, 0.72])  # where the eye is, seen from the middle of what is to be done
DISTANCE = 0.075  # of the eye [m]


class GoalDrawing:
    """The path, its done part in another colour, with its two ends; or the target that is next."""

    def __init__(self, api: viser.SceneApi) -> None:
        self._api = api
        self._line = nodes.lines(api, "/goal/line", 5.0)
        self._aim = nodes.ball(api, "/goal/aim", AIM)
        self._end = nodes.ball(api, "/goal/end", DONE)
        self._goal: Goal | None = None
        self._points = np.empty((0, 3))
        self._stations = np.empty(0)

    def show(self, goal: Goal | None) -> None:
        """Draw another goal; None: nothing."""
        self._goal = goal
        path = goal is not None and goal.planned is not None
        self._line.visible = self._end.visible = path
        self._aim.visible = goal is not None
        if goal is None or goal.planned is None:
            return
        planned = goal.planned
        self._stations = np.linspace(0.0, planned.length, 41)
        found = [planned.at(s) for s in self._stations]
        self._points = np.array([point + LIFT * outward for point, _, _, outward in found])
        self._line.points = to_buffer(np.stack([self._points[:-1], self._points[1:]], axis=1))
        self._end.position = to_view(self._points[-1])
        self._end.scale = float(to_view(0.7e-3))

    def frame(self, progress: Progress) -> None:
        """Show how far it is."""
        if self._goal is None:
            return
        if self._goal.planned is None:
            self._aim.position, self._aim.scale = to_view(progress.aim), float(to_view(TOUCH))
            return
        done = self._stations[1:] <= progress.station + 1e-6
        colours = palette.linear(np.where(done[:, None, None], np.array(DONE), np.array(AHEAD)))
        self._line.colors = np.ascontiguousarray(np.broadcast_to(colours, (len(done), 2, 3)))
        k = min(int(np.searchsorted(self._stations, progress.station)), len(self._points) - 1)
        self._aim.position, self._aim.scale = to_view(self._points[k]), float(to_view(0.7e-3))


def view_of(goal: Goal, p_tip: FloatArray) -> View:
    """The view of a trial: what is to be done and the tool above it, obliquely from above."""
    line = goal.line
    middle = 0.6 * 0.5 * (line.min(axis=0) + line.max(axis=0)) + 0.4 * p_tip
    return View(middle + DISTANCE * FROM / np.linalg.norm(FROM), middle)
