"""What is to be done in a trial: the session's options, and the goal in the arm's base frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import meshes
from app.scene.scene import Scene
from app.session import LIVE, Session
from app.settings import Options
from app.structure import Structure
from app.studies.experiments.site import THICKNESS, PlannedCut, planned
from app.studies.people.protocol import Condition, Protocol, Task

FloatArray = NDArray[np.float64]

INSIDE = "inner surface"  # of the skull, the structure that is guarded in tracing and cutting
NERVE = "facial nerve"  # what the targets are beside
KEPT = (
    "facial nerve", "chorda tympani", "malleus", "incus", "stapes", "semicircular canals",
    "sigmoid sinus", "dura",
)  # fmt: skip
"""The structures that are guarded in targeting."""
BESIDE = (2e-3, 4e-3)  # of targets, from the nerve's surface [m]


@dataclass(frozen=True)
class Goal:
    """What is to be reached. Arm base frame, SI units.

    Attributes:
        task: tracing, targeting or cutting.
        planned: the path on the outer surface; the tip's goal is `depth` below it. None: targets.
        targets: (k, 3) points to be touched in this order [m]; empty: there is a path.
        depth: of the path's goal below the outer surface [m].
        structures: names of what must not be touched, in the order of the session's structures.
    """

    task: str
    planned: PlannedCut | None
    targets: FloatArray
    depth: float
    structures: tuple[str, ...]

    @property
    def line(self) -> FloatArray:
        """The path of the tip (k, 3): along the goal of the path, or from target to target."""
        if self.planned is None:
            return self.targets
        return np.asarray(self.planned.points - self.depth * self.planned.outward)


def options(protocol: Protocol, task: Task, condition: Condition) -> Options:
    """The settings of a session in which this task is done under this condition."""
    common: dict[str, Any] = {
        "robot": protocol.robot, "guarded": False, "guard": "tip", "lock_orientation": True,
        "rule": condition.rule, "scale": condition.scale, "radius": condition.radius,
        "force_gain": condition.force_gain, "tip_speed": condition.tip_speed,
    }  # fmt: skip
    if task.task == "targeting":
        return Options(
            mesh="temporal-bone:bone", opacity=0.35,
            structures=tuple(
                Structure("temporal-bone", name, name, margin=condition.margin) for name in KEPT
            ),
            **common,
        )  # fmt: skip
    inside = Structure("craniotomy", INSIDE, INSIDE, margin=condition.margin)
    corridor = None if condition.rule == "off" else condition.corridor
    mesh = "skull-precut" if task.task == "tracing" else "skull"
    return Options(mesh=mesh, opacity=0.45, structures=(inside,), corridor=corridor, **common)


def adopt(session: Session, options: Options) -> None:
    """Bring a session to these settings, which are of `options`; a new scene takes seconds.

    Raises:
        Refused: an operation is in progress.
    """
    now = session.options
    if (options.mesh, options.robot) != (now.mesh, now.robot):
        changed = {name: getattr(options, name) for name in (*LIVE, "structures")}
        session.change(mesh=options.mesh, robot=options.robot, **changed)
        return
    session.set(**{name: getattr(options, name) for name in LIVE})
    for number, own in enumerate(options.structures, start=1):
        session.set_structure(number, margin=own.margin)


def goal(task: Task, seed: int, scene: Scene) -> Goal:
    """The goal of a trial in a scene built from its `options`; deterministic for a seed."""
    names = tuple(str(one.name) for one in scene.options.structures)
    if task.task == "targeting":
        return Goal(task.task, None, _targets(task.targets, seed, scene), 0.0, names)
    path = planned(meshes.planned_path(scene.mesh_name), task.length).moved(scene.T_base_mesh)
    return Goal(task.task, path, np.empty((0, 3)), THICKNESS, names)


def _targets(count: int, seed: int, scene: Scene) -> FloatArray:
    """Points (count, 3) in the cavity: beside the nerve, clear of every structure, apart."""
    rng = np.random.default_rng(seed)
    nerve = scene.structures[KEPT.index(NERVE)].surface
    found: list[FloatArray] = []
    apart = 4e-3
    for attempt in range(4000):
        if len(found) == count:
            break
        if attempt % 500 == 499:
            apart *= 0.7
        corner = nerve.vertices[rng.integers(len(nerve.vertices))]
        point = corner + rng.normal(scale=2.5e-3, size=3)
        near = nerve.nearest(point)[0]
        clear = all(
            one.nearest(point)[0] > BESIDE[0] and not (one.closed and one.inside(point))
            for one in scene.surfaces
        )
        above = point[2] > scene.surface.vertices[:, 2].min() + 10e-3
        far = all(np.linalg.norm(point - one) > apart for one in found)
        if clear and above and far and BESIDE[0] <= near <= BESIDE[1]:
            found.append(point)
    return np.array(found)
