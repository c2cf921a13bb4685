"""The site of an experiment: skull, planned cut, fiducials, and the arm."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import meshes
import robots
import vf
from app.words import OptionError
from meshes.builtin import skull

FloatArray = NDArray[np.float64]

SEGMENTS = {"skull-coarse": skull.COARSE, "skull": skull.STANDARD, "skull-fine": skull.FINE}
THICKNESS = skull.THICKNESS * 1e-3  # of the bone [m]
# Directions of the six fiducials from the head's centre (x right, y anterior, z superior): on the
# frontal, parietal and occipital bone, as far apart as the skull cap allows.
FIDUCIALS = (
    (0.45, 0.75, 0.35),
    (-0.45, 0.75, 0.35),
    (0.80, 0.10, 0.35),
    (-0.80, 0.10, 0.35),
    (0.45, -0.75, 0.45),
    (-0.45, -0.75, 0.45),
)


@dataclass(frozen=True)
class PlannedCut:
    """A planned cut with a local frame at each of its points.

    Attributes:
        stations: (k,) arc length from the start [m].
        points: (k, 3) on the outer surface [m].
        along, aside, outward: (k, 3) unit vectors: forward, lateral (to the right seen from
            outside), and out of the bone.
    """

    stations: FloatArray
    points: FloatArray
    along: FloatArray
    aside: FloatArray
    outward: FloatArray

    @property
    def length(self) -> float:
        return float(self.stations[-1])

    def at(self, station: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Point, and forward, lateral and outward direction, (3,) each, at an arc length [m]."""
        found = [
            np.array([np.interp(station, self.stations, rows[:, k]) for k in range(3)])
            for rows in (self.points, self.along, self.aside, self.outward)
        ]
        return found[0], *(v / np.linalg.norm(v) for v in found[1:])

    def moved(self, T: FloatArray) -> PlannedCut:
        """The same planned cut in another frame, by a rigid transform (4, 4)."""
        R = T[:3, :3]
        return PlannedCut(
            self.stations,
            self.points @ R.T + T[:3, 3],
            self.along @ R.T,
            self.aside @ R.T,
            self.outward @ R.T,
        )


@dataclass(frozen=True)
class Site:
    """The data that all trials of an experiment share.

    Attributes:
        mesh: name of the skull.
        planned: the planned cut, skull's axes.
        inner: vertices and faces of the inner surface, skull's axes [m].
        fiducials: (6, 3) on the outer surface, skull's axes [m].
        T_base_skull: (4, 4) true pose of the skull.
        T_base_start: the tool's pose at the start; its rotation is kept throughout.
        arm: the PSM.
    """

    mesh: str
    planned: PlannedCut
    inner: tuple[FloatArray, NDArray[np.int64]]
    fiducials: FloatArray
    T_base_skull: FloatArray
    T_base_start: pin.SE3
    arm: robots.Arm

    def guarded(self, T: FloatArray) -> vf.Surface:
        """The inner surface for a skull at T (4, 4), arm base frame."""
        return vf.Surface.from_arrays(meshes.transformed(T, self.inner[0]), self.inner[1])


@lru_cache(maxsize=4)
def build(mesh: str = "skull", length: float | None = None) -> Site:
    """The site on one of the skulls, the planned cut shortened to `length` [m] if given.

    Raises:
        OptionError: not one of the skulls, or a length that the cut does not have.
    """
    if mesh not in SEGMENTS:
        raise OptionError(f"unknown skull '{mesh}': choose one of {', '.join(SEGMENTS)}")
    vertices, _faces = meshes.arrays(mesh)
    arm = robots.load("psm")
    neutral = arm.tip(arm.neutral)
    T_base_skull = meshes.Placement().pose(vertices, neutral)
    path = planned(meshes.planned_path(mesh), length)
    start = meshes.transformed(T_base_skull, path.points[:1] + 1e-3 * path.outward[:1])[0]
    directions = np.array(FIDUCIALS)
    return Site(
        mesh=mesh,
        planned=path,
        inner=skull.endocranium(SEGMENTS[mesh]),
        fiducials=skull.outer_points(directions),
        T_base_skull=T_base_skull,
        T_base_start=pin.SE3(neutral.rotation, start),
        arm=arm,
    )


def planned(points: FloatArray, length: float | None) -> PlannedCut:
    """A planned cut through points (k, 3) [m], shortened to `length` [m] if given; skull's axes.

    Raises:
        OptionError: a length that the cut does not have.
    """
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    stations = np.r_[0.0, np.cumsum(steps)]
    if length is not None:
        if not 1e-3 < length <= stations[-1] + 1e-5:  # chords of an arc of 30 mm
            raise OptionError(
                f"the planned cut is {stations[-1] * 1e3:.0f} mm long: "
                f"{length * 1e3:g} mm of it cannot be cut"
            )
        length = min(length, float(stations[-1]))
        marks = np.append(np.arange(0.0, length - 5e-4, 1e-3), length)
        points = np.stack([np.interp(marks, stations, points[:, k]) for k in range(3)], axis=1)
        stations = marks
    along = np.gradient(points, stations, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    # The cut is sagittal: the lateral direction is the skull's left-right axis.
    aside = np.tile([1.0, 0.0, 0.0], (len(points), 1))
    outward = np.cross(aside, along)
    outward *= np.sign(outward[:, 2:])
    return PlannedCut(stations, points, along, aside, outward)
