"""The joints between base and tip of a Pinocchio model, as arrays for the compiled kinematics."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from robots.instrument import BASE, Capsule
from vf.tick.chain import JOINT, LINK, REVOLUTE, ROTATION, TRANSLATION

FloatArray = NDArray[np.float64]


def flat(model: pin.Model, frame: int) -> FloatArray:
    """The chain (k + 1, 14) from the base to a frame, see `vf.tick.chain`; read-only.

    Raises:
        ValueError: a joint is neither prismatic nor bounded revolute.
    """
    carried = _joints_to(model, frame)
    rows = np.zeros((len(carried) + 1, LINK))
    turned = pin.SE3.Identity()  # from the joint's frame to one whose z is its axis
    for row, joint in zip(rows, carried, strict=False):
        axis, revolute = _axis(model, joint)
        placement = turned.inverse() * model.jointPlacements[joint]
        turned = pin.SE3(_with_z(axis), np.zeros(3))
        _place(row, placement * turned)
        row[REVOLUTE] = float(revolute)
        row[JOINT] = model.idx_qs[joint]
    _place(rows[-1], turned.inverse() * model.frames[frame].placement)
    rows.flags.writeable = False
    return rows


def anchors(model: pin.Model, frame: int, capsules: Sequence[Capsule]) -> FloatArray:
    """Where the axes of capsules are fixed to the chain of a frame: (c, 2, 4), read-only.

    For each end the number of joints of the chain that move it, and where it is [m] in the frame
    of the last of them, whose z axis is the joint's (see `vf.tick.chain`).

    Raises:
        ValueError: a capsule is fixed to a joint that does not move the frame.
    """
    carried = _joints_to(model, frame)
    found = np.zeros((len(capsules), 2, 4))
    for row, capsule in zip(found, capsules, strict=True):
        for anchor, name, end in zip(row, capsule.frames, capsule.ends, strict=True):
            point = np.array(end)
            if name != BASE:
                joint = model.getJointId(name)
                if joint not in carried:
                    raise ValueError(
                        f"capsule {capsule.name!r} is fixed to {name!r}, which is not between the "
                        "base and the tip"
                    )
                anchor[0] = 1 + carried.index(joint)
                point = _with_z(_axis(model, joint)[0]).T @ point
            anchor[1:] = point
    found.flags.writeable = False
    return found


def _joints_to(model: pin.Model, frame: int) -> list[int]:
    """The joints between the base and a frame, from the base outwards."""
    joint = model.frames[frame].parentJoint
    carried = []
    while joint > 0:
        carried.append(int(joint))
        joint = model.parents[joint]
    return carried[::-1]


def _place(row: FloatArray, T: pin.SE3) -> None:
    row[ROTATION : ROTATION + 9] = T.rotation.ravel()
    row[TRANSLATION : TRANSLATION + 3] = T.translation


def _axis(model: pin.Model, joint: int) -> tuple[FloatArray, bool]:
    """Unit vector (3,) of a joint in its own frame, and whether it turns about it."""
    kind = model.joints[joint]
    if kind.nq != 1 or kind.nv != 1:
        raise ValueError(
            f"joint {model.names[joint]!r} is a {kind.shortname()}: "
            "joints must be prismatic or bounded revolute"
        )
    data = kind.createData()
    kind.calc(data, np.zeros(model.nq), np.zeros(model.nv))
    motion = np.asarray(data.S).ravel()  # linear, then angular, along the joint's own axes
    revolute = bool(np.abs(motion[3:]).max() > 0.5)
    axis = motion[3:] if revolute else motion[:3]
    if np.abs(motion).sum() != np.abs(axis).sum():
        raise ValueError(f"joint {model.names[joint]!r} turns and slides at once")
    return axis, revolute


def _with_z(axis: FloatArray) -> FloatArray:
    """A rotation (3, 3) whose third column is this unit vector; exact for the axes themselves."""
    k = int(np.abs(axis).argmax())
    first = np.zeros(3)
    first[(k + 1) % 3] = 1.0
    first -= (first @ axis) * axis
    first /= np.linalg.norm(first)
    return np.column_stack([first, np.cross(axis, first), axis])
