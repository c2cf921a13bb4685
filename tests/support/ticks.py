"""A controller driven tick by tick, with every tick checked, for the tests of `vf`."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import trimesh

import meshes
import robots
import vf
from tests.support import naive
from vf import Status

UM = 1e-6
ROUNDING = 5e-15  # of a tip position, a few products of numbers up to one metre [m]


def pose(p: np.ndarray | list[float], R: np.ndarray | None = None) -> pin.SE3:
    return pin.SE3(np.eye(3) if R is None else R, np.array(p, dtype=float))


def plate(z: float = 0.0, size: float = 0.1) -> vf.Surface:
    """A slab whose top is at z, its faces a few millimetres wide."""
    solid = trimesh.creation.box((size, size, 5e-3)).subdivide().subdivide().subdivide()
    return vf.Surface.from_arrays(
        solid.vertices + np.array([0.0003, 0.0007, z - 2.5e-3]), solid.faces
    )


def fixed(surface: vf.Surface, rule: str = "certified", radius: float | None = 5e-3) -> list:
    return [vf.MeshFixture(surface, rule, radius)]


class Run:
    """Drives a controller and checks what must hold in every tick, whatever happens."""

    def __init__(
        self, controller: vf.Controller, q: np.ndarray, surface: vf.Surface | None = None
    ) -> None:
        self.controller = controller
        self.arm = robots.load(controller.arm.name)  # its own: nothing is believed
        self.q = np.array(q, dtype=float)
        self.crosses = None
        if surface is not None:
            self.crosses = naive.Crossings(surface.vertices[surface.faces])
        self.steps: list[vf.Step] = []
        self.tips = [self.arm.tip(self.q).translation.copy()]

    def step(self, target: pin.SE3) -> vf.Step:
        arm, before = self.arm, self.q
        step = self.controller.step(before, target)
        case = f"tick {len(self.steps)}, q {before.tolist()}, target {target.translation.tolist()}"
        dt = self.controller.settings.dt
        # q + Δq is rounded once more than Δq.
        hair = 1e-15 * np.maximum(1.0, np.abs(before))
        assert (step.q >= np.minimum(arm.lower, before) - hair).all(), case
        assert (step.q <= np.maximum(arm.upper, before) + hair).all(), case
        assert (np.abs(step.q - before) <= arm.velocity * dt + hair).all(), case
        tip = arm.tip(step.q).translation
        # The tick's kinematics are its own: they agree with the arm's to rounding.
        assert np.abs(tip - step.tip.translation).max() < ROUNDING, case
        if step.status is not Status.REFUSED:
            assert np.linalg.norm(tip - self.tips[-1]) <= step.planes.radius + ROUNDING, case
            assert step.planes.slack(tip).min(initial=0) >= -ROUNDING, case
            assert len(step.multipliers) == len(step.planes), case
            assert (step.multipliers >= 0).all(), case
        if self.crosses is not None and step.status is not Status.INSIDE:
            assert not self.crosses(self.tips[-1], tip), case
        self.q = step.q
        self.steps.append(step)
        self.tips.append(tip.copy())
        return step

    def to(self, target: pin.SE3, ticks: int) -> vf.Step:
        for _ in range(ticks):
            step = self.step(target)
        return step

    @property
    def tip(self) -> np.ndarray:
        return self.tips[-1]


def point(surface: vf.Surface | None, start: list[float], **options: float) -> Run:
    fixtures = [] if surface is None else fixed(surface, radius=options.pop("radius", 5e-3))
    controller = vf.Controller(robots.load("point"), fixtures, vf.Settings(**options))
    return Run(controller, np.array(start), surface)


def psm_over(name: str) -> tuple[Run, vf.Surface]:
    arm = robots.load("psm")
    vertices, faces = meshes.arrays(name)
    surface = vf.Surface.from_arrays(meshes.place(vertices, arm.tip(arm.neutral)), faces)
    controller = vf.Controller(arm, fixed(surface), vf.Settings())
    return Run(controller, arm.neutral, surface), surface
