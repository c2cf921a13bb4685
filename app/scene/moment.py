"""What the view draws: a tick of a session or of a recording, and where all structures are."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

import vf
from app.control.messages import Telemetry
from app.control.watch import Crossing
from app.devices.report import LinkReport
from app.motion.movement import Movement
from app.motion.tracking import Belief
from app.scene.scene import Scene
from app.settings import Options
from app.structure import Structure

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Places:
    """Where the structures of a scene are at a tick.

    Attributes:
        poses: T_rest_now of every structure, the mesh first; None: it stands still. Empty: all do.
        beliefs: where the guard believes them to be; None: it stands still, or the guard knows.
        margin: added to the margins of moving structures for what is not known of them [m].
        shapes: vertices (n, 3) of every structure that deforms, where it rests [m]; None: it does
            not.
        believed: the same as the guard believes; None also where it knows.
    """

    poses: tuple[pin.SE3 | None, ...] = ()
    beliefs: tuple[Belief | None, ...] = ()
    margin: float = 0.0
    shapes: tuple[FloatArray | None, ...] = ()
    believed: tuple[FloatArray | None, ...] = ()


REST = Places()


def places_at(movement: Movement, phase: float) -> Places:
    """Where the structures are at a phase [s]."""
    if not movement.moves:
        return REST
    beliefs = movement.beliefs(phase)
    return Places(
        tuple(movement.truth(phase)), tuple(beliefs), movement.margin(phase),
        tuple(movement.truths(phase)), tuple(movement.believed(phase)),
    )  # fmt: skip


@dataclass(frozen=True)
class Placed:
    """A structure where it is.

    Attributes:
        own: its settings.
        surface: it, where it rests, arm base frame, in the shape that it truly has.
        pose: T_rest_now as it truly is; None: it rests.
        believed: the same as the guard believes.
        as_believed: the surface in the shape that the guard believes it to have.
        number: of the structure, 0 is the mesh.
        rest: the surface in the shape that it has at rest; None: that of `surface`.
    """

    own: Structure
    surface: vf.Surface
    pose: pin.SE3 | None = None
    believed: pin.SE3 | None = None
    as_believed: vf.Surface | None = None
    number: int = 0
    rest: vf.Surface | None = None

    @property
    def guards(self) -> vf.Surface:
        """The surface in the shape of which the guard keeps the tool out."""
        return self.surface if self.as_believed is None else self.as_believed

    def frozen(self) -> vf.Surface:
        """A surface in the base frame: it, where and as the guard believes it.

        Its tree is fitted anew, which takes a while where there are many triangles.
        """
        there = self.guards
        if self.believed is None:
            return there
        # Of the one at rest: what it takes to fit the tree is prepared once.
        return (self.rest or there).deforming(placed(self.believed, there.vertices)).shape(1.0)

    def seen(self, p_base: ArrayLike) -> FloatArray:
        """A point (3,) of the base frame in the frame in which the surface rests [m]."""
        return seen_from(self.pose, p_base)


def seen_from(pose: pin.SE3 | None, points: ArrayLike) -> FloatArray:
    """Points (…, 3) of the base frame in the frame of a pose."""
    points = np.asarray(points, dtype=np.float64)
    return points if pose is None else (points - pose.translation) @ pose.rotation


def placed(pose: pin.SE3 | None, points: ArrayLike) -> FloatArray:
    """Points (…, 3) of the frame of a pose in the base frame."""
    points = np.asarray(points, dtype=np.float64)
    return points if pose is None else points @ pose.rotation.T + pose.translation


@dataclass(frozen=True)
class Moment:
    """All that the view draws: the present state of a session, or that of a row of a recording.

    Attributes:
        scene, options: in force; the telemetry may still be of the previous scene.
        telemetry: the tick.
        clutched: whether the clutch is pressed.
        force: (3,) on the operator's hand [N].
        handle: pose of the operator's handle, base frame; None in a recording.
        crossing: where the tip crossed the mesh of this scene; None: nowhere, or unknown.
        places: where the structures are.
        contacts: in how many ticks the tip met the anatomy since the last reset; None: unknown.
        stream: how shapes that come from elsewhere came last; None: none are to come.
    """

    scene: Scene
    options: Options
    telemetry: Telemetry
    clutched: bool
    force: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    handle: pin.SE3 | None = None
    crossing: Crossing | None = None
    places: Places = REST
    contacts: int | None = None
    stream: LinkReport | None = None

    @property
    def tip(self) -> pin.SE3:
        """Pose of the tool's tip, base frame; before the first tick where it starts."""
        step = self.telemetry.step
        return self.scene.T_base_start if step is None else step.tip

    @property
    def moves(self) -> bool:
        """Whether the scene has a structure that moves."""
        return self.scene.moves

    def pose(self, number: int) -> pin.SE3 | None:
        """T_rest_now of a structure as it truly is; None: where it rests."""
        return self.places.poses[number] if number < len(self.places.poses) else None

    def believed(self, number: int) -> pin.SE3 | None:
        """The same as the guard believes."""
        belief = self.places.beliefs[number] if number < len(self.places.beliefs) else None
        return self.pose(number) if belief is None else belief.pose

    def margin(self, number: int) -> float:
        """What is added to the margins of a structure for what is not known of it [m]."""
        belief = self.places.beliefs[number] if number < len(self.places.beliefs) else None
        if belief is None:
            return 0.0
        tracker = self.scene.options.tracker
        return belief.margin if tracker is None else min(belief.margin, tracker.most)

    @cached_property
    def structures(self) -> list[Placed]:
        """All structures where they are, in the order of `Options.anatomy`."""
        pairs = zip(self.options.anatomy, self.scene.surfaces, strict=True)
        return [
            Placed(
                own, _shaped(one, self.shape(k)) or one, self.pose(k), self.believed(k),
                _shaped(one, self.shape(k, believed=True)), k, one,
            )
            for k, (own, one) in enumerate(pairs)
        ]  # fmt: skip

    def shape(self, number: int, believed: bool = False) -> FloatArray | None:
        """Vertices (n, 3) of a structure where it rests [m], as it truly is or as it is believed.

        None: it does not deform; believed, also where the guard knows.
        """
        shapes = self.places.believed if believed else self.places.shapes
        return shapes[number] if number < len(shapes) else None

    @property
    def guarded(self) -> list[Placed]:
        """Those that are guarded, in the order of the controller's fixtures."""
        return [one for one in self.structures if one.own.guarded]


def _shaped(surface: vf.Surface, vertices: FloatArray | None) -> vf.Surface | None:
    """The surface with other vertices (n, 3), None where there are none."""
    return None if vertices is None else surface.deforming(vertices).shape(1.0)
