"""Where an episode beside anatomy that moves begins, and the state of that anatomy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import robots
import vf
from app.judges import boxes, depth, passing
from app.judges.nearest import nearest
from app.studies.verification import swelling, wander
from app.studies.verification.campaign import random_joints
from app.studies.verification.instrument import GAPS, TRIES, turned
from meshes.content import Arrays

FloatArray = NDArray[np.float64]


@dataclass
class Scene:
    """A mesh in its own frame, where it is, and what shape it has.

    Attributes:
        surface, mesh: for the controller, and for the judge.
        truth: its poses.
        radius: of its vertices around the origin [m].
        closed: whether it has an inside.
        swelling: how it deforms; None: it does not.
        ticks: since it had the first of the two shapes of `surface`.
    """

    surface: Any
    mesh: passing.Shapes
    truth: wander.Truth
    radius: float
    closed: bool
    swelling: swelling.Swelling | None = None
    ticks: int = 0

    @property
    def blend(self) -> tuple[float, float]:
        """Of the next tick."""
        if self.swelling is None:
            return 0.0, 0.0
        return self.ticks / self.swelling.ticks, (self.ticks + 1) / self.swelling.ticks

    def deform(self, face: int, towards: FloatArray) -> None:
        """Be on the way to the next shape, see `swelling.Swelling.go`."""
        assert self.swelling is not None
        before = self.swelling.vertices
        after = self.swelling.go(face, towards)
        self.surface = self.surface.deforming(after)
        self.mesh = passing.shapes(before, self.mesh.faces, after, self.mesh)
        self.ticks = 0


class Starts:
    """Joints, and a mesh beside a part of the arm there, with nothing touched.

    The frame of a mesh is in the middle of it; poses are tried by moving the arm's axes to it.
    """

    def __init__(self, mesh: Arrays) -> None:
        vertices, self.faces = mesh
        self.vertices = vertices - 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
        self.boxes = boxes.build(self.vertices, self.faces)
        self.closed = depth.closed(self.faces)
        self._known: dict[float, tuple[vf.Surface, passing.Shapes]] = {}

    def near(
        self, arm: robots.Arm, judge: passing.Judge, rng: np.random.Generator
    ) -> tuple[FloatArray, Scene]:
        while True:
            q = random_joints(arm, rng)
            axes, radii = judge.axes(q)[judge.chosen], judge.radii[judge.chosen]
            k = int(rng.integers(len(axes)))
            axis = axes[k]
            for attempt in range(TRIES):
                corners = self.vertices[self.faces[rng.integers(len(self.faces))]]
                normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
                size = float(np.linalg.norm(normal))
                if size == 0.0:
                    continue
                # The face's normal points to the part, across its axis.
                out = np.cross(axis[1] - axis[0], rng.normal(size=3))
                if not np.linalg.norm(out) > 0.0:
                    out = rng.normal(size=3)
                out /= np.linalg.norm(out)
                side = 1.0 if rng.random() < 0.7 else -1.0
                turn = turned(side * normal / size, out, rng)
                scale = 1.0 if attempt < TRIES // 2 else 0.5 ** int(rng.integers(1, 4))
                spot = scale * (rng.dirichlet([1.0, 1.0, 1.0]) @ corners)
                gap = radii[k] + rng.uniform(*GAPS)
                place = axis[0] + rng.random() * (axis[1] - axis[0]) - gap * out
                pose = pin.SE3(turn, place - turn @ spot)
                if not self._clear((axes - pose.translation) @ turn, radii, scale):
                    continue
                surface, shapes = self._scaled(scale)
                if surface.inside(pose.actInv(arm.tip(q).translation)):
                    continue
                around = float(np.linalg.norm(shapes.vertices, axis=1).max())
                return q, Scene(surface, shapes, wander.Truth(pose), around, self.closed)

    def _scaled(self, scale: float) -> tuple[vf.Surface, passing.Shapes]:
        if scale not in self._known:
            vertices = scale * self.vertices
            surface = vf.Surface.from_arrays(vertices, self.faces)
            self._known[scale] = surface, passing.shapes(vertices, self.faces)
        return self._known[scale]

    def _clear(self, axes: FloatArray, radii: FloatArray, scale: float) -> bool:
        """Whether the axes (c, 2, 3), in the mesh's frame, are far enough from it."""
        for radius, axis in zip(radii, axes, strict=True):
            reach = (radius + GAPS[0]) / scale
            if nearest(self.boxes, axis / scale, reach)[0] < reach:
                return False
        return True
