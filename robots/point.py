"""The free-flying tip of the paper's simulation: three prismatic joints and no orientation."""

from __future__ import annotations

from functools import cache

import numpy as np
import pinocchio as pin

from robots.arm import Arm, FloatArray, Unreachable, add_joint
from robots.drawing import Drawing, ball, body, rod

REACH = 0.3  # [m] in both directions of each axis
SPEED = 0.2  # [m/s] per axis, the PSM's insertion speed
_ROUNDING = 1e-9  # [m] tolerance of a pose on the limit


def load() -> Arm:
    """Joints x, y, z along the base frame's axes; the tip's rotation is always the identity.

    `inverse` ignores the rotation of the pose it is given.
    """
    model = pin.Model()
    model.name = "point"
    parent = 0
    for axis, kind in zip(
        "xyz", (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ), strict=True
    ):
        parent = add_joint(model, parent, kind(), pin.SE3.Identity(), axis, (-REACH, REACH), SPEED)
    model.addFrame(pin.Frame("tip", parent, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    return Arm("point", model, "tip", np.zeros(3), _inverse, _drawing)


def _inverse(arm: Arm, pose: pin.SE3, start: FloatArray) -> FloatArray:
    q = pose.translation.copy()
    if not arm.within(q, _ROUNDING):
        raise Unreachable(f"point reaches ±{REACH} m along each axis, not {q} m")
    return arm.clamp(q)


@cache
def _drawing() -> Drawing:
    """A needle standing on the tip."""
    steel, blue = (176, 182, 190), (38, 110, 190)
    return Drawing(
        (
            body("needle", "z", steel, rod((0, 0, 0.0), (0, 0, 0.012), 0.0, 0.0016)),
            body("shank", "z", steel, rod((0, 0, 0.012), (0, 0, 0.05), 0.0016, chamfer=0.0003)),
            body("head", "z", blue, ball((0, 0, 0.055), 0.006)),
        )
    )
