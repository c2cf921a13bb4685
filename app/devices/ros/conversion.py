"""Messages of CRTK as messages of ROS 2, and back; on any objects that have the fields."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from app.devices.remote.messages import Message

KINDS = {
    "js": "sensor_msgs/JointState", "jp": "sensor_msgs/JointState",
    "cp": "geometry_msgs/PoseStamped", "cv": "geometry_msgs/TwistStamped",
    "cf": "geometry_msgs/WrenchStamped", "hold": "std_msgs/Empty", "free": "std_msgs/Empty",
    "state_command": "crtk_msgs/StringStamped", "operating_state": "crtk_msgs/OperatingState",
    "error": "std_msgs/String", "warning": "std_msgs/String", "status": "std_msgs/String",
    "period_statistics": "std_msgs/Float64MultiArray", "clutch": "sensor_msgs/Joy",
}  # fmt: skip
"""By the end of a topic's name: the type of its messages."""
FEEDBACK = (
    "measured_js", "setpoint_js", "measured_cp", "setpoint_cp", "measured_cv", "operating_state",
    "period_statistics", "jaw/measured_js", "jaw/setpoint_js", "error", "warning", "status",
)  # fmt: skip
COMMANDS = (
    "servo_cp", "servo_jp", "move_cp", "move_jp", "interpolate_cp", "interpolate_jp",
    "jaw/servo_jp", "hold", "free", "state_command", "body/servo_cf",
)  # fmt: skip
HAND = ("measured_cp", "clutch", "operating_state")


def kind_of(name: str) -> str:
    """The type of a topic."""
    last = name.rpartition("/")[2]
    return KINDS.get(last) or KINDS[last.rpartition("_")[2]]


def read(name: str, ros: Any, at: float) -> Message:
    """What a message of ROS says; it is checked later."""
    message = Message(name, at=at)
    header = getattr(ros, "header", None)
    if header is not None:
        message.stamp = header.stamp.sec + 1e-9 * header.stamp.nanosec
        message.frame = str(header.frame_id)
    kind = kind_of(name)
    if kind.endswith("JointState"):
        message.numbers = [float(x) for x in ros.position]
    elif kind.endswith("PoseStamped"):
        p, turn = ros.pose.position, ros.pose.orientation
        message.translation = [p.x, p.y, p.z]
        message.rotation = rows((turn.x, turn.y, turn.z, turn.w))
    elif kind.endswith("WrenchStamped"):
        f, t = ros.wrench.force, ros.wrench.torque
        message.numbers = [f.x, f.y, f.z, t.x, t.y, t.z]
    elif name == "operating_state":
        message.text = str(getattr(ros, "state", getattr(ros, "data", "")))
        message.homed = bool(getattr(ros, "is_homed", True))
        message.busy = bool(getattr(ros, "is_busy", False))
    elif kind.endswith("Joy"):  # as the dVRK's pedals
        message.pressed = any(ros.buttons)
        message.text = "" if message.pressed else "released"
    elif hasattr(ros, "string") or hasattr(ros, "data"):
        message.text = str(getattr(ros, "string", getattr(ros, "data", "")))
    return message


def write(message: Message, make: Callable[[str], Any], stamp: Any) -> Any:
    """The message of ROS.

    Args:
        make: a new object of a type of `KINDS`.
        stamp: the time that goes into its header.
    """
    kind = kind_of(message.name)
    ros = make(kind)
    if hasattr(ros, "header"):
        if message.valid:
            ros.header.stamp = stamp
        ros.header.frame_id = message.frame
    numbers: Any = message.numbers
    if kind.endswith("JointState"):
        ros.position = [float(x) for x in numbers]
    elif kind.endswith("PoseStamped"):
        p, turn = ros.pose.position, ros.pose.orientation
        p.x, p.y, p.z = message.translation  # type: ignore[misc]
        turn.x, turn.y, turn.z, turn.w = quaternion(message.rotation)
    elif kind.endswith("WrenchStamped"):
        f, t = ros.wrench.force, ros.wrench.torque
        f.x, f.y, f.z, t.x, t.y, t.z = numbers
    elif kind.endswith("TwistStamped"):
        v, w = ros.twist.linear, ros.twist.angular
        v.x, v.y, v.z, w.x, w.y, w.z = numbers
    elif kind.endswith("Float64MultiArray"):
        ros.data = [float(x) for x in numbers]
    elif hasattr(ros, "state"):
        ros.state = message.text
        ros.is_homed, ros.is_busy = message.homed, message.busy
    elif hasattr(ros, "string"):
        ros.string = message.text
    elif hasattr(ros, "data"):
        ros.data = message.text
    return ros


def rows(turn: Sequence[float]) -> list[list[float]]:
    """Rows of the rotation of a quaternion x, y, z, w; nan where it has no length."""
    length = math.sqrt(sum(x * x for x in turn))
    if not 0.9 < length < 1.1:
        return [[math.nan] * 3] * 3
    x, y, z, w = (v / length for v in turn)
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]


def quaternion(R: Any) -> tuple[float, float, float, float]:
    """Quaternion x, y, z, w of the rows of a rotation."""
    trace = R[0][0] + R[1][1] + R[2][2]
    # From the largest of the four, so that nothing small is divided by.
    squares = [R[0][0], R[1][1], R[2][2], trace]
    k = squares.index(max(squares))
    if k == 3:
        s = 2.0 * math.sqrt(1.0 + trace)
        return (R[2][1] - R[1][2]) / s, (R[0][2] - R[2][0]) / s, (R[1][0] - R[0][1]) / s, s / 4.0
    i, j = (k + 1) % 3, (k + 2) % 3
    s = 2.0 * math.sqrt(1.0 + R[k][k] - R[i][i] - R[j][j])
    found = [0.0] * 4
    found[k] = s / 4.0
    found[i] = (R[i][k] + R[k][i]) / s
    found[j] = (R[j][k] + R[k][j]) / s
    found[3] = (R[j][i] - R[i][j]) / s
    return found[0], found[1], found[2], found[3]
