"""The da Vinci patient-side manipulator (PSM, dVRK Classic) from its modified DH table.

The base frame sits at the remote centre of motion, where the shaft passes through the patient's
skin. At q = 0 the shaft points along −z and the arm's body lies towards −y. The table, the limits
and the speed limits are those of the dVRK's public configuration (jhu-dvrk,
sawIntuitiveResearchKit, PSM.json and the large needle driver's tool file):

    joint        type  α      a       θ          d            limits
    yaw          R     +π/2   0       q + π/2    0            ±1.588 rad
    pitch        R     −π/2   0       q − π/2    0            ±0.925 rad
    insertion    P     +π/2   0       0          q − 0.4318   0 … 0.240 m
    roll         R      0     0       q          0.4162       ±4.538 rad
    wrist_pitch  R     −π/2   0       q − π/2    0            ±1.396 rad
    wrist_yaw    R     −π/2   0.0091  q − π/2    0            ±1.396 rad

The tool tip lies 10.2 mm past the wrist-yaw axis, its +z pointing on, away from the wrist.
"""

from __future__ import annotations

import itertools
from math import asin, atan2, pi, sqrt

import numpy as np
import pinocchio as pin

from robots import psm_drawing
from robots.arm import Arm, FloatArray, Unreachable, add_joint
from robots.instrument import Capsule, rigid

INSERTION_OFFSET = 0.4318 - 0.4162  # [m] insertion at which the wrist is at the remote centre
WRIST_LENGTH = 0.0091  # [m] wrist-pitch axis to wrist-yaw axis
TIP_LENGTH = 0.0102  # [m] wrist-yaw axis to tip
SHAFT_RADIUS = 0.00835 / 2  # [m]
SHAFT_TOP = 0.4162 - 0.090  # [m] from the wrist up to where the shaft enters the tool's housing
_BLADE_RADIUS = 0.0015  # [m] the cutter's widest half
_WRIST_RADIUS = 0.0042  # [m] with the pivots on both of its axes
NEUTRAL = (0.0, 0.0, 0.12, 0.0, 0.0, 0.0)

# A DH row's fixed rotation turned so that Pinocchio's joint axis, z, is the row's own.
_TURN = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
_YAW = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
_SLIDE = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
_TIP = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])

# name, kind, placement in the parent joint's frame (rotation, translation [m]), limits, speed
_JOINTS = (
    ("yaw", "R", _YAW, (0.0, 0.0, 0.0), (-1.588, 1.588), pi / 2),
    ("pitch", "R", _TURN, (0.0, 0.0, 0.0), (-0.925, 0.925), pi / 2),
    ("insertion", "P", _SLIDE, (0.0, 0.4318, 0.0), (0.0, 0.240), 0.2),
    ("roll", "R", np.eye(3), (0.0, 0.0, 0.4162), (-4.538, 4.538), 6 * pi),
    ("wrist_pitch", "R", _TURN, (0.0, 0.0, 0.0), (-1.396, 1.396), 6 * pi),
    ("wrist_yaw", "R", _TURN, (WRIST_LENGTH, 0.0, 0.0), (-1.396, 1.396), 6 * pi),
)

# The blade's capsule ends at the tip. The remote centre, where the pitch joint's frame has its
# origin, cuts the shaft in two; the wrist is the origin of the roll joint's frame.
CAPSULES = (
    rigid(
        "blade", _BLADE_RADIUS, "wrist_yaw",
        (0.0, 0.0, 0.0), (0.0, TIP_LENGTH - _BLADE_RADIUS, 0.0),
    ),
    rigid("wrist", _WRIST_RADIUS, "wrist_pitch", (0.0, 0.0, 0.0), (WRIST_LENGTH, 0.0, 0.0)),
    Capsule(
        "shaft", SHAFT_RADIUS, ("pitch", "roll"), ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), port=True
    ),
    Capsule(
        "upper shaft", SHAFT_RADIUS, ("pitch", "roll"),
        ((0.0, 0.0, 0.0), (0.0, 0.0, -SHAFT_TOP)), port=True,
    ),
)  # fmt: skip

_MATCH = 1e-8  # [m, rad] largest error of the forward kinematics of a solution
_SINGULAR = 1e-9  # [m] shortest vector whose direction is defined
_ROUNDING = 1e-9  # [m, rad] tolerance of a joint on its limit


def load() -> Arm:
    """The PSM with a rigid cutter; frame "tip", rest pose the simulated dVRK's home."""
    model = pin.Model()
    model.name = "psm"
    parent = 0
    for name, kind, rotation, translation, limits, speed in _JOINTS:
        joint = pin.JointModelPZ() if kind == "P" else pin.JointModelRZ()
        T_parent_joint = pin.SE3(rotation, np.array(translation))
        parent = add_joint(model, parent, joint, T_parent_joint, name, limits, speed)
    T_wrist_tip = pin.SE3(_TIP, np.array([0.0, TIP_LENGTH, 0.0]))
    model.addFrame(pin.Frame("tip", parent, T_wrist_tip, pin.FrameType.OP_FRAME))
    return Arm("psm", model, "tip", NEUTRAL, inverse, psm_drawing.drawing, CAPSULES)


def inverse(arm: Arm, pose: pin.SE3, start: FloatArray) -> FloatArray:
    """Closed form: of all branches within the limits the one reached soonest from `start`.

    The wrist-pitch axis is perpendicular to the shaft, which passes through the base's origin, and
    to the wrist-yaw axis, which determines it up to sign. `Unreachable` where it is not defined:
    the wrist on the remote centre, or the yaw axis through it.
    """
    candidates = [q for branch in _branches(pose) for q in _turns(arm, branch)]
    solutions = [q for q in candidates if _matches(arm, q, pose)]
    if not solutions:
        raise Unreachable(
            f"psm: at {pose.translation} m the wrist is singular with the remote centre of motion"
        )
    allowed = [q for q in solutions if arm.within(q, _ROUNDING)]
    if not allowed:
        raise Unreachable(f"psm: {_excess(arm, solutions)}")
    return arm.clamp(min(allowed, key=lambda q: float(np.max(np.abs(q - start) / arm.velocity))))


def _branches(pose: pin.SE3) -> list[FloatArray]:
    """Joint vectors that may reach the pose: signs of two wrist axes and of the insertion."""
    R = pose.rotation
    x6, z6 = -R[:, 1], -R[:, 0]
    p_yaw = pose.translation - TIP_LENGTH * R[:, 2]
    across = np.cross(p_yaw, z6)
    norm = np.linalg.norm(across)
    if norm < _SINGULAR:
        return []
    found = []
    for sign_z, sign_x, sign_s in itertools.product((1.0, -1.0), repeat=3):
        z5 = sign_z * across / norm
        x5 = sign_x * np.cross(z5, z6)
        p_wrist = p_yaw - WRIST_LENGTH * x5
        depth = sign_s * sqrt(p_wrist @ p_wrist)  # negative above the remote centre
        if abs(depth) < _SINGULAR:
            continue
        shaft = p_wrist / depth
        # shaft = (sin q1 cos q2, −sin q2, −cos q1 cos q2) with cos q2 > 0 inside the limits
        q1 = atan2(shaft[0], -shaft[2])
        q2 = -asin(max(-1.0, min(1.0, shaft[1])))
        R3 = _YAW @ _about_z(q1) @ _TURN @ _about_z(q2) @ _SLIDE
        q4 = atan2(-(z5 @ R3[:, 0]), z5 @ R3[:, 1])
        x4 = np.cos(q4) * R3[:, 0] + np.sin(q4) * R3[:, 1]
        q5 = atan2(x5 @ x4, x5 @ shaft)
        q6 = atan2(x6 @ x5, x6 @ z5)
        found.append(np.array([q1, q2, depth + INSERTION_OFFSET, q4, q5, q6]))
    return found


def _turns(arm: Arm, q: FloatArray) -> list[FloatArray]:
    """`q` with the roll joint as it is and a full turn more and less: its range exceeds a turn."""
    return [q + np.array([0, 0, 0, turn, 0, 0]) for turn in (0.0, 2 * pi, -2 * pi)]


def _matches(arm: Arm, q: FloatArray, pose: pin.SE3) -> bool:
    error = pose.actInv(arm.tip(q))
    return bool(
        np.linalg.norm(error.translation) < _MATCH
        and np.abs(error.rotation - np.eye(3)).max() < _MATCH
    )


def _excess(arm: Arm, solutions: list[FloatArray]) -> str:
    """The limits broken by the solution that breaks them least."""
    span = arm.upper - arm.lower

    def excess(q: FloatArray) -> FloatArray:
        return np.maximum(arm.lower - q, q - arm.upper)

    best = min(solutions, key=lambda q: float(np.max(excess(q) / span)))
    broken = [
        f"{arm.joints[i]} would be {best[i]:.4g}, its range is {arm.lower[i]:g} … {arm.upper[i]:g}"
        for i in np.flatnonzero(excess(best) > _ROUNDING)
    ]
    return "; ".join(broken)


def _about_z(angle: float) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
