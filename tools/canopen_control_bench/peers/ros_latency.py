"""An rclpy program that commands joints by topic and receives joint states, with a listener on the bus.

    python -m canopen_control_bench.peers.ros_latency CHANNEL COMMANDS ROUNDS

It answers {"commands": [[ms...]...], "states": [ms...]}.
"""

from __future__ import annotations

import json
import select
import struct
import sys
import threading
import time

import rclpy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from canopen_control.bus.channel import open_port
from canopen_control.frame import frames_of
from canopen_control_bench.fleet import CONTROLLER, FIRST_NODE, SCALE
from canopen_control_bench.latency import command_latencies

STATES_S = 8.0
_PAIR = struct.Struct("<ii")
_TIMEOUT_S = 20.0


def main() -> None:
    """Measure, and print the results."""
    channel, count, rounds = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    rclpy.init()
    node = rclpy.create_node("bench_latency")
    publisher = node.create_publisher(Float64MultiArray, f"/{CONTROLLER}/commands", 1)
    end = time.monotonic() + _TIMEOUT_S
    while not publisher.get_subscription_count():
        if time.monotonic() > end:
            raise SystemExit("the bridge does not listen to the commands")
        time.sleep(0.05)

    def command(value: float) -> None:
        publisher.publish(Float64MultiArray(data=[value, value]))

    command_latencies(channel, command, 50)  # the first messages wake idle threads
    commands = [command_latencies(channel, command, count) for _ in range(rounds)]
    states = state_latencies(node, channel)
    sys.stdout.write(json.dumps({"commands": commands, "states": states}) + "\n")
    sys.stdout.flush()
    node.destroy_node()  # type: ignore[no-untyped-call]  # rclpy leaves it untyped
    rclpy.shutdown()


def state_latencies(node: rclpy.node.Node, channel: str) -> list[float]:
    """Return the time from each position on the wire to its joint state, in ms; the joints are turning."""
    first_seen: dict[int, int] = {}
    found: list[float] = []
    ended = threading.Event()

    def listen() -> None:
        port = open_port(channel, label="listener")
        while not ended.is_set():
            if select.select([port], [], [], 0.1)[0]:
                records, now = port.receive(), time.monotonic_ns()
                for frame in frames_of(records):
                    if frame.can_id == 0x280 + FIRST_NODE:
                        first_seen.setdefault(_PAIR.unpack(frame.data)[0], now)
        port.close()

    def on_state(message: JointState) -> None:
        now = time.monotonic_ns()
        position = round(message.position[list(message.name).index("joint_drive_1")] * SCALE)
        if position in first_seen:
            found.append((now - first_seen[position]) / 1e6)

    node.create_subscription(JointState, "/joint_states", on_state, 1)
    listener = threading.Thread(target=listen)
    listener.start()
    end = time.monotonic() + STATES_S
    while time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=0.1)
    ended.set()
    listener.join()
    return found[len(found) // 10 :]


if __name__ == "__main__":
    main()
