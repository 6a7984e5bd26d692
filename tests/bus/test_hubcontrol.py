"""What a hub answers to requests, right and wrong ones."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.bus.exchange import Exchange
from canopen_control.bus.hubcontrol import ERROR_KINDS, Control
from canopen_control.frame import CanFrame, frames_of, pack_records


class Desk:
    def __init__(self):
        self.exchange = Exchange()
        self.now = 5_000_000_000
        self.after = 0
        self.control = Control("robby", self.exchange, lambda: self.now, self._after)
        self.left, self.right = self.exchange.join("left", 11), self.exchange.join("right", 12)

    def _after(self):
        self.after += 1

    def ask(self, method, **params):
        return self.control.handle({"id": 1, "method": method, "params": params})


@pytest.fixture
def desk():
    return Desk()


def test_the_status_says_who_is_there_and_what_is_wrong(desk):
    desk.exchange.receive(desk.left, pack_records([CanFrame(0x181)] * 3), 0)
    desk.ask("cut", label="right")
    desk.ask("drop", label="left", can_id=0x181, every=2, count=4)
    desk.ask("delay", ms=5)
    desk.now += 1_500_000_000
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
def test_a_label_is_silenced_and_speaks_again(desk, on, off, field):
    assert desk.ask(on, label="left") == {"result": None}
    assert desk.left.silent
    assert desk.ask("status")["result"][field] == ["left"]
    assert desk.ask(off, label="left") == {"result": None}
    assert not desk.left.silent
    assert desk.after == 3  # each answered request


@pytest.mark.parametrize("kind", sorted(ERROR_KINDS))
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
    ("method", "params", "message"),
    [
        ("fly", {}, "no method 'fly'; there are: status, cut"),
        ("cut", {}, "label is missing or no text"),
        ("cut", {"label": 5}, "label is missing or no text"),
        ("cut", {"label": "middle"}, "nobody called 'middle' on local:robby; there are: left, right"),
        ("delay", {}, "delay wants ms"),
        ("delay", {"ms": -1}, "ms is no integer from 0 to 60000: -1"),
        ("delay", {"ms": True}, "ms is no integer"),
        ("drop", {"count": 0}, "count is no integer from 1"),
        ("bitrate", {"bitrate": 8_000_000}, "bitrate is no integer from 0 to 1000000"),
        ("error_frame", {"kind": "sparks"}, "no error frame 'sparks'; there are: bus-error"),
    ],
)
def test_a_wrong_request_is_answered_with_a_sentence_and_changes_nothing(desk, method, params, message):
    before = desk.ask("status")
    answer = desk.ask(method, **params)
    assert message in answer["error"]["message"]
    assert answer["error"]["kind"] == "ConfigError"
    assert desk.ask("status") == before


def test_a_request_without_id_is_done_and_not_answered(desk):
    class Connection:
        sent = []  # noqa: RUF012 - one use

        def send(self, message):
            self.sent.append(message)

    desk.control.on_connect(Connection())
    desk.control.on_message(Connection(), {"method": "cut", "params": {"label": "left"}})
    desk.control.on_message(Connection(), {"id": "x", "method": "uncut", "params": {"label": "left"}})
    assert [sorted(message) for message in Connection.sent] == [["hello"], ["id", "result"]]
    assert not desk.left.silent


values = st.recursive(st.none() | st.booleans() | st.integers() | st.text(max_size=9), st.lists, max_leaves=3)


@given(st.dictionaries(st.sampled_from(["id", "method", "params"]), values | st.sampled_from(["cut", "delay"])))
def test_no_message_raises(message):
    answer = Desk().control.handle(message)
    assert set(answer) <= {"result", "error"}


@given(
    st.sampled_from(["cut", "uncut", "drop", "delay", "bitrate", "error_frame", "restart"]),
    st.dictionaries(st.sampled_from(["label", "ms", "every", "count", "can_id", "bitrate", "kind"]), values),
)
def test_no_parameters_raise(method, params):
    assert len(Desk().ask(method, **params)) == 1
