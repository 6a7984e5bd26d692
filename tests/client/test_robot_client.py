from __future__ import annotations

import threading
import time
from base64 import b64decode, b64encode
from collections import deque

import pytest
from support.host import eventually
from support.jsonserver import json_server, line_of, say
from support.samples import event_of

from canopen_control.client import RobotClient, find_robots, robot_client, select_robot
from canopen_control.client.robot_client import EventStream, outpaced, stream_rate
from canopen_control.errors import ConfigError, LocalProtocolError, RemoteError
from canopen_control.host.reactor import Reactor
from canopen_control.host.sockets import close_listener, listen, socket_path
from canopen_control.rpc.messages.fault import FaultEvent
from canopen_control.rpc.messages.robot import (
    Description,
    GetDescription,
    GetStatus,
    PublishEvent,
    Release,
    RobotHello,
    SdoData,
    SdoRead,
    SdoWrite,
    Shutdown,
    Stop,
    Subscribe,
)
from canopen_control.rpc.messages.samples import TrajectoryPoint
from canopen_control.rpc.messages.state import ControllerReading, CycleTimes, StateSample


class Client:
    """A connection that has said what it will say."""

    def __init__(self, *messages):
        self.left, self.calls, self.closed = deque(messages), [], 0

    def ask(self, request):
        self.calls.append(request)

    def messages(self, timeout):
        self.timeout = timeout
        while self.left:
            message = self.left.popleft()
            if isinstance(message, RemoteError):
                raise message
            yield message

    def close(self):
        self.closed += 1


def event(kind, **more):
    return event_of({"time": 1.5, "kind": kind, "text": "it is", **more})


def test_events_in_their_order_and_nothing_else_until_none_comes():
    client = Client(event("a"), StateSample(), event("b", details={"error_code": 1}))
    stream = EventStream(client, 0.5)
    assert client.calls == [Subscribe(events=True)]  # before the first is asked for: none is missed
    assert [(item.kind, item.details) for item in stream] == [("a", None), ("b", FaultEvent(error_code=1))]
    assert client.timeout == 0.5
    assert client.closed == 1


def test_the_end_of_the_robot_is_its_last_event():
    client = Client(event("stopped"), RemoteError("BusClosed", "gone"))
    assert [item.kind for item in EventStream(client)] == ["stopped"]


def test_a_robot_that_died_is_an_error():
    client = Client(event("a"), RemoteError("BusClosed", "robot robby has closed the connection"))
    stream = EventStream(client)
    assert next(stream).time == 1.5
    with pytest.raises(RemoteError, match="closed the connection"):
        next(stream)
    assert client.closed == 1
    assert list(stream) == []


def test_a_block_closes_it():
    client = Client(event("a"))
    with EventStream(client) as stream:
        pass
    assert client.closed == 1
    assert list(stream) == []


@pytest.mark.parametrize(
    ("cycle_ms", "expected", "rate"),
    [
        (20, 0.0, 50.0),
        (10, 0.0, 100.0),
        (100, 0.0, 10.0),
        (5, 0.0, 100.0),
        (1, 0.0, 100.0),
        (8, 0.0, 62.5),  # 125 Hz would be more than is asked for by itself
        (20, 30.0, 25.0),
        (20, 500.0, 50.0),
        (1, 1000.0, 1000.0),
        (0, 0.0, 100.0),
    ],
)
def test_a_subscription_gets_a_whole_number_of_cycles(cycle_ms, expected, rate):
    assert stream_rate(CycleTimes(period_s=cycle_ms / 1000), expected) == pytest.approx(rate)


def test_a_controller_publishing_faster_than_the_state_is_named():
    fast = ControllerReading(name="states", type="", state="active", publish_rate=200.0)
    base = ControllerReading(name="base", type="", state="active", publish_rate=50.0)
    assert outpaced([fast, base], 200.0) is None
    assert outpaced([fast, base], 100.0) == (
        "states (200 Hz): published more often than the samples at 100 Hz, which omit the values in between"
    )
    assert "states (200 Hz), base (50 Hz)" in str(outpaced([fast, base], 20.0))


HELLO = {"hello": {"robot": "robby", "version": "0.1.0", "protocol": 2, "pid": 42}}


def text_of(number):
    return b64encode(number.to_bytes(2, "big")).decode()


def read(client, number):
    """Ask for an object whose value is its index, and return that."""
    return int.from_bytes(client.ask(SdoRead(node="a", index=number)).data, "big")


def push(client, count):
    """Have so many events pushed."""
    client.ask(PublishEvent(kind="push", text=str(count)))


def collected(number):
    return {"time": number, "kind": "test", "level": "info", "node": None, "text": "it is"}


class Robot:
    """A runtime as a client sees it, on a thread of its own; `answers` says what a method does."""

    def __init__(self, name="robby", hello=HELLO):
        self.reactor = Reactor()
        self.raised = []
        self.reactor.on_error = self.raised.append
        self.seen = []
        self.answers = {
            "description": lambda connection, request: {"result": {"urdf": "<robot/>"}},
            "sdo_read": lambda connection, request: {"result": {"data": text_of(request["params"]["index"])}},
            "release": lambda connection, request: {"error": {"kind": "InterfaceConflict", "message": "it is claimed"}},
            "status": lambda connection, request: None,
            "stop": lambda connection, request: {"error": {"kind": "X", "message": "no"}},
            "shutdown": lambda connection, request: self.server.close(),
            "tell": lambda connection, request: self.push(connection, int(request["params"]["text"])),
        }
        greet = (lambda connection: say(connection, hello)) if hello else (lambda connection: None)
        self.server = json_server(self.reactor, socket_path("robot", name), greet, self.on_message)
        self.thread = threading.Thread(target=self.reactor.run)

    def push(self, connection, count):
        for number in range(count):
            say(connection, {"event": collected(number)})
        return {"result": {}}

    def on_message(self, connection, request):
        self.seen.append(request)
        answer = self.answers[request["method"]](connection, request)
        if answer is not None and "id" in request:
            say(connection, {"id": request["id"], **answer})

    def on_loop(self, callback):
        done = threading.Event()
        self.reactor.call_threadsafe(lambda: (callback(), done.set()))
        assert done.wait(60)

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.reactor.call_threadsafe(self.server.close)
        self.reactor.call_threadsafe(self.reactor.stop)
        self.thread.join(60)
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
    with pytest.raises(ConfigError, match="no robot 'robby' is running; start one: canopen-control"):
        RobotClient.connect("robby")


def test_the_only_robot_needs_no_name(robot):
    assert find_robots() == ["robby"]
    assert select_robot() == "robby"
    assert select_robot("robby") == "robby"


# -- hello


def test_the_robot_reports_its_identity(client):
    assert client.robot == "robby"
    assert client.hello == RobotHello("robby", "0.1.0", 2, 42)
    assert client.fileno() >= 0


@pytest.mark.parametrize(
    ("hello", "sentence"),
    [
        ({"hello": {"robot": "robby", "protocol": 1}}, "robot robby speaks protocol 1, this client 2; use the same"),
        ({"hello": {"robot": 3, "protocol": 2}}, "sent an unexpected greeting: Expected `str`, got `int`"),
        ({"hello": "you"}, "speaks protocol None"),
        ({"welcome": 1}, "speaks protocol None"),
        ({"error": {"kind": "BusError", "message": "too many connections"}}, "^too many connections$"),
    ],
)
def test_another_greeting_ends_it(run_folder, hello, sentence):
    with Robot(hello=hello), pytest.raises(RemoteError, match=sentence):
        RobotClient.connect()


def test_a_robot_that_does_not_greet_hangs(run_folder):
    with (
        Robot(hello=None),
        pytest.raises(
            RemoteError, match=r"robot robby does not answer; its process may be stopped or blocked"
        ) as caught,
    ):
        RobotClient.connect(timeout=0.02)
    assert caught.value.kind == "Timeout"


def test_a_robot_that_dies_before_it_greets_is_gone(run_folder):
    listener = listen(socket_path("robot", "robby"))

    def accept_and_leave():
        for _ in range(2):  # the first connection only checks whether a robot is running
            listener.accept()[0].close()

    listener.setblocking(True)
    leaving = threading.Thread(target=accept_and_leave)
    leaving.start()
    with pytest.raises(RemoteError, match="robot robby has closed the connection") as caught:
        RobotClient.connect()
    assert caught.value.kind == "BusClosed"
    leaving.join(60)
    close_listener(listener)


# -- requests


def test_a_request_has_parameters_and_an_answer(robot, client):
    assert client.ask(SdoRead(node="a", index=7)) == SdoData(b"\0\7")
    assert client.ask(GetDescription()) == Description("<robot/>")
    requested = {"node": "a", "index": 7, "subindex": 0, "block": False, "timeout": None, "session": None}
    assert robot.seen == [
        {"id": 1, "method": "sdo_read", "params": requested},
        {"id": 2, "method": "description", "params": {}},
    ]


def test_a_refusal_has_the_kind_and_the_words_of_the_robot(client):
    with pytest.raises(RemoteError, match=r"^it is claimed$") as caught:
        client.ask(Release())
    assert caught.value.kind == "InterfaceConflict"
    assert read(client, 8) == 8


@pytest.mark.parametrize(
    ("error", "kind", "sentence"),
    [("no", "RemoteError", "no"), ({}, "RemoteError", "refused without a reason"), ({"kind": "X"}, "X", "refused")],
)
def test_a_refusal_of_any_shape_is_a_sentence(robot, client, error, kind, sentence):
    robot.answers["status"] = lambda connection, request: {"error": error}
    with pytest.raises(RemoteError, match=sentence) as caught:
        client.ask(GetStatus())
    assert caught.value.kind == kind


def test_a_call_that_times_out_is_abandoned_and_its_late_answer_ignored(robot, client):
    late = {}
    robot.answers["status"] = lambda connection, request: late.update(connection=connection, id=request["id"])
    client.timeout = 0.02
    with pytest.raises(RemoteError, match=r"robot robby has not answered 'status' within 0.02 s") as caught:
        client.ask(GetStatus())
    assert caught.value.kind == "Timeout"
    client.timeout = 10
    robot.on_loop(lambda: say(late["connection"], {"id": late["id"], "result": {}}))
    assert read(client, 1) == 1
    assert client._awaited == {}


def test_a_request_may_have_a_timeout_of_its_own(client):
    with pytest.raises(RemoteError, match=r"within 0.01 s"):
        client.ask(GetStatus(), 0.01)


def test_a_notification_is_not_answered(robot, client):
    client.notify(Stop(latch=True))
    read(client, 1)
    assert robot.seen[0] == {"method": "stop", "params": {"latch": True, "source": None}}


def test_a_robot_that_dies_in_the_middle_of_a_call_is_one_sentence(robot, client):
    with pytest.raises(
        RemoteError, match=r"^robot robby has closed the connection; it was shut down or killed$"
    ) as caught:
        client.ask(Shutdown())
    assert caught.value.kind == "BusClosed"
    for use in (lambda: read(client, 1), lambda: next(client.messages(1)), lambda: client.notify(Stop())):
        with pytest.raises(RemoteError) as caught:
            use()
        assert caught.value.kind == "BusClosed"


def test_what_is_too_long_is_the_callers_error_and_leaves_nothing_behind(client):
    with pytest.raises(LocalProtocolError, match="more than 65536"):
        client.ask(PublishEvent(kind="long", text="x" * 70_000))
    assert client._awaited == {}
    assert read(client, 1) == 1


def test_a_complaint_about_the_line_itself_ends_the_conversation(robot, client):
    robot.answers["status"] = lambda connection, request: connection.refuse("RemoteProtocolError", "no such line")
    with pytest.raises(RemoteError, match=r"^no such line$") as caught:
        client.ask(GetStatus())
    assert caught.value.kind == "RemoteProtocolError"


# -- subscriptions


def test_what_was_subscribed_to_comes_in_order_also_before_an_answer(client):
    push(client, 3)
    assert [event.time for event in client.messages(0)] == [0, 1, 2]
    assert list(client.messages(0)) == []


def test_messages_wait_as_long_as_commanded(robot, client):
    started = time.monotonic()
    assert list(client.messages(0.02)) == []
    assert time.monotonic() - started >= 0.02
    (connection,) = robot.server.connections
    later = threading.Timer(0.01, lambda: robot.on_loop(lambda: say(connection, {"state": {"time": 1.0}})))
    later.start()
    assert next(client.messages()) == StateSample(time=1.0)
    later.join()


def test_what_has_come_is_yielded_before_the_end_is_reported(robot, client):
    push(client, 2)
    robot.on_loop(robot.server.close)
    messages = client.messages(10)
    assert [next(messages).time for _ in range(2)] == [0, 1]
    with pytest.raises(RemoteError, match="closed the connection"):
        next(messages)


def test_unfetched_items_are_dropped_and_counted(client, monkeypatch):
    monkeypatch.setattr("canopen_control.rpc.client._MAX_PUSHED", 3)
    push(client, 5)
    assert client.dropped == 2
    assert [event.time for event in client.messages(0)] == [2, 3, 4]


def test_several_lines_may_come_at_once(robot, client):
    lines = line_of({"state": {"time": 1.0}}) + line_of({"state": {"time": 2.0}})
    robot.on_loop(lambda: robot.server.connections[0].send(lines))
    assert [sample.time for sample in client.messages(0)] == [1.0, 2.0]


# -- threads


def test_many_threads_share_one_connection(client):
    wrong = []

    def ask(number):
        requested = [100 * number + step for step in range(50)]
        wrong.extend(item for item in requested if read(client, item) != item)

    def listen_to_events():
        received.extend(event.time for event in client.messages(0.5))

    received = []
    listening = threading.Thread(target=listen_to_events)
    threads = [threading.Thread(target=ask, args=(number,)) for number in range(6)]
    for thread in [listening, *threads]:
        thread.start()
    push(client, 20)
    for thread in [*threads, listening]:
        thread.join(60)
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
        assert read(client, number) == number
    client.close()
    listening.join(60)
    assert stopped == [True]


def test_a_death_is_reported_to_every_thread_that_waits(robot, client):
    reports = []

    def wait():
        try:
            client.ask(GetStatus())
        except RemoteError as error:
            reports.append(error)

    threads = [threading.Thread(target=wait) for _ in range(4)]
    for thread in threads:
        thread.start()
    assert eventually(lambda: len(robot.seen) == 4)
    robot.on_loop(robot.server.close)
    for thread in threads:
        thread.join(60)
    assert [error.kind for error in reports] == ["BusClosed"] * 4
    assert len(set(map(id, reports))) == 4


def test_closing_twice_is_fine_and_a_closed_client_reports_this(client):
    client.close()
    client.close()
    with pytest.raises(RemoteError, match="closed"):
        client.ask(GetStatus())
    with pytest.raises(RemoteError, match="closed"):
        next(client.messages(0))
    assert client.fileno() == -1


# -- objects


def test_a_long_object_goes_in_pieces(robot, client):
    for method in ("sdo_data", "sdo_write"):
        robot.answers[method] = lambda connection, request: {"result": {}}
    data = bytes(range(250)) * 200
    client.sdo_write(SdoWrite(node="3", index=0x2000, data=data, timeout=2.0), 5.0)
    assert [item["method"] for item in robot.seen] == ["sdo_data", "sdo_data", "sdo_write"]
    assert b"".join(b64decode(item["params"]["data"]) for item in robot.seen) == data
    assert (robot.seen[2]["params"]["index"], robot.seen[2]["params"]["timeout"]) == (0x2000, 2.0)


def test_a_long_trajectory_goes_in_pieces(robot, client):
    robot.answers["trajectory_data"] = lambda connection, request: {"result": {}}
    points = [TrajectoryPoint(positions=[0.0] * 5, time_from_start=float(number)) for number in range(250)]
    rest = client.send_points(points)
    sent = [item["time_from_start"] for request in robot.seen for item in request["params"]["points"]]
    assert [len(request["params"]["points"]) for request in robot.seen] == [100, 100]
    assert sent + [item.time_from_start for item in rest] == [float(number) for number in range(250)]
    assert client.send_points([]) == []


def test_heartbeats_come_on_their_own_while_the_end_of_a_trajectory_is_awaited(robot, client, monkeypatch):
    monkeypatch.setattr(robot_client, "HEARTBEAT_S", 0.04)
    robot.answers["trajectory_heartbeat"] = lambda connection, request: {"result": {}}
    with client.heartbeats():
        assert eventually(lambda: len(robot.seen) >= 3)
    assert {item["method"] for item in robot.seen} == {"trajectory_heartbeat"}
    assert all("id" not in item for item in robot.seen)
    assert "heartbeats" not in [thread.name for thread in threading.enumerate()]
