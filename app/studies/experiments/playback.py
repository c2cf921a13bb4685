"""Playback of a trial in the page: the same goals and controller, in real time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import meshes
from app.scene.outside import shows_fronts_only
from app.scene.registered import ranges
from app.scene.scene import Scene
from app.settings import Options
from app.structure import Registration
from app.studies.experiments import protocol, site
from app.studies.experiments.protocol import Recorded, Trial

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Playback:
    """The goals of a trial as a script, which stays at the last one.

    Attributes:
        rotation: (3, 3) of every goal, arm base frame.
        goals: (n, 3) one a tick [m].
        rate: ticks per second [Hz].
    """

    rotation: FloatArray
    goals: FloatArray
    rate: float

    def pose(self, time: float) -> pin.SE3:
        """The goal a time ≥ 0 [s] after the start."""
        return pin.SE3(self.rotation, self.goals[min(round(time * self.rate), len(self.goals) - 1)])


def options(trial: Trial) -> Options:
    """Settings of a session with the trial's controller, which guards the tip alone."""
    with_margins = trial.margin > 0.0 and trial.noise >= protocol.LEAST_NOISE
    return Options(
        mesh="skull-precut" if trial.experiment == "tracing" else trial.mesh,
        robot="psm",
        rule=trial.rule,
        guard="tip",
        radius=protocol.RADIUS,
        rate=trial.rate,
        corridor=trial.width if trial.assisted else None,
        registration=None if not with_margins else Registration(
            tuple(map(tuple, site.build(trial.mesh, trial.length).fiducials.tolist())),
            trial.noise, trial.margin,
        ),
    )  # fmt: skip


def scene(recorded: Recorded) -> Scene:
    """The scene of a trial: the skull at its true pose, its inner surface at the registered one.

    With the autopilot switched on at the start, the joints equal those of the trial bitwise.
    """
    trial = recorded.outcome.trial
    place = site.build(trial.mesh, trial.length)
    vertices, faces = meshes.arrays(options(trial).mesh)
    shown, faces_shown, decimated = meshes.display(
        meshes.transformed(place.T_base_skull, vertices), faces
    )
    surface = place.guarded(recorded.T_base_registered)
    added = protocol.margin_map(trial, recorded.T_base_registered)
    return Scene(
        version=1,
        mesh_name=options(trial).mesh,
        surface=surface,
        T_base_mesh=place.T_base_skull,
        planned_path=place.planned.moved(recorded.T_base_registered).points,
        vertices_shown=shown,
        faces_shown=faces_shown,
        decimated=decimated,
        fronts_only=shows_fronts_only(shown, faces_shown),
        robot=place.arm.name,
        arm=place.arm.copy(),
        notes=(
            f"Trial {trial.key}, played as the autopilot. The skull is drawn at its true pose; "
            "its inner surface is guarded at the registered one.",
        ),
        start=place.arm.inverse(place.T_base_start, start=place.arm.neutral),
        T_base_start=place.T_base_start,
        autopilot=Playback(place.T_base_start.rotation, recorded.run.goals, trial.rate),
        options=options(trial),
        added=added,
        added_range=ranges(added, [trial.mesh], [surface]),
    )
