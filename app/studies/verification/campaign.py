"""Randomised test of the safety property: does the tip cross the surface, do the planes leak?"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

import robots
import vf
from app.judges import oracles
from app.studies.verification import hands, scenes
from meshes.content import Arrays

FloatArray = NDArray[np.float64]
Progress = Callable[[int], None]

MARKS = np.linspace(0.0, 1.0, 5)  # fractions of a tick's motion at which the tip is tested
EPISODE = 400  # ticks from one start position
SAMPLED = 97  # interval of the measurement of the blocked share [ticks]
QUERIES_SAMPLED = 16  # likewise [queries]


@dataclass
class Drive:
    """Result of `drive`."""

    ticks: int = 0
    crossings: int = 0
    first: str = ""  # description of the first crossing, to reproduce it
    inside: int = 0  # ticks that began inside, according to the controller
    statuses: Counter[vf.Status] = field(default_factory=Counter)
    solvers: Counter[vf.Solver] = field(default_factory=Counter)
    planes: int = 0
    shrunk: int = 0  # ticks with the plane budget exhausted
    forbidden: int = 0
    free: int = 0
    times: list[float] = field(default_factory=list)  # [s]

    @property
    def blocked(self) -> float:
        """Share of the directly reachable part of the motion sphere that the planes forbid."""
        return self.forbidden / self.free if self.free else 0.0


@dataclass
class Cover:
    """Result of `query`."""

    queries: int = 0
    leaking: int = 0  # queries with at least one leak
    first: str = ""
    planes: int = 0
    shrunk: int = 0
    forbidden: int = 0
    free: int = 0

    @property
    def blocked(self) -> float:
        return self.forbidden / self.free if self.free else 0.0


def drive(
    arm: robots.Arm,
    mesh: Arrays,
    *,
    rule: str,
    radius: float | None,
    steps: int,
    seed: int,
    noise: float = 0.0,
    tip_radius: float = 0.0,
    scene: scenes.Scene = scenes.PLAIN,
    outside_of: vf.Surface | None = None,
    progress: Progress = lambda _ticks: None,
) -> Drive:
    """Drive the arm against a mesh with adversarial proxies for `steps` ticks.

    Every `EPISODE` ticks the arm starts at random joint positions, with the mesh moved so that a
    random point of it is next to the tip. The segments between the true tip positions of
    consecutive ticks, and between `MARKS` of the joints' motion, are tested against every triangle
    and the corridor; a tip with a radius crosses a triangle that its ball overlaps.

    Args:
        tip_radius: of the tip, at least that of the scene [m].
        scene: the other fixtures.
        noise: bound on the actuation error at the tip added after every tick, as a share of the
            motion sphere's radius. The standoff is at least four times it: no planes can guarantee
            safety for an error larger than the standoff. It is 0 in a narrow scene.
        outside_of: start only outside this closed surface (the mesh before it was damaged).
    """
    rng = np.random.default_rng(seed)
    result = Drive()
    bound = 0.0 if scene.narrow else noise * (radius if radius is not None else 5e-4)
    tip_radius = max(tip_radius, scene.tip_radius)
    settings = vf.Settings(
        dt=scene.period, standoff=max(scene.standoff, 4.0 * bound), tip_radius=tip_radius
    )
    while result.ticks < steps:
        q = random_joints(arm, rng)
        tip = arm.tip(q)
        around = scenes.Surroundings(
            scene,
            partial(_surface_near, mesh, tip.translation, tip_radius, outside_of, rng),
            tip.translation, rule, radius, tip_radius, rng,
        )  # fmt: skip
        controller = vf.Controller(arm, around.fixtures, settings)
        tools = [tip]
        hand = hands.goals(rng, around.surfaces[0], tip, tools)
        crossed = False
        length = min(EPISODE, steps - result.ticks)
        for _ in range(length):
            before = q
            step = controller.step(q, next(hand))
            q = _actuate(arm, step.q, bound, rng) if bound else step.q
            tools[0] = arm.tip(q)
            crossed |= _judge(result, around, step, _tip_positions(arm, before, q), rng, crossed)
            result.ticks += 1
        progress(length)
    return result


def _tip_positions(arm: robots.Arm, q: FloatArray, q_new: FloatArray) -> list[FloatArray]:
    """Tip positions (3,) at `MARKS` of a uniform joint motion from q to q_new (n,)."""
    if (q_new == q).all():
        return [arm.tip(q).translation.copy()]
    marks = MARKS if arm.revolute.any() else MARKS[[0, -1]]
    return [arm.tip(q + t * (q_new - q) if t < 1.0 else q_new).translation.copy() for t in marks]


def _judge(
    result: Drive,
    around: scenes.Surroundings,
    step: vf.Step,
    way: list[FloatArray],
    rng: np.random.Generator,
    crossed_before: bool,
) -> bool:
    """Count the events of one tick; returns whether something was crossed.

    Every episode starts outside. So the status INSIDE excuses a crossing, on the way out, only
    after an earlier crossing in the same episode (`crossed_before`).
    """
    result.statuses[step.status] += 1
    result.solvers[step.solver] += 1
    result.planes += len(step.planes)
    result.shrunk += step.planes.radius < step.radius
    result.times.append(step.timings.total)
    if step.status is vf.Status.INSIDE:
        result.inside += 1
        if crossed_before:
            return False
    crossed = any(around.crossings(a, b) for a, b in pairwise(way))
    if crossed:
        result.crossings += 1
        if not result.first:
            result.first = f"tick {result.ticks}: {way[0].tolist()} → {way[-1].tolist()}"
    if result.ticks % SAMPLED == 0 and step.radius > 0.0:
        surface = around.surfaces[0]
        forbidden, free = oracles.blocked(surface, step.planes, way[0], step.radius, rng, 16)
        result.forbidden += forbidden
        result.free += free
    return crossed


def random_joints(arm: robots.Arm, rng: np.random.Generator) -> FloatArray:
    """Random joint positions; a third of them with some joints exactly at their limits."""
    share = rng.uniform(0.02, 0.98, len(arm.lower))
    if rng.random() < 1.0 / 3.0:
        ends = rng.random(len(share)) < 0.4
        share[ends] = rng.integers(0, 2, ends.sum())
    return arm.lower + share * (arm.upper - arm.lower)


def _surface_near(
    mesh: Arrays,
    p: FloatArray,
    tip_radius: float,
    outside_of: vf.Surface | None,
    rng: np.random.Generator,
) -> vf.Surface:
    """The mesh, moved so that p (3,) is outside and within millimetres of a random point of it."""
    vertices, faces = mesh
    while True:
        corners = vertices[faces[rng.integers(len(faces))]]
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        size = float(np.linalg.norm(normal))
        if size == 0.0:
            continue
        spot = rng.dirichlet([1.0, 1.0, 1.0]) @ corners
        side = 1.0 if rng.random() < 0.7 else -1.0  # open meshes are approached from both sides
        gap = tip_radius + rng.uniform(5e-5, 3e-3)
        start = spot + side * gap * normal / size
        if outside_of is not None and outside_of.inside(start):
            continue
        surface = vf.Surface.from_arrays(vertices + (p - start), faces)
        if not surface.inside(p) and surface.nearest(p)[0] > tip_radius + 4e-5:
            return surface


def _actuate(arm: robots.Arm, q: FloatArray, bound: float, rng: np.random.Generator) -> FloatArray:
    """Actual joint positions, with a random tip error of at most `bound` [m]."""
    p = arm.tip(q).translation
    error = rng.normal(size=len(q)) * arm.velocity
    J = arm.jacobian(q)[:3]
    error *= bound * rng.random() / max(float(np.linalg.norm(J @ error)), 1e-12)
    while True:
        q_true = arm.clamp(q + error)
        if np.linalg.norm(arm.tip(q_true).translation - p) <= bound:
            return q_true
        error *= 0.5


def query(
    mesh: Arrays,
    *,
    rule: str,
    edges: float,
    queries: int,
    seed: int,
    standoff: float = 0.0,
    tip_radius: float = 0.0,
    outside_of: vf.Surface | None = None,
    progress: Progress = lambda _queries: None,
) -> Cover:
    """Search for leaks of a rule at random points around a mesh, on both sides of it.

    Points inside a closed mesh are skipped.

    Args:
        edges: radius of the ball in median edge lengths.
        standoff, tip_radius: of the certified rule [m]; the other rules ignore them. Points at
            which the tip overlaps the mesh are skipped.
        outside_of: query only outside this closed surface (the mesh before it was damaged).
    """
    surface = vf.Surface.from_arrays(*mesh)
    rng = np.random.default_rng(seed)
    radius = edges * surface.median_edge
    result = Cover()
    while result.queries < queries:
        corners = surface.vertices[surface.faces[rng.integers(len(surface.faces))]]
        heading = rng.normal(size=3)
        heading /= np.linalg.norm(heading)
        gap = tip_radius + radius * rng.uniform(0.001, 1.0)
        x = rng.dirichlet([1.0, 1.0, 1.0]) @ corners + heading * gap
        if surface.inside(x) or (outside_of is not None and outside_of.inside(x)):
            continue
        if tip_radius and surface.nearest(x)[0] <= tip_radius:
            continue
        planes = planes_of(rule, surface, x, radius, standoff, tip_radius)
        result.queries += 1
        result.planes += len(planes)
        result.shrunk += planes.radius < radius
        if oracles.leaks(surface, planes, x, planes.radius, tip_radius):
            result.leaking += 1
            if not result.first:
                result.first = f"query {result.queries}: x = {x.tolist()}, radius {radius!r}"
        if result.queries % QUERIES_SAMPLED == 1:
            forbidden, free = oracles.blocked(surface, planes, x, radius, rng, 64)
            result.forbidden += forbidden
            result.free += free
        if result.queries % 100 == 0:
            progress(100)
    progress(result.queries % 100)
    return result


def planes_of(
    rule: str,
    surface: vf.Surface,
    x: FloatArray,
    radius: float,
    standoff: float,
    tip_radius: float = 0.0,
) -> vf.Planes:
    """The planes of a rule, without the controller."""
    if rule == "certified":
        return vf.certified_planes(surface, x, radius, standoff, tip_radius)
    if rule == "paper":
        return vf.paper_planes(surface, x, radius)
    if rule == "all":
        return vf.every_plane(surface, x, radius)
    fixture = vf.MeshFixture(surface, rule, radius)
    return fixture.planes(x, radius, standoff, tip_radius, fixture.inside(x))
