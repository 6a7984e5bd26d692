"""An rclpy program that counts what arrives of joint states, odometry and transforms.

python -m canopen_control.bench.peers.ros_count SECONDS ROUNDS      each round: "begin", then {topic: count}
"""

from __future__ import annotations

import json
import sys
import time
from typing import TYPE_CHECKING

import rclpy
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState

from canopen_control.bench.fleet import CONTROLLER
from canopen_control.ros.interfaces import interface

if TYPE_CHECKING:
    from collections.abc import Callable

TOPICS: dict[str, type] = {
    "/joint_states": JointState,
    f"/{CONTROLLER}/odom": Odometry,
    "/tf": interface("tf2_msgs/msg/TFMessage"),
}
_PATIENCE_S = 20.0


def main() -> None:
    """Wait until all topics have come, then count."""
    seconds, rounds = float(sys.argv[1]), int(sys.argv[2])
    rclpy.init()
    node = rclpy.create_node("bench_count")
    counts = dict.fromkeys(TOPICS, 0)

    def counter(topic: str) -> Callable[[object], None]:
        def count(_message: object) -> None:
            counts[topic] += 1

        return count

    for topic, kind in TOPICS.items():
        node.create_subscription(kind, topic, counter(topic), 10)
    _spin(node, lambda: all(counts.values()), _PATIENCE_S)
    if not all(counts.values()):
        raise SystemExit(f"nothing came of {[topic for topic, count in counts.items() if not count]}")
    for _ in range(rounds):
        counts.update(dict.fromkeys(TOPICS, 0))
        _say("begin")
        _spin(node, lambda: False, seconds)
        _say(json.dumps(counts))
    node.destroy_node()  # type: ignore[no-untyped-call]  # rclpy leaves it untyped
    rclpy.shutdown()


def _spin(node: rclpy.node.Node, ended: Callable[[], bool], seconds: float) -> None:
    end = time.monotonic() + seconds
    while time.monotonic() < end and not ended():
        rclpy.spin_once(node, timeout_sec=0.05)


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
