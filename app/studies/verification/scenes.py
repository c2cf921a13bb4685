"""Scenes of the campaign: several meshes, a corridor, wide standoffs, exhausted plane budgets."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import vf
from app.judges import oracles

FloatArray = NDArray[np.float64]

PINS = 300  # more than the plane budget
PIN_DISTANCE = 4e-5  # from the tip at the start, less than that of any mesh [m]
ROUNDING = 1e-11  # tolerance of a distance from a path [m]
RIM = 32  # points of a tip that are tested against a corridor


@dataclass(frozen=True)
class Scene:
    """A kind of scene.

    Attributes:
        name: for the table.
        meshes: number of copies of the mesh, at random poses around the tip.
        pins: whether more triangles than the plane budget surround the tip.
        corridor: whether a corridor contains the tip.
        standoff: [m].
        tip_radius: [m].
        period: of the control loop [s].
        narrow: whether free space may be smaller than an actuation error.
    """

    name: str
    meshes: int = 1
    pins: bool = False
    corridor: bool = False
    standoff: float = vf.Settings.standoff
    tip_radius: float = 0.0
    period: float = vf.Settings.dt
    narrow: bool = False


PLAIN = Scene("one mesh")
SCENES = (
    PLAIN,
    Scene("three meshes", meshes=3),
    Scene("wide standoff, ball", standoff=1e-3, tip_radius=1e-3),
    Scene("low rate", period=0.02),
    Scene("mesh and corridor, wide standoff", corridor=True, standoff=1e-3, narrow=True),
    Scene("budget spent, two meshes", meshes=2, pins=True, standoff=1e-3),
    Scene("two meshes and corridor, ball", meshes=2, corridor=True, tip_radius=5e-4, narrow=True),
)


class Surroundings:
    """The fixtures of one episode and the tests for crossings.

    Args:
        scene: the kind of scene.
        mesh_near: makes the mesh at a random pose near the start.
        x: (3,) start of the tip.
        rule, radius: of the meshes' fixtures.
        tip_radius: of the cutter [m].
    """

    def __init__(
        self,
        scene: Scene,
        mesh_near: Callable[[], vf.Surface],
        x: FloatArray,
        rule: str,
        radius: float | None,
        tip_radius: float,
        rng: np.random.Generator,
    ) -> None:
        self.tip_radius = tip_radius
        self.surfaces = [mesh_near() for _ in range(scene.meshes)]
        if scene.pins:
            self.surfaces.append(_pins(x, tip_radius, rng))
        self.fixtures: list[vf.Fixture] = [
            vf.MeshFixture(surface, rule, radius) for surface in self.surfaces
        ]
        self._path = np.empty((0, 3))
        if scene.corridor:
            corridor = _corridor(x, tip_radius, radius, rng)
            self.fixtures.append(corridor)
            self._path, self._down, self._width = corridor.path, corridor.direction, corridor.width

    def crossings(self, a: FloatArray, b: FloatArray) -> int:
        """Number of triangles and corridors that the tip crosses from a to b (3,)."""
        count = 0
        for surface in self.surfaces:
            if self.tip_radius:
                count += oracles.overlaps(surface, a, b, self.tip_radius)
            else:
                count += oracles.crossings(surface, a, b)
        if len(self._path):
            count += self._farthest(b) > self._width + ROUNDING
        return count

    def _farthest(self, p: FloatArray) -> float:
        """Largest distance from the path of a point of a tip at p (3,) [m].

        It may be less than the centre's distance plus the tip's radius: at the inside of a bend a
        point far from one segment of the path is near the next one.
        """
        if not self.tip_radius:
            return oracles.lateral_distance(self._path, self._down, p)
        _, _, across = np.linalg.svd(self._down[None, :])
        turns = np.linspace(0.0, 2.0 * np.pi, RIM, endpoint=False)
        rim = np.stack([np.cos(turns), np.sin(turns)], axis=1) @ across[1:]
        ways = p + self.tip_radius * rim
        return max(oracles.lateral_distance(self._path, self._down, way) for way in ways)


def _pins(x: FloatArray, tip_radius: float, rng: np.random.Generator) -> vf.Surface:
    """Triangles collapsed to points on a spherical cap around x (3,), each needing a plane."""
    k = np.arange(PINS) + 0.5
    z = 1.0 - k / PINS * (1.0 - np.cos(np.radians(120.0)))
    angle = np.pi * (1.0 + 5.0**0.5) * k
    ring = np.sqrt(1.0 - z * z)
    ways = np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    distances = tip_radius + PIN_DISTANCE * (1.0 + 1e-3 * rng.uniform(size=(PINS, 1)))
    points = x + distances * (ways @ turn.T)
    return vf.Surface.from_arrays(points, np.arange(PINS)[:, None].repeat(3, axis=1))


def _corridor(
    x: FloatArray, tip_radius: float, radius: float | None, rng: np.random.Generator
) -> vf.CorridorFixture:
    """A random corridor with bends that contains x (3,)."""
    while True:
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        heading = np.cumsum(rng.uniform(-0.9, 0.9, 6))
        steps = rng.uniform(2e-3, 8e-3, (6, 1)) * np.stack(
            [np.cos(heading), np.sin(heading), rng.uniform(-0.5, 0.5, 6)], axis=1
        )
        path = np.cumsum(steps, axis=0)
        width = tip_radius + 10.0 ** rng.uniform(-4.0, -3.0)
        at = path[2] + rng.random() * (path[3] - path[2])
        try:
            corridor = vf.CorridorFixture(x + (path - at) @ turn.T, turn[:, 2], width, radius)
        except ValueError:  # bends too tightly for its width
            continue
        if corridor.room(x) > tip_radius + 5e-5:
            return corridor
