from __future__ import annotations

import pytest
from support.sdo import NODE, conversations, frame, play_client

from canopen_control.cia301.sdo_client import SdoClient
from canopen_control.cia301.sdo_exchange import SdoOptions

CONVERSATIONS = conversations("""
a gap is acknowledged at the end of the sub-block
    block-read 2008 > A40820007F < C608200014 > A3 < 0100010203040506 < 830E0F10111213 > A2017F = open
what comes behind a gap is not kept: CRC 0 is wrong for these bytes
    block-read 2008 > A40820007F < C608200014 > A3 < 0100010203040506 < 830E0F10111213 > A2017F < 010708090A0B0C0D
        < 820E0F10111213 > A2027F < C5 > 8008200004000405 > 400820 = open
without CRC its field does not count
    crc=0 block-read 2008 > A00820007F < C608200014 > A3 < 0100010203040506 < 020708090A0B0C0D < 830E0F10111213
        > A2037F < C5FFFF > A1 = 000102030405060708090A0B0C0D0E0F10111213
a doubled segment of a block is taken once
    crc=0 block-read 2008 > A00820007F < C608200014 > A3 < 0100010203040506 <! 0100010203040506 < 020708090A0B0C0D
        < 830E0F10111213 > A2037F < C5 > A1 = 000102030405060708090A0B0C0D0E0F10111213
silence within a sub-block acknowledges what came
    block-read 2008 > A40820007F < C608200014 > A3 < 0100010203040506 < 020708090A0B0C0D +500 > A2027F
        < 810E0F10111213 > A2017F = open
what was still under way after such a silence does not count
    block-read 2008 > A40820007F < C608200014 > A3 < 0100010203040506 +500 > A2017F <! 830E0F10111213 = open
with CRC it acknowledges again when the first segment is lost as well
    block-read 2008 > A40820007F < C608200014 > A3 < 0100010203040506 +500 > A2017F +500 > A2007F +500 > A2007F +500
        > A2007F +500 > 8008200000000405 > 400010 = open
silence before any segment is a timeout
    block-read 2008 > A40820007F < C608200014 > A3 +500 > 8008200000000405 > 400010 = open
without CRC more bytes than announced are noticed, and segments are tried
    crc=0 block-read 2008 > A00820007F < C60820000D > A3 < 0100010203040506 < 020708090A0B0C0D < 830E0F10111213
        > 8008200012000706 > 400820 = open
without CRC fewer bytes than announced are noticed, and segments are tried
    crc=0 block-read 2008 > A00820007F < C608200015 > A3 < 0100010203040506 < 020708090A0B0C0D < 830E0F10111213
        > A2037F < C5 > 8008200013000706 > 400820 = open
an empty object is one segment without bytes
    block-read 2008 > A40820007F < C60820 > A3 < 81 > A2017F < DD > A1 = empty
the size of a block upload may be unknown
    block-read 2008 > A40820007F < C40820 > A3 < 813132333435 > A2017F < C96C54 > A1 = 3132333435
the server sets the size of every sub-block
    block-write 2008 #20 > C608200014 < A408200001 > 0100010203040506 < A20101 > 010708090A0B0C0D < A2017F
        > 810E0F10111213 = open
an acknowledgement of a segment that was not sent ends the block transfer
    block-write 2008 #20 > C608200014 < A40820007F > 0100010203040506 > 020708090A0B0C0D > 830E0F10111213 < A2047F
        > 8008200003000405 > 2108200014 = open
an acknowledgement that asks for blocks of no segment ends the block transfer
    block-write 2008 #20 > C608200014 < A40820007F > 0100010203040506 > 020708090A0B0C0D > 830E0F10111213 < A203
        > 8008200002000405 > 2108200014 = open
an acknowledgement that asks for blocks of 128 segments ends the block transfer
    block-write 2008 #20 > C608200014 < A40820007F > 0100010203040506 > 020708090A0B0C0D > 830E0F10111213 < A20380
        > 8008200002000405 > 2108200014 = open
a lost confirmation of the end is a timeout
    block-write 2008 #20 > C608200014 < A40820007F > 0100010203040506 > 020708090A0B0C0D > 830E0F10111213 < A2037F
        > C5CCAC <! A2037F +500 > 8008200000000405 > 400010 = open
""")


@pytest.mark.parametrize("words", CONVERSATIONS.values(), ids=CONVERSATIONS)
def test_the_conversations_of_the_client(words):
    play_client(words)


SEGMENTS = ["583#0100010203040506", "583#020708090A0B0C0D", "583#830E0F1011121300"]


def reading(*answers, size="14000000", crc=True, block_size=127):
    client = SdoClient(NODE, options=SdoOptions(crc=crc, block_size=block_size))
    request = client.read(0x2008, block=True, now=0)
    for answer in (f"583#C6082000{size}", *answers):
        client.frames()
        client.receive(frame(answer), 0)
    return client, request


def writing(*answers, data=bytes(range(20)), block_size="7F"):
    client = SdoClient(NODE)
    request = client.write(0x2008, 0, data, block=True, now=0)
    for answer in (f"583#A4082000{block_size}000000", *answers):
        client.frames()
        client.receive(frame(answer), 0)
    return client, request


def said(client):
    return [str(one) for one in client.frames()]


def test_a_server_that_never_gets_further_is_given_up():
    client, request = reading()
    for _ in range(17):
        said(client)
        client.receive(frame(SEGMENTS[2]), 0)
    assert said(client) == ["603#8008200003000405", "603#4008200000000000"]
    assert not request.done


def test_a_server_that_never_acknowledges_anything_is_given_up():
    client, _ = writing(*["583#A2007F0000000000"] * 17)
    assert said(client) == ["603#8008200003000405", "603#2108200014000000"]


def test_no_segment_can_be_mistaken_for_an_abort():
    client, _ = writing(data=bytes(7 * 127))
    assert 0x80 not in [one.data[0] for one in client.frames()]


def test_the_progress_of_an_upload_is_what_has_come():
    client, _ = reading()
    assert client.progress == (0, 20)
    client, _ = reading(*SEGMENTS[:2])
    assert client.progress == (14, 20)
    client, _ = reading(*SEGMENTS, "583#C5FFFF0000000000", crc=False)
    assert client.progress == (0, None)


def test_the_progress_of_a_download_is_what_was_acknowledged():
    client, _ = writing()
    assert client.progress == (0, 20)
    client, _ = writing("583#A2037F0000000000")
    assert client.progress == (20, 20)


def test_a_copy_of_a_last_segment_that_resembles_the_end_is_ignored():
    data = bytes(range(7)) * 65  # the last segment is number 65: its first byte, 0xC1, is that of the end
    segments = [f"583#{number | (0x80 if number == 65 else 0):02X}{bytes(range(7)).hex()}" for number in range(1, 66)]
    client, request = reading(*segments, segments[-1], size=len(data).to_bytes(4, "little").hex(), crc=False)
    assert (request.done, client.ignored) == (False, 1)
    client.receive(frame("583#C100000000000000"), 0)
    assert (request.error, request.data) == (None, data)
