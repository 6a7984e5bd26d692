import json

import pytest
from support.samples import event_of, sample_of

from canopen_control.errors import ConfigError
from canopen_control.host.lineclient import LineClient
from canopen_control.host.reactor import Reactor
from canopen_control.host.sockets import socket_path
from canopen_control.host.timer import ManualClock
from canopen_control.rpc.messages.robot import Description
from canopen_control.rpc.messages.state import RobotEvent
from canopen_control.trace.flight_file import FlightMeta, read_samples, save
from canopen_control.trace.replayed_robot import ReplayedRobot

S = 1_000_000_000
META = FlightMeta(robot="robby", reason=RobotEvent(time=0.0, kind="", node=None, level="info", text=""),
                  buses={"can": "local:robby"})  # fmt: skip
TRUTH = {"time": 1.0, "x": 1.0, "y": 0.0, "heading": 0.0}


def samples(*times):
    return [sample_of({"time": time, "state": "running", "true_pose": TRUTH | {"x": time}}) for time in times]


class Watched:
    """A recording under a manual clock, and a bare connection to it."""

    def __init__(self, times, meta=META, **how):
        self.reactor = Reactor(ManualClock(S))
        events = [event_of({"time": 1.05, "kind": "x", "node": None, "level": "info", "text": "it was so"})]
        described = Description("<robot/>", "/robby.urdf")
        self.robot = ReplayedRobot("was", meta, samples(*times), events, described, self.reactor, **how)
        self.reactor.run_for(0)
        self.client = LineClient(socket_path("robot", "was"))
        self.hello = self.receive()

    def receive(self):
        self.reactor.run_for(0)
        line = self.client.receive(0.2)
        return None if line is None else json.loads(line)

    def ask(self, method, **params):
        self.client.send(json.dumps({"id": 1, "method": method, "params": params}).encode() + b"\n")
        answer = self.receive()
        while "id" not in answer:
            answer = self.receive()
        return answer.get("result", answer.get("error"))

    def close(self):
        self.client.close()
        self.robot.close()
        self.reactor.close()


@pytest.fixture
def watched():
    created = []

    def make(*times, **how):
        created.append(Watched(times, **how))
        return created[-1]

    yield make
    for item in created:
        item.close()


def test_states_and_events_come_at_their_own_rhythm(watched):
    w = watched(1.0, 1.1, 1.3, speed=2.0)
    assert w.hello["hello"]["robot"] == "was"
    w.ask("subscribe", events=True)
    w.reactor.run_for(5 * S)
    assert w.ask("status")["true_pose"]["x"] == 1.0, "it waits for who watches"
    w.ask("subscribe", state_rate=25.0, events=True)
    assert w.receive()["state"]["time"] == 1.0
    w.reactor.run_for(S // 25)
    assert w.receive() is None, "a tenth of a second at double speed"
    w.reactor.run_for(S // 50)
    assert w.receive()["state"]["true_pose"]["x"] == 1.1
    assert w.receive()["event"]["text"] == "it was so"
    assert not w.robot.over
    w.reactor.run_for(S)
    assert w.receive()["state"]["time"] == 1.3
    assert w.robot.over
    status = w.ask("status")
    assert (status["robot"], status["true_pose"]["x"], [item["text"] for item in status["events"]]) == (
        "was", 1.3, ["it was so"]
    )  # fmt: skip


def test_a_gap_is_not_waited_for(watched):
    w = watched(1.0, 500.0)
    w.ask("subscribe", state_rate=25.0)
    w.reactor.run_for(S + 1)
    assert w.robot.over
    w.ask("subscribe", state_rate=5.0)
    assert w.receive()["state"]["time"] == 500.0, "who comes later sees where it stands"
    w.reactor.run_for(S)
    assert [w.receive()["state"]["time"] for _ in range(2)] == [500.0] * 2, "and goes on to hear it"


def test_what_a_page_asks_is_answered_and_what_moves_is_refused(watched):
    w = watched(1.0)
    assert w.ask("description") == {"urdf": "<robot/>", "path": "/robby.urdf"}
    assert w.ask("nodes")["nodes"] == []
    assert w.ask("controllers") == []
    refused = w.ask("stop", latch=True)
    assert refused["message"] == "was is a recording of robby, which cannot be changed"
    assert "is a recording" in w.ask("twist", controller="base", linear=1.0, angular=0.0)["message"]


def test_a_recording_without_states_is_reported():
    with (
        Reactor(ManualClock(S)) as reactor,
        pytest.raises(ConfigError, match="the recording of robby contains no states to replay"),
    ):
        ReplayedRobot("was", META, [], [], Description(""), reactor)


def test_samples_are_read_whole_from_a_file(tmp_path):
    lines = [json.dumps({"time": value, "state": "running", "true_pose": TRUTH}).encode() for value in (1.0, 2.0)]
    path = save(tmp_path, META, iter(()), [], lines)
    read = read_samples(path)
    assert [item.time for item in read] == [1.0, 2.0]
    assert read[0].true_pose.x == 1.0
