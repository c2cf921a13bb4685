"""Exports a recording as MCAP with standard ROS 2 messages, for Foxglove, rosbag2 and others."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

import robots
import vf
from app.control.messages import STATES
from app.recording.export.messages import TYPES, Cdr
from app.recording.format import MEASURED, Recording, RecordingError

if TYPE_CHECKING:
    from mcap.writer import Writer

BASE, TIP = "base", "tip"
TOPICS = {
    "setpoint_js": ("sensor_msgs/msg/JointState", "joints after the tick"),
    "setpoint_cp": ("geometry_msgs/msg/PoseStamped", "pose of the tip after the tick"),
    "measured_js": ("sensor_msgs/msg/JointState", "joints that the arm measured before it"),
    "operating_state": ("std_msgs/msg/String", "that of an arm that is elsewhere"),
    "goal_point": ("geometry_msgs/msg/PointStamped", "the proxy, where there is one"),
    "body/servo_cf": ("geometry_msgs/msg/WrenchStamped", "force on the hand, base frame"),
    "status": ("std_msgs/msg/String", "outcome of the tick"),
    "distance": ("std_msgs/msg/Float64", "to the nearest plane's closest point [m]"),
    "clutch": ("std_msgs/msg/Bool", "whether the clutch is pressed"),
}
"""By topic, below the robot's name: type and meaning. ``/tf`` has the tip besides."""


def write(recording: Recording, path: Path) -> int:
    """Write the ticks of a recording as MCAP; returns how many messages that are.

    Poses are in the arm's base frame, named ``base``. Times count from the recording's first tick.

    Raises:
        RecordingError: the file exists.
        ImportError: the package `mcap` is not installed.
        OSError: it cannot be written.
    """
    from mcap.writer import Writer

    if path.exists():
        raise RecordingError(f"{path} exists already: choose another name")
    arms = [robots.load(place.options.robot) for place in recording.places]
    with path.open("xb") as file:
        writer = Writer(file)
        writer.start("ros2", "vf-sandbox")
        bag = _Bag(writer)
        first = float(recording.rows["tick"][0]) if len(recording.rows) else 0.0
        for row in recording.rows[recording.rows["ticked"] > 0]:
            order = recording.orders[row["order"]]
            place = recording.plants[order["plant"]][0]
            at = (float(row["tick"]) - first) * recording.dt
            bag.tick(arms[place], row, order, len(recording.places[place].start), max(at, 0.0))
        writer.finish()
    return bag.count


class _Bag:
    """The channels of a file, made when they are first used.

    Attributes:
        count: messages so far.
    """

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self.count = 0

    def tick(self, arm: robots.Arm, row: Any, order: Any, n: int, at: float) -> None:
        """Write the messages of one tick; n joints, at this time [s]."""
        q = np.array(row["q"][:n])
        pose = arm.tip(q)
        turn = pin.Quaternion(pose.rotation).coeffs().tolist()  # x, y, z, w
        p = pose.translation.tolist()

        def put(topic: str, message: Cdr) -> None:
            self._put(f"/{arm.name}/{topic}", TOPICS[topic][0], message, at)

        put("setpoint_js", _joints(arm, q, at))
        if row["sensed"] == MEASURED:
            put("measured_js", _joints(arm, row["measured"][:n], at))
        if order["state"]:
            put("operating_state", Cdr().text(STATES[int(order["state"])]))
        put("setpoint_cp", Cdr().header(at, BASE).f64(*p, *turn))
        tf = Cdr().u32(1).header(at, BASE).text(TIP).f64(*p, *turn)
        self._put("/tf", "tf2_msgs/msg/TFMessage", tf, at)
        if row["driven"]:
            put("goal_point", Cdr().header(at, BASE).f64(*row["target"].tolist()))
        if row["stepped"]:
            force = row["force"].tolist()
            put("body/servo_cf", Cdr().header(at, BASE).f64(*force, 0.0, 0.0, 0.0))
            put("status", Cdr().text(vf.Status(int(row["status"])).name))
            put("distance", Cdr().f64(float(row["distance"])))
        put("clutch", Cdr().flag(bool(order["clutch"])))

    def _put(self, topic: str, kind: str, message: Cdr, at: float) -> None:
        if topic not in self._channels:
            if kind not in self._schemas:
                self._schemas[kind] = self._writer.register_schema(
                    kind, "ros2msg", TYPES[kind].encode()
                )
            self._channels[topic] = self._writer.register_channel(topic, "cdr", self._schemas[kind])
        time = round(at * 1e9)
        self._writer.add_message(self._channels[topic], time, message.bytes(), time)
        self.count += 1


def _joints(arm: robots.Arm, q: Any, at: float) -> Cdr:
    """A JointState of joints (n,) at this time [s]."""
    js = Cdr().header(at, BASE).u32(len(q))
    for joint in arm.joints:
        js.text(joint)
    return js.list_f64(q.tolist()).list_f64(()).list_f64(())
