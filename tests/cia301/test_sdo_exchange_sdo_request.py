from __future__ import annotations

import pytest

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.sdo_exchange import RetryBudget, SdoOptions, SdoRequest
from canopen_control.errors import LocalProtocolError

MS = 1_000_000


@pytest.mark.parametrize("size", [0, 128, -1])
def test_an_impossible_block_size_is_refused(size):
    with pytest.raises(LocalProtocolError, match="1 to 127"):
        SdoOptions(block_size=size)


@pytest.mark.parametrize("threshold", [-1, 256])
def test_an_impossible_switch_threshold_is_refused(threshold):
    with pytest.raises(LocalProtocolError, match="one byte"):
        SdoOptions(switch_threshold=threshold)


def test_a_write_of_nothing_is_a_write():
    request = SdoRequest(0x2000, 0, b"", 1)
    assert request.is_write
    assert repr(request) == "<SdoRequest write 0x2000:00 open>"


def test_timeouts_and_toggle_errors_are_counted_apart():
    budget = RetryBudget(1)
    timeouts = [budget.has_try(AbortCode.TIMED_OUT) for _ in range(2)]
    toggles = [budget.has_try(AbortCode.TOGGLE_NOT_ALTERNATED) for _ in range(3)]
    assert (timeouts, toggles) == ([True, False], [True, True, False])
    assert not budget.has_try(AbortCode.NO_OBJECT)


def test_the_pause_never_leaves_the_time_for_it():
    budget = RetryBudget(1)
    now, pauses = 0, []
    while (until := budget.pause(AbortCode.DEVICE_STATE, 3000 * MS, now)) is not None:
        pauses.append((until - now) // MS)
        now = until
    assert pauses == [20, 40, 80, 160, 320, 500, 500, 500, 500]
    assert budget.pause(AbortCode.NO_OBJECT, 3000 * MS, now) is None
