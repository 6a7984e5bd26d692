"""What is typed of the blocking client; how it shares its connection is tested with the robot's, tests/client."""

from __future__ import annotations

import threading

import pytest
from support.jsonserver import json_server, say
from support.store import STORE, Changed, Get, Hello, Put, Value

from canopen_control.errors import RemoteError, UnreadableMessage
from canopen_control.host.lineclient import LineClient
from canopen_control.host.reactor import Reactor
from canopen_control.host.sockets import socket_path
from canopen_control.rpc.client import Client, read_hello
from canopen_control.rpc.messages.declare import Done
from canopen_control.rpc.wire import read_line


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
    made = Store()
    made.thread.start()
    yield made
    made.reactor.call_threadsafe(made.server.close)
    made.reactor.call_threadsafe(made.reactor.stop)
    made.thread.join(10)
    made.reactor.close()


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
    with pytest.raises(RemoteError, match=f"the store sent garbage: .*{words}") as caught:
        client.ask(Get("a"))
    assert caught.value.kind == "RemoteProtocolError"


def test_what_was_sent_unasked_has_its_type_and_what_nobody_knows_is_skipped(client):
    messages = client.messages(5.0)
    assert next(messages) == Changed("a")
    with pytest.raises(UnreadableMessage, match=r"garbage: Expected `str`, got `int` - at `\$.key`"):
        next(messages)


def test_a_greeting_is_read_or_says_why_not():
    assert read_hello(STORE, read_line(b'{"hello":{"store":"a","protocol":2}}'), "it") == Hello("a")
    with pytest.raises(RemoteError, match="it speaks protocol 1, this client 2"):
        read_hello(STORE, read_line(b'{"hello":{"store":"a","protocol":1}}'), "it")
    with pytest.raises(RemoteError, match="another user"):
        read_hello(STORE, read_line(b'{"error":{"kind":"BusError","message":"this is another user\'s"}}'), "it")
