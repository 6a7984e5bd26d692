from __future__ import annotations

import pytest
from support.ros import domain, run_ros

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


FURTHER = """
from canopen_control.ros.rcl import further_node, start
from std_msgs.msg import String
arguments = ["--ros-args", "-r", "__node:=first", "-r", "chatter:=/all", "-p", "use_sim_time:=false"]
context, node = start("bridge", "two", arguments)
own = further_node("base", context, node.get_namespace(), ["--ros-args", "-r", "~/cmd_vel:=/cmd_vel"])
names = [each.get_fully_qualified_name() for each in (node, own)]
topics = [own.create_publisher(String, name, 1).topic_name for name in ("base/cmd_vel", "chatter", "base/odom")]
print(names, topics, sorted(name for name, _ in own.get_service_names_and_types_by_node("base", "/two")))
try:
    further_node("no-node", context, "/two")
except Exception as error:
    print(type(error).__name__)
"""


def test_a_further_node_keeps_its_name_and_has_remappings_of_its_own_alongside_those_of_all():
    with domain() as number:
        names, error = run_ros(FURTHER, number).splitlines()
    assert names == "['/two/first', '/two/base'] ['/cmd_vel', '/all', '/two/base/odom'] []"
    assert error == "InvalidNodeNameException"
