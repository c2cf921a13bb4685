"""A deterministic route of the proxy: contacts and slides at twelve spots, half of them pits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import robots
import vf

FloatArray = NDArray[np.float64]

HOVER = 6e-3  # height of the start above a spot [m]
DEPTH = 3e-3  # of the proxy below the surface while sliding [m]
SLIDE = 8e-3  # length of a slide [m]
REACH = 0.03  # largest horizontal distance of a spot from the arm's neutral tip [m]
SPOTS = 12
TICKS = 200  # of 1 ms per spot, slow enough for the PSM's insertion joint (0.2 m/s)
_PIT = 4e-3  # radius over which hollowness is measured [m]
_CANDIDATES = 240


@dataclass(frozen=True)
class Route:
    """Proxy paths, one for each spot, in the arm's base frame.

    Attributes:
        rotation: (3, 3) of every pose.
        starts: joints (n,) with the tip at the beginning of each path.
        paths: polylines (k, 3) [m].
        pits: whether each spot was chosen for its hollowness.
    """

    rotation: FloatArray
    starts: tuple[FloatArray, ...]
    paths: tuple[FloatArray, ...]
    pits: tuple[bool, ...]

    def targets(self, spot: int) -> list[pin.SE3]:
        """The proxy at `TICKS` instants of a spot's path, at constant speed."""
        path = self.paths[spot]
        arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
        s = np.linspace(0.0, arc[-1], TICKS)
        points = np.column_stack([np.interp(s, arc, path[:, k]) for k in range(3)])
        return [pin.SE3(self.rotation, point) for point in points]


def plan(surface: vf.Surface, arm: robots.Arm, spots: int = SPOTS) -> Route:
    """A route over the upper (+z) side of a surface below the arm's tip.

    Each path goes from free space into the surface, along and below it, and up again: the tool is
    free, in contact, sliding, and in a pit sliding against several walls.

    Raises:
        ValueError: no spot of the surface can be reached from above.
    """
    T = arm.tip(arm.neutral)
    found = []
    for k in range(_CANDIDATES):
        # A Fermat spiral covers the disc evenly.
        distance, angle = REACH * np.sqrt(k / _CANDIDATES), k * np.pi * (3.0 - np.sqrt(5.0))
        xy = T.translation[:2] + distance * np.array([np.cos(angle), np.sin(angle)])
        point = _highest(surface, xy)
        if point is not None:
            found.append(point)
    candidates = np.array(found).reshape(-1, 3)
    hollow = np.array([_hollowness(surface, p) for p in candidates])
    chosen: list[FloatArray] = []
    starts, paths, pits = [], [], []
    # Alternately the most hollow candidate and the one farthest from those chosen, so that the
    # first few are representative too.
    while len(candidates) and len(chosen) < spots:
        pit = len(chosen) % 2 == 0
        if pit:
            k = int(np.argmax(hollow))
        else:
            apart = np.linalg.norm(candidates[:, None] - np.array(chosen)[None], axis=2)
            k = int(np.argmax(apart.min(axis=1)))
        spot = candidates[k]
        path = _path(surface, spot, len(chosen))
        try:
            q = arm.inverse(pin.SE3(T.rotation, path[0]), start=arm.neutral)
        except robots.Unreachable:
            keep = np.arange(len(candidates)) != k
        else:
            chosen.append(spot)
            starts.append(np.array(q))
            paths.append(path)
            pits.append(pit)
            keep = np.linalg.norm(candidates - spot, axis=1) > 0.5 * SLIDE
        candidates, hollow = candidates[keep], hollow[keep]
    if not chosen:
        raise ValueError("no spot of the mesh can be reached from above: is the unit right?")
    return Route(np.array(T.rotation), tuple(starts), tuple(paths), tuple(pits))


def _highest(surface: vf.Surface, xy: FloatArray) -> FloatArray | None:
    """The highest point (3,) of the surface on the vertical through xy, if there is one."""
    a, b, c = surface.vertices[surface.faces].transpose(1, 0, 2)  # (m, 3) each
    u, v, p = (b - a)[:, :2], (c - a)[:, :2], xy - a[:, :2]
    area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        s = (p[:, 0] * v[:, 1] - p[:, 1] * v[:, 0]) / area
        t = (u[:, 0] * p[:, 1] - u[:, 1] * p[:, 0]) / area
        hit = (s >= 0.0) & (t >= 0.0) & (s + t <= 1.0)
    if not hit.any():
        return None
    height = a[hit, 2] + s[hit] * (b - a)[hit, 2] + t[hit] * (c - a)[hit, 2]
    return np.array([*xy, height.max()])


def _hollowness(surface: vf.Surface, p: FloatArray) -> float:
    """Mean height of the surface around p (3,) above it [m]; > 0 in a pit."""
    around = surface.vertices[surface.faces[surface.within(p, _PIT).triangles, 0]]
    return float((around[:, 2] - p[2]).mean())


def _path(surface: vf.Surface, spot: FloatArray, index: int) -> FloatArray:
    angle = index * np.pi * (3.0 - np.sqrt(5.0))
    along = np.array([np.cos(angle), np.sin(angle), 0.0])
    slide = [spot]
    for s in np.linspace(0.0, SLIDE, 9)[1:]:
        here = _highest(surface, (spot + s * along)[:2])
        # Beyond an edge of the shape the path stops.
        slide.append(here if here is not None and abs(here[2] - spot[2]) < SLIDE else slide[-1])
    up = np.array([0.0, 0.0, 1.0])
    below = np.array(slide) - DEPTH * up
    return np.vstack([spot + HOVER * up, below, below[-1] + (DEPTH + 0.5 * HOVER) * up])
