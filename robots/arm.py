"""One arm: a Pinocchio model, its tool tip, its limits, its inverse and its drawing."""

from __future__ import annotations

from collections.abc import Callable
from math import isfinite

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from robots import chain
from robots.drawing import Body, Drawing
from robots.instrument import BASE, Capsule, tip_ball

FloatArray = NDArray[np.float64]

Inverse = Callable[["Arm", pin.SE3, FloatArray], FloatArray]
"""The joint vector of a tip pose near a start, both valid."""

_ALIGNED = pin.LOCAL_WORLD_ALIGNED


class Unreachable(ValueError):
    """No joint vector within the limits has the given tip pose; the message gives the reason."""


class Arm:
    """A serial arm with a tool tip. Lengths in m, angles in rad, poses in the arm's base frame.

    Not thread-safe: every call writes Pinocchio's workspace. Give each thread its own `copy()`.

    Attributes (arrays are read-only, `(n,)`, float64):
        name:     the name it was loaded under.
        joints:   joint names, in the order of the joint vector.
        lower, upper: position limits [rad or m].
        velocity: speed limits [rad/s or m/s].
        revolute: 1 for a revolute joint, 0 for a prismatic one.
        neutral:  the rest pose, within the limits.
        chain:    `(k + 1, 14)`, the joints between base and tip as `vf.tick.chain` reads them.
        capsules: the bodies of the instrument, the one at the tip first.
        anchors:  `(c, 2, 4)`, where the ends of their axes are fixed, as `vf.tick.chain` reads it.
    """

    def __init__(
        self,
        name: str,
        model: pin.Model,
        tip_frame: str,
        neutral: ArrayLike,
        inverse: Inverse,
        drawing: Callable[[], Drawing],
        capsules: tuple[Capsule, ...] = (),
    ) -> None:
        if not model.existFrame(tip_frame):
            raise ValueError(f"arm {name!r} has no frame {tip_frame!r}")
        if model.nq != model.nv:
            raise ValueError(f"arm {name!r}: joints must be prismatic or bounded revolute")
        self.name = name
        self.joints: tuple[str, ...] = tuple(model.names)[1:]
        self.lower = _read_only(model.lowerPositionLimit)
        self.upper = _read_only(model.upperPositionLimit)
        self.velocity = _read_only(model.velocityLimit)
        prismatic = [joint.shortname().startswith("JointModelP") for joint in model.joints]
        self.revolute = _read_only([float(not straight) for straight in prismatic[1:]])
        self._shape = (model.nq,)
        self._model = model
        self._data = model.createData()
        self._tip = int(model.getFrameId(tip_frame))
        self.chain = chain.flat(model, self._tip)
        self.capsules = tuple(capsules) or (tip_ball(model, self._tip),)
        self._check_capsules()
        self.anchors = chain.anchors(model, self._tip, self.capsules)
        self._inverse = inverse
        self._drawing = drawing
        self.neutral = _read_only(self._checked(neutral))
        if not self.within(self.neutral):
            raise ValueError(f"arm {name!r}: the rest pose {self.neutral} breaks the joint limits")

    def copy(self) -> Arm:
        """A copy with its own workspace, for another thread."""
        return Arm(
            self.name,
            self._model,
            self._model.frames[self._tip].name,
            self.neutral,
            self._inverse,
            self._drawing,
            self.capsules,
        )

    def tip(self, q: ArrayLike) -> pin.SE3:
        """Pose of the tool tip, `T_base_tip`; the caller owns it. `q` is `(n,)`."""
        pin.forwardKinematics(self._model, self._data, self._checked(q))
        return pin.updateFramePlacement(self._model, self._data, self._tip)

    def jacobian(self, q: ArrayLike) -> FloatArray:
        """Jacobian of the tip, `(6, n)`, C-contiguous, owned by the caller.

        Rows 0–2 give the tip's linear velocity [m], rows 3–5 the angular velocity [rad], both
        along the base frame's axes (Pinocchio's LOCAL_WORLD_ALIGNED).
        """
        return pin.computeFrameJacobian(
            self._model, self._data, self._checked(q), self._tip, _ALIGNED
        )

    def kinematics(self, q: ArrayLike) -> tuple[pin.SE3, FloatArray]:
        """`(tip(q), jacobian(q))` from one pass over the arm, for the control loop."""
        q = self._checked(q)
        # This updates the joints' placements too.
        J = pin.computeFrameJacobian(self._model, self._data, q, self._tip, _ALIGNED)
        return pin.updateFramePlacement(self._model, self._data, self._tip), J

    def axes(self, q: ArrayLike) -> FloatArray:
        """Starts and ends of the axes of `capsules`, `(c, 2, 3)`, base frame [m]."""
        pin.forwardKinematics(self._model, self._data, self._checked(q))
        placements = self._data.oMi
        return np.array(
            [
                [
                    placements[self._model.getJointId(frame)].act(np.array(end))
                    for frame, end in zip(capsule.frames, capsule.ends, strict=True)
                ]
                for capsule in self.capsules
            ]
        )

    def axis_jacobians(self, q: ArrayLike) -> FloatArray:
        """Linear Jacobians of the ends of the axes, `(c, 2, 3, n)`, along the base frame's axes."""
        pin.computeJointJacobians(self._model, self._data, self._checked(q))
        found = np.zeros((len(self.capsules), 2, 3, len(self.lower)))
        for k, capsule in enumerate(self.capsules):
            for i, (name, end) in enumerate(zip(capsule.frames, capsule.ends, strict=True)):
                if name == BASE:
                    continue
                joint = self._model.getJointId(name)
                J = pin.getJointJacobian(self._model, self._data, joint, _ALIGNED)
                arm = self._data.oMi[joint].rotation @ np.array(end)
                found[k, i] = J[:3] - pin.skew(arm) @ J[3:]
        return found

    def clamp(self, q: ArrayLike) -> FloatArray:
        """`q` with every joint brought into its limits, a new `(n,)` array."""
        return np.clip(self._checked(q), self.lower, self.upper)

    def within(self, q: ArrayLike, slack: float = 0.0) -> bool:
        """Whether every joint is within its limits widened by `slack` [rad or m]."""
        q = self._checked(q)
        return bool(np.all(q >= self.lower - slack) and np.all(q <= self.upper + slack))

    def inverse(self, pose: pin.SE3, start: ArrayLike | None = None) -> FloatArray:
        """A joint vector within the limits whose tip is at `pose`.

        Of several solutions the one near `start` (`neutral` by default). Raises `Unreachable` where
        there is none, `ValueError` for an invalid pose.
        """
        rotation = pose.rotation
        if not (np.isfinite(pose.translation).all() and np.isfinite(rotation).all()):
            raise ValueError(f"pose must be finite, got {pose}")
        if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-6 or np.linalg.det(rotation) < 0:
            raise ValueError(f"pose's rotation must be orthonormal and right-handed, got {pose}")
        return self._inverse(self, pose, self._checked(self.neutral if start is None else start))

    @property
    def bodies(self) -> tuple[Body, ...]:
        """The bodies to draw, built at the first use (fractions of a second)."""
        return self._drawing().bodies

    def placements(self, q: ArrayLike) -> FloatArray:
        """Poses of `bodies` in the base frame, `(len(bodies), 7)`: quaternion wxyz, position [m].

        Bodies of the same `frame` have equal rows.
        """
        q = self._checked(q)
        pin.forwardKinematics(self._model, self._data, q)
        poses = {n: _viewer_pose(T) for n, T in zip(self._model.names, self._data.oMi, strict=True)}
        drawing = self._drawing()
        poses.update((n, _viewer_pose(T)) for n, T in drawing.passive(q).items())
        return np.array([poses[body.frame] for body in drawing.bodies])

    def _check_capsules(self) -> None:
        names = [capsule.name for capsule in self.capsules]
        if len(set(names)) < len(names):
            raise ValueError(f"arm {self.name!r}: capsules must have different names, got {names}")
        for capsule in self.capsules:
            for frame in capsule.frames:
                if frame != BASE and frame not in self.joints:
                    raise ValueError(
                        f"arm {self.name!r}: capsule {capsule.name!r} is fixed to {frame!r}; "
                        f"choose one of {BASE}, {', '.join(self.joints)}"
                    )

    def _checked(self, q: ArrayLike) -> FloatArray:
        vector = np.asarray(q, dtype=np.float64)
        # The fastest test: a sum with NaN or infinity is not finite.
        if vector.shape != self._shape or not isfinite(sum(vector.tolist())):
            raise ValueError(
                f"{self.name} needs {self._shape[0]} finite joint values "
                f"({', '.join(self.joints)}), got {q!r}"
            )
        return vector


def _viewer_pose(T: pin.SE3) -> FloatArray:
    x, y, z, qx, qy, qz, qw = pin.SE3ToXYZQUAT(T)
    return np.array([qw, qx, qy, qz, x, y, z])


def add_joint(
    model: pin.Model,
    parent: int,
    joint: pin.JointModel,
    T_parent_joint: pin.SE3,
    name: str,
    limits: tuple[float, float],
    speed: float,
) -> int:
    """Add a joint with position limits [rad or m] and a speed limit [rad/s or m/s]; its index."""
    lower, upper = limits
    effort = 1.0  # required, not used
    bounds = (np.array([value]) for value in (effort, speed, lower, upper))
    return int(model.addJoint(parent, joint, T_parent_joint, name, *bounds))


def _read_only(values: ArrayLike) -> FloatArray:
    array = np.array(values, dtype=np.float64)
    array.flags.writeable = False
    return array
