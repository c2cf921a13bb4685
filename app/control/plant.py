"""Makes plants: the controller of a scene's arm, mesh and settings, wherever the loop runs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import meshes
import vf
from app.control.autopilot import Script
from app.control.engine import Plant, guarded
from app.motion.course import Course
from app.settings import Options
from app.structure import Structure
from robots import Arm

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Description:
    """What a plant is made of: small but for the surface. The arm comes beside it.

    Attributes:
        robot: name of the arm.
        others: as those of `Plant`.
    """

    robot: str
    q0: FloatArray
    surface: vf.Surface
    planned_path: FloatArray | None
    scene: int
    autopilot: Script
    options: Options
    scene_options: Options
    structures: tuple[vf.Surface, ...] = ()
    courses: tuple[Course | None, ...] = ()
    added: meshes.MarginMap | None = None

    @property
    def surfaces(self) -> tuple[vf.Surface, ...]:
        """Those of all structures, the anatomy first, in the order of `Options.anatomy`."""
        return self.surface, *self.structures


def describe(plant: Plant) -> Description:
    """The description that `assemble` makes an equal plant of."""
    return Description(
        robot=plant.arm.name,
        q0=plant.q0,
        surface=plant.surface,
        planned_path=plant.planned_path,
        scene=plant.scene,
        autopilot=plant.autopilot,
        options=plant.options,
        scene_options=plant.scene_options,
        structures=plant.structures,
        courses=plant.courses,
        added=plant.added,
    )


def assemble(description: Description, arm: Arm) -> Plant:
    """The plant of a description, on an arm that belongs to it from here on; takes milliseconds.

    Raises:
        ValueError: a corridor wider than the bends of its path allow.
    """
    options, surface = description.options, description.surface
    fixtures: list[vf.Fixture] = [
        vf.MeshFixture(
            one, options.rule, options.radius, margin=margin_of(own, one, description.added),
            guard=own.guard, name=str(own.name),
        )
        for own, one in guarded(options, description.surfaces)
    ]  # fmt: skip
    if options.corridor is not None and description.planned_path is not None:
        fixtures.append(corridor(surface, description.planned_path, options.corridor))
    settings = vf.Settings(
        dt=options.horizon,
        standoff=options.standoff,
        tip_radius=options.tip_radius,
        force_gain=options.force_gain,
        tip_speed=options.tip_speed,
        guard=options.guard,
        trocar=options.trocar,
        approach=options.approach or None,
    )
    controller = vf.Controller(arm, fixtures, settings)
    # The first tick sets up the solver's workspace.
    controller.step(description.q0, arm.tip(description.q0))
    return Plant(
        arm=arm,
        controller=controller,
        q0=description.q0,
        surface=surface,
        planned_path=description.planned_path,
        clearance=clearance(options),
        scene=description.scene,
        dt=options.dt,
        stale_after=options.stale_after,
        autopilot=description.autopilot,
        options=options,
        scene_options=description.scene_options,
        structures=description.structures,
        courses=description.courses,
        added=description.added,
    )


def margin_of(
    own: Structure, surface: vf.Surface, added: meshes.MarginMap | None
) -> float | FloatArray:
    """The margin of a structure [m], or with a registration that of each of its vertices (n,)."""
    margin = own.margin or 0.0
    return margin if added is None else margin + added.at(surface.vertices)


def corridor(surface: vf.Surface, path: FloatArray, width: float) -> vf.CorridorFixture:
    """The corridor of this width [m] along a path (k, 3) planned on a surface, as a cut into it."""
    below = [surface.nearest(p)[1] for p in path]
    return vf.CorridorFixture(path, vf.cutting_direction(path, surface.normals[below]), width)


def clearance(options: Options) -> float:
    """Distance from the surface beyond which a tip is in free space [m]."""
    return options.standoff + options.tip_radius
