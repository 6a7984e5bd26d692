from __future__ import annotations

import pytest
from support.sdo import MS, NODE, MemoryStore, frame

from canopen_control.cia301.sdo_server import SdoServer

WRITE = "603#C608200014000000"
WRITE_NO_CRC = "603#C208200014000000"
SEGMENTS = ["603#0100010203040506", "603#020708090A0B0C0D", "603#830E0F1011121300"]
READ = "603#A40720007F000000"
START = "603#A300000000000000"


def device(**options):
    return SdoServer(NODE, MemoryStore({(0x2007, 0): bytes(range(20)), (0x2008, 0): b"old"}), **options)


def ask(server, *requests, now=0):
    said = []
    for request in requests:
        server.receive(frame(request), now)
        said += [str(one) for one in server.frames()]
    return said


@pytest.mark.parametrize("size", ["00", "80", "FF"])
def test_an_impossible_block_size_is_refused(size):
    assert ask(device(), f"603#A4072000{size}000000") == ["583#8007200002000405"]


def test_the_switch_to_a_plain_upload_needs_the_clients_leave():
    assert ask(device(), "603#A40720007F140000") == ["583#4107200014000000"]
    assert ask(device(), "603#A40720007F130000") == ["583#C607200014000000"]
    assert ask(device(), READ) == ["583#C607200014000000"]


def test_no_segment_goes_before_the_start():
    assert ask(device(), READ, "603#A2037F0000000000") == ["583#C607200014000000"]


def test_a_doubled_start_sends_one_sub_block():
    server = device()
    ask(server, READ)
    server.receive(frame(START), 0)
    server.receive(frame(START), 0)
    assert len(server.frames()) == 3


def test_after_a_gap_it_continues_behind_it_numbered_from_1():
    said = ask(device(), READ, START, "603#A2017F0000000000")
    assert said[-2:] == ["583#010708090A0B0C0D", "583#820E0F1011121300"]


def test_the_client_sets_the_size_of_every_sub_block():
    said = ask(device(), "603#A407200001000000", START, "603#A201020000000000")
    assert said[1:] == ["583#0100010203040506", "583#010708090A0B0C0D", "583#820E0F1011121300"]


@pytest.mark.parametrize(
    ("ack", "code"), [("047F", "03000405"), ("FF7F", "03000405"), ("0300", "02000405"), ("0380", "02000405")]
)
def test_an_impossible_acknowledgement_is_aborted(ack, code):
    assert ask(device(), READ, START, f"603#A2{ack}0000000000")[-1] == f"583#80072000{code}"


def test_a_client_that_never_gets_anything_is_given_up():
    assert ask(device(), READ, START, *["603#A2007F0000000000"] * 17)[-1] == "583#8007200003000405"


def test_an_upload_is_served_when_the_client_has_confirmed_the_end():
    server = device()
    ask(server, READ, START, "603#A2037F0000000000")
    assert server.served == 0
    ask(server, "603#A100000000000000")
    assert (server.served, server.next_deadline()) == (1, None)


def test_without_crc_of_the_client_the_field_is_zero():
    said = ask(device(), "603#A00720007F000000", START, "603#A2037F0000000000")
    assert (said[0], said[-1]) == ("583#C207200014000000", "583#C500000000000000")


def test_a_server_may_lack_the_crc():
    assert ask(device(crc=False), READ, WRITE) == ["583#C207200014000000", "583#A00820007F000000"]


def test_doubled_segments_are_taken_once():
    server = device()
    doubled = [segment for segment in SEGMENTS for _ in range(2)]
    said = ask(server, WRITE_NO_CRC, *doubled, "603#C500000000000000")
    assert said == ["583#A00820007F000000", "583#A2037F0000000000", "583#A100000000000000"]
    assert server.store.objects[0x2008, 0] == bytes(range(20))


def test_a_segment_that_resembles_another_command_is_a_segment():
    """0x40 is segment 64, 0x60 is 96, 0x23 is 35: none of them begins another transfer."""
    server = device()
    server.receive(frame("603#C208200000030000"), 0)
    for number in range(1, 110):
        server.receive(frame(f"603#{number:02X}00200000000000"), 0)
    assert len(server.frames()) == 1
    assert server.aborted == 0


def test_silence_in_a_sub_block_acknowledges_what_came():
    server = device()
    ask(server, WRITE, SEGMENTS[0], SEGMENTS[1])
    server.tick(149 * MS)
    assert server.frames() == []
    server.tick(150 * MS)
    assert [str(one) for one in server.frames()] == ["583#A2027F0000000000"]
    assert ask(server, SEGMENTS[2], "603#810E0F1011121300", now=160 * MS) == ["583#A2017F0000000000"]


def test_silence_before_the_first_segment_is_the_clients_affair():
    server = device(timeout_ns=1000 * MS)
    ask(server, WRITE)
    server.tick(150 * MS)
    assert server.frames() == []
    server.tick(1000 * MS)
    assert [str(one) for one in server.frames()] == ["583#8008200000000405"]


@pytest.mark.parametrize(("write", "again"), [(WRITE, 3), (WRITE_NO_CRC, 0)], ids=["with CRC", "without"])
def test_with_crc_it_reports_this_again_when_the_first_segment_is_lost_as_well(write, again):
    server = device()
    ask(server, write, SEGMENTS[0])
    said = []
    while (deadline := server.next_deadline()) is not None:
        server.tick(deadline)
        said += [str(one) for one in server.frames()]
    assert said == ["583#A2017F0000000000", *["583#A2007F0000000000"] * again, "583#8008200000000405"]


def test_a_client_that_never_sends_the_right_segment_is_given_up():
    assert ask(device(), WRITE, *[SEGMENTS[2]] * 17)[-1] == "583#8008200003000405"


@pytest.mark.parametrize(
    ("initiate", "end", "code"),
    [
        ("603#C208200013000000", "603#C500000000000000", "12000706"),
        ("603#C208200013000000", "603#C900000000000000", None),  # 19 bytes as announced
        ("603#C208200014000000", "603#C900000000000000", "13000706"),
        ("603#C008200000000000", "603#C900000000000000", None),
        ("603#C608200014000000", "603#C500000000000000", "04000405"),
    ],
)
def test_length_and_crc_are_checked_at_the_end(initiate, end, code):
    server = device()
    answer = ask(server, initiate, *SEGMENTS, end)[-1]
    assert answer == (f"583#80082000{code}" if code else "583#A100000000000000")
    assert server.store.objects[0x2008, 0] == (b"old" if code else bytes(range(19)))


def test_more_than_announced_is_refused_at_once():
    assert ask(device(), "603#C20820000D000000", *SEGMENTS)[-1] == "583#8008200012000706"


def test_the_end_is_confirmed_only_when_the_store_has_taken_the_object():
    server = device()
    server.store.sizes[0x2008, 0] = 4
    assert ask(server, "603#C008200000000000", *SEGMENTS, "603#C500000000000000")[-1] == "583#8008200012000706"


def test_another_last_segment_after_the_last_is_an_error():
    assert ask(device(), WRITE, *SEGMENTS, "603#83FFFFFFFFFFFFFF")[-1] == "583#8008200001000405"


def test_an_abort_within_the_segments_is_an_abort():
    server = device()
    ask(server, WRITE, SEGMENTS[0], "603#8008200000000405")
    assert ask(server, SEGMENTS[1]) == ["583#8000000001000405"]
