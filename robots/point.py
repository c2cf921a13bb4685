"""The free-flying tip of the paper's simulation: three prismatic joints and no orientation.

A needle of any length and direction can be put on it, as a body that must keep out of anatomy too.
"""

from __future__ import annotations

from functools import cache, partial

import numpy as np
import pinocchio as pin

from robots.arm import Arm, FloatArray, Unreachable, add_joint
from robots.drawing import Drawing, ball, body, rod
from robots.instrument import Capsule, Point, rigid

REACH = 0.3  # [m] in both directions of each axis
SPEED = 0.2  # [m/s] per axis, the PSM's insertion speed
_ROUNDING = 1e-9  # [m] tolerance of a pose on the limit


NEEDLE_RADIUS = 0.0016  # [m]
_POINT_LENGTH = 0.012  # of the needle's tapered end [m]
_UP = (0.0, 0.0, 0.05)  # the needle that is drawn where none is guarded [m]


def load(needle: Point | None = None) -> Arm:
    """Joints x, y, z along the base frame's axes; the tip's rotation is always the identity.

    `inverse` ignores the rotation of the pose it is given.

    Args:
        needle: from the tip to the needle's other end, base frame [m]; a capsule of the instrument
            then, of `NEEDLE_RADIUS`. None: the only capsule is the tip, a ball of no radius.

    Raises:
        ValueError: the needle is no longer than it is thick, or not finite.
    """
    tip = rigid("tip", 0.0, "z", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    capsules = (tip,) if needle is None else (tip, _needle(needle))
    drawing = partial(_drawing, needle)
    model = pin.Model()
    model.name = "point"
    parent = 0
    for axis, kind in zip(
        "xyz", (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ), strict=True
    ):
        parent = add_joint(model, parent, kind(), pin.SE3.Identity(), axis, (-REACH, REACH), SPEED)
    model.addFrame(pin.Frame("tip", parent, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    return Arm("point", model, "tip", np.zeros(3), _inverse, drawing, capsules)


def _needle(needle: Point) -> Capsule:
    """The needle as a capsule that ends at the tip."""
    length = float(np.linalg.norm(needle))
    if not 2.0 * NEEDLE_RADIUS < length < np.inf:
        raise ValueError(
            f"a needle must be longer than {2.0 * NEEDLE_RADIUS:g} m and finite, got {needle}"
        )
    x, y, z = (float(v) for v in needle)
    near = NEEDLE_RADIUS / length
    return rigid("needle", NEEDLE_RADIUS, "z", (near * x, near * y, near * z), (x, y, z))


def _inverse(arm: Arm, pose: pin.SE3, start: FloatArray) -> FloatArray:
    q = pose.translation.copy()
    if not arm.within(q, _ROUNDING):
        raise Unreachable(f"point reaches ±{REACH} m along each axis, not {q} m")
    return arm.clamp(q)


@cache
def _drawing(needle: Point | None) -> Drawing:
    """A needle standing on the tip; the one that nothing guards has a head."""
    steel, blue = (176, 182, 190), (38, 110, 190)
    whole = np.array(_UP if needle is None else needle)
    length = float(np.linalg.norm(whole))
    waist = min(_POINT_LENGTH, 0.5 * length) / length * whole
    bodies = [
        body("needle", "z", steel, rod((0, 0, 0.0), waist, 0.0, NEEDLE_RADIUS)),
        body("shank", "z", steel, rod(waist, whole, NEEDLE_RADIUS, chamfer=0.0003)),
    ]
    if needle is None:
        bodies.append(body("head", "z", blue, ball((0, 0, 0.055), 0.006)))
    return Drawing(tuple(bodies))
