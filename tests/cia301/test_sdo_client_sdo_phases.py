"""What each phase of an SDO request makes of frames that are no answer to it, and of those that may be one."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.sdo import MS, NODE

from canopen_control.cia301.sdo_client import first_phase
from canopen_control.cia301.sdo_exchange import SdoExchange, SdoOptions, SdoRequest

HALF = 500 * MS
REQUESTS = {
    "AwaitingUpload": lambda: SdoRequest(0x2000, 0, None, HALF),
    "AwaitingBlockUpload": lambda: SdoRequest(0x2000, 0, None, HALF, True),
    "AwaitingDownload": lambda: SdoRequest(0x2000, 0, bytes(9), HALF),
    "AwaitingBlockDownload": lambda: SdoRequest(0x2000, 0, bytes(900), HALF, True),
}
PHASES = pytest.mark.parametrize("phase", REQUESTS)


def waiting(phase, *, sent=True):
    exchange = SdoExchange(NODE, "", 1, SdoOptions(), 0x603, first_phase)
    exchange.start(REQUESTS[phase](), 0)
    assert type(exchange.phase).__name__ == phase
    if sent:
        exchange.out.clear()
    return exchange


@PHASES
@pytest.mark.parametrize("command", range(0x80))
def test_an_answer_about_another_object_is_counted_and_changes_nothing(phase, command):
    exchange = waiting(phase)
    exchange.receive(bytes((command, 0x01, 0x20, 0, 1, 0, 0, 0)), 1)
    assert (exchange.ignored, type(exchange.phase).__name__, exchange.out) == (1, phase, [])


@PHASES
@pytest.mark.parametrize("command", [0x4F, 0x41, 0x60, 0x80, 0xA4, 0xC6])
def test_what_comes_before_the_request_has_left_is_no_answer_to_it(phase, command):
    exchange = waiting(phase, sent=False)
    exchange.receive(bytes((command, 0x00, 0x20, 0, 1, 0, 0, 0)), 1)
    assert (exchange.ignored, type(exchange.phase).__name__, len(exchange.out)) == (1, phase, 1)


@given(st.sampled_from(list(REQUESTS)), st.lists(st.binary(min_size=1, max_size=8), max_size=12))
def test_whatever_the_server_sends_the_request_ends_once_or_goes_on_with_a_deadline(phase, answers):
    exchange = waiting(phase)
    for now, answer in enumerate(answers):
        if now % 2:  # about the object that was asked for
            answer = (answer[:1] + b"\x00\x20\x00" + answer[4:]).ljust(8, b"\0")
        exchange.receive(answer, now)
        exchange.out.clear()
        assert len(exchange.finished) == (exchange.active is None)
        assert (exchange.deadline is None) is (exchange.active is None)
        assert exchange.active is not None or type(exchange.phase).__name__ == "Phase"
