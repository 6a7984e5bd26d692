from __future__ import annotations

from types import SimpleNamespace

import pytest
from support import endpoints
from support.ros import domain, run_ros

from canopen_control.ros.endpoint import Endpoint, success_of


def test_an_endpoint_takes_everything_and_cares_for_nothing():
    endpoint = Endpoint(None)
    assert endpoint.on_state({}) is endpoint.on_event({}) is endpoint.on_controller(None) is None
    assert endpoint.on_process_data({}) is endpoint.close() is None


def test_an_endpoint_destroys_all_that_it_has_created_once():
    ros = endpoints.Ros()
    endpoint = Endpoint(ros)
    publisher = endpoint.publisher(str, "told", None)
    endpoint.subscribe(str, "heard", None, None)
    endpoint.serve("std_srvs/srv/Empty", "asked", None)
    endpoint.close()
    assert ros.left == ["asked", "heard", publisher]
    endpoint.close()
    assert len(ros.left) == 3


def test_an_error_of_a_topic_is_reported_and_no_error_is_not():
    ros = endpoints.Ros()
    Endpoint(ros).report("heard", "it is off")
    Endpoint(ros).report("heard", None)
    assert ros.collected == ["heard: it is off"]


pytestmark = pytest.mark.ros


@pytest.mark.parametrize("fallback", [[], ["single-threaded"]])
def test_a_later_answer_of_another_thread_arrives_and_the_ones_behind_it_do_not_wait(fallback):
    code = """
import sys, threading
from std_srvs.srv import SetBool
from canopen_control.ros import rcl
from canopen_control.ros.endpoint import serve
from canopen_control.ros.rcl import Spinner
if len(sys.argv) > 1:
    sys.modules["rclpy.experimental.events_executor"] = None
context, node = rcl.start("server", "", [])
release, answered = threading.Event(), []

def handler(request, response, reply):
    response.message = threading.current_thread().name
    if request.data:
        reply(response)
    else:
        threading.Thread(target=lambda: (release.wait(60), reply(response))).start()

serve(node, SetBool, "switch", handler)
spinner = Spinner(node, context, print)
spinner.start()
other, client_node = rcl.start("client", "", [])
client = client_node.create_client(SetBool, "switch")
asking = Spinner(client_node, other, print)
asking.start()
assert client.wait_for_service(20)
done = {False: threading.Event(), True: threading.Event()}
for slow in (False, True):
    future = client.call_async(SetBool.Request(data=slow))
    future.add_done_callback(lambda future, slow=slow: (answered.append(slow), done[slow].set()))
assert done[True].wait(60), "the quick one waits behind the slow one"
assert answered == [True]
release.set()
assert done[False].wait(60)
assert future.result().message == "ros"
asking.stop(5), spinner.stop(5), other.shutdown(), context.shutdown()
"""
    with domain() as number:
        assert run_ros(code, number, fallback) == ""


@pytest.mark.parametrize(("error", "reported"), [(None, (True, "")), ("it is off", (False, "it is off"))])
def test_a_service_with_a_message_field_returns_the_refusal_of_the_robot(error, reported):
    response, replies = SimpleNamespace(success=None, message=None), []
    success_of(response, replies.append)(None, error)
    assert replies == [response]
    assert (response.success, response.message) == reported
