from __future__ import annotations

from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.sdo import MS, NODE, SECOND, Line, MemoryStore, conversations, frame, play_client

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.sdo_client import SdoClient, first_phase
from canopen_control.cia301.sdo_exchange import SdoOptions, SdoRequest, SdoTransfer
from canopen_control.cia301.sdo_server import SdoServer
from canopen_control.errors import BusClosed, LocalProtocolError, SdoAbort, SdoCancelled, SdoLengthError, SdoTimeout
from canopen_control.od.model import DataType, Entry

CONVERSATIONS = conversations("""
a doubled segment is taken once
    read 1008 > 400810 < 4108100009 > 60 < 00544D434D2D3132 > 70 <! 00544D434D2D3132 < 1B3730 = 544D434D2D31323730
an upload may end with an empty segment, as those of node-canopen 6.2.1 do
    read 1008 > 400810 < 4108100009 > 60 < 00544D434D2D3132 > 70 < 1A3730 > 60 < 0F = 544D434D2D31323730
a segment doubled before the next request has left is ignored
    read 1008 > 400810 < 4108100009 > 60 < 00544D434D2D3132 <! 00544D434D2D3132 <! 00544D434D2D3132 > 70 < 1B3730
        = 544D434D2D31323730
a toggle error in the first segment aborts and starts again
    read 1008 > 400810 < 4108100009 > 60 < 10544D434D2D3132 > 8008100000000305 > 400810 = open
a toggle error of another segment with the old toggle aborts and starts again
    read 1008 > 400810 < 4108100009 > 60 < 00544D434D2D3132 > 70 < 0B3730 > 8008100000000305 > 400810 = open
a toggle error of more than a copy aborts and starts again
    read 1008 > 400810 < 4108100009 > 60 < 00544D434D2D3132 > 70 <! 00544D434D2D3132 < 00544D434D2D3132
        > 8008100000000305 > 400810 = open
after two restarts a toggle error is final
    read 1008 > 400810 < 4108100009 > 60 < 10544D434D2D3132 > 8008100000000305 > 400810 < 4108100009 > 60
        < 10544D434D2D3132 > 8008100000000305 > 400810 < 4108100009 > 60 < 10544D434D2D3132 > 8008100000000305
        = abort 05030000
the server's toggle abort starts again too
    write 1008 #20 > 2108100014 < 600810 > 0000010203040506 < 8008100000000305 > 2108100014 = open
silence after a copy is a toggle error
    read 1008 > 400810 < 4108100015 > 60 < 00 > 70 <! 00 +500 > 8008100000000305 > 400010 = open
a lost segment times out and the transfer starts again, after a request that settles late answers
    read 1008 > 400810 < 4108100015 > 60 < 00 > 70 +500 > 8008100000000405 > 400010 < 43001000920104 > 400810 = open
more bytes than announced end the transfer
    read 1008 > 400810 < 4108100008 > 60 < 00544D434D2D3132 > 70 < 1B3730 > 8008100012000706 = abort 06070012
fewer bytes than announced end the transfer
    read 1008 > 400810 < 410810000A > 60 < 00544D434D2D3132 > 70 < 1B3730 > 8008100013000706 = abort 06070013
an empty segment that is not the last ends the transfer
    read 1008 > 400810 < 400810 > 60 < 0E > 8008100000000008 = abort 08000000
a size that was not announced is what comes
    read 1008 > 400810 < 400810 > 60 < 00544D434D2D3132 > 70 < 1B3730 = 544D434D2D31323730
an empty object is written with one empty segment
    write 1008 #0 > 210810 < 600810 > 0F < 20 = written
a doubled acknowledgement skips nothing
    write 1008 #20 > 2108100014 < 600810 > 0000010203040506 < 20 > 100708090A0B0C0D <! 20 < 30 > 030E0F10111213 = open
a wrong toggle in the first acknowledgement is an error
    write 1008 #20 > 2108100014 < 600810 > 0000010203040506 < 30 > 8008100000000305 > 2108100014 = open
a second copy of an acknowledgement is an error
    write 1008 #20 > 2108100014 < 600810 > 0000010203040506 < 20 > 100708090A0B0C0D <! 20 < 20 > 8008100000000305
        > 2108100014 = open
the abort after a timeout carries the true multiplexer
    read 6064:12 > 40646012 +500 > 8064601200000405 > 400010 = open
without retries the first timeout is the last
    retries=0 read 6064 > 406460 +500 > 8064600000000405 = SdoTimeout
a late answer is not that of the retry
    read 6064 > 406460 +500 > 8064600000000405 > 400010 <! 43646000FF < 43001000920104 > 406460 < 4364600001
        = 01000000
the device type itself is settled by the error register
    read 1000 > 400010 +500 > 8000100000000405 > 400110 = open
an abort settles late answers as well as a value
    read 6064 > 406460 +500 > 8064600000000405 > 400010 < 8000100000000206 > 406460 = open
late answers are settled by the right object only
    read 6064 > 406460 +500 > 8064600000000405 > 400010 <! 4F0110 <! 600010 <! 8064600000000206 = open
a device type that comes in segments settles too
    read 6064 > 406460 +500 > 8064600000000405 > 400010 < 4100100004 > 406460 = open
an acknowledgement for another object is ignored
    write 6040 0600 > 2B40600006 <! 60406001 <! 604160 <! 4B4060 < 604060 = written
an abort without a multiplexer ends the transfer under way
    read 1008 > 400810 < 4108100009 > 60 < 8000000000000008 = abort 08000000
a server that aborts because it waited too long is asked once more
    read 1008 > 400810 < 4108100009 > 60 < 8008100000000405 > 400810 < 4108100009 > 60 < 8008100000000405
        = abort 05040000
with no patience the first "not now" is the answer
    busy_ns=0 write 6060 03 > 2F60600003 < 8060600022000008 = abort 08000022
an object that does not exist is not asked for again
    write 6060 03 > 2F60600003 < 8060600000000206 = abort 06020000
a read-only object is not written again
    write 6060 03 > 2F60600003 < 8060600002000106 = abort 06010002
an impossible value is not written again
    write 6060 03 > 2F60600003 < 8060600030000906 = abort 06090030
a wrong length is not written again
    write 6060 03 > 2F60600003 < 8060600012000706 = abort 06070012
answers within the pause are ignored
    write 6060 03 > 2F60600003 < 8060600022000008 <! 606060 <! 8060600000000206 = open
an object that does not report its size is stopped at the limit
    max_size=10 read 1008 > 400810 < 400810 > 60 < 0001020304050607 > 70 < 1001020304050607 > 8008100005000405
        = abort 05040005
an object over the limit is refused
    max_size=100 read 1008 > 400810 < 4108100065 > 8008100005000405 = abort 05040005
an object over the limit is refused in blocks
    max_size=100 block-read 1008 > A40810007F < C608100065 > 8008100005000405 = abort 05040005
an expedited write may leave its length open
    announce_size=0 write 6040 0600 > 2240600006 = open
an answer that is not an upload ends it
    read 6041 > 404160 < 5E4160004006 > 8041600001000405 = abort 05040001
a refusal of blocks that names no object counts
    block-write 2000 #5 > C600200005 < 8000000001000405 > 2100200005 = open
a server that keeps silent about block transfer is asked plainly
    block-write 2000 #5 > C600200005 +500 > 8000200000000405 > 400010 < 43001000920104 > 2100200005 = open
a refusal of the object is final
    block-write 2000 #5 > C600200005 < 8000200002000106 = abort 06010002
a server that asks for blocks of no segment is served in segments
    block-write 2000 #5 > C600200005 < A40020 > 8000200002000405 > 2100200005 = open
a server that asks for blocks of 128 segments is served in segments
    block-write 2000 #5 > C600200005 < A400200080 > 8000200002000405 > 2100200005 = open
a server that asks for blocks of 255 segments is served in segments
    block-write 2000 #5 > C600200005 < A4002000FF > 8000200002000405 > 2100200005 = open
a block upload answered plainly is a plain upload
    block-read 1018:01 > A41810017F < 431810018602 = 86020000
""")


@pytest.mark.parametrize("words", CONVERSATIONS.values(), ids=CONVERSATIONS)
def test_the_conversations_of_the_client(words):
    play_client(words)


def test_progress_counts_the_segments_that_are_over():
    reader = SdoClient(NODE)
    reader.read(0x1008, now=0)
    for answer in ("583#410810000A000000", "583#0041424344454647"):
        reader.frames()
        reader.receive(frame(answer), 0)
    assert reader.progress == (7, 10)
    writer = SdoClient(NODE)
    writer.write(0x1008, 0, bytes(10), now=0)
    assert writer.progress == (0, None)
    for answer in ("583#6008100000000000", "583#2000000000000000"):
        writer.frames()
        writer.receive(frame(answer), 0)
    assert writer.progress == (7, 10)


HALF = 500 * MS
REQUESTS = {
    "AwaitingUpload": lambda: SdoRequest(0x2000, 0, None, HALF),
    "AwaitingBlockUpload": lambda: SdoRequest(0x2000, 0, None, HALF, True),
    "AwaitingDownload": lambda: SdoRequest(0x2000, 0, bytes(9), HALF),
    "AwaitingBlockDownload": lambda: SdoRequest(0x2000, 0, bytes(900), HALF, True),
}
PHASES = pytest.mark.parametrize("phase", REQUESTS)


def waiting(phase, *, sent=True):
    exchange = SdoTransfer(NODE, "", 1, SdoOptions(), 0x603, first_phase)
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
def test_what_comes_before_the_request_has_left_is_not_an_answer_to_it(phase, command):
    exchange = waiting(phase, sent=False)
    exchange.receive(bytes((command, 0x00, 0x20, 0, 1, 0, 0, 0)), 1)
    assert (exchange.ignored, type(exchange.phase).__name__, len(exchange.out)) == (1, phase, 1)


@given(st.sampled_from(list(REQUESTS)), st.lists(st.binary(min_size=1, max_size=8), max_size=12))
def test_whatever_the_server_sends_the_request_ends_once_or_continues_with_a_deadline(phase, answers):
    exchange = waiting(phase)
    for now, answer in enumerate(answers):
        if now % 2:  # about the object that was asked for
            answer = (answer[:1] + b"\x00\x20\x00" + answer[4:]).ljust(8, b"\0")
        exchange.receive(answer, now)
        exchange.out.clear()
        assert len(exchange.finished) == (exchange.active is None)
        assert (exchange.deadline is None) is (exchange.active is None)
        assert exchange.active is not None or type(exchange.phase).__name__ == "Phase"


def said(client):
    return [str(one) for one in client.frames()]


def hear(client, *answers, now=0):
    for answer in answers:
        client.receive(frame(answer), now)


@pytest.fixture
def client():
    return SdoClient(NODE, name="left")


class TestTiming:
    def test_a_request_without_a_time_is_due_at_once_and_starts_with_the_tick(self, client):
        client.read(0x1000)
        assert client.next_deadline() == 0
        client.tick(7 * SECOND)
        assert client.next_deadline() == 7 * SECOND + HALF

    def test_a_request_that_waits_in_the_queue_does_not_age(self, client):
        client.read(0x1000, now=0)
        second = client.read(0x1001, now=0)
        client.frames()
        hear(client, "583#4300100092010400", now=400 * MS)
        assert said(client) == ["603#4001100000000000"]
        assert client.next_deadline() == 900 * MS
        hear(client, "583#4F01100000000000", now=600 * MS)
        assert second.elapsed_ns == 200 * MS

    def test_every_segment_has_the_whole_timeout(self, client):
        request = client.read(0x1008, now=0)
        client.frames()
        hear(client, "583#4108100009000000", now=400 * MS)
        client.frames()
        hear(client, "583#00544D434D2D3132", now=800 * MS)
        client.frames()
        hear(client, "583#1B37300000000000", now=1200 * MS)
        assert (request.data, request.elapsed_ns) == (b"TMCM-1270", 1200 * MS)


class TestTimeouts:
    def test_after_the_last_try_the_error_names_node_and_step(self, client):
        request = client.read(0x6064, now=0)
        client.frames()
        client.tick(HALF)
        client.frames()
        client.tick(2 * HALF)
        assert isinstance(request.error, SdoTimeout)
        assert str(request.error).startswith("node 3 (left): 0x6064:00: no answer within 1 s")
        assert client.events() == [request]

    def test_a_late_answer_is_not_that_of_the_next_request_for_the_object(self):
        client = SdoClient(NODE, retries=0)
        first = client.write(0x6040, 0, b"\x06\0", now=0)
        client.frames()
        client.tick(HALF)
        second = client.write(0x6040, 0, b"\x07\0", now=HALF)
        client.frames()
        hear(client, "583#6040600000000000", now=HALF)
        assert (first.done, second.done) == (True, False)
        hear(client, "583#4300100092010400", now=HALF)
        assert said(client) == ["603#2B40600007000000"]
        hear(client, "583#8040600022000008", now=HALF)
        assert not second.done  # not now: the request will be repeated

    def test_a_late_acknowledgement_is_not_that_of_another_object(self):
        """The `canopen` package calls the second write a success."""
        client = SdoClient(NODE, retries=0)
        client.write(0x6083, 0, bytes(4), now=0)
        client.frames()
        client.tick(HALF)
        second = client.write(0x6084, 0, bytes(4), now=HALF)
        assert said(client) == ["603#8083600000000405", "603#2384600000000000"]
        hear(client, "583#6083600000000000", now=HALF + 50 * MS)
        client.tick(2 * HALF)
        assert isinstance(second.error, SdoTimeout)

    def test_a_node_that_has_booted_owes_nothing(self):
        client = SdoClient(NODE, retries=0)
        client.read(0x6064, now=0)
        client.frames()
        client.tick(HALF)
        client.forget()
        client.frames()
        client.read(0x6064, now=SECOND)
        assert said(client) == ["603#4064600000000000"]


class TestMatching:
    def test_answers_for_another_object_are_ignored_until_the_timeout(self, client):
        """Two threads of the `canopen` package get errors from this."""
        request = client.read(0x6064, now=0)
        client.frames()
        hear(client, "583#4384600001000000", "583#4364600101000000", "583#8084600000000206")
        assert (request.done, client.ignored, client.next_deadline()) == (False, 3, HALF)
        hear(client, "583#4364600002000000")
        assert request.data == b"\2\0\0\0"

    def test_an_answer_before_the_request_has_left_is_a_copy(self, client):
        first = client.read(0x6064, now=0)
        second = client.read(0x6064, now=0)
        client.frames()
        hear(client, "583#4364600001000000", "583#4364600001000000")
        assert (first.done, second.done, client.ignored) == (True, False, 1)

    @pytest.mark.parametrize("answer", ["583#", "583#80", "583#806460", "583#8064600002"])
    def test_a_cut_abort_is_not_an_answer_and_raises_nothing(self, client, answer):
        """In the `canopen` package it is a struct.error."""
        request = client.read(0x6064, now=0)
        client.frames()
        hear(client, answer)
        assert (request.done, client.ignored) == (False, 1)

    def test_an_expedited_answer_cut_behind_its_data_is_taken(self, client):
        request = client.read(0x1400, 2, now=0)
        client.frames()
        hear(client, "583#4F001402FE")
        assert request.data == b"\xfe"

    def test_an_expedited_answer_cut_within_its_data_is_not(self, client):
        request = client.read(0x1400, 2, now=0)
        client.frames()
        hear(client, "583#4B001402FE", "583#43001402FE00")
        assert (request.done, client.ignored) == (False, 2)


class TestQueue:
    def test_requests_go_one_by_one_in_their_order(self, client):
        requests = [client.read(0x2000, sub, now=0) for sub in range(3)]
        for sub in range(3):
            assert said(client) == [f"603#400020{sub:02X}00000000"]
            hear(client, f"583#4F0020{sub:02X}{sub:02X}000000")
        assert [r.data for r in requests] == [b"\0", b"\1", b"\2"]
        assert client.events() == requests

    def test_an_abort_names_node_object_and_meaning(self, client):
        request = client.read(0x2000, now=0)
        client.frames()
        hear(client, "583#8000200000000206")
        assert str(request.error) == (
            "node 3 (left): 0x2000:00: abort 0x06020000 (object does not exist in the object dictionary)"
        )

    def test_cancelling_all_ends_every_request_with_the_error(self, client):
        requests = [client.read(0x2000), client.read(0x2001), client.write(0x2002, 0, b"1")]
        client.frames()
        error = BusClosed("vcan0")
        client.cancel_all(error)
        assert [r.error for r in requests] == [error] * 3
        assert client.events() == requests
        assert said(client) == ["603#8000200000000008"]
        assert (client.busy, client.waiting, client.next_deadline()) == (False, 0, None)

    def test_a_cancelled_request_that_has_not_left_never_does(self, client):
        request = client.read(0x2000)
        client.cancel(request, BusClosed("vcan0"))
        assert said(client) == []

    def test_cancelling_one_starts_the_next_and_quarantines_its_object(self, client):
        first, second, third = client.read(0x2000), client.read(0x2000), client.read(0x2001)
        client.frames()
        client.cancel(first, BusClosed("vcan0"))
        assert said(client) == ["603#8000200000000008", "603#4000100000000000"]
        client.cancel(third, BusClosed("vcan0"))
        hear(client, "583#4300100092010400")
        assert said(client) == ["603#4000200000000000"]
        assert (second.done, third.done) == (False, True)

    def test_a_transfer_in_segments_can_be_cancelled_and_a_request_of_one_frame_is_completed(self, client):
        long, short = client.write(0x2000, 0, bytes(20), now=0), client.write(0x2001, 0, b"\1")
        client.frames()
        hear(client, "583#6000200000000000")
        client.frames()
        client.cancel_transfer(short)
        client.cancel_transfer(long)
        assert isinstance(long.error, SdoCancelled)
        assert said(client) == ["603#8000200000000008", "603#2F01200001000000"]
        client.cancel_transfer(short)
        hear(client, "583#6001200000000000")
        assert (short.done, short.error) == (True, None)

    def test_an_upload_is_cancelled_only_while_segments_come(self, client):
        request = client.read(0x2000, now=0)
        client.frames()
        client.cancel_transfer(request)
        hear(client, "583#4100200014000000")
        assert not request.done
        client.cancel_transfer(request)
        assert isinstance(request.error, SdoCancelled)

    def test_cancelling_what_is_done_changes_nothing(self, client):
        request = client.read(0x2000, now=0)
        client.frames()
        hear(client, "583#4F00200005000000")
        client.cancel(request, BusClosed("vcan0"))
        assert (request.error, request.data) == (None, b"\5")
        assert client.events() == [request]

    @pytest.mark.parametrize(("index", "subindex"), [(-1, 0), (0x10000, 0), (0x2000, -1), (0x2000, 256)])
    def test_an_impossible_object_is_refused_and_nothing_changes(self, client, index, subindex):
        with pytest.raises(LocalProtocolError):
            client.read(index, subindex)
        assert (client.busy, said(client)) == (False, [])


class TestBusy:
    @pytest.mark.parametrize("code", ["22000008", "21000008", "05000405", "23000A06"])
    def test_not_now_is_asked_again_after_a_pause(self, client, code):
        request = client.write(0x6060, 0, b"\3", now=0)
        client.frames()
        hear(client, f"583#80606000{code}")
        assert (request.done, said(client)) == (False, [])
        client.tick(client.next_deadline())
        assert said(client) == ["603#2F60600003000000"]
        hear(client, "583#6060600000000000", now=20 * MS)
        assert (request.error, request.elapsed_ns) == (None, 20 * MS)

    def test_the_pauses_grow_and_end(self, client):
        request = client.write(0x6060, 0, b"\3", now=0)
        now, pauses = 0, []
        while not request.done:
            client.frames()
            hear(client, "583#8060600022000008", now=now)
            if not request.done:
                pauses.append(client.next_deadline() - now)
                now = client.next_deadline()
                client.tick(now)
        assert pauses == [20 * MS, 40 * MS, 80 * MS, 160 * MS, 320 * MS]
        assert request.error.code == AbortCode.DEVICE_STATE

    @pytest.mark.parametrize("code", ["22000008", "23000A06"])
    def test_an_upload_is_asked_for_once_more_and_then_taken_at_its_word(self, client, code):
        first = client.read(0x6041, 0, now=0)
        client.frames()
        hear(client, f"583#80416000{code}")
        assert (first.done, said(client)) == (False, [])
        client.tick(client.next_deadline())
        assert said(client) == ["603#4041600000000000"]
        hear(client, f"583#80416000{code}", now=20 * MS)
        assert isinstance(first.error, SdoAbort)
        second = client.read(0x6064, 0, now=30 * MS)
        client.frames()
        hear(client, f"583#80646000{code}", now=31 * MS)
        assert isinstance(second.error, SdoAbort)
        client.forget()  # another device may be there now
        third = client.read(0x6064, 0, now=40 * MS)
        client.frames()
        hear(client, f"583#80646000{code}", now=41 * MS)
        assert not third.done

    def test_a_request_cancelled_in_the_pause_sends_nothing(self, client):
        request = client.write(0x6060, 0, b"\3", now=0)
        client.frames()
        hear(client, "583#8060600022000008")
        client.cancel(request, BusClosed("vcan0"))
        assert (said(client), client.next_deadline()) == ([], None)


ENTRIES = {
    (0x6041, 0): Entry(0x6041, 0, "Statusword", DataType.UNSIGNED16),
    (0x6060, 0): Entry(0x6060, 0, "Modes of operation", DataType.INTEGER8),
    (0x1008, 0): Entry(0x1008, 0, "Name", DataType.VISIBLE_STRING),
}


class TestLengths:
    @pytest.fixture
    def client(self):
        return SdoClient(NODE, name="left", od=SimpleNamespace(get=lambda *address: ENTRIES.get(address)))

    def test_an_answer_without_a_length_is_cut_to_what_is_known(self, client):
        request = client.read(0x6041, now=0)
        client.frames()
        hear(client, "583#4241600040060000")
        assert request.data == b"\x40\x06"

    def test_an_answer_without_a_length_has_four_bytes(self, client):
        request = client.read(0x6042, now=0)
        client.frames()
        hear(client, "583#4242600040060000")
        assert request.data == b"\x40\x06\0\0"

    @pytest.mark.parametrize(
        ("answer", "words"),
        [
            ("583#4F41600050000000", "node 3 (left): 0x6041:00 Statusword: answered 1 byte (50), UNSIGNED16 has 2"),
            ("583#4341600050060100", "answered 4 bytes (50 06 01 00), UNSIGNED16 has 2"),
        ],
    )
    def test_an_answer_of_another_length_is_an_error_and_the_next_one_counts(self, client, answer, words):
        request, following = client.read(0x6041, now=0), client.read(0x6041)
        client.frames()
        hear(client, answer)
        assert isinstance(request.error, SdoLengthError)
        assert words in str(request.error)
        client.frames()
        hear(client, "583#4B41600040060000")
        assert (following.error, following.data) == (None, b"\x40\x06")

    def test_a_device_that_answers_everything_in_four_bytes_is_understood(self, client):
        for answer, index, data in (
            ("583#4341600040060000", 0x6041, b"\x40\x06"),
            ("583#43606000FFFFFFFF", 0x6060, b"\xff"),
        ):
            request = client.read(index, now=0)
            client.frames()
            hear(client, answer)
            assert (request.error, request.data) == (None, data)

    def test_what_has_no_fixed_length_is_not_judged(self, client):
        request = client.read(0x1008, now=0)
        client.frames()
        hear(client, "583#4F08100041000000")
        assert (request.error, request.data) == (None, b"A")


class TestBlock:
    def test_a_server_without_block_transfer_is_served_in_segments_and_remembered(self, client):
        store = MemoryStore({(0x2000, 0): b""})
        line = Line(client, SdoServer(NODE, store, block=False))
        for data in (b"first value", b"second value"):
            request = client.write(0x2000, 0, data, block=True)
            line.run()
            assert (request.error, store.objects[0x2000, 0]) == (None, data)
        assert client.block_supported is False
        assert [text[:6] for text in line.said].count("603#C6") == 1

    def test_large_writes_use_block_transfer_by_themselves(self, client):
        client.write(0x2000, 0, bytes(256), now=0)
        client.write(0x2000, 0, bytes(255), now=0)
        assert said(client) == ["603#C600200000010000"]

    def test_the_chunked_kilobyte_that_canopen_cannot_write_arrives(self, client):
        """Issue 618 of the `canopen` package: 1024 bytes are not a multiple of a segment."""
        store = MemoryStore({(0x1F50, 1): b""})
        line = Line(client, SdoServer(NODE, store, block_size=100))
        request = client.write(0x1F50, 1, bytes(range(256)) * 12, block=True)
        line.run()
        assert (request.error, client.retried) == (None, 0)
        assert store.objects[0x1F50, 1] == bytes(range(256)) * 12
