"""What holds for every arm: kinematics, limits, inverse, names."""

import numpy as np
import pinocchio as pin
import pytest

import robots

ARMS = ("psm", "point", "panda", "ur5")


@pytest.fixture(params=ARMS)
def arm(request):
    return robots.load(request.param)


def random_q(arm, rng):
    return rng.uniform(arm.lower, arm.upper)


def test_the_catalogue_has_exactly_these_arms():
    assert sorted(robots.names()) == sorted(ARMS)
    for name in robots.names():
        assert robots.load(name).name == name


def test_an_unknown_name_lists_the_valid_ones():
    with pytest.raises(ValueError, match="'pms'") as caught:
        robots.load("pms")
    for name in ARMS:
        assert name in str(caught.value)


def test_limits_are_finite_ordered_read_only_and_hold_the_rest_pose(arm):
    n = len(arm.joints)
    for array in (arm.lower, arm.upper, arm.velocity, arm.neutral):
        assert array.shape == (n,)
        assert array.dtype == np.float64
        assert np.isfinite(array).all()
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0
    assert np.all(arm.lower < arm.upper)
    assert np.all(arm.velocity > 0.0)
    assert np.all(arm.lower <= arm.neutral)
    assert np.all(arm.neutral <= arm.upper)


def test_jacobian_against_central_differences_of_the_tip(arm):
    rng = np.random.default_rng(1)
    h = 1e-6
    for _ in range(50):
        q = random_q(arm, rng)
        J = arm.jacobian(q)
        assert J.shape == (6, len(arm.joints))
        assert J.flags.c_contiguous
        R = arm.tip(q).rotation
        for j in range(len(arm.joints)):
            e = np.zeros(len(q))
            e[j] = h
            ahead, behind = arm.tip(q + e), arm.tip(q - e)
            linear = (ahead.translation - behind.translation) / (2 * h)
            W = (ahead.rotation - behind.rotation) / (2 * h) @ R.T  # skew matrix of ω
            angular = 0.5 * np.array([W[2, 1] - W[1, 2], W[0, 2] - W[2, 0], W[1, 0] - W[0, 1]])
            np.testing.assert_allclose(J[:, j], np.r_[linear, angular], atol=2e-9)


def test_kinematics_gives_the_tip_and_the_jacobian(arm):
    rng = np.random.default_rng(2)
    for _ in range(20):
        q = random_q(arm, rng)
        tip, J = arm.kinematics(q)
        fresh = arm.copy()
        np.testing.assert_allclose(tip.homogeneous, fresh.tip(q).homogeneous, atol=1e-14)
        np.testing.assert_allclose(J, fresh.jacobian(q), atol=1e-14)


def test_results_are_the_callers_own(arm):
    rng = np.random.default_rng(3)
    q = random_q(arm, rng)
    tip, J = arm.kinematics(q)
    only_tip = arm.tip(q)
    placements = arm.placements(q)
    kept = [tip.homogeneous.copy(), J.copy(), only_tip.homogeneous.copy(), placements.copy()]
    other = random_q(arm, rng)
    arm.kinematics(other)
    arm.tip(other)
    arm.placements(other)
    tip_again = arm.tip(q)
    tip_again.translation = np.full(3, 9.0)
    for was, now in zip(kept, [tip.homogeneous, J, only_tip.homogeneous, placements], strict=True):
        np.testing.assert_array_equal(was, now)
    np.testing.assert_array_equal(arm.tip(q).homogeneous, only_tip.homogeneous)


def test_a_copy_has_its_own_workspace(arm):
    twin = arm.copy()
    assert twin._data is not arm._data
    np.testing.assert_array_equal(twin.neutral, arm.neutral)
    np.testing.assert_array_equal(
        twin.tip(twin.neutral).homogeneous, arm.tip(arm.neutral).homogeneous
    )


def test_bad_joint_vectors_are_refused_everywhere(arm):
    n = len(arm.joints)
    with_nan, with_inf = arm.neutral.copy(), arm.neutral.copy()
    with_nan[-1] = np.nan
    with_inf[0] = -np.inf
    for bad in (np.zeros(n + 1), np.zeros(n - 1), np.zeros((n, 1)), with_nan, with_inf):
        for call in (arm.tip, arm.jacobian, arm.kinematics, arm.clamp, arm.placements):
            with pytest.raises(ValueError, match=f"{arm.name} needs {n} finite joint values"):
                call(bad)
        with pytest.raises(ValueError, match="finite joint values"):
            arm.inverse(arm.tip(arm.neutral), bad)


def test_bad_poses_are_refused(arm):
    pose = arm.tip(arm.neutral)
    lost = pin.SE3(pose.rotation, np.array([np.nan, 0.0, 0.0]))
    with pytest.raises(ValueError, match="finite"):
        arm.inverse(lost)
    stretched = pose.copy()
    stretched.rotation = 1.1 * np.eye(3)
    with pytest.raises(ValueError, match="orthonormal"):
        arm.inverse(stretched)
    mirrored = pose.copy()
    mirrored.rotation = np.diag([1.0, 1.0, -1.0])
    with pytest.raises(ValueError, match="right-handed"):
        arm.inverse(mirrored)


def test_clamp_brings_every_joint_into_its_limits(arm):
    rng = np.random.default_rng(4)
    q = arm.neutral + rng.normal(size=len(arm.joints)) * 10.0
    clamped = arm.clamp(q)
    expected = [
        lo if v < lo else hi if v > hi else v
        for v, lo, hi in zip(q, arm.lower, arm.upper, strict=True)
    ]
    np.testing.assert_array_equal(clamped, expected)
    inside = random_q(arm, rng)
    np.testing.assert_array_equal(arm.clamp(inside), inside)


def test_inverse_round_trip_over_reachable_poses_from_anywhere(arm):
    rng = np.random.default_rng(5)
    for _ in range(60):
        q = random_q(arm, rng)
        pose = arm.tip(q)
        found = arm.inverse(pose, start=random_q(arm, rng))
        assert np.all(found >= arm.lower)
        assert np.all(found <= arm.upper)
        error = pose.actInv(arm.tip(found))
        assert np.linalg.norm(error.translation) < 1e-8, q
        np.testing.assert_allclose(error.rotation, np.eye(3), atol=1e-7, err_msg=str(q))


def test_inverse_stays_near_a_close_start(arm):
    rng = np.random.default_rng(6)
    middle, span = (arm.lower + arm.upper) / 2, arm.upper - arm.lower
    for _ in range(30):
        start = middle + rng.uniform(-0.2, 0.2, len(span)) * span
        # Well-conditioned starts only: next to a singularity a near pose may need a far joint.
        values = np.linalg.svd(arm.jacobian(start)[: len(span)], compute_uv=False)
        if values[-1] < 0.02 * values[0] and arm.name != "point":
            continue
        q = start + 1e-4 * rng.uniform(-1.0, 1.0, len(span))
        found = arm.inverse(arm.tip(q), start)
        assert np.abs(found - start).max() < 5e-3


def test_unreachable_poses_say_so(arm):
    away = arm.tip(arm.neutral)
    away.translation = np.array([3.0, -2.0, 4.0])
    with pytest.raises(robots.Unreachable, match=arm.name):
        arm.inverse(away)
    assert issubclass(robots.Unreachable, ValueError)


def test_the_point_ignores_rotation_and_names_its_reach():
    arm = robots.load("point")
    turned = pin.SE3(pin.rpy.rpyToMatrix(0.3, 0.2, 0.1), np.array([0.1, -0.2, 0.3]))
    np.testing.assert_array_equal(arm.inverse(turned), [0.1, -0.2, 0.3])
    np.testing.assert_array_equal(arm.velocity, [0.2] * 3)
    with pytest.raises(robots.Unreachable, match=r"±0\.3 m"):
        arm.inverse(pin.SE3(np.eye(3), np.array([0.0, 0.31, 0.0])))


@pytest.mark.parametrize(("name", "frame"), [("panda", "panda_hand_tcp"), ("ur5", "tool0")])
def test_the_probe_adds_100_mm_along_the_approach_to_the_urdfs_own_frame(name, frame):
    arm = robots.load(name)
    data = arm._model.createData()
    rng = np.random.default_rng(8)
    for _ in range(5):
        q = random_q(arm, rng)
        pin.framesForwardKinematics(arm._model, data, q)
        holder = data.oMf[arm._model.getFrameId(frame)]
        tip = holder.actInv(arm.tip(q))
        np.testing.assert_allclose(tip.translation, [0.0, 0.0, 0.1], atol=1e-12)
        np.testing.assert_allclose(tip.rotation, np.eye(3), atol=1e-12)


@pytest.mark.parametrize(("name", "joints"), [("panda", 7), ("ur5", 6)])
def test_urdf_arms_rest_above_a_table_with_the_tool_pointing_down(name, joints):
    arm = robots.load(name)
    assert len(arm.joints) == joints
    tip = arm.tip(arm.neutral)
    np.testing.assert_allclose(tip.rotation[:, 2], [0.0, 0.0, -1.0], atol=1e-9)
    assert 0.25 < tip.translation[0] < 0.6
    assert 0.2 < tip.translation[2] < 0.6
    # Elbow up: the fourth joint's link stands higher than the tool.
    assert arm.placements(arm.neutral)[:, 6].max() > tip.translation[2] + 0.1
