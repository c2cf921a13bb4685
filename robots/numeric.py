"""Inverse kinematics by damped least squares, for arms without a closed form."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from robots.arm import Arm, FloatArray, Unreachable

_LENGTH = 0.2  # [m/rad] weight of a rotation error against a position error
_CLOSE = 1e-9  # [m] weighted error of a solution
_ITERATIONS = 200
_RESTARTS = 40
_STEP = 0.5  # [rad] largest step of a joint in one iteration
_STALLED = 1e-12  # [rad] step at which the iteration ends


def inverse(arm: Arm, pose: pin.SE3, start: FloatArray) -> FloatArray:
    """Levenberg–Marquardt from `start`; joints at a limit are excluded from the step.

    From a local minimum it restarts at the rest pose, then at fixed pseudo-random joint vectors.
    Raises `Unreachable` when none of them converges.
    """
    best = np.inf
    for q_0 in _starts(arm, start):
        q, error = _descend(arm, pose, q_0)
        if error < _CLOSE:
            return q
        best = min(best, error)
    raise Unreachable(
        f"{arm.name}: no joint vector within the limits found for the tip at {pose.translation} m; "
        f"the best one misses by {best:.3g} m (rotation at {_LENGTH} m/rad)"
    )


def _starts(arm: Arm, start: FloatArray) -> Iterator[FloatArray]:
    yield arm.clamp(start)
    yield arm.neutral.copy()
    rng = np.random.default_rng(0)
    for _ in range(_RESTARTS):
        yield rng.uniform(arm.lower, arm.upper)


def _descend(arm: Arm, pose: pin.SE3, q: FloatArray) -> tuple[FloatArray, float]:
    """The last joint vector and its weighted error [m]."""
    residual, J = _residual(arm, pose, q)
    error = float(np.linalg.norm(residual))
    damping = 1e-3
    for _ in range(_ITERATIONS):
        if error < _CLOSE:
            break
        step = _free_step(arm, q, J, residual, damping * error)
        length = float(np.abs(step).max())
        if length < _STALLED:
            break
        trial = arm.clamp(q + step * min(1.0, _STEP / length))
        residual_there, J_there = _residual(arm, pose, trial)
        error_there = float(np.linalg.norm(residual_there))
        if error_there < error:
            q, residual, J, error = trial, residual_there, J_there, error_there
            damping = max(damping / 5.0, 1e-9)
        else:
            damping *= 10.0
    return q, error


def _free_step(
    arm: Arm, q: FloatArray, J: FloatArray, residual: FloatArray, damping: float
) -> FloatArray:
    """The damped step of the joints that it does not move beyond their limits."""
    step = np.zeros_like(q)
    free = np.ones(q.size, dtype=bool)
    for _ in range(q.size):
        J_free = J[:, free]
        # Normal equations would be numerically singular for seven joints.
        rows = np.vstack((J_free, np.sqrt(damping) * np.eye(J_free.shape[1])))
        wanted = np.concatenate((residual, np.zeros(J_free.shape[1])))
        step[:] = 0.0
        step[free] = np.linalg.lstsq(rows, wanted)[0]
        stuck = free & (((q <= arm.lower) & (step < 0.0)) | ((q >= arm.upper) & (step > 0.0)))
        if not stuck.any():
            break
        free &= ~stuck
        if not free.any():
            return np.zeros_like(q)
    return step


def _residual(arm: Arm, pose: pin.SE3, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Weighted pose error and Jacobian [m], along the base frame's axes."""
    tip, J = arm.kinematics(q)
    turn = pin.log3(pose.rotation @ tip.rotation.T)
    J[3:] *= _LENGTH
    return np.concatenate((pose.translation - tip.translation, _LENGTH * turn)), J
