from __future__ import annotations

import pytest
from support.sdo import NODE, frame

from canopen_control.cia301.sdo_client import SdoClient
from canopen_control.cia301.sdo_exchange import SdoOptions

HALF = 500_000_000
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


def test_a_gap_is_acknowledged_at_the_end_of_the_sub_block():
    client, _ = reading(SEGMENTS[0], SEGMENTS[2])
    assert said(client) == ["603#A2017F0000000000"]


def test_what_comes_behind_a_gap_is_not_kept():
    client, request = reading(SEGMENTS[0], SEGMENTS[2], "583#010708090A0B0C0D", "583#820E0F1011121300")
    assert said(client) == ["603#A2027F0000000000"]
    client.receive(frame("583#C500000000000000"), 0)
    assert not request.done  # CRC 0 is wrong for these bytes
    assert said(client)[0] == "603#8008200004000405"


def test_without_crc_its_field_does_not_count():
    _, request = reading(*SEGMENTS, "583#C5FFFF0000000000", crc=False)
    assert (request.error, request.data) == (None, bytes(range(20)))


def test_a_doubled_segment_is_taken_once():
    client, request = reading(SEGMENTS[0], SEGMENTS[0], *SEGMENTS[1:], "583#C500000000000000", crc=False)
    assert request.data == bytes(range(20))
    assert client.ignored == 1


def test_silence_within_a_sub_block_acknowledges_what_came():
    client, request = reading(SEGMENTS[0], SEGMENTS[1])
    client.tick(HALF)
    assert said(client) == ["603#A2027F0000000000"]
    client.receive(frame("583#810E0F1011121300"), HALF)
    assert said(client) == ["603#A2017F0000000000"]
    assert not request.done


def test_after_that_what_was_still_under_way_does_not_count():
    client, _ = reading(SEGMENTS[0])
    client.tick(HALF)
    said(client)
    client.receive(frame(SEGMENTS[2]), HALF)
    assert said(client) == []


def test_with_crc_it_reports_this_again_when_the_first_segment_is_lost_as_well():
    client, _ = reading(SEGMENTS[0])
    for number, expected in enumerate(["01", "00", "00", "00"], 1):
        client.tick(number * HALF)
        assert said(client) == [f"603#A2{expected}7F0000000000"]
    client.tick(5 * HALF)
    assert said(client)[0] == "603#8008200000000405"


def test_silence_before_any_segment_is_a_timeout():
    client, _ = reading()
    said(client)
    client.tick(HALF)
    assert said(client)[0] == "603#8008200000000405"


def test_a_server_that_never_gets_further_is_given_up():
    client, request = reading()
    for _ in range(17):
        said(client)
        client.receive(frame(SEGMENTS[2]), 0)
    assert said(client) == ["603#8008200003000405", "603#4008200000000000"]
    assert not request.done


@pytest.mark.parametrize(
    ("size", "answers", "code"),
    [("0D000000", SEGMENTS, "12000706"), ("15000000", [*SEGMENTS, "583#C500000000000000"], "13000706")],
)
def test_without_crc_a_wrong_length_is_noticed_and_segments_are_tried(size, answers, code):
    client, _ = reading(*answers, size=size, crc=False)
    frames = said(client)
    assert f"603#80082000{code}" in frames
    assert frames[-1] == "603#4008200000000000"


def test_an_empty_object_is_one_segment_without_bytes():
    client, request = reading("583#8100000000000000", "583#DD00000000000000", size="00000000")
    assert said(client) == ["603#A100000000000000"]
    assert (request.error, request.data) == (None, b"")


def test_the_size_may_be_unknown():
    client = SdoClient(NODE)
    request = client.read(0x2008, block=True, now=0)
    for answer in ("583#C408200000000000", "583#8131323334350000", "583#C96C540000000000"):
        client.frames()
        client.receive(frame(answer), 0)
    assert (request.error, request.data) == (None, b"12345")
    assert said(client) == ["603#A100000000000000"]


def test_the_server_sets_the_size_of_every_sub_block():
    client, _ = writing("583#A201010000000000", block_size="01")
    assert said(client) == ["603#010708090A0B0C0D"]
    client.receive(frame("583#A2017F0000000000"), 0)
    assert said(client) == ["603#810E0F1011121300"]


@pytest.mark.parametrize(
    ("answer", "code"),
    [("583#A2047F0000000000", "03000405"), ("583#A203000000000000", "02000405"), ("583#A203800000000000", "02000405")],
)
def test_an_impossible_acknowledgement_ends_the_block_transfer(answer, code):
    client, _ = writing(answer)
    assert said(client) == [f"603#80082000{code}", "603#2108200014000000"]


def test_a_server_that_never_acknowledges_anything_is_given_up():
    client, _ = writing(*["583#A2007F0000000000"] * 17)
    assert said(client) == ["603#8008200003000405", "603#2108200014000000"]


def test_a_lost_confirmation_of_the_end_is_a_timeout():
    client, request = writing("583#A2037F0000000000")
    assert said(client)[0].startswith("603#C5")
    client.receive(frame("583#A2037F0000000000"), 0)
    client.tick(HALF)
    assert said(client)[0] == "603#8008200000000405"
    assert not request.done


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
