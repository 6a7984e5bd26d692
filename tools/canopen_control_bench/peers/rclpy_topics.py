"""Other ROS programs for the figures of the bridge: one publishes only, one listens and sends commands.

`python -m canopen_control_bench.peers.rclpy_topics publish` publishes a JointState of two joints, an Odometry and a
TFMessage below /plain with one timer of rclpy at 50 Hz. `... listen` subscribes to those and to the bridge's, and
serves orders on standard input: "counts" tells how many have come, {"command": n, "hz": f} publishes so many Twists.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from functools import partial
from typing import TYPE_CHECKING, Any

from canopen_control.ros.installation import from_wheels, prepare
from canopen_control_bench.turns import say

if TYPE_CHECKING:
    from collections.abc import Mapping


HZ = 50.0
KINDS = {
    "joint_states": "sensor_msgs/msg/JointState",
    "odom": "nav_msgs/msg/Odometry",
    "tf": "tf2_msgs/msg/TFMessage",
}
TOPICS = {
    "bridge": {"joint_states": "/joint_states", "odom": "/robby_base_controller/odom", "tf": "/tf"},
    "plain": {"joint_states": "/plain/joint_states", "odom": "/plain/odom", "tf": "/plain/tf"},
}
COMMANDS = "/robby_base_controller/cmd_vel_unstamped"


def main(arguments: list[str]) -> int:
    """Run the program named by the first argument until standard input ends."""
    prepare(os.environ, wheels=from_wheels(), prefix=sys.prefix)
    from canopen_control.ros.rcl import single_threaded_executor, start

    what = arguments[0]
    context, node = start(f"bench_{what}", "", [])
    executor = single_threaded_executor(context)
    executor.add_node(node)
    serve = _ROLES[what](node)
    ended = threading.Event()

    def orders() -> None:
        for line in sys.stdin:
            say(serve(json.loads(line)))
        ended.set()

    threading.Thread(target=orders, daemon=True).start()
    say({"ready": True})
    while not ended.is_set():
        executor.spin_once(timeout_sec=0.5)
    os._exit(0)  # the rest is rclpy's own teardown


def _publish(node: Any) -> Any:  # noqa: ANN401 - rclpy's, without types
    from canopen_control.ros.interfaces import interface

    publishers = {key: node.create_publisher(interface(KINDS[key]), name, 10) for key, name in TOPICS["plain"].items()}
    joints, odometry, tf = (interface(KINDS[key])() for key in KINDS)
    joints.name, joints.position, joints.velocity = ["left", "right"], [1.0, 2.0], [3.0, 4.0]
    transform = interface("geometry_msgs/msg/TransformStamped")
    tf.transforms = [transform(child_frame_id=name) for name in ("left", "right", "base_link")]

    def tick() -> None:
        now = node.get_clock().now().to_msg()
        joints.header.stamp = odometry.header.stamp = now
        for stamped in tf.transforms:
            stamped.header.stamp = now
        for key, message in zip(KINDS, (joints, odometry, tf), strict=True):
            publishers[key].publish(message)

    node.create_timer(1 / HZ, tick)
    return lambda _order: {}


def _listen(node: Any) -> Any:  # noqa: ANN401 - rclpy's, without types
    from canopen_control.ros.interfaces import interface

    counts = {who: dict.fromkeys(topics, 0) for who, topics in TOPICS.items()}

    def count(who: str, key: str, _message: object) -> None:
        counts[who][key] += 1

    for who, topics in TOPICS.items():
        for key, name in topics.items():
            node.create_subscription(interface(KINDS[key]), name, partial(count, who, key), 10)
    twist = interface("geometry_msgs/msg/Twist")
    publisher = node.create_publisher(twist, COMMANDS, 10)

    def serve(order: Any) -> Mapping[str, object]:  # noqa: ANN401 - as JSON has it
        if order == "counts":
            return counts
        for _ in range(order["command"]):
            time.sleep(1 / order["hz"])
            message = twist()
            message.linear.x = time.monotonic()
            publisher.publish(message)
        time.sleep(0.2)  # the last message is in transit
        return {"published": order["command"]}

    return serve


_ROLES = {"publish": _publish, "listen": _listen}


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
