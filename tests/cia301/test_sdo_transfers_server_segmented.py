from __future__ import annotations

import pytest
from support.sdo import NODE, MemoryStore, frame

from canopen_control.cia301.sdo_server import SdoServer

INITIATE_UNSIZED = "603#2008200000000000"


def device(**options):
    return SdoServer(NODE, MemoryStore({(0x2007, 0): b"0123456789", (0x2008, 0): b"old"}), **options)


def ask(server, *requests):
    said = []
    for request in requests:
        server.receive(frame(request), 0)
        said += [str(one) for one in server.frames()]
    return said


def at_once(server, *requests):
    """Return the answers to requests that come before any answer has left, as copies by the bus do."""
    for request in requests:
        server.receive(frame(request), 0)
    return [str(one) for one in server.frames()]


def test_a_doubled_request_for_a_segment_is_answered_once():
    server = device()
    ask(server, "603#4007200000000000")
    assert at_once(server, *["603#6000000000000000"] * 2) == ["583#0030313233343536"]
    assert ask(server, "603#7000000000000000") == ["583#1937383900000000"]


def test_a_request_that_is_repeated_after_its_answer_has_not_alternated():
    server = device()
    ask(server, "603#4007200000000000", "603#6000000000000000")
    assert ask(server, "603#6000000000000000") == ["583#8007200000000305"]
    assert ask(server, "603#7000000000000000") == ["583#8000000001000405"]  # the transfer is over


def test_a_doubled_request_for_the_last_segment_is_not_an_error():
    said = ask(device(), "603#4007200000000000", "603#6000000000000000", *["603#7000000000000000"] * 2)
    assert len(said) == 3


def test_the_object_is_read_once_and_does_not_change_under_way():
    server = device()
    ask(server, "603#4007200000000000", "603#6000000000000000")
    server.store.objects[0x2007, 0] = b"changed while it was read"
    assert ask(server, "603#7000000000000000") == ["583#1937383900000000"]
    assert server.store.uploads == 1


def test_a_doubled_segment_is_taken_once():
    server = device()
    ask(server, INITIATE_UNSIZED)
    assert at_once(server, *["603#0031323334353637"] * 2) == ["583#2000000000000000"]
    assert ask(server, *["603#1D38000000000000"] * 2) == ["583#3000000000000000"]
    assert server.store.downloads == [(0x2008, 0, b"12345678")]


def test_a_segment_that_is_repeated_after_its_confirmation_has_not_alternated():
    server = device()
    said = ask(server, INITIATE_UNSIZED, *["603#0031323334353637"] * 2)
    assert said[1:] == ["583#2000000000000000", "583#8008200000000305"]
    assert server.store.downloads == []


def test_another_segment_with_the_old_toggle_is_an_error():
    said = ask(device(), INITIATE_UNSIZED, "603#0031323334353637", "603#0D38000000000000")
    assert said[2] == "583#8008200000000305"


@pytest.mark.parametrize(("size", "code"), [("07", "12000706"), ("09", "13000706")])
def test_another_length_than_announced_is_refused_and_nothing_is_written(size, code):
    server = device()
    said = ask(server, f"603#21082000{size}000000", "603#0031323334353637", "603#1D38000000000000")
    assert said[-1] == f"583#80082000{code}"
    assert server.store.downloads == []


def test_one_that_grows_over_the_limit_is_refused():
    said = ask(device(max_size=10), INITIATE_UNSIZED, "603#0031323334353637", "603#1031323334353637")
    assert said[-1] == "583#8008200005000405"


def test_the_last_segment_is_confirmed_only_when_the_store_has_taken_the_object():
    server = device()
    server.store.sizes[0x2008, 0] = 4
    said = ask(server, INITIATE_UNSIZED, "603#0531323334350000")
    assert said == ["583#6008200000000000", "583#8008200012000706"]
    assert server.store.objects[0x2008, 0] == b"old"
