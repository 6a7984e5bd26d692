import pytest

from canopen_control.client.stream import outpaced, stream_rate
from canopen_control.rpc.messages.state import ControllerReading, CycleTimes


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
