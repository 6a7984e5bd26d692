from __future__ import annotations

import pytest
from support.ros import domain, run_ros

pytestmark = pytest.mark.ros

#: A server whose goals are judged by the test, and its client, in one process
SCENE = """
import time, uuid
from canopen_control.ros import rcl
from canopen_control.ros.action_goals import AsyncActionServer
from canopen_control.ros.endpoint import ActionClients
from canopen_control.ros.interfaces import interface
from canopen_control.ros.rcl import Spinner
from rclpy.action import ActionClient
from unique_identifier_msgs.msg import UUID
Follow = interface("control_msgs/action/FollowJointTrajectory")
context, node = rcl.start("server", "", [])
errors, requests, cancelled, lost = [], [], [], []
spinner = Spinner(node, context, errors.append)
server = AsyncActionServer(node, Follow, "follow", requests.append, cancelled.append, lost.append)
client = ActionClient(node, Follow, "follow")
spinner.start()
assert client.wait_for_server(20)
def until(condition):
    end = time.monotonic() + 20
    while not condition():
        assert time.monotonic() < end, (errors, requests)
        time.sleep(0.005)
def send(number=1):
    return client.send_goal_async(Follow.Goal(), goal_uuid=UUID(uuid=[number] * 16))
"""
END = """
spinner.call(server.destroy)
spinner.stop(5)
context.shutdown()
assert errors == [], errors
"""


def expect_passes(code):
    with domain() as number:
        run_ros(SCENE + code + END, number)


def test_goals_are_accepted_later_and_ended_elsewhere_without_spinning():
    expect_passes("""
future = send()
until(lambda: requests)
begin, used = time.monotonic(), time.process_time()
time.sleep(0.2)
assert time.process_time() - used < 0.12, "something spins while the goal is judged"
assert not future.done()
assert requests[0].client in ActionClients(node, "/follow").present()
spinner.call(lambda: server.answer(requests[0].uuid, None))
until(future.done)
handle = future.result()
assert handle.accepted
result = handle.get_result_async()
used = time.process_time()
time.sleep(0.2)
assert time.process_time() - used < 0.12, "something spins while the goal is followed"
assert server.handle_of(requests[0].uuid).is_active
done = Follow.Result(error_code=0, error_string="well")
spinner.call(lambda: server.finish(requests[0].uuid, "succeeded", done))
until(result.done)
assert (result.result().status, result.result().result.error_string) == (4, "well")
spinner.call(lambda: server.finish(requests[0].uuid, "aborted", done))  # it has ended
spinner.call(lambda: server.finish(b"nobody", "aborted", done))
again = send()
until(again.done)
assert not again.result().accepted
assert len(requests) == 1
""")


def test_a_refused_goal_has_a_result_and_a_goal_that_was_not_cancelled_is_aborted():
    expect_passes("""
from canopen_control.ros import action_goals
action_goals._MAX_RESULTS = 2
handles = []
for number in range(3):
    future = send(number)
    until(lambda: len(requests) == number + 1)
    refusal = Follow.Result(error_code=-2, error_string=f"no {number}")
    spinner.call(lambda: server.answer(requests[-1].uuid, refusal))
    until(future.done)
    assert not future.result().accepted
    handles.append(future.result())
results = [each.get_result_async() for each in handles]
until(lambda: all(each.done() for each in results))
told = [(each.result().status, each.result().result.error_code, each.result().result.error_string) for each in results]
assert told == [(0, 0, ""), (6, -2, "no 1"), (6, -2, "no 2")], told
requests.clear()
for number, asks in ((1, False), (2, True)):
    future = send(10 + number)
    until(lambda: len(requests) == number)
    spinner.call(lambda: server.answer(requests[-1].uuid, None))
    until(future.done)
    if asks:
        cancel = future.result().cancel_goal_async()
        until(cancel.done)
        assert cancelled == [requests[-1].uuid]
    result = future.result().get_result_async()
    spinner.call(lambda: server.finish(requests[-1].uuid, "canceled", Follow.Result()))
    until(result.done)
    assert result.result().status == (5 if asks else 6)
""")
