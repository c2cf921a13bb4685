"""Courses of motions: where they begin, how far they go, how fast they are at most."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from app.motion import waves
from app.motion.course import Course
from app.motion.declared import PERIODS, Motion
from app.words import OptionError

CENTRE = np.array([0.01, -0.02, 0.3])
WAVES = list(waves.WAVES)


@pytest.mark.parametrize("kind", WAVES)
def test_a_wave_begins_at_rest_reaches_one_and_is_never_steeper_than_said(kind):
    wave, slope = waves.WAVES[kind]
    times = np.linspace(0.0, 2.0, 400_001)
    values = np.array([wave(float(time)) for time in times])
    assert values[0] == pytest.approx(0.0, abs=1e-12)
    assert values.min() >= -1e-12
    assert values.max() == pytest.approx(1.0, abs=1e-6)
    steepest = np.abs(np.diff(values)).max() * 200_000
    assert steepest == pytest.approx(slope, rel=1e-3)


def test_a_breath_pauses_at_the_end_of_expiration():
    values = np.array([waves.breathing(p) for p in np.linspace(0.0, 1.0, 1001)])
    assert (values < 0.02).mean() > 0.3


@given(
    kinds=st.lists(st.sampled_from(WAVES), min_size=1, max_size=3),
    data=st.data(),
)
@settings(max_examples=60, deadline=None)
def test_no_point_is_faster_than_the_bound(kinds, data):
    small = st.floats(-0.02, 0.02)
    turns = st.floats(-0.5, 0.5)
    motions = [
        Motion(
            kind,
            move=tuple(data.draw(small) for _ in range(3)),
            turn=tuple(data.draw(turns) for _ in range(3)),
            period=data.draw(st.floats(0.1, 3.0)),
            after=data.draw(st.floats(0.0, 1.0)),
        )
        for kind in kinds
    ]
    course = Course(motions, CENTRE)
    rng = np.random.default_rng(0)
    away = rng.normal(size=(5, 3))
    points = CENTRE + 0.1 * away / np.linalg.norm(away, axis=1)[:, None]
    step = 1e-4
    fastest = 0.0
    for start in rng.uniform(0.0, 4.0, 40):
        a, b = course.pose(start), course.pose(start + step)
        for point in points:
            fastest = max(fastest, float(np.linalg.norm(b * point - a * point)) / step)
    assert fastest <= course.speed(0.1) * (1.0 + 1e-6) + 1e-12


def test_a_turn_is_about_the_centre_and_a_move_along_the_base_frame():
    motion = Motion("shift", move=(0.0, 0.0, 0.004), turn=(0.0, 0.0, 0.5), period=2.0)
    T = Course([motion], CENTRE).pose(1.0)
    moved = T * CENTRE - CENTRE
    assert moved == pytest.approx([0.0, 0.0, 0.002])
    assert pin.log3(T.rotation) == pytest.approx([0.0, 0.0, 0.25])
    assert Course([motion], CENTRE).pose(50.0).translation == pytest.approx(
        Course([motion], CENTRE).pose(2.0).translation
    )


def test_a_motion_that_begins_later_rests_until_then():
    course = Course([Motion("knock", move=(0.003, 0.0, 0.0), after=1.0)], CENTRE)
    assert course.pose(0.99).isIdentity()
    assert course.pose(1.2).translation == pytest.approx([0.003, 0.0, 0.0])


def table(folder: Path, text: str) -> str:
    path = folder / "poses.csv"
    path.write_text(text, "utf-8")
    return str(path)


def test_poses_of_a_file_are_on_lines_and_steady_turns(tmp_path):
    turned = Rotation.from_rotvec([[0, 0, 0], [0.1, 0.2, -0.3]])
    (x, y, z, w) = turned.as_quat()[1]
    text = f"t,x,y,z,qw,qx,qy,qz\n1,0,0,0,1,0,0,0\n3,4,0,-2,{-w},{-x},{-y},{-z}\n"
    course = Course([Motion("poses", file=table(tmp_path, text))], np.zeros(3))
    T = course.pose(1.5)
    assert T.translation == pytest.approx([0.001, 0.0, -0.0005])
    assert T.rotation == pytest.approx(Slerp([1, 3], turned)(1.5).as_matrix())
    assert course.pose(0.0).translation == pytest.approx([0, 0, 0])
    assert course.pose(9.0).translation == pytest.approx([0.004, 0.0, -0.002])
    v = np.hypot(4.0, 2.0) * 1e-3 / 2.0
    rate = np.linalg.norm([0.1, 0.2, 0.3]) / 2.0
    assert course.speed(0.1) == pytest.approx(v + rate * 0.1)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("t,x,y\n0,0,0\n", "its columns must be t, x, y, z"),
        ("t,x,y,z\n0,0,0,0\n", "1 poses; there must be 2 to"),
        ("t,x,y,z\n0,0,0,0\n0,1,0,0\n", "the time 0 s does not follow"),
        ("t,x,y,z\n0,0,0,0\n1,nan,0,0\n", "line 3: 'nan' is not a finite number"),
        ("t,x,y,z\n0,0,0,0\n1,0,0\n", "line 3: 3 values, not 4"),
        ("t,x,y,z,qw,qx,qy,qz\n0,0,0,0,1,0,0,0\n1,0,0,0,2,0,0,0\n", "a quaternion of length 2"),
        ("", "not nothing"),
    ],
)
def test_a_table_that_is_not_understood_is_refused_by_name(tmp_path, text, told):
    with pytest.raises(OptionError, match=r"poses\.csv") as refusal:
        Course([Motion("poses", file=table(tmp_path, text))], CENTRE)
    assert told in str(refusal.value)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"kind": "sneeze"}, "choose one of breathing, heartbeat, shift, knock, poses"),
        ({"kind": "poses"}, "needs a file"),
        ({"kind": "knock", "file": "a.csv"}, "takes no file"),
        ({"kind": "poses", "file": "a.csv", "move": (0.1, 0.0, 0.0)}, "takes no move"),
        ({"kind": "shift", "period": 0.0}, "period 0 s is outside 0.02 s to 100000 s"),
        ({"kind": "shift", "move": (3.0, 0.0, 0.0)}, "more than 2 m"),
    ],
)
def test_a_motion_that_makes_no_sense_is_refused(options, told):
    with pytest.raises(OptionError) as refusal:
        Motion(**options)
    assert told in str(refusal.value)


def test_every_wave_has_a_usual_period():
    assert set(PERIODS) == set(WAVES) == set(waves.WAVES)
