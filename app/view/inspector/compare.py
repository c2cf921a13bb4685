"""Comparison of all rules at one pose: planes, next step, leaks and needlessly blocked space.

Leaks and blocked space are estimated by sampling, with no code of the rules, over the triangles
that `app.judges.boxes` finds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import vf
from app.judges import boxes, oracles
from app.scene import scene as scenes
from app.scene.picking import distances
from app.scene.scene import Scene
from app.settings import Options

FloatArray = NDArray[np.float64]

SAMPLES = 2000  # points of the surface
PATHS = 96  # straight paths from x
MAX_TRIANGLES = 1500  # that a path is tested against, the nearest ones
BLOCK = 64  # planes tested at a time


@dataclass(frozen=True)
class Forecast:
    """Result of one rule.

    Attributes:
        rule: its name.
        planes: their number.
        leaking: share of the surface in the ball that is on the allowed side of every plane.
        blocked: share of the ball's free space (reached by straight free paths) that the planes
            forbid; nan if no free point was found.
        step: length of the tip's next step [m]; nan without a `Pose`.
        p_tip: (3,) the tip after that step [m].
        gap: from there to the surface [m].
        crosses: whether the step meets the surface.
    """

    rule: str
    planes: int
    leaking: float
    blocked: float
    step: float
    p_tip: FloatArray
    gap: float
    crosses: bool


@dataclass(frozen=True)
class Pose:
    """Joint positions (n,) and proxy of the next step."""

    q: FloatArray
    target: pin.SE3


@dataclass(frozen=True)
class Forecasts:
    """Results of all rules from the same state.

    Attributes:
        x: (3,) the tip or the probe [m].
        tick: number of the tick; None for a probe.
        of: one forecast per rule.
    """

    x: FloatArray
    tick: int | None
    of: tuple[Forecast, ...]


class Comparison:
    """A copy of a scene's arm and one controller per rule; for one thread at a time."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._arm = scene.arm.copy()
        self._options: Options | None = None
        self._controllers: dict[str, vf.Controller] = {}

    def forecasts(
        self,
        surface: vf.Surface,
        x: FloatArray,
        radius: float,
        options: Options,
        pose: Pose | None,
    ) -> tuple[Forecast, ...]:
        """Forecasts at x (3,) [m]; without a `pose` no step is computed."""
        rng = np.random.default_rng(0)  # the same samples each time, for steady numbers
        reach = radius + options.tip_radius
        near = boxes.near(boxes.of(surface), x, x, reach)
        away = oracles.distances(surface, near, x)
        near = near[np.argsort(away)[: np.count_nonzero(away <= reach)]]
        corners = surface.vertices[surface.faces[near]] - x
        on_surface = sample(corners, reach, SAMPLES, rng)
        free = reachable(corners[:MAX_TRIANGLES], radius, PATHS, rng)
        inside = surface.inside(x)
        found = []
        for rule in vf.RULES:
            planes = vf.MeshFixture(surface, rule, radius).planes(
                x, radius, options.standoff, options.tip_radius, inside
            )
            leaking = _share(planes, x, on_surface, options.tip_radius)
            blocked = 1.0 - _share(planes, x, free, 0.0)
            step, p_tip, gap, crosses = np.nan, x, np.nan, False
            if pose is not None:
                step, p_tip, gap, crosses = self._step(rule, surface, options, pose)
            found.append(Forecast(rule, len(planes), leaking, blocked, step, p_tip, gap, crosses))
        return tuple(found)

    def _step(
        self, rule: str, surface: vf.Surface, options: Options, pose: Pose
    ) -> tuple[float, FloatArray, float, bool]:
        """Step, p_tip, gap and crosses of a `Forecast`."""
        made = self._controller(rule, options).step(pose.q, pose.target)
        start = np.array(self._arm.tip(pose.q).translation)
        p_tip = np.array(made.tip.translation)
        move = p_tip - start
        step = float(np.linalg.norm(move))
        near = boxes.near(boxes.of(surface), start, p_tip, 1e-9)
        met = distances(surface.vertices[surface.faces[near]], start, move)
        return step, p_tip, surface.nearest(p_tip)[0], bool(step > 0.0 and (met <= 1.0).any())

    def _controller(self, rule: str, options: Options) -> vf.Controller:
        """The controller that the session would use, with its corridor."""
        if self._options != options:
            self._options, self._controllers = options, {}
        if rule not in self._controllers:
            plant = scenes.plant(self._scene, replace(options, rule=rule))
            self._controllers[rule] = plant.controller
        return self._controllers[rule]


def _share(planes: vf.Planes, x: FloatArray, points: FloatArray, tip_radius: float) -> float:
    """Share of points (k, 3), relative to x, that are allowed; nan for no points."""
    if len(points) == 0:
        return float("nan")
    within = np.linalg.norm(points, axis=1) <= planes.radius + tip_radius
    return float((within & allowed(planes, x, points, tip_radius)).mean())


def allowed(
    planes: vf.Planes, x: FloatArray, points: FloatArray, tip_radius: float
) -> NDArray[np.bool_]:
    """Which of the points (k, 3), relative to x, are on the allowed side of every plane.

    With a tip radius the planes are shifted towards the surface by it.
    """
    offsets = planes.offsets - planes.normals @ x - tip_radius
    left = np.arange(len(points))
    for k in range(0, len(planes), BLOCK):
        some = slice(k, k + BLOCK)
        behind = (points[left] @ planes.normals[some].T < offsets[some]).any(axis=1)
        left = left[~behind]
    out = np.zeros(len(points), dtype=bool)
    out[left] = True
    return out


def sample(corners: FloatArray, reach: float, count: int, rng: np.random.Generator) -> FloatArray:
    """Up to `count` points, uniform over the area of triangles (m, 3, 3) in a ball at the origin.

    Each point is drawn from a triangle or from the disc of its plane in the ball, whichever is
    smaller, and kept if it lies in both.
    """
    if len(corners) == 0:
        return np.zeros((0, 3))
    a, u, v = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    n = np.cross(u, v)
    doubled = np.linalg.norm(n, axis=1)
    proper = doubled > 0.0
    a, u, v, n, doubled = a[proper], u[proper], v[proper], n[proper], doubled[proper]
    if len(a) == 0:
        return np.zeros((0, 3))
    n = n / doubled[:, None]
    height = np.einsum("ij,ij->i", n, a)
    disc2 = np.maximum(reach**2 - height**2, 0.0)  # squared radius of the disc
    area = np.minimum(0.5 * doubled, np.pi * disc2)
    if area.sum() == 0.0:
        return np.zeros((0, 3))
    i = rng.choice(len(a), size=count, p=area / area.sum())
    s, t = rng.random(count), rng.random(count)
    flip = s + t > 1.0
    s, t = np.where(flip, 1.0 - s, s), np.where(flip, 1.0 - t, t)
    on_triangle = a[i] + s[:, None] * u[i] + t[:, None] * v[i]
    angle, rho = 2.0 * np.pi * rng.random(count), np.sqrt(disc2[i] * rng.random(count))
    e = u[i] / np.linalg.norm(u[i], axis=1, keepdims=True)
    f = np.cross(n[i], e)
    on_disc = height[i, None] * n[i] + rho[:, None] * (
        np.cos(angle)[:, None] * e + np.sin(angle)[:, None] * f
    )
    from_triangle = 0.5 * doubled[i] <= np.pi * disc2[i]
    points = np.where(from_triangle[:, None], on_triangle, on_disc)
    kept = np.linalg.norm(points, axis=1) <= reach
    # Barycentric coordinates, for the points drawn from a disc.
    w = points - a[i]
    p = np.einsum("ij,ij->i", np.cross(w, v[i]), n[i]) / doubled[i]
    q = np.einsum("ij,ij->i", np.cross(u[i], w), n[i]) / doubled[i]
    kept &= from_triangle | ((p >= 0.0) & (q >= 0.0) & (p + q <= 1.0))
    return np.asarray(points[kept])


def reachable(
    corners: FloatArray, radius: float, count: int, rng: np.random.Generator
) -> FloatArray:
    """Of `count` random points in a ball at the origin, those that a straight free path reaches."""
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    ends = directions * (radius * rng.random((count, 1)) ** (1.0 / 3.0))
    if len(corners) == 0:
        return ends
    free = [not (distances(corners, np.zeros(3), end) <= 1.0).any() for end in ends]
    return np.asarray(ends[free])
