"""Attempts of an SDO request: continuation, repetition and end."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.sdo import MS, NODE, frame

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.sdo_client import SdoClient, first_phase
from canopen_control.cia301.sdo_exchange import (
    BLOCK_ERRORS,
    LateAnswerGuard,
    RetryBudget,
    SdoOptions,
    SdoRequest,
    SdoTransfer,
    completed,
    initiate,
    initiate_block,
)
from canopen_control.errors import BusClosed, LocalProtocolError, SdoAbort, SdoTimeout
from canopen_control.frame import CanFrame

MS_OF_SDO_REQUEST = 1_000_000


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
    while (until := budget.pause(AbortCode.DEVICE_STATE, 3000 * MS_OF_SDO_REQUEST, now)) is not None:
        pauses.append((until - now) // MS_OF_SDO_REQUEST)
        now = until
    assert pauses == [20, 40, 80, 160, 320, 500, 500, 500, 500]
    assert budget.pause(AbortCode.NO_OBJECT, 3000 * MS_OF_SDO_REQUEST, now) is None


X, Y, TYPE, REGISTER = b"\0\x20\0", b"\1\x20\0", b"\0\x10\0", b"\1\x10\0"


def late(*muxes):
    guard = LateAnswerGuard()
    for mux in muxes:
        guard.add(mux)
    return guard


def test_an_answer_settles_all_that_was_asked_before():
    guard = late(X, Y)
    guard.answered(TYPE)
    assert not guard.pending


def test_an_answer_that_may_be_late_settles_only_what_was_asked_before_the_first_of_its_kind():
    guard = late(X, TYPE, Y, TYPE)
    guard.answered(TYPE)
    assert list(guard.pending) == [TYPE, Y]


def test_the_flush_request_is_for_an_object_that_is_not_pending():
    assert late(X).flush_request()[1:4] == TYPE
    assert late(X, TYPE).flush_request()[1:4] == REGISTER
    assert late(REGISTER).flush_request()[1:4] == TYPE


def test_with_both_pending_the_later_one_settles_more():
    assert late(TYPE, X, REGISTER).flush_request()[1:4] == REGISTER
    assert late(REGISTER, X, TYPE).flush_request()[1:4] == TYPE


def test_two_flush_requests_settle_everything_whatever_the_order():
    guard = late(TYPE, REGISTER, X)
    for _ in range(2):
        guard.answered(guard.flush_request()[1:4])
    assert not guard.pending


OPTIONS = SdoOptions()


def request(length=None):
    return SdoRequest(0x2001, 2, None if length is None else bytes(length), 1)


def first_frame(request, options, block):
    return initiate_block(request, options) if block else initiate(request, options)


@pytest.mark.parametrize(
    ("length", "block", "first"),
    [
        (None, False, "4001200200000000"),
        (0, False, "2101200200000000"),
        (1, False, "2F01200200000000"),
        (4, False, "2301200200000000"),
        (5, False, "2101200205000000"),
        (None, True, "A40120027F000000"),
        (5, True, "C601200205000000"),
    ],
)
def test_the_first_frame(length, block, first):
    assert first_frame(request(length), OPTIONS, block).hex().upper() == first


@pytest.mark.parametrize(
    ("length", "block", "first"), [(1, False, "22"), (5, False, "20"), (5, True, "C0"), (None, True, "A0")]
)
def test_the_first_frame_of_a_client_that_offers_nothing(length, block, first):
    options = SdoOptions(announce_size=False, crc=False)
    data = first_frame(request(length), options, block)
    assert data[0] == int(first, 16)
    assert data[4:] in (bytes(4), b"\x7f\0\0\0")


@pytest.mark.parametrize(
    ("data", "whole"),
    [
        ("60012000", True),
        ("600120", False),
        ("4F01200005", True),
        ("4F012000", False),
        ("4B0120000506", True),
        ("4B01200005", False),
        ("8001200000000206", True),
        ("80012000000002", False),
        ("41012000090000", False),
        ("A1", False),
        ("", False),
        ("430120000102030405", False),
    ],
)
def test_a_cut_frame_is_whole_if_no_byte_that_counts_is_missing(data, whole):
    filled = completed(bytes.fromhex(data))
    assert filled == (bytes.fromhex(data).ljust(8, b"\0") if whole else b"")


HALF = 500 * MS


@pytest.fixture
def exchange():
    return SdoTransfer(NODE, "", 1, SdoOptions(), 0x603, first_phase)


def test_an_idle_exchange_ignores_everything(exchange):
    for command in range(256):
        exchange.receive(bytes((command, 0, 0x20, 0, 0, 0, 0, 0)), 0)
    exchange.tick(HALF)
    exchange.cancel(BusClosed("vcan0"))
    assert (exchange.out, exchange.finished, exchange.deadline) == ([], [], None)
    assert exchange.ignored == 256


def test_the_abort_of_a_cancelled_transfer_leaves_although_the_next_is_cancelled_too():
    client = SdoClient(NODE)
    requests = [client.write(0x2000, 0, bytes(20), block=True, now=0), client.read(0x2001, now=0)]
    client.frames()
    client.receive(frame("583#A40020007F000000"), 0)
    for request in requests:
        client.cancel(request, BusClosed("vcan0"))
    assert [str(one) for one in client.frames()] == ["603#8000200000000008"]


def test_segments_that_is_not_needed_any_more_do_not_leave():
    client = SdoClient(NODE)
    client.write(0x2000, 0, bytes(800), block=True, now=0)
    client.frames()
    client.receive(frame("583#A40020007F000000"), 0)
    client.tick(HALF)
    assert [one.data[0] for one in client.frames()] == [0x80, 0x40]


def test_a_late_abort_without_a_multiplexer_is_not_the_next_requests():
    client = SdoClient(NODE, retries=0)
    client.read(0x1008, now=0)
    client.frames()
    client.tick(HALF)
    request = client.read(0x6064, now=HALF)
    client.frames()
    client.receive(frame("583#8000000001000405"), HALF)
    assert not request.done


def test_each_answer_leads_to_the_phase_that_has_a_name(exchange):
    def phase(data=""):
        exchange.out.clear()
        if data:
            exchange.receive(bytes.fromhex(data), 1)
        return type(exchange.phase).__name__

    assert phase() == "Phase"
    exchange.start(SdoRequest(0x2000, 0, None, HALF), 0)
    assert phase() == "AwaitingUpload"
    assert phase("4100200009000000") == "Transferring"
    exchange.cancel(BusClosed("vcan0"))  # its answer is still owed: the object is in quarantine
    exchange.start(SdoRequest(0x2000, 0, None, HALF), 2)
    assert phase() == "FlushingLateAnswers"
    assert phase("80001000 00000206") == "AwaitingUpload"
    assert phase("80002000 21000008") == "Pausing"
    exchange.tick(exchange.deadline)
    assert phase() == "AwaitingUpload"
    assert phase("80002000 00000206") == "Phase"
    exchange.start(SdoRequest(0x2001, 0, bytes(9), HALF, True), 3)
    assert phase() == "AwaitingBlockDownload"
    assert phase("80012000 01000405") == "AwaitingDownload"  # the server has no block transfer, so segments are used
    assert exchange.block_supported is False


HALF = 500 * MS


def started(*, retries=1, block=False):
    exchange = SdoTransfer(NODE, "", retries, SdoOptions(), 0x603, first_phase)
    request = SdoRequest(0x2000, 0, None, HALF, block)
    exchange.start(request, 0)
    return exchange, request


def test_a_refused_request_ends_with_the_servers_code():
    exchange, request = started()
    exchange.handle_abort(request, AbortCode.NO_OBJECT, 1)
    assert isinstance(request.error, SdoAbort)
    assert (request.error.code, exchange.active, exchange.retried) == (AbortCode.NO_OBJECT, None, 0)


@pytest.mark.parametrize("code", sorted(BLOCK_ERRORS))
def test_what_blocks_cannot_do_is_done_again_in_segments_and_only_once(code):
    exchange, request = started(block=True)
    exchange.handle_abort(request, code, 1)
    assert (exchange.retried, exchange.phase.block, request.done) == (1, False, False)
    assert (exchange.block_supported is False) is (code == AbortCode.UNKNOWN_COMMAND)
    exchange.handle_abort(request, code, 2)
    assert request.done


def test_a_try_that_timed_out_leaves_an_abort_and_its_object_in_quarantine():
    exchange, request = started(retries=0)
    exchange.out.clear()
    exchange.handle_timeout(request, HALF)
    assert isinstance(request.error, SdoTimeout)
    assert [str(frame) for frame in exchange.out] == ["603#8000200000000405"]
    assert b"\x00\x20\x00" in exchange.late_answers.pending


@given(st.integers(0, 3), st.booleans(), st.lists(st.sampled_from([0, *AbortCode]), max_size=40))
def test_whatever_goes_wrong_a_request_is_not_tried_for_ever(retries, block, troubles):
    exchange, request = started(retries=retries, block=block)
    for now, code in enumerate(troubles, 1):
        if request.done:
            break
        if code:
            exchange.handle_abort(request, code, now)
        else:
            exchange.handle_timeout(request, now)
        assert exchange.finished == ([request] if request.done else [])
        assert (exchange.active is None) is request.done
    assert exchange.retried <= retries + 10


def broken_off(index, abort=None):
    """Begin a block download of an object, let the server fall silent or abort, and return client and request."""
    client = SdoClient(5, timeout_ns=100, retries=1)
    request = client.write(index, 1, bytes(2000), block=True, now=0)
    client.frames()
    client.receive(CanFrame(0x585, bytes((0xA4, index & 0xFF, index >> 8, 1, 127, 0, 0, 0))), 1)
    assert len(client.frames()) == 127
    if abort is not None:
        client.receive(CanFrame(0x585, bytes((0x80, index & 0xFF, index >> 8, 1)) + abort.to_bytes(4, "little")), 2)
    else:
        while not request.done and not client.retried:
            client.tick(client.next_deadline())
    return client, request


def test_the_data_of_a_program_that_broke_off_are_not_sent_again():
    client, request = broken_off(0x1F50)
    assert isinstance(request.error, SdoTimeout)
    assert client.retried == 0
    client, request = broken_off(0x2000)
    assert (request.done, client.retried) == (False, 1)  # in segments


def test_a_block_of_a_program_that_was_refused_is_not_sent_again_and_the_next_time_goes_in_segments():
    client, request = broken_off(0x1F50, 0x05040004)  # CRC error
    assert isinstance(request.error, SdoAbort)
    assert (client.retried, client.block_supported) == (0, False)
    client, request = broken_off(0x1F50, 0x08000022)
    assert isinstance(request.error, SdoAbort)
    assert (client.retried, client.block_supported) == (0, True)


def test_a_server_without_block_transfer_gets_a_program_in_segments():
    client = SdoClient(5, timeout_ns=100, retries=1)
    request = client.write(0x1F50, 1, bytes(2000), block=True, now=0)
    client.frames()
    client.receive(CanFrame(0x585, bytes((0x80, 0x50, 0x1F, 1)) + (0x05040001).to_bytes(4, "little")), 1)
    assert (request.done, client.retried, client.block_supported) == (False, 1, False)
