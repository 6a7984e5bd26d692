"""The context of endpoints of one node, with a node that only records calls."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from canopen_control.ros import endpoint
from canopen_control.ros.endpoint import NodeContext
from canopen_control.ros.interfaces import MissingInterface

pytestmark = pytest.mark.ros


@pytest.fixture
def scene(monkeypatch):
    warned, gone, created, later = [], [], {}, []
    node = SimpleNamespace(
        create_subscription=lambda _kind, topic, callback, _qos: created.setdefault(topic, callback),
        destroy_subscription=gone.append,
        destroy_service=gone.append,
    )
    shared = SimpleNamespace(
        robot="robby", controllers={}, publishers={}, warn_of=lambda of, _key, text: warned.append((of is node, text)),
        hand_over=later.append, call=lambda function: function(),
    )  # fmt: skip
    for name in ("command", "connect", "watch_process_data", "ask", "unix", "frame", "leave_out"):
        setattr(shared, name, lambda *_: None)
    monkeypatch.setattr(endpoint, "interface", lambda name: name)
    monkeypatch.setattr(endpoint, "serve", lambda _node, _kind, name, taken: created.setdefault(name, taken))
    return SimpleNamespace(
        ros=NodeContext(shared, node), collected=warned, gone=gone, made=created, later=later, shared=shared
    )


def test_what_a_callback_raises_is_a_warning_of_the_node(scene):
    def callback(message):
        raise ValueError(f"not {message}")

    scene.ros.subscribe(str, "commands", callback, None)
    scene.made["commands"]("this")
    assert scene.collected == [(True, "commands: ValueError: not this")]


def test_a_request_is_handed_over_and_one_that_raises_is_answered(scene):
    def handler(request, response, reply):
        raise KeyError(request)

    scene.ros.serve("p/srv/Get", "get", handler)
    answered = []
    scene.made["get"]("request", "response", answered.append)
    assert answered == [], "not yet: it is for the other thread"
    scene.later.pop()()
    assert answered == ["response"]
    assert scene.collected == [(True, "get: KeyError: 'request'")]


def test_what_is_left_is_destroyed_and_what_is_shared_is_the_sessions(scene):
    scene.ros.unsubscribe("topic")
    scene.ros.unserve("service")
    assert scene.gone == ["topic", "service"]
    scene.shared.controllers = {"base": 1}
    assert (scene.ros.robot, scene.ros.controllers) == ("robby", {"base": 1})


def test_a_service_that_this_ros_has_no_interface_for_is_left_out_and_reported(scene, monkeypatch):
    def interface(name):
        raise MissingInterface(name)

    monkeypatch.setattr(endpoint, "interface", interface)
    left_out = []
    scene.ros.leave_out = left_out.append
    service = scene.ros.serve("p/srv/New", "new", None)
    assert (service, left_out, "new" in scene.made) == (None, ["p/srv/New"], False)
    scene.ros.unserve(service)
    assert scene.gone == []
