#!/usr/bin/env bash
# rclpy 7.1.6 (ROS 2 Jazzy, PyPI package ros-jazzy-rclpy) and the order of functions given to Executor.create_task.
#
# Input: five functions are given to an executor one after the other, before it spins. Each notes its number.
# Seen: EventsExecutor runs them as 0 1 2 3 4, SingleThreadedExecutor as 4 3 2 1 0: the newest first.
# One would guess that both run them in the order in which they were given.
# Why it matters: create_task is the way from another thread to the thread of the callbacks. "Send the result, then end"
# ends first, and the result is lost; it works with the one executor and fails with the other.
# Exit code 0 while that is so, 1 when it has changed, 2 when the package cannot be installed.
set -u
folder=$(mktemp -d) || exit 2
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv" && "$folder/venv/bin/pip" install -q "ros-jazzy-rclpy[fastrtps]==7.1.6" 2>/dev/null || exit 2

ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST ROS_LOG_DIR="$folder" "$folder/venv/bin/python" - <<'PYTHON'
import importlib.metadata
import sys
import time

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.experimental.events_executor import EventsExecutor

rclpy.init()
orders = {}
for kind in (EventsExecutor, SingleThreadedExecutor):
    order = orders[kind.__name__] = []
    executor = kind()
    for number in range(5):
        executor.create_task(order.append, number)
    deadline = time.monotonic() + 10.0
    while len(order) < 5 and time.monotonic() < deadline:
        executor.spin_once(timeout_sec=0.1)
    executor.shutdown()
rclpy.shutdown()
print(f"rclpy {importlib.metadata.version('ros-jazzy-rclpy')}: {orders}")
sys.exit(orders != {"EventsExecutor": [0, 1, 2, 3, 4], "SingleThreadedExecutor": [4, 3, 2, 1, 0]})
PYTHON
