import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.virtual.virtual_drive import OverloadGuard

MS = 1_000_000


def tripped(torque, seconds, guard=None, every=10):
    """Return after how many seconds of a torque it is too hot, None: not at all."""
    guard = guard or OverloadGuard()
    for now in range(0, round(seconds * 1000) + 1, every):
        if guard.exceeded(torque, 1000 * MS + now * MS):
            return now / 1000
    return None


@pytest.mark.parametrize(("torque", "after"), [(2000.0, 2.0), (-3000.0, 0.75), (1500.0, 4.8)])
def test_more_than_the_rated_torque_is_taken_for_a_time(torque, after):
    assert tripped(torque, 10.0) == pytest.approx(after, abs=0.03)


@given(st.floats(-1000.0, 1000.0))
def test_the_rated_torque_is_taken_for_ever(torque):
    assert tripped(torque, 100.0, every=50) is None


def test_it_cools_down():
    guard = OverloadGuard()
    assert tripped(2000.0, 1.8, guard) is None
    hot = guard.heat
    for now in range(0, 3000, 10):
        guard.exceeded(0.0, 10_000 * MS + now * MS)
    assert guard.heat < hot - 2.5


def test_a_pause_without_power_counts_as_rest_whatever_the_torque_was_before():
    guard = OverloadGuard()
    tripped(2000.0, 1.8, guard)
    assert not guard.exceeded(2000.0, 60_000 * MS)
    assert guard.heat == 0.0
