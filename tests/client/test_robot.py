from __future__ import annotations

import threading
import time

import pytest

from canopen_control.client import RobotClient, find_robots, select_robot
from canopen_control.errors import ConfigError, LocalProtocolError, RemoteError
from canopen_control.host.jsonlines import LineServer
from canopen_control.host.lines import encode
from canopen_control.host.reactor import Reactor
from canopen_control.host.sockets import close_listener, listen, socket_path

HELLO = {"hello": {"robot": "robby", "version": "0.1.0", "protocol": 1, "pid": 42}}


class Robot:
    """A runtime as a client sees it, on a thread of its own; `answers` says what a method does."""

    def __init__(self, name="robby", hello=HELLO):
        self.reactor = Reactor()
        self.raised = []
        self.reactor.on_error = self.raised.append
        self.seen = []
        self.answers = {
            "echo": lambda connection, request: {"result": request["params"]},
            "nothing": lambda connection, request: None,
            "refuse": lambda connection, request: {"error": {"kind": "InterfaceConflict", "message": "it is claimed"}},
            "die": lambda connection, request: self.server.close(),
            "push": lambda connection, request: self.push(connection, request["params"]["count"]),
        }
        greet = (lambda connection: connection.send(hello)) if hello else (lambda connection: None)
        self.server = LineServer(self.reactor, socket_path("robot", name), greet, self.on_message)
        self.thread = threading.Thread(target=self.reactor.run)

    def push(self, connection, count):
        for number in range(count):
            connection.send({"event": {"number": number}})
        return {"result": count}

    def on_message(self, connection, request):
        self.seen.append(request)
        answer = self.answers[request["method"]](connection, request)
        if answer is not None and "id" in request:
            connection.send({"id": request["id"], **answer})

    def on_loop(self, callback):
        done = threading.Event()
        self.reactor.call_threadsafe(lambda: (callback(), done.set()))
        assert done.wait(10)

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.reactor.call_threadsafe(self.server.close)
        self.reactor.call_threadsafe(self.reactor.stop)
        self.thread.join(10)
        self.reactor.close()
        assert not self.thread.is_alive()
        assert self.raised == []


@pytest.fixture
def robot(run_folder):
    with Robot() as robot:
        yield robot


@pytest.fixture
def client(robot):
    with RobotClient.connect() as client:
        yield client


# -- which robot


def test_no_robot_running_is_a_sentence(run_folder):
    assert find_robots() == []
    with pytest.raises(ConfigError, match="no robot is running; start one: canopen-control run robby"):
        select_robot()
    with pytest.raises(ConfigError, match=r"no robot 'robby' is running$"):
        RobotClient.connect("robby")


def test_the_only_robot_needs_no_name(robot):
    assert find_robots() == ["robby"]
    assert select_robot() == "robby"
    assert select_robot("robby") == "robby"


def test_several_robots_are_named_and_one_must_be_chosen(run_folder):
    listeners = [listen(socket_path("robot", name)) for name in ("b", "a")]
    with pytest.raises(ConfigError, match="several robots are running: a, b; choose one with --name"):
        select_robot()
    assert select_robot("b") == "b"
    with pytest.raises(ConfigError, match="no robot 'c' is running; running: a, b"):
        select_robot("c")
    with pytest.raises(ConfigError, match="is no name"):
        select_robot("../c")
    for listener in listeners:
        close_listener(listener)


# -- hello


def test_the_robot_says_who_it_is(client):
    assert client.robot == "robby"
    assert client.hello == HELLO["hello"]
    assert client.fileno() >= 0


@pytest.mark.parametrize(
    ("hello", "sentence"),
    [
        ({"hello": {"robot": "robby", "protocol": 2}}, "robot robby speaks protocol 2, this client 1; use the same"),
        ({"hello": "you"}, "speaks protocol None"),
        ({"welcome": 1}, "speaks protocol None"),
        ({"error": {"kind": "BusError", "message": "too many connections"}}, "^too many connections$"),
    ],
)
def test_another_greeting_ends_it(run_folder, hello, sentence):
    with Robot(hello=hello), pytest.raises(RemoteError, match=sentence):
        RobotClient.connect()


def test_a_robot_that_does_not_greet_hangs(run_folder):
    with Robot(hello=None), pytest.raises(RemoteError, match=r"robot robby does not answer; does it hang\?") as caught:
        RobotClient.connect(timeout=0.02)
    assert caught.value.kind == "Timeout"


def test_a_robot_that_dies_before_it_greets_is_gone(run_folder):
    listener = listen(socket_path("robot", "robby"))

    def accept_and_leave():
        for _ in range(2):  # the first connection only looks whether somebody lives here
            listener.accept()[0].close()

    listener.setblocking(True)
    leaving = threading.Thread(target=accept_and_leave)
    leaving.start()
    with pytest.raises(RemoteError, match="robot robby has closed the connection") as caught:
        RobotClient.connect()
    assert caught.value.kind == "BusClosed"
    leaving.join(10)
    close_listener(listener)


# -- requests


def test_a_call_has_parameters_and_a_result(robot, client):
    assert client.call("echo", controller="c", values=[1.5, -2]) == {"controller": "c", "values": [1.5, -2]}
    assert client.call("echo") == {}
    assert robot.seen[0] == {"id": 1, "method": "echo", "params": {"controller": "c", "values": [1.5, -2]}}
    assert robot.seen[1]["id"] == 2


def test_parameters_may_have_any_name(client):
    params = {"method": 1, "self": 2, "timeout": 3, "params": 4}
    assert client.call("echo", **params) == params
    assert client.request("echo", params) == params


def test_a_refusal_has_the_kind_and_the_words_of_the_robot(client):
    with pytest.raises(RemoteError, match=r"^it is claimed$") as caught:
        client.call("refuse")
    assert caught.value.kind == "InterfaceConflict"
    assert client.call("echo", still="fine") == {"still": "fine"}


@pytest.mark.parametrize(
    ("error", "kind", "sentence"),
    [("no", "RemoteError", "no"), ({}, "RemoteError", "refused without a reason"), ({"kind": "X"}, "X", "refused")],
)
def test_a_refusal_of_any_shape_is_a_sentence(robot, client, error, kind, sentence):
    robot.answers["odd"] = lambda connection, request: {"error": error}
    with pytest.raises(RemoteError, match=sentence) as caught:
        client.call("odd")
    assert caught.value.kind == kind


def test_a_call_that_takes_too_long_is_given_up_and_its_late_answer_is_nobodys(robot, client):
    late = {}
    robot.answers["slow"] = lambda connection, request: late.update(connection=connection, id=request["id"])
    client.timeout = 0.02
    with pytest.raises(RemoteError, match=r"robot robby has not answered 'slow' within 0.02 s") as caught:
        client.call("slow")
    assert caught.value.kind == "Timeout"
    client.timeout = 10
    robot.on_loop(lambda: late["connection"].send({"id": late["id"], "result": "too late"}))
    assert client.call("echo", a=1) == {"a": 1}
    assert client._awaited == {}


def test_a_request_may_have_a_timeout_of_its_own(client):
    with pytest.raises(RemoteError, match=r"within 0.01 s"):
        client.request("nothing", {}, timeout=0.01)


def test_a_notification_is_not_answered(robot, client):
    client.notify("refuse", a=1)
    client.call("echo")
    assert robot.seen[0] == {"method": "refuse", "params": {"a": 1}}


def test_a_robot_that_dies_in_the_middle_of_a_call_is_one_sentence(robot, client):
    with pytest.raises(
        RemoteError, match=r"^robot robby has closed the connection; it was shut down or has died$"
    ) as caught:
        client.call("die")
    assert caught.value.kind == "BusClosed"
    for use in (lambda: client.call("echo"), lambda: next(client.messages(1)), lambda: client.notify("echo")):
        with pytest.raises(RemoteError) as caught:
            use()
        assert caught.value.kind == "BusClosed"


def test_what_json_cannot_say_is_the_callers_mistake_and_leaves_nothing_behind(client):
    with pytest.raises(LocalProtocolError):
        client.call("echo", value=float("nan"))
    assert client._awaited == {}
    assert client.call("echo") == {}


def test_a_complaint_about_the_line_itself_ends_the_conversation(robot, client):
    robot.answers["complain"] = lambda connection, request: connection.refuse("RemoteProtocolError", "no such line")
    with pytest.raises(RemoteError, match=r"^no such line$") as caught:
        client.call("complain")
    assert caught.value.kind == "RemoteProtocolError"


# -- subscriptions


def test_what_was_subscribed_to_comes_in_order_also_before_an_answer(client):
    assert client.call("push", count=3) == 3
    assert [message["event"]["number"] for message in client.messages(0)] == [0, 1, 2]
    assert list(client.messages(0)) == []


def test_messages_wait_as_long_as_they_are_told(robot, client):
    started = time.monotonic()
    assert list(client.messages(0.02)) == []
    assert time.monotonic() - started >= 0.02
    (connection,) = robot.server.connections
    later = threading.Timer(0.01, lambda: robot.on_loop(lambda: connection.send({"state": {"n": 1}})))
    later.start()
    assert next(client.messages()) == {"state": {"n": 1}}
    later.join()


def test_what_has_come_is_yielded_before_the_end_is_told(robot, client):
    client.call("push", count=2)
    robot.on_loop(robot.server.close)
    messages = client.messages(10)
    assert [next(messages)["event"]["number"] for _ in range(2)] == [0, 1]
    with pytest.raises(RemoteError, match="closed the connection"):
        next(messages)


def test_what_nobody_fetches_is_dropped_and_counted(client, monkeypatch):
    monkeypatch.setattr("canopen_control.client.robot._KEPT_MESSAGES", 3)
    client.call("push", count=5)
    assert client.dropped == 2
    assert [message["event"]["number"] for message in client.messages(0)] == [2, 3, 4]


def test_one_line_may_hold_state_encoded_for_many(robot, client):
    robot.on_loop(lambda: robot.server.broadcast({"state": 1}))
    robot.on_loop(lambda: robot.server.connections[0].send_encoded(encode({"state": 2})))
    assert [message["state"] for message in client.messages(0)] == [1, 2]


# -- threads


def test_many_threads_share_one_connection(client):
    wrong = []

    def ask(number):
        asked = [{"number": number, "step": step} for step in range(50)]
        wrong.extend(params for params in asked if client.call("echo", **params) != params)

    def listen_to_events():
        received.extend(message["event"]["number"] for message in client.messages(0.5))

    received = []
    listening = threading.Thread(target=listen_to_events)
    threads = [threading.Thread(target=ask, args=(number,)) for number in range(6)]
    for thread in [listening, *threads]:
        thread.start()
    assert client.call("push", count=20) == 20
    for thread in [*threads, listening]:
        thread.join(20)
        assert not thread.is_alive()
    assert wrong == []
    assert received == list(range(20))


def test_a_call_is_answered_while_another_thread_reads(client):
    stopped = []

    def listen_for_ever():
        with pytest.raises(RemoteError, match="the connection to robot robby is closed"):
            list(client.messages())
        stopped.append(True)

    listening = threading.Thread(target=listen_for_ever)
    listening.start()
    for number in range(20):
        assert client.call("echo", n=number) == {"n": number}
    client.close()
    listening.join(10)
    assert stopped == [True]


def test_a_death_is_told_to_every_thread_that_waits(robot, client):
    told = []

    def wait():
        try:
            client.call("nothing")
        except RemoteError as error:
            told.append(error)

    threads = [threading.Thread(target=wait) for _ in range(4)]
    for thread in threads:
        thread.start()
    while len(robot.seen) < 4:
        time.sleep(0.001)
    robot.on_loop(robot.server.close)
    for thread in threads:
        thread.join(10)
    assert [error.kind for error in told] == ["BusClosed"] * 4
    assert len(set(map(id, told))) == 4


def test_closing_twice_is_fine_and_a_closed_client_says_so(client):
    client.close()
    client.close()
    with pytest.raises(RemoteError, match="closed"):
        client.call("echo")
    with pytest.raises(RemoteError, match="closed"):
        next(client.messages(0))
    assert client.fileno() == -1
