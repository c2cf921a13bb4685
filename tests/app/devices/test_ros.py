"""Devices over ROS 2: conversions without it, a round trip where rclpy can be imported."""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from app.devices.remote.messages import Message
from app.devices.ros.conversion import COMMANDS, FEEDBACK, kind_of, quaternion, read, rows, write
from app.devices.ros.node import Topics
from app.kinds.links import Address
from app.session import Session
from app.settings import Options
from app.words import OptionError
from tests.support.counterparts import ROOT


def test_rotations_and_quaternions_are_those_of_pinocchio() -> None:
    rng = np.random.default_rng(3)
    turns = [*rng.normal(size=(200, 3)), [np.pi, 0, 0], [0, np.pi, 0], [0, 0, np.pi], [0, 0, 0]]
    for turn in turns:
        R = pin.exp3(np.array(turn, dtype=float))
        found = quaternion(R.tolist())
        assert np.linalg.norm(found) == pytest.approx(1.0)
        np.testing.assert_allclose(pin.Quaternion(np.array(found)).matrix(), R, atol=1e-12)
        np.testing.assert_allclose(rows(found), R, atol=1e-12)
    assert np.isnan(rows((0.0, 0.0, 0.0, 0.0))).all()


def made(kind: str) -> Any:
    """An object with the fields of a type, as far as they are used."""
    three, four = (
        (lambda: SimpleNamespace(x=0.0, y=0.0, z=0.0)),
        SimpleNamespace(x=0, y=0, z=0, w=1),
    )
    header = SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=0), frame_id="")
    fields: dict[str, Any] = {
        "JointState": {"position": []}, "Empty": {}, "String": {"data": ""},
        "PoseStamped": {"pose": SimpleNamespace(position=three(), orientation=four)},
        "WrenchStamped": {"wrench": SimpleNamespace(force=three(), torque=three())},
        "TwistStamped": {"twist": SimpleNamespace(linear=three(), angular=three())},
        "StringStamped": {"string": ""}, "Float64MultiArray": {"data": []},
        "OperatingState": {"state": "", "is_homed": False, "is_busy": False},
    }[kind.partition("/")[2]]  # fmt: skip
    if kind.endswith(("Stamped", "JointState", "OperatingState")):
        fields["header"] = header
    return SimpleNamespace(**fields)


@pytest.mark.parametrize("name", sorted({*FEEDBACK, *COMMANDS}))
def test_what_is_written_is_read_back(name: str) -> None:
    kind = kind_of(name)
    R = pin.exp3(np.array([0.3, -0.2, 1.0])).tolist()
    message = Message(name, text="enable", homed=True, frame="base")
    if kind.endswith(("JointState", "WrenchStamped", "TwistStamped", "Float64MultiArray")):
        message.numbers = [0.1, -0.2, 0.3, 0.4, 0.5, 0.6]
    if kind.endswith("PoseStamped"):
        message.rotation, message.translation = R, [0.1, 0.2, 0.3]
    back = read(name, write(message, made, SimpleNamespace(sec=7, nanosec=500_000_000)), at=3.0)
    assert (back.name, back.at) == (name, 3.0)
    if kind.endswith(("JointState", "WrenchStamped")):
        assert back.numbers == message.numbers
    if kind.endswith("PoseStamped"):
        assert (back.translation, back.frame) == (message.translation, "base")
        np.testing.assert_allclose(back.rotation, R, atol=1e-12)
    if kind.endswith(("String", "StringStamped", "OperatingState")):
        assert back.text == "enable"
    if back.stamp is not None:
        assert back.stamp == 7.5


def test_what_is_not_valid_has_the_stamp_zero() -> None:
    message = Message("measured_js", numbers=[1.0], valid=False)
    back = read("measured_js", write(message, made, SimpleNamespace(sec=7, nanosec=0)), 0.0)
    assert back.stamp == 0.0


def has_rclpy() -> str:
    """Why there is no rclpy; empty: there is."""
    try:
        importlib.import_module("rclpy")
        importlib.import_module("sensor_msgs.msg")
    except ImportError as error:
        return str(error).splitlines()[0]
    return ""


@pytest.mark.skipif(not has_rclpy(), reason="rclpy is installed")
def test_without_rclpy_it_is_refused_with_the_reason() -> None:
    with pytest.raises(OptionError, match=r"rclpy cannot be imported .*source a ROS 2"):
        Topics(Address("ros", path="PSM1"), "arm")


@pytest.mark.skipif(bool(has_rclpy()), reason=f"rclpy: {has_rclpy()}")
def test_a_round_trip_over_ros(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "77")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    options = Options(
        mesh="sphere", robot="psm", standoff=1e-4, arm="ros:/PSM1?age=500ms",
        master="ros:/GUARD?age=500ms",
    )  # fmt: skip
    with Session(options, process=True) as session:
        done = subprocess.run(
            [sys.executable, "-m", "tests.support.ros_peer", "/PSM1", "/GUARD"],
            capture_output=True, text=True, timeout=120, cwd=ROOT, env=dict(os.environ),
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        said = json.loads(done.stdout.splitlines()[-1])
        assert said["goals"] >= 400, (said, session.devices)
        assert said["state"] == "ENABLED"
        assert said["frame"] == "base"
        assert said["largest"] < 0.1
        assert "force" in said
        assert session.crossing is None
