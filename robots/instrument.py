"""The instrument of an arm as capsules: what the whole-instrument guard keeps out of anatomy."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

import pinocchio as pin

BASE = "universe"
"""The frame that does not move, for the ends of a capsule's axis."""

Point = tuple[float, float, float]


@dataclass(frozen=True)
class Capsule:
    """A body of the instrument: all points within `radius` of an axis segment.

    Each end of the axis is fixed to a joint's frame, mostly both to the same. The two may differ
    where the arm keeps one end on the line of the other: the part of a PSM's shaft that is in the
    patient reaches from the remote centre, where the pitch joint's frame is, to the wrist.

    Attributes:
        name:   unique within the arm.
        radius: [m], 0 or more.
        frames: joints whose frames the start and the end of the axis are fixed to, or `BASE`.
        ends:   start and end in these frames [m]; equal in equal frames for a ball.
        port:   the axis starts at the remote centre, where a shaft enters the patient
                (`vf.Settings.trocar`). It then keeps its direction in the start's frame.

    Raises:
        ValueError: a radius or an end that is not finite, or a negative radius.
    """

    name: str
    radius: float
    frames: tuple[str, str]
    ends: tuple[Point, Point]
    port: bool = False

    def __post_init__(self) -> None:
        if not (isfinite(self.radius) and self.radius >= 0.0):
            raise ValueError(f"capsule {self.name!r}: radius must be 0 or more, got {self.radius}")
        if not all(isfinite(v) for end in self.ends for v in end):
            raise ValueError(f"capsule {self.name!r}: ends must be finite, got {self.ends}")

    @property
    def ball(self) -> bool:
        """Whether the axis is a point."""
        return self.frames[0] == self.frames[1] and self.ends[0] == self.ends[1]


def rigid(name: str, radius: float, frame: str, start: Point, end: Point) -> Capsule:
    """A capsule with both ends in one frame."""
    return Capsule(name, radius, (frame, frame), (start, end))


def tip_ball(model: pin.Model, tip_frame: int) -> Capsule:
    """The tip as a ball of no radius, for an arm that has no other capsules."""
    frame = model.frames[tip_frame]
    x, y, z = (float(v) for v in frame.placement.translation)
    return rigid("tip", 0.0, model.names[frame.parentJoint], (x, y, z), (x, y, z))
