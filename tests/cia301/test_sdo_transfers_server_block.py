from __future__ import annotations

import pytest
from support.sdo import NODE, MemoryStore, conversations, frame, play_server

from canopen_control.cia301.sdo_server import SdoServer

CONVERSATIONS = conversations("""
a block upload in blocks of no segment is refused
    2007=20 > A40720 < 8007200002000405
a block upload in blocks of 128 segments is refused
    2007=20 > A407200080 < 8007200002000405
a block upload in blocks of 255 segments is refused
    2007=20 > A4072000FF < 8007200002000405
it switches to a plain upload with the client's leave
    2007=20 > A40720007F14 < 4107200014
it does not switch to a plain upload below the client's threshold
    2007=20 > A40720007F13 < C607200014
it does not switch to a plain upload without the client's leave
    2007=20 > A40720007F < C607200014
no segment goes before the start
    2007=20 > A40720007F < C607200014 >! A2037F
a doubled start sends one sub-block
    2007=20 > A40720007F < C607200014 > A3 >! A3 < 0100010203040506 < 020708090A0B0C0D < 830E0F10111213
after a gap it goes on behind it, numbered from 1
    2007=20 > A40720007F < C607200014 > A3 < 0100010203040506 < 020708090A0B0C0D < 830E0F10111213 > A2017F
        < 010708090A0B0C0D < 820E0F10111213
the client sets the size of every sub-block
    2007=20 > A407200001 < C607200014 > A3 < 0100010203040506 > A20102 < 010708090A0B0C0D < 820E0F10111213
an acknowledgement of a segment that was not sent is aborted
    2007=20 > A40720007F < C607200014 > A3 < 0100010203040506 < 020708090A0B0C0D < 830E0F10111213 > A2047F
        < 8007200003000405
an acknowledgement of segment 255 is aborted
    2007=20 > A40720007F < C607200014 > A3 < 0100010203040506 < 020708090A0B0C0D < 830E0F10111213 > A2FF7F
        < 8007200003000405
an acknowledgement that asks for blocks of no segment is aborted
    2007=20 > A40720007F < C607200014 > A3 < 0100010203040506 < 020708090A0B0C0D < 830E0F10111213 > A203
        < 8007200002000405
an acknowledgement that asks for blocks of 128 segments is aborted
    2007=20 > A40720007F < C607200014 > A3 < 0100010203040506 < 020708090A0B0C0D < 830E0F10111213 > A20380
        < 8007200002000405
without the CRC of the client its field is zero
    2007=20 > A00720007F < C207200014 > A3 < 0100010203040506 < 020708090A0B0C0D < 830E0F10111213 > A2037F < C5
a server may lack the CRC
    crc=0 2007=20 > A40720007F < C207200014 > C608200014 < A00820007F
doubled segments of a block are taken once
    > C208200014 < A00820007F > 0100010203040506 >! 0100010203040506 > 020708090A0B0C0D >! 020708090A0B0C0D
        > 830E0F10111213 < A2037F >! 830E0F10111213 > C5 < A1 = 000102030405060708090A0B0C0D0E0F10111213
silence in a sub-block acknowledges what came
    > C608200014 < A40820007F > 0100010203040506 > 020708090A0B0C0D +149 +1 < A2027F +10 >! 830E0F10111213
        > 810E0F10111213 < A2017F
silence before the first segment is ended by the timeout alone
    timeout_ms=1000 > C608200014 < A40820007F +150 +850 < 8008200000000405
fewer bytes in the last segment than announced are refused
    > C208200013 < A00820007F > 0100010203040506 > 020708090A0B0C0D > 830E0F10111213 < A2037F > C5 < 8008200012000706
as many bytes as announced are taken
    > C208200013 < A00820007F > 0100010203040506 > 020708090A0B0C0D > 830E0F10111213 < A2037F > C9 < A1
        = 000102030405060708090A0B0C0D0E0F101112
more bytes announced than came are refused
    > C208200014 < A00820007F > 0100010203040506 > 020708090A0B0C0D > 830E0F10111213 < A2037F > C9 < 8008200013000706
a length that was not announced is what came
    > C00820 < A00820007F > 0100010203040506 > 020708090A0B0C0D > 830E0F10111213 < A2037F > C9 < A1
        = 000102030405060708090A0B0C0D0E0F101112
a wrong CRC is refused
    > C608200014 < A40820007F > 0100010203040506 > 020708090A0B0C0D > 830E0F10111213 < A2037F > C5 < 8008200004000405
more than announced is refused at once
    > C20820000D < A00820007F > 0100010203040506 > 020708090A0B0C0D > 830E0F10111213 < 8008200012000706
the end of a block is confirmed only when the store has taken the object
    size=4 > C00820 < A00820007F > 0100010203040506 > 020708090A0B0C0D > 830E0F10111213 < A2037F > C5
        < 8008200012000706
another last segment after the last is an error
    > C608200014 < A40820007F > 0100010203040506 > 020708090A0B0C0D > 830E0F10111213 < A2037F > 83FFFFFFFFFFFFFF
        < 8008200001000405
an abort within the segments of a block is an abort
    > C608200014 < A40820007F > 0100010203040506 > 8008200000000405 > 020708090A0B0C0D < 8000000001000405
""")


@pytest.mark.parametrize("words", CONVERSATIONS.values(), ids=CONVERSATIONS)
def test_the_conversations_of_the_server(words):
    play_server(words)


WRITE = "603#C608200014000000"
WRITE_NO_CRC = "603#C208200014000000"
SEGMENTS = ["603#0100010203040506", "603#020708090A0B0C0D", "603#830E0F1011121300"]
READ = "603#A40720007F000000"
START = "603#A300000000000000"


def device(**options):
    return SdoServer(NODE, MemoryStore({(0x2007, 0): bytes(range(20)), (0x2008, 0): b"old"}), **options)


def ask(server, *requests, now=0):
    messages = []
    for request in requests:
        server.receive(frame(request), now)
        messages += [str(one) for one in server.frames()]
    return messages


def test_a_client_that_never_gets_anything_is_given_up():
    assert ask(device(), READ, START, *["603#A2007F0000000000"] * 17)[-1] == "583#8007200003000405"


def test_an_upload_is_served_when_the_client_has_confirmed_the_end():
    server = device()
    ask(server, READ, START, "603#A2037F0000000000")
    assert server.served == 0
    ask(server, "603#A100000000000000")
    assert (server.served, server.next_deadline()) == (1, None)


def test_a_segment_that_resembles_another_command_is_a_segment():
    """0x40 is segment 64, 0x60 is 96, 0x23 is 35: none of them begins another transfer."""
    server = device()
    server.receive(frame("603#C208200000030000"), 0)
    for number in range(1, 110):
        server.receive(frame(f"603#{number:02X}00200000000000"), 0)
    assert len(server.frames()) == 1
    assert server.aborted == 0


@pytest.mark.parametrize(("write", "again"), [(WRITE, 3), (WRITE_NO_CRC, 0)], ids=["with CRC", "without"])
def test_with_crc_it_reports_this_again_when_the_first_segment_is_lost_as_well(write, again):
    server = device()
    ask(server, write, SEGMENTS[0])
    messages = []
    while (deadline := server.next_deadline()) is not None:
        server.tick(deadline)
        messages += [str(one) for one in server.frames()]
    assert messages == ["583#A2017F0000000000", *["583#A2007F0000000000"] * again, "583#8008200000000405"]


def test_a_client_that_never_sends_the_right_segment_is_given_up():
    assert ask(device(), WRITE, *[SEGMENTS[2]] * 17)[-1] == "583#8008200003000405"
