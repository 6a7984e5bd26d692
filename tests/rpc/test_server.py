from __future__ import annotations

import json
from types import SimpleNamespace

import pytest
from support.store import STORE, Changed, Get, Hello, Put, Value

from canopen_control.errors import ControlError
from canopen_control.host import sockets
from canopen_control.host.lineclient import MAX_VALUES
from canopen_control.host.reactor import Reactor
from canopen_control.host.sockets import socket_path
from canopen_control.host.timer import ManualClock
from canopen_control.rpc.messages.declare import Done
from canopen_control.rpc.server import Server


class Store:
    """A server of two methods, and one raw peer."""

    def __init__(self):
        self.reactor, self.values, self.calls = Reactor(ManualClock()), {}, []
        self.server = Server(STORE, self.reactor, socket_path("robot", "store"), lambda: Hello("shelf"))
        self.server.register(Get, self.get)
        self.server.register(Put, self.put)
        self.peer = sockets.connect(socket_path("robot", "store"))
        self.peer.setblocking(False)
        self.buffer = b""

    def get(self, call):
        self.calls.append(call)
        if call.request.key == "broken":
            raise OverflowError("too much")
        if call.request.key not in self.values:
            raise ControlError(f"no {call.request.key}")
        call.reply(Value(self.values[call.request.key]))

    def put(self, call):
        self.values[call.request.key] = call.request.number
        call.settle("it is full" if len(self.values) > 2 else None)
        self.server.push(Changed(call.request.key))

    def tell(self, line):
        self.peer.sendall(line if isinstance(line, bytes) else json.dumps(line).encode() + b"\n")
        self.reactor.run_for(0)

    def collected(self):
        self.reactor.run_for(0)
        result = self.peer.recv(1 << 20)
        return [json.loads(line) for line in result.splitlines()]

    def ask(self, method, under=1, **params):
        self.tell({"id": under, "method": method, "params": params})
        return next(item for item in self.collected() if "id" in item)


@pytest.fixture
def store():
    created = Store()
    yield created
    created.peer.close()
    created.server.close()
    created.reactor.close()


def test_a_new_member_is_greeted(store):
    assert store.collected() == [{"hello": {"store": "shelf", "protocol": 2}}]


def test_a_handler_gets_the_request_as_its_type_and_answers_under_its_number(store):
    assert store.ask("put", "x", key="a", number=2) == {"id": "x", "result": {}}
    assert store.ask("get", 5, key="a") == {"id": 5, "result": {"number": 2.0}}
    assert store.calls[0].request == Get("a")


def test_what_was_done_is_received_but_not_what_was_read_or_refused(store):
    received = []
    store.server.observer = SimpleNamespace(done=lambda method, params: received.append((method, bytes(params))))
    store.ask("put", key="a", number=2)
    store.ask("get", key="a")
    store.ask("put", number=2)
    assert received == [("put", b'{"key": "a", "number": 2}')]


def test_a_refusal_has_the_class_of_its_error(store):
    assert store.ask("get", key="b")["error"] == {"kind": "ControlError", "message": "no b"}
    for key in "abc":
        answer = store.ask("put", key=key)
    assert answer["error"] == {"kind": "ControlError", "message": "it is full"}


NO_NUMBER = "NaN or an infinite number (null in JSON) where a finite one is needed"


@pytest.mark.parametrize(
    ("method", "params", "sentence"),
    [
        ("dance", {}, "no method 'dance'; available: get, put"),
        (None, {}, "no method ''; available: get, put"),
        ("get", {}, "get: Object missing required field `key`"),
        ("get", {"key": 3}, "get: Expected `str`, got `int` - at `$.key`"),
        ("get", {"key": "a", "colour": 1}, "get: Object contains unknown field `colour`"),
        ("put", {"key": "a", "number": None}, f"put: {NO_NUMBER} - at `$.number`"),
        ("get", [1], "get: Expected `object`, got `array`"),
        ("get", {"key": "broken"}, "get: too much"),
    ],
)
def test_what_is_wrong_is_refused_in_a_sentence_and_the_next_request_is_served(store, method, params, sentence):
    store.tell({"id": 1, "method": method, "params": params})
    (answer,) = [item for item in store.collected() if "id" in item]
    assert answer["error"] == {"kind": "LocalProtocolError", "message": sentence}
    assert store.ask("put", key="a") == {"id": 1, "result": {}}


def test_a_notification_is_done_and_not_answered(store):
    store.tell({"method": "put", "params": {"key": "a", "number": 4}})
    store.tell({"method": "get", "params": {"key": "nowhere"}})
    assert [item for item in store.collected() if "id" in item or "error" in item] == []
    assert store.values == {"a": 4.0}


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        (b"garbage", "JSON is malformed"),
        (b"[1]", "a message is a JSON object"),
        (b"\xff\xfe", "malformed"),
        (b'{"a": [' + b"1," * MAX_VALUES + b"1]}", "more than 4096 values"),
        (b'{"a": "' + rb"\u0041" * 5000 + b'"}', "more than 4096 values"),
    ],
)
def test_a_line_that_is_not_a_request_ends_the_connection(store, line, sentence):
    store.collected()
    store.tell(line + b'\n{"id": 1, "method": "put", "params": {"key": "a"}}\n')
    (answer,) = store.collected()
    assert answer["error"]["kind"] == "RemoteProtocolError"
    assert answer["error"]["message"].startswith("not a JSON object on a line: ")
    assert sentence in answer["error"]["message"]
    assert store.server.connections == []
    assert store.values == {}


def test_what_is_pushed_comes_under_its_key_to_those_it_is_for(store):
    store.collected()
    store.server.push(Changed("a"))
    store.server.push(Changed("b"), [])
    assert store.collected() == [{"changed": {"key": "a"}}]
    assert store.server.line_of(Changed("c")) == b'{"changed":{"key":"c"}}\n'


def test_a_client_waiting_for_an_answer_is_not_closed_like_idle_ones(store):
    store.server.register(Get, store.calls.append)
    store.tell({"id": 1, "method": "get", "params": {"key": "a"}})
    call, later = store.calls[0], store.reactor.now() + 1_000_000_000
    waiting = call.connection.eviction_order(later)
    call.reply(Value(1.0))
    assert waiting > call.connection.eviction_order(later)


def test_a_client_is_identified_by_its_process(store):
    store.ask("get", key="a")
    assert "client #1 (pid " in store.calls[0].client


def test_a_method_that_is_not_answered_is_found_at_the_start(store):
    store.server.check()
    other = Server(STORE, store.reactor, socket_path("robot", "other"), lambda: Hello("empty"))
    other.register(Put, lambda call: call.reply(Done()))
    with pytest.raises(LookupError, match="no handler answers get of the store socket"):
        other.check()
    other.close()
