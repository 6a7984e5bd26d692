"""The types of the blocking client; the shared connection is tested in tests/client."""

from __future__ import annotations

import threading

import pytest
from support.jsonserver import json_server, say
from support.store import STORE, Changed, Get, Hello, Put, Value

from canopen_control.errors import RemoteError, UnreadableMessage
from canopen_control.host.lineclient import LineClient
from canopen_control.host.reactor import Reactor
from canopen_control.host.sockets import socket_path
from canopen_control.host.timer import ManualClock
from canopen_control.rpc.client import ENDLESS, Client, ReactorClient, read_hello
from canopen_control.rpc.messages.declare import Done
from canopen_control.rpc.wire import read_line

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
def scene():
    created = Scene()
    yield created
    created.client.close()
    created.server.close()
    created.reactor.close()


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


def test_a_request_that_times_out_is_reported_and_its_late_answer_ignored(scene):
    scene.ask(Get("a"))
    scene.reactor.run_for(999 * MS)
    assert scene.answers == []
    scene.reactor.run_for(2 * MS)
    assert scene.answers == [(Get("a"), None, "robot fake has not answered")]
    scene.answer(0, result={"number": 1})
    assert len(scene.answers) == 1


def test_the_end_of_the_robot_is_reported_to_all_clients_and_to_later_requests(scene):
    scene.ask(Get("a"))
    scene.server.close()
    scene.reactor.run_for(0)
    scene.ask(Get("b"))
    assert [request.key for request, _, _ in scene.answers] == ["a", "b"]
    assert all("has closed the connection" in error for _, _, error in scene.answers)


def test_what_cannot_be_sent_is_refused_and_the_next_question_continues(scene):
    scene.ask(Get("x" * 70_000))
    assert "more than 65536" in scene.answers[0][2]
    scene.ask(Get("a"))
    assert [message["params"]["key"] for _, message in scene.requests] == ["a"]


def test_leaving_reports_pending_requests_and_is_idempotent(scene):
    scene.ask(Get("a"))
    scene.client.close()
    scene.client.close()
    assert scene.answers == [(Get("a"), None, "the connection to robot fake was closed")]


def test_without_a_robot_there_is_not_a_client(scene):
    with pytest.raises(RemoteError):
        ReactorClient(STORE, socket_path("robot", "nobody"), scene.reactor)


def test_what_may_be_answered_at_any_time_is_waited_for(scene):
    scene.client.ask(Get("a"), lambda result, error: scene.answers.append((result, error)), ENDLESS)
    scene.client.ask(Get("b"), lambda result, error: scene.answers.append((result, error)), 100 * MS)
    scene.reactor.run_for(5000 * MS)
    assert scene.answers == [(None, "robot fake has not answered")]
    scene.answer(0, result={"number": 7.0})
    assert scene.answers[-1] == (Value(7.0), None)


def test_what_is_reported_again_and_again_needs_no_answer_and_ends_with_the_connection(scene):
    scene.client.send_periodically(Get("alive"), 100 * MS)
    scene.reactor.run_for(350 * MS)
    assert [message for _, message in scene.requests] == [{"method": "get", "params": {"key": "alive"}}] * 4
    scene.client.close()
    scene.reactor.run_for(500 * MS)
    assert len(scene.requests) == 4
    scene.client.send_periodically(Get("alive"), 100 * MS)
    scene.reactor.run_for(500 * MS)
    assert len(scene.requests) == 4


class Store:
    """A server on a thread of its own that answers with what stands in `answers`."""

    def __init__(self):
        self.reactor, self.seen = Reactor(), []
        self.answers = {"get": {"result": {"number": 2.5, "colour": "new"}}, "put": {"result": {}}}
        self.server = json_server(self.reactor, socket_path("robot", "store"), self.greet, self.on_message)
        self.thread = threading.Thread(target=self.reactor.run)

    def greet(self, connection):
        say(connection, {"hello": {"store": "shelf", "protocol": 2, "more": 1}})
        say(connection, {"changed": {"key": "a"}})
        say(connection, {"unknown": 1})
        say(connection, {"changed": {"key": 5}})

    def on_message(self, connection, message):
        self.seen.append(message)
        say(connection, {"id": message["id"], **self.answers[message["method"]]})


@pytest.fixture
def store(private_folders):
    created = Store()
    created.thread.start()
    yield created
    created.reactor.call_threadsafe(created.server.close)
    created.reactor.call_threadsafe(created.reactor.stop)
    created.thread.join(60)
    created.reactor.close()


@pytest.fixture
def client(store):
    with Client(STORE, LineClient(socket_path("robot", "store"), label="the store")) as client:
        yield client


def test_an_answer_has_the_type_that_its_request_declares(store, client):
    assert client.hello == Hello("shelf")
    assert client.ask(Get("a")) == Value(2.5)
    assert client.ask(Put(key="a", number=1.0)) == Done()
    assert [message["params"] for message in store.seen] == [{"key": "a"}, {"key": "a", "number": 1.0}]


@pytest.mark.parametrize(
    ("answer", "words"), [({"number": "x"}, "`float`, got `str`"), ([], "`object`"), ({}, "missing")]
)
def test_an_answer_of_another_shape_is_a_sentence(store, client, answer, words):
    store.answers["get"] = {"result": answer}
    with pytest.raises(RemoteError, match=f"the store sent an invalid message: .*{words}") as caught:
        client.ask(Get("a"))
    assert caught.value.kind == "RemoteProtocolError"


def test_pushed_messages_have_their_type_and_unknown_ones_are_skipped(client):
    messages = client.messages(5.0)
    assert next(messages) == Changed("a")
    with pytest.raises(UnreadableMessage, match=r"an invalid message: Expected `str`, got `int` - at `\$.key`"):
        next(messages)


def test_a_greeting_is_read_or_reports_why_not():
    assert read_hello(STORE, read_line(b'{"hello":{"store":"a","protocol":2}}'), "it") == Hello("a")
    with pytest.raises(RemoteError, match="it speaks protocol 1, this client 2"):
        read_hello(STORE, read_line(b'{"hello":{"store":"a","protocol":1}}'), "it")
    with pytest.raises(RemoteError, match="another user"):
        read_hello(
            STORE, read_line(b'{"error":{"kind":"BusError","message":"this program belongs to another user"}}'), "it"
        )
