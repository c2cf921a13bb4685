"""A stand-in for an arm and a console over ROS 2, for a process of its own; it needs rclpy.

    python -m tests.support.ros_peer /PSM1 /GUARD

Prints ``moved N`` when the arm took N set-points, and ends with the guard's feedback as JSON.
"""

from __future__ import annotations

import itertools
import json
import math
import sys
import time

import rclpy
from geometry_msgs.msg import PoseStamped, WrenchStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import String


def main(arm: str, guard: str) -> None:
    rclpy.init()
    node = rclpy.create_node("peer")
    q = [0.02, 0.01, 0.12, 0.1, 0.0, 0.0]
    heard: dict[str, object] = {}
    goals: list[list[float]] = []
    start: list[PoseStamped] = []

    def servo(message: JointState) -> None:
        goals.append(list(message.position))

    def setpoint(message: PoseStamped) -> None:
        heard["frame"] = message.header.frame_id
        if heard.get("state") == "ENABLED" and not start:
            start.append(message)

    node.create_subscription(JointState, f"{arm}/servo_jp", servo, 10)
    node.create_subscription(PoseStamped, f"{guard}/setpoint_cp", setpoint, 10)
    node.create_subscription(
        String, f"{guard}/operating_state", lambda m: heard.update(state=m.data), 10
    )
    node.create_subscription(
        WrenchStamped, f"{guard}/body/servo_cf", lambda m: heard.update(force=m.wrench.force.z), 10
    )
    measured = node.create_publisher(JointState, f"{arm}/measured_js", 10)
    command = node.create_publisher(String, f"{guard}/state_command", 10)
    servo_cp = node.create_publisher(PoseStamped, f"{guard}/servo_cp", 10)
    until, asked, told = time.monotonic() + 60.0, 0.0, 0
    while time.monotonic() < until and len(goals) < 400:
        rclpy.spin_once(node, timeout_sec=0.002)
        now = time.monotonic()
        if goals:
            q = [a + 0.3 * (b - a) for a, b in zip(q, goals[-1], strict=True)]
        js = JointState()
        js.header.stamp = node.get_clock().now().to_msg()
        js.position = q
        measured.publish(js)
        if heard.get("state") == "DISABLED" and now - asked > 0.5:
            asked = now
            command.publish(String(data="enable"))
        if start:
            goal = PoseStamped()
            goal.header.stamp = node.get_clock().now().to_msg()
            goal.header.frame_id = start[0].header.frame_id
            goal.pose.orientation = start[0].pose.orientation
            p, at = start[0].pose.position, goal.pose.position
            at.x, at.y, at.z = p.x + 0.004 * math.sin(3.0 * now), p.y, p.z
            servo_cp.publish(goal)
            if told == 0:
                start[0].pose.position.x -= 0.004 * math.sin(3.0 * now)
            told += 1
    largest = max((abs(b - a) for one, two in itertools.pairwise(goals)
                   for a, b in zip(one, two, strict=True)), default=0.0)  # fmt: skip
    print(json.dumps({"goals": len(goals), "largest": largest, **heard}), flush=True)
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
