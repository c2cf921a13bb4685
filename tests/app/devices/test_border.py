"""What comes from a device is taken only if it can be a measurement or a goal."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

import robots
from app.devices.remote.border import HARMLESS, JointBorder, PoseBorder, Reason
from app.devices.remote.messages import Message

PSM = robots.load("psm")
NEUTRAL = PSM.neutral.tolist()


def joints(values: object = None, stamp: float | None = 1.0, at: float = 0.0) -> Message:
    return Message("measured_js", numbers=NEUTRAL if values is None else values, stamp=stamp, at=at)


def border() -> JointBorder:
    return JointBorder(PSM.lower, PSM.upper, PSM.velocity)


def test_good_joints_are_taken_as_they_are_and_read_only() -> None:
    q = border().checked(joints())
    np.testing.assert_array_equal(q, PSM.neutral)
    with pytest.raises(ValueError, match="read-only"):
        q[0] = 1.0


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ([math.nan, *NEUTRAL[1:]], Reason.FINITE),
        ([math.inf, *NEUTRAL[1:]], Reason.FINITE),
        ([4.67e-310, *NEUTRAL[1:]], Reason.FINITE),
        ([None, *NEUTRAL[1:]], Reason.FINITE),
        (["0", *NEUTRAL[1:]], Reason.NUMBERS),
        ([True, *NEUTRAL[1:]], Reason.NUMBERS),
        ([[0.0], *NEUTRAL[1:]], Reason.NUMBERS),
        ([10**400, *NEUTRAL[1:]], Reason.RANGE),
        (NEUTRAL[:5], Reason.COUNT),
        ([*NEUTRAL, 0.0], Reason.COUNT),
        ([], Reason.COUNT),
        ({"0": 1.0}, Reason.NUMBERS),
        ("000000", Reason.NUMBERS),
        ([0.0, 0.0, 0.3, 0.0, 0.0, 0.0], Reason.RANGE),
        ([-2.0, *NEUTRAL[1:]], Reason.RANGE),
    ],
)
def test_what_are_no_joints_of_this_arm_is_refused(values: object, reason: Reason) -> None:
    assert border().checked(joints(values)) is reason


@pytest.mark.parametrize("message", [
    Message("measured_js", numbers=NEUTRAL, stamp=1.0, valid=False),
    Message("measured_js", numbers=NEUTRAL, stamp=0.0),
])  # fmt: skip
def test_what_is_marked_as_not_valid_is_refused(message: Message) -> None:
    assert border().checked(message) is Reason.INVALID


def test_doubled_and_overtaken_values_are_refused_and_harm_nothing() -> None:
    one = border()
    for stamp, expected in ((1.0, None), (1.0, Reason.REPEATED), (0.99, Reason.LATE), (1.01, None)):
        found = one.checked(joints(stamp=stamp, at=stamp))
        assert (found if isinstance(found, Reason) else None) == expected
        assert expected is None or expected in HARMLESS


def test_a_clock_that_goes_back_is_refused_until_it_has_stayed_there() -> None:
    one = border()
    one.checked(joints(stamp=100.0, at=0.0))
    found = [one.checked(joints(stamp=20.0 + t, at=t)) for t in np.arange(0.01, 0.5, 0.01)]
    refused = [q is Reason.BACK for q in found]
    taken = refused.index(False)
    assert 0.24 < taken * 0.01 < 0.28
    assert all(refused[:taken])
    assert not any(refused[taken:])
    # A single stray stamp from the past does not make it go back.
    assert one.checked(joints(stamp=3.0, at=0.51)) is Reason.BACK
    assert not isinstance(one.checked(joints(stamp=20.6, at=0.6)), Reason)


def test_joints_jump_when_they_outrun_four_times_their_speed() -> None:
    moved = np.array(NEUTRAL)
    moved[0] += 0.1  # takes 16 ms at four times 90 °/s
    for wait, jumps in ((0.01, True), (0.05, False)):
        one = border()
        one.checked(joints(stamp=1.0, at=0.0))
        found = one.checked(joints(moved.tolist(), 1.0 + wait, wait))
        assert (found is Reason.JUMP) == jumps
    # What was refused does not become the measure of what comes.
    one = border()
    one.checked(joints(stamp=1.0, at=0.0))
    for k in range(1, 10):
        assert one.checked(joints(moved.tolist(), 1.0 + 1e-3 * k, 1e-3 * k)) is Reason.JUMP
    assert not isinstance(one.checked(joints(stamp=1.02, at=0.01)), Reason)


def pose(
    R: object = None, p: object = (0.0, 0.0, -0.1), stamp: float | None = None, frame: str = "",
    at: float = 0.0,
) -> Message:  # fmt: skip
    rows = np.eye(3).tolist() if R is None else R
    return Message(
        "servo_cp", rotation=rows, translation=list(p) if isinstance(p, tuple) else p,
        stamp=stamp, frame=frame, at=at,
    )  # fmt: skip


def test_a_pose_is_taken_with_its_rotation_made_orthonormal() -> None:
    turn = pin.exp3(np.array([0.3, -1.0, 2.0]))
    found = PoseBorder("").checked(pose((turn + 2e-4).tolist()))
    assert isinstance(found, pin.SE3)
    np.testing.assert_allclose(found.rotation, turn, atol=5e-4)
    np.testing.assert_allclose(found.rotation @ found.rotation.T, np.eye(3), atol=1e-14)


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (pose(np.diag([1.0, 1.0, -1.0]).tolist()), Reason.ROTATION),
        (pose((2.0 * np.eye(3)).tolist()), Reason.ROTATION),
        (pose((1e300 * np.eye(3)).tolist()), Reason.ROTATION),
        (pose(np.zeros((3, 3)).tolist()), Reason.ROTATION),
        (pose([[1.0, 0.1, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), Reason.ROTATION),
        (pose([[1.0, 0.0], [0.0, 1.0]]), Reason.ROTATION),
        (pose([[1.0, 0.0, math.nan], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), Reason.FINITE),
        (pose(p=(0.0, 0.0)), Reason.NUMBERS),
        (pose(p=None), Reason.NUMBERS),
        (pose(p=(0.0, 0.0, 2.1)), Reason.RANGE),
        (pose(p=(0.0, math.inf, 0.0)), Reason.FINITE),
        (pose(frame="other"), Reason.FRAME),
    ],
)
def test_what_is_no_pose_is_refused(message: Message, reason: Reason) -> None:
    assert PoseBorder("base").checked(message) is reason


def test_without_a_name_the_frame_is_that_of_the_first_pose() -> None:
    one = PoseBorder("")
    assert isinstance(one.checked(pose(frame="ECM")), pin.SE3)
    assert isinstance(one.checked(pose()), pin.SE3)
    assert one.checked(pose(frame="PSM1_base")) is Reason.FRAME


def test_a_hand_jumps_when_it_outruns_a_hand() -> None:
    for p, R, jumps in (
        ((0.0, 0.0, -0.096), None, False),
        ((0.0, 0.0, -0.08), None, True),
        ((0.0, 0.0, -0.1), pin.exp3(np.array([0.05, 0.0, 0.0])).tolist(), False),
        ((0.0, 0.0, -0.1), pin.exp3(np.array([0.0, 0.0, 0.5])).tolist(), True),
    ):
        one = PoseBorder("")
        one.checked(pose(at=0.0))
        assert (one.checked(pose(R, p, at=1e-3)) is Reason.JUMP) == jumps


def test_a_single_leap_after_a_gap_is_not_believed_a_second_one_is() -> None:
    border = JointBorder(-np.ones(1) * 4, np.ones(1) * 4, np.ones(1))

    def told(x: float, at: float) -> object:
        return border.checked(Message("measured_js", numbers=[x], at=at))

    assert isinstance(told(0.0, 0.0), np.ndarray)
    # In 0.2 s it can have gone 0.8: one wrong value, and the arm is still where it was.
    assert told(0.5, 0.2) is Reason.JUMP
    assert isinstance(told(0.001, 0.201), np.ndarray)
    # It is elsewhere, and says so again.
    assert told(0.5, 0.4) is Reason.JUMP
    assert isinstance(told(0.501, 0.401), np.ndarray)
    # Farther than an arm can go it is not believed however often it says so.
    assert told(3.0, 0.5) is Reason.JUMP
    assert told(3.0, 0.501) is Reason.JUMP
