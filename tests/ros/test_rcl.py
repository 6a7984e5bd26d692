from __future__ import annotations

import pytest
from support.ros import run_ros

pytestmark = pytest.mark.ros


def test_a_node_starts_in_its_namespace_and_signals_stay_ours():
    code = """
import signal
before = signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)
from canopen_control.ros.rcl import start
context, node = start("bridge", "robby", ["--ros-args", "-r", "chatter:=talk"])
assert node.get_fully_qualified_name() == "/robby/bridge"
assert node.resolve_topic_name("chatter") == "/robby/talk"
assert (signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)) == before
context.shutdown()
"""
    assert run_ros(code) == ""


def test_the_executor_is_the_events_executor_or_a_single_threaded_one():
    code = """
import sys
from canopen_control.ros import rcl
context, node = rcl.start("bridge", "", [])
assert type(rcl.make_executor(context)).__name__ == "EventsExecutor"
sys.modules["rclpy.experimental.events_executor"] = None  # an rclpy that has none
assert type(rcl.make_executor(context)).__name__ == "SingleThreadedExecutor"
context.shutdown()
"""
    assert run_ros(code) == ""
