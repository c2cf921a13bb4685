"""The PSM against its DH table, multiplied out independently, and against known invariants."""

import numpy as np
import pinocchio as pin
import pytest

import robots

# kind, α, a, θ offset, d offset: modified (Craig) DH of the dVRK's PSM
DH = [
    ("R", np.pi / 2, 0.0, np.pi / 2, 0.0),
    ("R", -np.pi / 2, 0.0, -np.pi / 2, 0.0),
    ("P", np.pi / 2, 0.0, 0.0, -0.4318),
    ("R", 0.0, 0.0, 0.0, 0.4162),
    ("R", -np.pi / 2, 0.0, -np.pi / 2, 0.0),
    ("R", -np.pi / 2, 0.0091, -np.pi / 2, 0.0),
]
R_TIP = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
LIMITS = np.array(
    [
        (-1.588, 1.588),
        (-0.925, 0.925),
        (0.0, 0.24),
        (-4.538, 4.538),
        (-1.396, 1.396),
        (-1.396, 1.396),
    ]
)


def dh_frames(q):
    """Base-frame transforms (4, 4) of the six DH frames."""
    T, frames = np.eye(4), []
    for (kind, alpha, a, theta, d), value in zip(DH, q, strict=True):
        theta, d = (theta + value, d) if kind == "R" else (theta, d + value)
        ca, sa, ct, st = np.cos(alpha), np.sin(alpha), np.cos(theta), np.sin(theta)
        T = T @ np.array(
            [
                [ct, -st, 0.0, a],
                [st * ca, ct * ca, -sa, -d * sa],
                [st * sa, ct * sa, ca, d * ca],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )
        frames.append(T)
    return frames


def dh_tip(q):
    T = dh_frames(q)[-1].copy()
    T[:3, :3] = T[:3, :3] @ R_TIP
    T[:3, 3] += 0.0102 * T[:3, 2]
    return T


@pytest.fixture(scope="module")
def arm():
    return robots.load("psm")


@pytest.fixture
def rng():
    return np.random.default_rng(11)


def random_q(rng):
    return rng.uniform(LIMITS[:, 0], LIMITS[:, 1])


def test_limits_speeds_and_rest_pose(arm):
    np.testing.assert_array_equal(np.c_[arm.lower, arm.upper], LIMITS)
    np.testing.assert_allclose(arm.velocity[[0, 1]], np.deg2rad(90.0))
    assert arm.velocity[2] == 0.2
    np.testing.assert_allclose(arm.velocity[3:], np.deg2rad(1080.0))
    np.testing.assert_array_equal(arm.neutral, [0, 0, 0.12, 0, 0, 0])


def test_tip_against_the_dh_product(arm, rng):
    for _ in range(500):
        q = random_q(rng)
        np.testing.assert_allclose(arm.tip(q).homogeneous, dh_tip(q), atol=2e-15)


def test_tip_at_the_published_check_poses(arm):
    T = arm.tip(np.zeros(6))
    np.testing.assert_allclose(T.translation, [0.0, 0.0, -0.0037], atol=1e-15)
    np.testing.assert_allclose(T.rotation, [[0, 1, 0], [1, 0, 0], [0, 0, -1]], atol=1e-15)
    T = arm.tip([0.1, -0.2, 0.12, 0.3, 0.2, -0.1])
    np.testing.assert_allclose(T.translation, [0.010034751, 0.021203405, -0.121077354], atol=5e-10)
    rows = [
        [0.289050727, 0.955764068, -0.054449279],
        [0.957099336, -0.287314346, 0.037567650],
        [0.020261751, -0.062972325, -0.997809575],
    ]
    np.testing.assert_allclose(T.rotation, rows, atol=5e-10)


def test_insertion_moves_the_tip_along_a_shaft_through_the_remote_centre(arm, rng):
    for _ in range(100):
        q = random_q(rng)
        shaft = np.array([np.sin(q[0]) * np.cos(q[1]), -np.sin(q[1]), -np.cos(q[0]) * np.cos(q[1])])
        wrist = dh_frames(q)[4][:3, 3]
        np.testing.assert_allclose(wrist, (q[2] - 0.0156) * shaft, atol=1e-15)
        deeper = q + np.array([0, 0, 0.01, 0, 0, 0])
        moved = arm.tip(deeper).translation - arm.tip(q).translation
        np.testing.assert_allclose(moved, 0.01 * shaft, atol=1e-15)


def test_inverse_returns_the_start_when_it_is_a_solution(arm, rng):
    for _ in range(300):
        q = random_q(rng)
        found = arm.inverse(arm.tip(q), start=q)
        np.testing.assert_allclose(dh_tip(found), dh_tip(q), atol=1e-8)
        # Only next to the wrist's singularities may rounding be amplified this far.
        np.testing.assert_allclose(found, q, atol=1e-6)


def test_inverse_takes_the_quickest_branch(arm, rng):
    """Every branch is found again by numeric descent from many starts; none is quicker."""
    from robots import numeric

    several = 0
    for _ in range(12):
        pose, start = arm.tip(random_q(rng)), random_q(rng)
        found = arm.inverse(pose, start)
        time = np.max(np.abs(found - start) / arm.velocity)
        others = []
        for _ in range(12):
            q, error = numeric._descend(arm, pose, random_q(rng))
            if error < 1e-9:
                others.append(np.max(np.abs(q - start) / arm.velocity))
                several += np.abs(q - found).max() > 1e-3
        assert all(time <= other + 1e-6 for other in others)
    assert several > 0


def test_inverse_uses_the_whole_range_of_roll(arm):
    q = np.array([0.1, 0.2, 0.15, 4.4, 0.3, -0.2])
    pose = arm.tip(q)
    np.testing.assert_allclose(arm.inverse(pose, start=q), q, atol=1e-9)
    near_other_end = arm.inverse(pose, start=q - np.array([0, 0, 0, 2 * np.pi, 0, 0]))
    assert near_other_end[3] == pytest.approx(4.4 - 2 * np.pi, abs=1e-9)


def test_inverse_with_the_wrist_above_the_remote_centre(arm):
    q = np.array([0.3, -0.4, 0.004, 0.5, 0.2, -0.1])
    np.testing.assert_allclose(arm.inverse(arm.tip(q), start=q), q, atol=1e-9)


def test_inverse_names_the_joint_that_would_break_its_limit(arm):
    for joint, name in enumerate(arm.joints[:3]):
        q = np.array([0.1, 0.1, 0.12, 0.0, 0.0, 0.0])
        q[joint] = LIMITS[joint, 1] + 0.05
        with pytest.raises(robots.Unreachable, match=f"{name} would be"):
            arm.inverse(arm.tip(q))


def test_inverse_at_the_limits_is_reachable_and_inside_them(arm):
    for end in (arm.lower, arm.upper):
        q = np.where(arm.joints == np.array("roll"), 0.0, end)
        found = arm.inverse(arm.tip(q), start=q)
        assert np.all((found >= arm.lower) & (found <= arm.upper))
        np.testing.assert_allclose(found, q, atol=1e-7)


def test_a_wrist_on_the_remote_centre_is_refused_as_singular(arm):
    # The yaw axis' point itself at the base's origin leaves the wrist's direction undefined.
    R = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    with pytest.raises(robots.Unreachable, match="singular"):
        arm.inverse(pin.SE3(R, 0.0102 * R[:, 2]))
