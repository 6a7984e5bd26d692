from __future__ import annotations

import pytest
from support.sdo import NODE, MemoryStore, conversations, frame, play_server

from canopen_control.cia301.sdo_server import SdoServer

CONVERSATIONS = conversations("""
an expedited download without a size has the object's own
    size=2 > 2208200007 < 600820 = 0700
an expedited download without a size has four bytes where the object's is unknown
    > 2208200007 < 600820 = 07000000
an expedited download has as many bytes as it announces, and as the object has
    size=2 > 2B08200007 < 600820 = 0700
an expedited download has as many bytes as it announces
    > 27082000070809 < 600820 = 070809
an announced length below that of the object ends a download with the first frame
    size=2 > 2108200001 < 8008200013000706
an announced length above that of the object ends a download with the first frame
    size=2 > 2108200003 < 8008200012000706
an announced length below that of the object ends a block download with the first frame
    size=2 > C608200001 < 8008200013000706
an announced length above that of the object ends a block download with the first frame
    size=2 > C608200003 < 8008200012000706
what is over the limit is refused at once
    max_size=100 > 2108200065 < 8008200005000405 > 2108200064 < 600820
what is over the limit is refused at once in blocks
    max_size=100 > C608200065 < 8008200005000405 > C608200064 < A40820007F
what fits another transfer ends the active one with its object
    > 400720 < 410720000A > 00 < 8007200001000405 > 60 < 8000000001000405
a new request ends the old transfer without a frame of its own
    > 400720 < 410720000A > 60 < 0030313233343536 > 400820 < 470820006F6C64 > 70 < 8000000001000405
the client's abort ends the transfer
    > 400720 < 410720000A > 8007200000000405 > 60 < 8000000001000405
a transfer that stands still is aborted
    timeout_ms=1000 > 400720 < 410720000A +999 +1 < 8007200000000405
every segment keeps a transfer alive
    timeout_ms=1000 > 400720 < 410720000A +900 > 60 < 0030313233343536 +600 +100 > 70 < 19373839
a copy of a request whose answer has not left is not answered again
    > 400820 >! 400820 < 470820006F6C64 > 400820 < 470820006F6C64
a request given up and made again is answered again
    > 400820 > 8008200000000405 > 400820 < 470820006F6C64 < 470820006F6C64
a server without block transfer does not know the command
    block=0 > A40720007F < 8000000001000405 > C608200008 < 8000000001000405
""")


@pytest.mark.parametrize("words", CONVERSATIONS.values(), ids=CONVERSATIONS)
def test_the_conversations_of_the_server(words):
    play_server(words)


class Device(SdoServer):
    """A server, the store behind it, and a short way to ask it."""

    def __init__(self, **options):
        objects = {(0x2000, 0): b"\5", (0x2001, 0): b"\1\2", (0x2007, 0): b"0123456789", (0x2008, 0): b""}
        super().__init__(NODE, MemoryStore(objects), **options)

    def ask(self, *requests, now=0):
        messages = []
        for request in requests:
            self.receive(frame(request), now)
            messages += [str(one) for one in self.frames()]
        return messages


@pytest.fixture
def device():
    return Device()


def test_frames_for_other_nodes_are_not_ours(device):
    assert device.ask("604#4000200000000000", "583#4000200000000000", "000#0103") == []
    assert device.ignored == 0


@pytest.mark.parametrize("request_", ["603#", "603#40", "603#40002000", "603#40002000000000"])
def test_a_frame_of_another_length_is_counted_and_not_answered(device, request_):
    assert device.ask(request_) == []
    assert device.ignored == 1


@pytest.mark.parametrize("code", [0x06010001, 0x06010002, 0x06090011, 0x08000021, 0x08000022])
@pytest.mark.parametrize("command", ["40", "23", "21", "A4", "C6", "22"])
def test_what_the_store_reports_no_to_is_aborted_with_its_code(device, command, code):
    device.store.aborts[0x2000, 0] = code
    answer = device.ask(f"603#{command}0020007F000000")
    assert answer == [f"583#80002000{code.to_bytes(4, 'little').hex().upper()}"]
    assert device.next_deadline() is None


def test_a_defect_of_the_store_is_a_general_error_and_an_event(device):
    device.store.objects[0x2000, 0] = None
    assert device.ask("603#4000200000000000") == ["583#8000200000000008"]
    (failure,) = device.events()
    assert (failure.index, failure.subindex, type(failure.error)) == (0x2000, 0, TypeError)
    assert device.ask("603#4001200000000000") == ["583#4B01200001020000"]
    assert device.events() == []


def test_a_defect_in_every_transfer_kind_is_a_general_error(device):
    def broken(*_):
        raise KeyError("a defect")

    device.store.upload = device.store.download = device.store.size_of = broken
    for request in ("4000200000000000", "2300200000000000", "2100200008000000", "C600200008000000", "A40020007F000000"):
        assert device.ask("603#" + request) == ["583#8000200000000008"]
    assert len(device.events()) == 5


@pytest.mark.parametrize("stray", ["60", "70", "00", "0F", "10", "A1", "A2", "A3", "C1", "E0", "FF", "90"])
def test_what_fits_no_transfer_is_an_unknown_command(device, stray):
    assert device.ask(f"603#{stray}01020304050607") == ["583#8000000001000405"]


def test_an_abort_without_a_transfer_is_not_answered(device):
    assert device.ask("603#8000200000000405") == []
    assert (device.aborted, device.ignored) == (0, 0)


def test_a_reset_drops_everything(device):
    device.receive(frame("603#4007200000000000"), 0)
    device.reset()
    assert (device.frames(), device.next_deadline()) == ([], None)
    assert device.ask("603#6000000000000000") == ["583#8000000001000405"]
