from collections import deque

import pytest
from support.samples import event_of

from canopen_control.client.robot_client import EventStream, outpaced, stream_rate
from canopen_control.errors import RemoteError
from canopen_control.rpc.messages.robot import Subscribe
from canopen_control.rpc.messages.state import ControllerReading, CycleTimes, EventDetails, StateSample


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
    assert [(each.kind, each.details) for each in stream] == [("a", None), ("b", EventDetails(error_code=1))]
    assert client.timeout == 0.5
    assert client.closed == 1


def test_the_end_of_the_robot_is_its_last_event():
    client = Client(event("stopped"), RemoteError("BusClosed", "gone"))
    assert [each.kind for each in EventStream(client)] == ["stopped"]


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
    ("cycle_ms", "wanted", "rate"),
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
def test_a_subscription_gets_a_whole_number_of_cycles(cycle_ms, wanted, rate):
    assert stream_rate(CycleTimes(period_s=cycle_ms / 1000), wanted) == pytest.approx(rate)


def test_who_publishes_more_often_than_the_state_comes_is_named():
    fast = ControllerReading(name="states", type="", state="active", publish_rate=200.0)
    base = ControllerReading(name="base", type="", state="active", publish_rate=50.0)
    assert outpaced([fast, base], 200.0) is None
    assert outpaced([fast, base], 100.0) == (
        "states (200 Hz): published more often than the state comes, 100 Hz; what is between is left out"
    )
    assert "states (200 Hz), base (50 Hz)" in str(outpaced([fast, base], 20.0))
