from __future__ import annotations

import pytest
from support.host import use_private_folders
from support.jsonserver import json_server, say
from support.store import STORE, Get, Put, Value

from canopen_control.errors import RemoteError
from canopen_control.host.reactor import Reactor
from canopen_control.host.sockets import socket_path
from canopen_control.host.timer import ManualClock
from canopen_control.rpc.client import ENDLESS, ReactorClient
from canopen_control.rpc.messages.declare import Done

MS = 1_000_000


class Scene:
    """A robot that answers when it is told to, and somebody who asks, on one reactor with a manual clock."""

    def __init__(self):
        self.reactor = Reactor(ManualClock())
        self.requests, self.answers = [], []
        self.server = json_server(
            self.reactor, socket_path("robot", "fake"), self.greet, self.on_message, lambda connection: None
        )
        path = socket_path("robot", "fake")
        self.client = ReactorClient(STORE, path, self.reactor, label="robot fake", timeout_ns=1000 * MS)

    def greet(self, connection):
        say(connection, {"hello": {"store": "fake", "protocol": 2}})

    def on_message(self, connection, message):
        self.requests.append((connection, message))

    def ask(self, request):
        self.client.ask(request, lambda result, error: self.answers.append((request, result, error)))
        self.reactor.run_for(0)

    def answer(self, index, **content):
        connection, message = self.requests[index]
        say(connection, {"id": message["id"], **content})
        self.reactor.run_for(0)


@pytest.fixture
def scene(tmp_path, monkeypatch):
    use_private_folders(monkeypatch, tmp_path)
    made = Scene()
    yield made
    made.client.close()
    made.server.close()
    made.reactor.close()


def test_answers_find_their_questions_in_any_order_as_what_they_declare(scene):
    scene.ask(Get("a"))
    scene.ask(Put(key="b", number=2.0))
    assert scene.requests[0][1]["params"] == {"key": "a"}
    scene.answer(1, result={})
    assert scene.answers == [(Put(key="b", number=2.0), Done(), None)]
    scene.answer(0, result={"number": 1})
    assert scene.answers[1:] == [(Get("a"), Value(1.0), None)]


def test_a_refusal_is_an_answer(scene):
    scene.ask(Get("a"))
    scene.answer(0, error={"kind": "ControlError", "message": "no"})
    assert scene.answers == [(Get("a"), None, "no")]


def test_an_answer_of_another_shape_is_an_error(scene):
    scene.ask(Get("a"))
    scene.answer(0, result={"number": "many"})
    assert scene.answers == [(Get("a"), None, "the answer cannot be read: Expected `float`, got `str` - at `$.number`")]


def test_what_is_not_answered_in_time_is_told_and_a_late_answer_is_nobodys(scene):
    scene.ask(Get("a"))
    scene.reactor.run_for(999 * MS)
    assert scene.answers == []
    scene.reactor.run_for(2 * MS)
    assert scene.answers == [(Get("a"), None, "robot fake has not answered")]
    scene.answer(0, result={"number": 1})
    assert len(scene.answers) == 1


def test_when_the_robot_goes_everybody_is_told_and_so_is_who_asks_later(scene):
    scene.ask(Get("a"))
    scene.server.close()
    scene.reactor.run_for(0)
    scene.ask(Get("b"))
    assert [request.key for request, _, _ in scene.answers] == ["a", "b"]
    assert all("has closed the connection" in error for _, _, error in scene.answers)


def test_what_cannot_be_sent_is_refused_and_the_next_question_goes_on(scene):
    scene.ask(Get("x" * 70_000))
    assert "more than 65536" in scene.answers[0][2]
    scene.ask(Get("a"))
    assert [message["params"]["key"] for _, message in scene.requests] == ["a"]


def test_leaving_tells_who_waits_and_twice_is_once(scene):
    scene.ask(Get("a"))
    scene.client.close()
    scene.client.close()
    assert scene.answers == [(Get("a"), None, "robot fake was left")]


def test_without_a_robot_there_is_no_client(scene):
    with pytest.raises(RemoteError):
        ReactorClient(STORE, socket_path("robot", "nobody"), scene.reactor)


def test_what_may_be_answered_at_any_time_is_waited_for(scene):
    scene.client.ask(Get("a"), lambda result, error: scene.answers.append((result, error)), ENDLESS)
    scene.client.ask(Get("b"), lambda result, error: scene.answers.append((result, error)), 100 * MS)
    scene.reactor.run_for(5000 * MS)
    assert scene.answers == [(None, "robot fake has not answered")]
    scene.answer(0, result={"number": 7.0})
    assert scene.answers[-1] == (Value(7.0), None)


def test_what_is_said_again_and_again_wants_no_answer_and_ends_with_the_connection(scene):
    scene.client.keep_saying(Get("alive"), 100 * MS)
    scene.reactor.run_for(350 * MS)
    assert [message for _, message in scene.requests] == [{"method": "get", "params": {"key": "alive"}}] * 4
    scene.client.close()
    scene.reactor.run_for(500 * MS)
    assert len(scene.requests) == 4
    scene.client.keep_saying(Get("alive"), 100 * MS)
    scene.reactor.run_for(500 * MS)
    assert len(scene.requests) == 4
