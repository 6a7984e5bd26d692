from __future__ import annotations

import pytest
from support.sdo import NODE, frame

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.sdo_client import SdoClient
from canopen_control.errors import SdoAbort

HALF = 500_000_000


def reading(*answers):
    """Return a client, and its request after `answers`, which are taken as they come."""
    client = SdoClient(NODE)
    request = client.read(0x1008, now=0)
    for answer in answers:
        client.frames()
        client.receive(frame(answer), 0)
    return client, request


def writing(data, *answers):
    client = SdoClient(NODE)
    request = client.write(0x1008, 0, data, now=0)
    for answer in answers:
        client.frames()
        client.receive(frame(answer), 0)
    return client, request


def commands(client):
    return [one.data[0] for one in client.frames()]


def test_a_doubled_segment_is_taken_once():
    client, request = reading("583#4108100009000000", "583#00544D434D2D3132", "583#00544D434D2D3132")
    assert commands(client) == []
    client.receive(frame("583#1B37300000000000"), 0)
    assert request.data == b"TMCM-1270"


def test_a_segment_doubled_before_the_next_request_has_left_is_ignored():
    client, request = reading("583#4108100009000000")
    client.frames()
    for _ in range(3):
        client.receive(frame("583#00544D434D2D3132"), 0)
    assert client.ignored == 2
    client.frames()
    client.receive(frame("583#1B37300000000000"), 0)
    assert request.data == b"TMCM-1270"


@pytest.mark.parametrize(
    "answers",
    [
        ["583#10544D434D2D3132"],  # the first one already
        ["583#00544D434D2D3132", "583#0B37300000000000"],  # another segment with the old toggle
        ["583#00544D434D2D3132"] * 3,  # more than a copy
    ],
)
def test_a_toggle_error_aborts_and_starts_again(answers):
    client, request = reading("583#4108100009000000", *answers)
    assert [str(one) for one in client.frames()] == ["603#8008100000000305", "603#4008100000000000"]
    assert not request.done


def test_after_two_restarts_a_toggle_error_is_final():
    client, request = reading(*["583#4108100009000000", "583#10544D434D2D3132"] * 3)
    assert isinstance(request.error, SdoAbort)
    assert request.error.code == AbortCode.TOGGLE_NOT_ALTERNATED
    assert commands(client) == [0x80]


def test_the_servers_toggle_abort_starts_again_too():
    client, request = writing(bytes(20), "583#6008100000000000", "583#8008100000000305")
    assert commands(client) == [0x21]
    assert not request.done


def test_silence_after_a_copy_is_a_toggle_error():
    client, _ = reading("583#4108100015000000", "583#0000000000000000", "583#0000000000000000")
    client.tick(HALF)
    assert [str(one) for one in client.frames()] == ["603#8008100000000305", "603#4000100000000000"]


def test_a_lost_segment_times_out_and_the_transfer_starts_again():
    client, _ = reading("583#4108100015000000", "583#0000000000000000")
    client.frames()
    client.tick(HALF)
    assert commands(client) == [0x80, 0x40]  # the abort, and what settles late answers
    client.receive(frame("583#4300100092010400"), HALF)
    assert commands(client) == [0x40]


@pytest.mark.parametrize(
    ("answers", "code"),
    [
        (["583#4108100008000000", "583#00544D434D2D3132", "583#1B37300000000000"], AbortCode.LENGTH_TOO_HIGH),
        (["583#410810000A000000", "583#00544D434D2D3132", "583#1B37300000000000"], AbortCode.LENGTH_TOO_LOW),
        (["583#4008100000000000", "583#0E00000000000000"], AbortCode.GENERAL_ERROR),  # empty and not the last
    ],
)
def test_a_wrong_length_ends_the_transfer(answers, code):
    client, request = reading(*answers)
    assert request.error.code == code
    assert commands(client) == [0x80]


def test_a_size_that_was_not_announced_is_what_comes():
    _, request = reading("583#4008100000000000", "583#00544D434D2D3132", "583#1B37300000000000")
    assert request.data == b"TMCM-1270"


def test_an_empty_object_is_written_with_one_empty_segment():
    client, request = writing(b"", "583#6008100000000000")
    assert [str(one) for one in client.frames()] == ["603#0F00000000000000"]
    client.receive(frame("583#2000000000000000"), 0)
    assert (request.done, request.error) == (True, None)


def test_a_doubled_acknowledgement_skips_nothing():
    client, request = writing(bytes(range(20)), "583#6008100000000000", "583#2000000000000000")
    client.frames()
    client.receive(frame("583#2000000000000000"), 0)
    assert commands(client) == []
    client.receive(frame("583#3000000000000000"), 0)
    assert [str(one) for one in client.frames()] == ["603#030E0F1011121300"]
    assert not request.done


def test_a_wrong_toggle_in_the_first_acknowledgement_is_an_error():
    client, _ = writing(bytes(20), "583#6008100000000000", "583#3000000000000000")
    assert commands(client) == [0x80, 0x21]


def test_a_second_copy_of_an_acknowledgement_is_an_error():
    client, _ = writing(bytes(20), "583#6008100000000000", *["583#2000000000000000"] * 3)
    assert commands(client) == [0x80, 0x21]


def test_a_doubled_initiate_answer_is_ignored():
    client, request = reading("583#4108100009000000", "583#4108100009000000")
    assert (client.ignored, request.done) == (1, False)


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
