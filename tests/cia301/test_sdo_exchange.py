"""How a try of an SDO request goes on, is made again or ends."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.sdo import MS, NODE, MemoryStore, frame

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.sdo_client import SdoClient, first_phase
from canopen_control.cia301.sdo_exchange import BLOCK_ERRORS, SdoExchange, SdoOptions, SdoRequest
from canopen_control.cia301.sdo_server import SdoServer
from canopen_control.errors import BusClosed, SdoAbort, SdoTimeout
from canopen_control.frame import CanFrame

HALF = 500 * MS


@pytest.fixture
def exchange():
    return SdoExchange(NODE, "", 1, SdoOptions(), 0x603, first_phase)


def test_an_idle_exchange_ignores_everything(exchange):
    for command in range(256):
        exchange.receive(bytes((command, 0, 0x20, 0, 0, 0, 0, 0)), 0)
    exchange.tick(HALF)
    exchange.cancel(BusClosed("vcan0"))
    assert (exchange.out, exchange.finished, exchange.deadline) == ([], [], None)
    assert exchange.ignored == 256


def test_a_request_that_ends_leaves_it_idle(exchange):
    request = SdoRequest(0x2000, 0, None, HALF)
    exchange.start(request, 0)
    exchange.out.clear()
    exchange.receive(bytes.fromhex("4F00200005000000"), 7)
    assert (exchange.active, exchange.deadline, exchange.finished) == (None, None, [request])
    assert (request.data, request.elapsed_ns) == (b"\5", 7)


def test_a_list_that_was_handed_out_is_the_callers():
    client, server = SdoClient(NODE), SdoServer(NODE, MemoryStore())
    for core in (client, server):
        taken, happened = core.frames(), core.events()
        taken.append(frame("080#"))
        happened.append("something else")
        assert (core.frames(), core.events()) == ([], [])


def test_the_abort_of_a_cancelled_transfer_leaves_although_the_next_is_cancelled_too():
    client = SdoClient(NODE)
    requests = [client.write(0x2000, 0, bytes(20), block=True, now=0), client.read(0x2001, now=0)]
    client.frames()
    client.receive(frame("583#A40020007F000000"), 0)
    for request in requests:
        client.cancel(request, BusClosed("vcan0"))
    assert [str(one) for one in client.frames()] == ["603#8000200000000008"]


def test_segments_that_nobody_wants_any_more_do_not_leave():
    client = SdoClient(NODE)
    client.write(0x2000, 0, bytes(800), block=True, now=0)
    client.frames()
    client.receive(frame("583#A40020007F000000"), 0)
    client.tick(HALF)
    assert [one.data[0] for one in client.frames()] == [0x80, 0x40]


def test_a_server_that_aborts_because_it_waited_too_long_is_asked_once_more():
    client = SdoClient(NODE)
    request = client.read(0x1008, now=0)
    for _ in range(2):
        client.frames()
        client.receive(frame("583#4108100009000000"), 0)
        client.frames()
        client.receive(frame("583#8008100000000405"), 0)
    assert request.error.code == 0x05040000
    assert client.retried == 1


def test_a_probe_is_settled_by_the_right_object_only():
    client = SdoClient(NODE)
    client.read(0x6064, now=0)
    client.frames()
    client.tick(HALF)
    client.frames()
    for answer in ("583#4F01100000000000", "583#6000100000000000", "583#8064600000000206"):
        client.receive(frame(answer), HALF)
    assert (client.frames(), client.ignored) == ([], 3)


def test_a_device_type_that_comes_in_segments_settles_too():
    client = SdoClient(NODE)
    client.read(0x6064, now=0)
    client.frames()
    client.tick(HALF)
    client.frames()
    client.receive(frame("583#4100100004000000"), HALF)
    assert [str(one) for one in client.frames()] == ["603#4064600000000000"]


def test_a_late_abort_without_a_multiplexer_is_not_the_next_requests():
    client = SdoClient(NODE, retries=0)
    client.read(0x1008, now=0)
    client.frames()
    client.tick(HALF)
    request = client.read(0x6064, now=HALF)
    client.frames()
    client.receive(frame("583#8000000001000405"), HALF)
    assert not request.done


def test_a_block_upload_answered_plainly_is_a_plain_upload():
    client = SdoClient(NODE)
    request = client.read(0x1018, 1, block=True, now=0)
    client.frames()
    client.receive(frame("583#4318100186020000"), 0)
    assert request.data == b"\x86\2\0\0"


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
    assert phase() == "Probing"
    assert phase("80001000 00000206") == "AwaitingUpload"
    assert phase("80002000 21000008") == "Pausing"
    exchange.tick(exchange.deadline)
    assert phase() == "AwaitingUpload"
    assert phase("80002000 00000206") == "Phase"
    exchange.start(SdoRequest(0x2001, 0, bytes(9), HALF, True), 3)
    assert phase() == "AwaitingBlockDownload"
    assert phase("80012000 01000405") == "AwaitingDownload"  # the server knows no blocks: in segments then
    assert exchange.block_supported is False


HALF = 500 * MS


def started(*, retries=1, block=False):
    exchange = SdoExchange(NODE, "", retries, SdoOptions(), 0x603, first_phase)
    request = SdoRequest(0x2000, 0, None, HALF, block)
    exchange.start(request, 0)
    return exchange, request


def test_a_refused_request_ends_with_the_servers_code():
    exchange, request = started()
    exchange.refused(request, AbortCode.NO_OBJECT, 1)
    assert isinstance(request.error, SdoAbort)
    assert (request.error.code, exchange.active, exchange.retried) == (AbortCode.NO_OBJECT, None, 0)


@pytest.mark.parametrize("code", sorted(BLOCK_ERRORS))
def test_what_blocks_cannot_do_is_done_again_in_segments_and_only_once(code):
    exchange, request = started(block=True)
    exchange.refused(request, code, 1)
    assert (exchange.retried, exchange.phase.block, request.done) == (1, False, False)
    assert (exchange.block_supported is False) is (code == AbortCode.UNKNOWN_COMMAND)
    exchange.refused(request, code, 2)
    assert request.done


def test_a_try_that_timed_out_leaves_an_abort_and_its_object_in_quarantine():
    exchange, request = started(retries=0)
    exchange.out.clear()
    exchange.timed_out(request, HALF)
    assert isinstance(request.error, SdoTimeout)
    assert [str(frame) for frame in exchange.out] == ["603#8000200000000405"]
    assert b"\x00\x20\x00" in exchange.quarantine.owed


@given(st.integers(0, 3), st.booleans(), st.lists(st.sampled_from([0, *AbortCode]), max_size=40))
def test_whatever_goes_wrong_a_request_is_not_tried_for_ever(retries, block, troubles):
    exchange, request = started(retries=retries, block=block)
    for now, code in enumerate(troubles, 1):
        if request.done:
            break
        if code:
            exchange.refused(request, code, now)
        else:
            exchange.timed_out(request, now)
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


def test_a_server_that_knows_no_blocks_gets_a_program_in_segments():
    client = SdoClient(5, timeout_ns=100, retries=1)
    request = client.write(0x1F50, 1, bytes(2000), block=True, now=0)
    client.frames()
    client.receive(CanFrame(0x585, bytes((0x80, 0x50, 0x1F, 1)) + (0x05040001).to_bytes(4, "little")), 1)
    assert (request.done, client.retried, client.block_supported) == (False, 1, False)
