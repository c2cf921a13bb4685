import numpy as np
import pinocchio as pin
import pytest

from app.control.teleoperation import latch


def poses(seed: int, count: int) -> list[pin.SE3]:
    pin.seed(seed)
    return [pin.SE3.Random() for _ in range(count)]


@pytest.mark.parametrize("scale", [0.2, 1.0, 1.7])
def test_a_latched_handle_is_at_its_proxy(scale: float) -> None:
    handle, proxy = poses(1, 2)
    assert latch(scale, handle, proxy).proxy(handle).isApprox(proxy, 1e-12)


@pytest.mark.parametrize("scale", [0.2, 1.0, 1.7])
def test_translation_is_scaled_in_the_base_frame(scale: float) -> None:
    handle, proxy, later = poses(2, 3)
    moved = latch(scale, handle, proxy).proxy(later)
    expected = proxy.translation + scale * (later.translation - handle.translation)
    np.testing.assert_allclose(moved.translation, expected, atol=1e-14)


def test_rotation_is_not_scaled() -> None:
    # The proxy turns by the handle's own turn: angle and axis in the base frame are the same.
    handle, proxy, later = poses(3, 3)
    moved = latch(0.2, handle, proxy).proxy(later)
    turn_of_handle = later.rotation @ handle.rotation.T
    turn_of_proxy = moved.rotation @ proxy.rotation.T
    np.testing.assert_allclose(turn_of_proxy, turn_of_handle, atol=1e-12)


def test_unit_scale_latched_at_one_pose_is_the_identity() -> None:
    start, later = poses(4, 2)
    assert latch(1.0, start, start).proxy(later).isApprox(later, 1e-12)


def test_the_map_keeps_copies_of_its_poses() -> None:
    handle, proxy = poses(5, 2)
    teleop = latch(1.0, handle, proxy)
    before = teleop.proxy(poses(6, 1)[0])
    handle.translation = np.array([9.0, 9.0, 9.0])
    assert teleop.proxy(poses(6, 1)[0]).isApprox(before, 0.0)


def test_a_locked_orientation_stays_whatever_the_handle_does() -> None:
    handle, proxy, later = poses(7, 3)
    moved = latch(0.5, handle, proxy, locked=True).proxy(later)
    np.testing.assert_array_equal(moved.rotation, proxy.rotation)
    free = latch(0.5, handle, proxy).proxy(later)
    np.testing.assert_array_equal(moved.translation, free.translation)
