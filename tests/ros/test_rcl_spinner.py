from __future__ import annotations

import pytest
from support.ros import domain, run_ros

pytestmark = pytest.mark.ros

START = """
import os, sys, threading
from std_msgs.msg import String
from canopen_control.ros import rcl
from canopen_control.ros.rcl import Spinner
if len(sys.argv) > 1:
    sys.modules["rclpy.experimental.events_executor"] = None
context, node = rcl.start("spun", "", [])
errors, got, enough, failed = [], [], threading.Event(), threading.Event()
spinner = Spinner(node, context, lambda error: (errors.append(error), failed.set()))
"""


@pytest.mark.parametrize("fallback", [[], ["single-threaded"]])
def test_callbacks_come_in_one_thread_and_an_exception_of_one_ends_nothing(fallback):
    code = (
        START
        + """
def callback(message):
    got.append((message.data, threading.current_thread().name))
    if message.data == "bad":
        raise ValueError("no")
    if message.data == "last":
        enough.set()
node.create_subscription(String, "chatter", callback, 10)
publisher = node.create_publisher(String, "chatter", 10)
spinner.start()
for text in ("good", "bad"):
    publisher.publish(String(data=text))
assert failed.wait(60), got
publisher.publish(String(data="last"))
assert enough.wait(60), got
assert spinner.stop(5)
assert [text for text, _ in got] == ["good", "bad", "last"]
assert {name for _, name in got} == {"ros"}
assert [str(error) for error in errors] == ["no"], errors
context.shutdown()
"""
    )
    with domain() as number:
        assert run_ros(code, number, fallback) == ""


def test_a_function_is_run_between_callbacks():
    code = (
        START
        + """
spinner.start()
spinner.call(lambda: (got.append(threading.current_thread().name), enough.set()))
assert enough.wait(60)
assert got == ["ros"]
assert spinner.stop(5)
context.shutdown()
"""
    )
    assert run_ros(code) == ""


@pytest.mark.parametrize("fallback", [[], ["single-threaded"]])
def test_functions_that_were_called_before_the_stop_are_run(fallback):
    code = (
        START
        + """
spinner.start()
spinner.call(lambda: (enough.set(), failed.wait(60)))
assert enough.wait(60)
for number in range(50):
    spinner.call(lambda number=number: got.append(number))
threading.Timer(0.1, failed.set).start()
assert spinner.stop(60)
assert got == list(range(50)), got
context.shutdown()
"""
    )
    with domain() as number:
        assert run_ros(code, number, fallback) == ""


def test_a_callback_that_hangs_is_not_waited_for():
    code = (
        START
        + """
release = threading.Event()
spinner.start()
spinner.call(lambda: (enough.set(), release.wait(60)))
assert enough.wait(60)
assert not spinner.stop(0.01)
os._exit(0)  # as the bridge does then
"""
    )
    assert run_ros(code) == ""
