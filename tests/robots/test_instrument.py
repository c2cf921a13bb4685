"""The capsules of the arms: where they are, and that they hold what is drawn and little more."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import robots
from robots import point
from robots.instrument import Capsule, rigid

ARMS = robots.names()
NEEDLE = (0.02, 0.0, 0.04)
# Of what is drawn of these frames, every corner is in a capsule …
HELD = {
    "psm": ("roll", "wrist_pitch", "wrist_yaw"),
    "point": ("z",),
    "panda": ("panda_joint5", "panda_joint6", "panda_joint7"),
    "ur5": ("elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint"),
}
# … but for this [m]: the collar at the end of the PSM's shaft, the flat end of a probe.
STICKS_OUT = {"psm": 1.5e-4, "point": 1e-6, "panda": 1e-5, "ur5": 1e-5}


def load(name: str) -> robots.Arm:
    return point.load(NEEDLE) if name == "point" else robots.load(name)


def random_q(arm: robots.Arm, rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(arm.lower, arm.upper)


def distances(points: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Of points (m, 3) from an axis (2, 3)."""
    way = axis[1] - axis[0]
    length2 = way @ way
    share = np.clip((points - axis[0]) @ way / length2, 0.0, 1.0) if length2 else 0.0
    return np.linalg.norm(points - axis[0] - np.multiply.outer(share, way), axis=-1)


def drawn(arm: robots.Arm, q: np.ndarray, frames: tuple[str, ...]) -> np.ndarray:
    found = []
    for body, row in zip(arm.bodies, arm.placements(q), strict=True):
        if body.frame in frames:
            w, x, y, z = row[:4]
            R = pin.Quaternion(w, x, y, z).toRotationMatrix()
            found.append(body.vertices.astype(np.float64) @ R.T + row[4:])
    return np.vstack(found)


def test_the_names_are_those_of_the_instruments_parts() -> None:
    assert [c.name for c in robots.load("psm").capsules] == [
        "blade", "wrist", "shaft", "upper shaft"
    ]  # fmt: skip
    assert [c.name for c in robots.load("point").capsules] == ["tip"]
    assert [c.name for c in load("point").capsules] == ["tip", "needle"]
    for name in ("panda", "ur5"):
        assert robots.load(name).capsules[0].name == "probe"


@pytest.mark.parametrize("name", ARMS)
def test_the_first_capsule_ends_at_the_tip(name: str) -> None:
    arm, rng = load(name), np.random.default_rng(3)
    for _ in range(20):
        q = random_q(arm, rng)
        axes = arm.axes(q)
        assert axes.shape == (len(arm.capsules), 2, 3)
        tip = arm.tip(q).translation
        radius = arm.capsules[0].radius
        assert distances(tip[None], axes[0])[0] == pytest.approx(radius, abs=1e-12)
        assert np.linalg.norm(axes[0, 1] - tip) == pytest.approx(radius, abs=1e-12)


@pytest.mark.parametrize("name", ARMS)
def test_what_is_drawn_of_the_instrument_is_in_its_capsules(name: str) -> None:
    arm, rng = load(name), np.random.default_rng(4)
    for _ in range(5):
        q = random_q(arm, rng)
        corners = drawn(arm, q, HELD[name])
        outside = np.min(
            [
                distances(corners, axis) - capsule.radius
                for capsule, axis in zip(arm.capsules, arm.axes(q), strict=True)
            ],
            axis=0,
        )
        assert outside.max() < STICKS_OUT[name]


@pytest.mark.parametrize("name", ARMS)
def test_no_capsule_is_much_thicker_or_longer_than_what_is_drawn(name: str) -> None:
    arm = load(name)
    q = arm.neutral
    corners = drawn(arm, q, HELD[name])
    for capsule, axis in zip(arm.capsules, arm.axes(q), strict=True):
        if capsule.ball and not capsule.radius:
            continue
        away = distances(corners, axis)
        near = away < capsule.radius + STICKS_OUT[name]
        assert away[near].max() > 0.9 * capsule.radius
        # Beyond either end of the axis there is something drawn within two radii.
        for i in (1,) if capsule.port else (0, 1):  # at the remote centre the shaft goes on
            end = axis[i]
            outwards = (end - axis[1 - i]) / np.linalg.norm(end - axis[1 - i])
            assert ((corners[near] - end) @ outwards).max() > -1.0 * capsule.radius


def test_the_psms_shaft_is_cut_at_the_remote_centre_and_ends_at_the_wrist() -> None:
    arm, rng = robots.load("psm"), np.random.default_rng(5)
    for _ in range(50):
        q = random_q(arm, rng)
        s = np.array([np.sin(q[0]) * np.cos(q[1]), -np.sin(q[1]), -np.cos(q[0]) * np.cos(q[1])])
        _blade, wrist, shaft, upper = arm.axes(q)
        np.testing.assert_allclose(shaft, [np.zeros(3), (q[2] - 0.0156) * s], atol=1e-12)
        np.testing.assert_allclose(upper, [np.zeros(3), (q[2] - 0.0156 - 0.3262) * s], atol=1e-12)
        np.testing.assert_allclose(wrist[0], shaft[1], atol=1e-12)
        assert np.linalg.norm(wrist[1] - wrist[0]) == pytest.approx(0.0091)
    assert arm.capsules[2].radius == 0.00835 / 2


@pytest.mark.parametrize("name", ARMS)
def test_the_anchors_say_the_same_of_the_chain(name: str) -> None:
    """The product of the chain's rows, multiplied out here, takes the anchors to the axes."""
    arm, rng = load(name), np.random.default_rng(6)
    for _ in range(10):
        q = random_q(arm, rng)
        T, moved = np.eye(4), [np.eye(4)]
        for row in arm.chain[:-1]:
            step = np.eye(4)
            step[:3, :3], step[:3, 3] = row[:9].reshape(3, 3), row[9:12]
            joint, value = np.eye(4), q[int(row[13])]
            if row[12]:
                joint[:2, :2] = [[np.cos(value), -np.sin(value)], [np.sin(value), np.cos(value)]]
            else:
                joint[2, 3] = value
            T = T @ step @ joint
            moved.append(T)
        for anchors, axis in zip(arm.anchors, arm.axes(q), strict=True):
            for anchor, end in zip(anchors, axis, strict=True):
                there = moved[int(anchor[0])] @ [*anchor[1:], 1.0]
                np.testing.assert_allclose(there[:3], end, atol=1e-12)


def test_a_copy_has_the_same_capsules() -> None:
    arm = load("point")
    assert arm.copy().capsules == arm.capsules
    np.testing.assert_array_equal(arm.copy().axes(arm.neutral), arm.axes(arm.neutral))


def own_arm(*capsules: Capsule) -> robots.Arm:
    """An arm of two joints, of which a third is not on the way to the tip."""
    model, limits = pin.Model(), (np.ones(1), np.ones(1), -np.ones(1), np.ones(1))
    first = model.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), "lift", *limits)
    second = model.addJoint(first, pin.JointModelPZ(), pin.SE3.Identity(), "slide", *limits)
    model.addJoint(first, pin.JointModelRY(), pin.SE3.Identity(), "aside", *limits)
    T = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.25]))
    model.addFrame(pin.Frame("tip", second, T, pin.FrameType.OP_FRAME))
    return robots.Arm("own", model, "tip", np.zeros(3), None, None, capsules)  # type: ignore[arg-type]


def test_an_arm_that_gives_none_has_its_tip_as_a_ball() -> None:
    arm = own_arm()
    assert len(arm.capsules) == 1
    assert arm.capsules[0].ball
    assert arm.capsules[0].radius == 0.0
    q = np.array([0.3, 0.1, 0.0])
    for end in arm.axes(q)[0]:
        np.testing.assert_allclose(end, arm.tip(q).translation, atol=1e-15)


def test_an_axis_may_be_fixed_to_the_base() -> None:
    arm = own_arm(Capsule("rod", 0.01, (robots.instrument.BASE, "slide"), ((1, 2, 3), (0, 0, 0))))
    np.testing.assert_allclose(arm.axes(np.zeros(3))[0], [[1, 2, 3], [0, 0, 0]])
    assert not arm.capsules[0].ball


def test_what_is_no_capsule_is_refused() -> None:
    with pytest.raises(ValueError, match="radius must be 0 or more, got -1"):
        rigid("a", -1.0, "lift", (0, 0, 0), (0, 0, 0))
    with pytest.raises(ValueError, match="ends must be finite"):
        rigid("a", 1.0, "lift", (0, 0, np.nan), (0, 0, 0))
    with pytest.raises(ValueError, match="fixed to 'hand'; choose one of universe, lift, slide"):
        own_arm(rigid("a", 1.0, "hand", (0, 0, 0), (0, 0, 0)))
    with pytest.raises(ValueError, match="'aside', which is not between the base and the tip"):
        own_arm(rigid("a", 1.0, "aside", (0, 0, 0), (0, 0, 0)))
    twice = [rigid("a", 1.0, "lift", (0, 0, 0), (0, 0, 0))] * 2
    with pytest.raises(ValueError, match="different names"):
        own_arm(*twice)
    with pytest.raises(ValueError, match=r"a needle must be longer than 0\.0032 m"):
        point.load((0.0, 0.0, 0.003))
