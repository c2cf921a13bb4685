"""Scripted motion of the proxy: approach the anatomy, press, slide, lift off, circle.

The path is planned once from the surface; the pose is then a function of time alone, so that a
demo, a test and a replay get bitwise equal proxies.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import vf

FloatArray = NDArray[np.float64]

SPEED = 0.08  # highest speed of the proxy [m/s]; a surgeon's hand stays below 0.1
HOVER = 0.006  # height above the surface between contacts [m]
DEPTH = 0.003  # depth of the proxy below the surface while pressing and sliding [m]
STRIDE = 5e-4  # distance of the points of a slide [m]
STEP = 3e-3  # a slide with a larger height difference between two points is omitted [m]
DWELL = 0.4  # rest at the deepest point of a press [s]
SPOTS = 4
REACH = 0.015  # largest horizontal distance of a spot from the start, within the first view [m]
_PEAK = 1.875  # peak over mean speed of a minimum-jerk motion


class Script(Protocol):
    """A scripted proxy: its pose is a function of time alone."""

    def pose(self, time: float) -> pin.SE3:
        """The proxy a time ≥ 0 [s] after the start, arm base frame."""
        ...


@dataclass(frozen=True)
class Autopilot:
    """A closed tour of the proxy's position; the orientation stays the tool's neutral one.

    Attributes:
        rotation: (3, 3) of every pose, arm base frame.
        starts: (k + 1,) time at which each leg starts, the last one is the tour's duration [s].
        legs: k polylines (m, 3), arm base frame [m]; each is run through from rest to rest.
        arcs: k cumulative lengths (m,) along the polylines [m].
    """

    rotation: FloatArray
    starts: FloatArray
    legs: tuple[FloatArray, ...]
    arcs: tuple[FloatArray, ...]

    @property
    def duration(self) -> float:
        """Time of one tour, after which it starts over [s]."""
        return float(self.starts[-1])

    def pose(self, time: float) -> pin.SE3:
        """The proxy a time ≥ 0 [s] after the start, arm base frame."""
        time = time % self.duration
        k = min(int(np.searchsorted(self.starts, time, side="right")) - 1, len(self.legs) - 1)
        u = (time - self.starts[k]) / (self.starts[k + 1] - self.starts[k])
        # Minimum jerk along the arc: zero speed and acceleration where legs meet.
        s = self.arcs[k][-1] * u * u * u * (10.0 + u * (-15.0 + 6.0 * u))
        leg, arc = self.legs[k], self.arcs[k]
        position = np.array([np.interp(s, arc, leg[:, i]) for i in range(3)])
        return pin.SE3(self.rotation, position)


@dataclass(frozen=True)
class Course:
    """A script through waypoints: minimum jerk between them, at rest in each and after the last.

    Attributes:
        rotation: (3, 3) of every pose, arm base frame.
        times: (k,) of the waypoints, rising from 0 [s].
        points: (k, 3) the waypoints, arm base frame [m].
    """

    rotation: FloatArray
    times: FloatArray
    points: FloatArray

    @property
    def duration(self) -> float:
        """Time of the last waypoint [s]; the proxy stays there."""
        return float(self.times[-1])

    def pose(self, time: float) -> pin.SE3:
        """The proxy a time ≥ 0 [s] after the start, arm base frame."""
        k = int(np.searchsorted(self.times, time, side="right")) - 1
        if k >= len(self.times) - 1:
            return pin.SE3(self.rotation, self.points[-1])
        u = (time - self.times[k]) / (self.times[k + 1] - self.times[k])
        share = u * u * u * (10.0 + u * (-15.0 + 6.0 * u))
        return pin.SE3(self.rotation, (1.0 - share) * self.points[k] + share * self.points[k + 1])


def plan(surface: vf.Surface, T_base_tip: pin.SE3) -> Autopilot:
    """A tour over the upper side of a surface that starts and ends at the given tip pose.

    Args:
        surface: the anatomy, arm base frame, below (−z) the tip.
        T_base_tip: the tool's neutral pose.
    """
    start = np.array(T_base_tip.translation)
    spots = _spots(surface, start)
    up = np.array([0.0, 0.0, 1.0])
    ceiling = max(float(spots[:, 2].max()) + HOVER, float(start[2]))
    legs: list[FloatArray] = []
    here = start
    for index, spot in enumerate(spots):
        above, below = spot + HOVER * up, spot - DEPTH * up
        # Travel at the height of the start, above any peak between two spots.
        legs.append(np.array([here, [*here[:2], ceiling], [*above[:2], ceiling], above]))
        legs.append(np.array([above, below]))
        legs.append(np.array([below, below]))
        here = below
        if index + 1 < len(spots):
            slide = _slide(surface, spot, spots[index + 1], ceiling)
            # No slide over an opening, through which the tip would pass: lift off instead.
            if slide is not None:
                legs.append(slide - DEPTH * up)
                here = legs[-1][-1]
        lifted = np.array([here[0], here[1], here[2] + DEPTH + HOVER])
        legs.append(np.array([here, lifted]))
        here = lifted
    legs.append(_circle(here, spots.mean(axis=0) - DEPTH * up))
    here = legs[-1][-1]
    legs.append(np.array([here, [here[0], here[1], ceiling], start]))

    arcs = [np.concatenate([[0.0], np.cumsum(_lengths(leg))]) for leg in legs]
    times = [max(_PEAK * arc[-1] / SPEED, DWELL) for arc in arcs]
    for array in (*legs, *arcs):
        array.flags.writeable = False
    starts = np.concatenate([[0.0], np.cumsum(times)])
    return Autopilot(np.array(T_base_tip.rotation), starts, tuple(legs), tuple(arcs))


def _spots(surface: vf.Surface, start: FloatArray) -> FloatArray:
    """Up to SPOTS points (k, 3) on the upper side, distributed below the start."""
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    reach = min(0.4 * float((high - low)[:2].min()), REACH)
    ceiling = max(float(high[2]), float(start[2])) + 1e-3
    found = []
    for k in range(24):
        # A Fermat spiral covers the disc evenly, from its centre outwards.
        distance, angle = reach * np.sqrt(k / 23), k * np.pi * (3.0 - np.sqrt(5.0))
        xy = start[:2] + distance * np.array([np.cos(angle), np.sin(angle)])
        point = _below(surface, xy, ceiling, float(low[2]) - 1e-3)
        if point is not None:
            found.append(point)
    if not found:
        return np.array([surface.nearest(start)[2]])
    chosen = np.linspace(0, len(found) - 1, min(SPOTS, len(found))).round().astype(int)
    return np.array([found[k] for k in chosen])


def _below(surface: vf.Surface, xy: FloatArray, ceiling: float, floor: float) -> FloatArray | None:
    """The highest point (3,) of the surface on the vertical through xy, if there is one.

    Sphere tracing: descend by the distance to the nearest triangle until it is zero.
    """
    point = np.array([*xy, ceiling])
    for _ in range(300):
        distance = surface.nearest(point)[0]
        if distance < 1e-6:
            return point
        point[2] -= distance
        if point[2] < floor:
            return None
    return None  # no convergence along a steep wall


def _slide(surface: vf.Surface, a: FloatArray, b: FloatArray, ceiling: float) -> FloatArray | None:
    """From a to b along the upper side, (k, 3); None: there is an opening or a step on the way."""
    points = 2 + int(np.linalg.norm(b - a) / STRIDE)
    line = np.linspace(a, b, points)
    floor = float(surface.vertices[:, 2].min()) - 1e-3
    top = max(ceiling, float(surface.vertices[:, 2].max())) + 1e-3
    for k in range(1, points - 1):
        hit = _below(surface, line[k, :2], top, floor)
        if hit is None:
            return None
        line[k] = hit
    return line if np.abs(np.diff(line[:, 2])).max() <= STEP else None


def _circle(start: FloatArray, centre: FloatArray, points: int = 73) -> FloatArray:
    """From the start down to a circle about the centre, 4 mm in radius, and once around."""
    angle = np.linspace(0.0, 2.0 * np.pi, points)
    ring = centre + 0.004 * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    return np.vstack([start, ring])


def _lengths(leg: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(np.diff(leg, axis=0), axis=1))
