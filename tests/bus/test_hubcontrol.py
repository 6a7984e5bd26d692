"""Answers of a hub to valid and invalid requests."""

from __future__ import annotations

import json
from typing import get_args

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.host import use_private_folders
from support.properties import examples

from canopen_control.bus.frame_router import FrameRouter
from canopen_control.bus.hubcontrol import HubControl
from canopen_control.frame import CanFrame, frames_of, pack_records
from canopen_control.host.reactor import Reactor
from canopen_control.host.sockets import connect, listen, socket_path
from canopen_control.host.timer import ManualClock
from canopen_control.rpc.messages.hub import HUB, ErrorKind


class Desk:
    """A control socket on a manual clock, with two members on its exchange and one who asks."""

    def __init__(self):
        self.router, self.after = FrameRouter(), 0
        self.reactor = Reactor(ManualClock(5_000_000_000))
        path = socket_path("busctl", "robby")
        self.control = HubControl(
            "robby", self.router, self.reactor, listen(path), started=self.reactor.now(), after=self._after
        )
        self.left, self.right = self.router.join("left", 11), self.router.join("right", 12)
        self.peer = connect(path)
        self.peer.setblocking(False)
        (self.hello,) = self.tell(b"")

    def _after(self):
        self.after += 1

    def tell(self, line):
        self.peer.sendall(line)
        self.reactor.run_for(0)
        try:
            return [json.loads(item) for item in self.peer.recv(1 << 20).splitlines()]
        except BlockingIOError:
            return []

    def ask(self, method, **params):
        (answer,) = self.tell(json.dumps({"id": 1, "method": method, "params": params}).encode() + b"\n")
        assert answer.pop("id") == 1
        return answer

    def close(self):
        self.peer.close()
        self.control.close()
        self.reactor.close()
        assert self.reactor.errors == 0


@pytest.fixture
def desk():
    desk = Desk()
    yield desk
    desk.close()


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    """One desk for all that changes nothing that matters."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        use_private_folders(monkeypatch, tmp_path_factory.mktemp("desk"))
        desk = Desk()
        yield desk
        desk.close()


def test_the_hello_names_the_bus_and_the_protocol_of_all_sockets(desk):
    assert desk.hello["hello"]["bus"] == "robby"
    assert desk.hello["hello"]["protocol"] == 2


def test_the_status_reports_members_and_problems(desk):
    desk.router.receive(desk.left, pack_records([CanFrame(0x181)] * 3), 0)
    desk.ask("cut", label="right")
    desk.ask("drop", label="left", can_id=0x181, every=2, count=4)
    desk.ask("delay", ms=5)
    desk.reactor.run_for(1_500_000_000)
    status = desk.ask("status")["result"]
    assert status["members"] == [
        {"label": "left", "pid": 11, "rx": 0, "tx": 3, "lost": 0, "queued": 0},
        {"label": "right", "pid": 12, "rx": 3, "tx": 0, "lost": 0, "queued": 3},
    ]
    assert status["cut"] == ["right"]
    assert status["bus_off"] == []
    assert status["delays_ms"] == {"": 5.0}
    assert status["drops"] == [{"label": "left", "can_id": 0x181, "every": 2, "count": 4, "seen": 0, "lost": 0}]
    assert (status["uptime_s"], status["frames"], status["bitrate"], status["load"]) == (1.5, 3, None, None)


@pytest.mark.parametrize(("on", "off", "field"), [("cut", "uncut", "cut"), ("bus_off", "restart", "bus_off")])
def test_a_label_is_silenced_and_sends_again(desk, on, off, field):
    assert desk.ask(on, label="left") == {"result": {}}
    assert desk.left.silent
    assert desk.ask("status")["result"][field] == ["left"]
    assert desk.ask(off, label="left") == {"result": {}}
    assert not desk.left.silent
    assert desk.after == 2  # each request that changed something


@pytest.mark.parametrize("kind", get_args(ErrorKind))
def test_every_kind_of_error_frame_reaches_its_label_or_everybody(desk, kind):
    desk.ask("error_frame", kind=kind, label="left")
    desk.ask("error_frame", kind=kind)
    assert [frame.is_error for frame in frames_of(desk.left.outbox)] == [True, True]
    assert len(list(frames_of(desk.right.outbox))) == 1


def test_the_bit_rate_is_set_and_taken_back(desk):
    desk.ask("bitrate", bitrate=500_000)
    assert desk.ask("status")["result"]["bitrate"] == 500_000
    assert desk.ask("status")["result"]["load"] == 0.0
    desk.ask("bitrate", bitrate=None)
    assert desk.ask("status")["result"]["bitrate"] is None


@pytest.mark.parametrize(
    ("method", "params", "kind", "message"),
    [
        ("fly", {}, "LocalProtocolError", "no method 'fly'; available: status, cut"),
        ("cut", {}, "LocalProtocolError", "cut: Object missing required field `label`"),
        ("cut", {"label": 5}, "LocalProtocolError", "Expected `str`, got `int` - at `$.label`"),
        ("cut", {"label": "left", "who": 1}, "LocalProtocolError", "unknown field `who`"),
        ("cut", {"label": "middle"}, "ConfigError", "no member called 'middle' on local:robby; available: left, right"),
        ("cut", {"label": ""}, "ConfigError", "no member called ''"),
        ("delay", {}, "LocalProtocolError", "missing required field `ms`"),
        ("delay", {"ms": -1}, "LocalProtocolError", "Expected `int` >= 0 - at `$.ms`"),
        ("delay", {"ms": True}, "LocalProtocolError", "Expected `int`, got `bool` - at `$.ms`"),
        ("drop", {"count": 0}, "LocalProtocolError", "Expected `int` >= 1 - at `$.count`"),
        ("bitrate", {"bitrate": 8_000_000}, "LocalProtocolError", "Expected `int` <= 1000000 - at `$.bitrate`"),
        ("error_frame", {"kind": "sparks"}, "LocalProtocolError", "Invalid enum value 'sparks' - at `$.kind`"),
    ],
)
def test_a_wrong_request_is_answered_with_a_sentence_and_changes_nothing(desk, method, params, kind, message):
    before = desk.ask("status")
    answer = desk.ask(method, **params)
    assert message in answer["error"]["message"]
    assert answer["error"]["kind"] == kind
    assert desk.ask("status") == before


values = st.recursive(st.none() | st.booleans() | st.integers() | st.text(max_size=9), st.lists, max_leaves=3)


@given(st.dictionaries(st.sampled_from(["method", "params"]), values | st.sampled_from(["cut", "delay"])))
@settings(max_examples=examples(50))
def test_every_message_is_answered_once(shared, message):
    (answer,) = shared.tell(json.dumps({**message, "id": 1}).encode() + b"\n")
    assert set(answer) in ({"id", "result"}, {"id", "error"})


@given(
    st.sampled_from(list(HUB.methods)),
    st.dictionaries(st.sampled_from(["label", "ms", "every", "count", "can_id", "bitrate", "kind"]), values),
)
def test_no_parameters_end_it(shared, method, params):
    assert len(shared.ask(method, **params)) == 1
