"""The compiled kinematics against Pinocchio's, over random joints of every arm and of odd ones."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import robots
from robots.chain import flat
from vf.tick.chain import jacobian, tip_pose


def largest_error(model: pin.Model, frame: int, draws: int, rng: np.random.Generator) -> float:
    """Between the two, over random joint vectors: of the tip's pose, and of its Jacobian."""
    chain, data = flat(model, frame), model.createData()
    pose, axes = np.empty((3, 4)), np.empty((len(chain) - 1, 6))
    J = np.full((6, model.nv), np.nan)
    low = np.maximum(model.lowerPositionLimit, -10.0)
    high = np.minimum(model.upperPositionLimit, 10.0)
    worst = 0.0
    for _ in range(draws):
        q = rng.uniform(low, high)
        tip_pose(chain, q, pose, axes)
        jacobian(chain, axes, *pose[:, 3], J)
        known = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)
        T = pin.updateFramePlacement(model, data, frame)
        worst = max(worst, np.abs(pose - T.homogeneous[:3]).max(), np.abs(J - known).max())
    return worst


@pytest.mark.parametrize("name", robots.names())
def test_every_arm_is_where_pinocchio_says(name: str) -> None:
    arm = robots.load(name)
    assert largest_error(arm._model, arm._tip, 2000, np.random.default_rng(1)) < 1e-12


def some_placement(rng: np.random.Generator) -> pin.SE3:
    return pin.SE3(pin.exp3(rng.normal(size=3)), rng.uniform(-1.0, 1.0, 3))


def odd_model(rng: np.random.Generator) -> tuple[pin.Model, int]:
    """Joints of all kinds about any axes, with a second branch that does not move the tip."""
    model = pin.Model()
    parent, branch = 0, 0
    kinds = (
        pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ, pin.JointModelPX, pin.JointModelPY,
        pin.JointModelPZ,
    )  # fmt: skip
    for k in range(9):
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        joint = (
            rng.choice(kinds)() if k % 3 else pin.JointModelRevoluteUnaligned(axis)
            if k else pin.JointModelPrismaticUnaligned(axis)
        )  # fmt: skip
        limits = np.ones(1), np.ones(1), -3.0 * np.ones(1), 3.0 * np.ones(1)
        if k == 4:
            branch = model.addJoint(parent, joint, some_placement(rng), f"j{k}", *limits)
        elif k == 6:
            model.addJoint(branch, joint, some_placement(rng), f"j{k}", *limits)
        else:
            parent = model.addJoint(parent, joint, some_placement(rng), f"j{k}", *limits)
    frame = pin.Frame("tip", parent, some_placement(rng), pin.FrameType.OP_FRAME)
    return model, model.addFrame(frame)


@pytest.mark.parametrize("seed", range(6))
def test_joints_about_any_axis_and_of_another_branch(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model, frame = odd_model(rng)
    assert len(flat(model, frame)) < model.njoints  # the other branch is left out
    assert largest_error(model, frame, 100, rng) < 1e-12


def test_other_kinds_of_joints_are_refused_by_name() -> None:
    for joint in (pin.JointModelTranslation(), pin.JointModelRUBZ()):
        model = pin.Model()
        parent = model.addJoint(0, joint, pin.SE3.Identity(), "wheel")
        frame = model.addFrame(pin.Frame("tip", parent, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
        with pytest.raises(ValueError, match="wheel"):
            flat(model, frame)
