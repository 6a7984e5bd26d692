from __future__ import annotations

import pytest
from support.sdo import MS, NODE, MemoryStore, frame

from canopen_control.cia301.sdo_server import SdoServer


class Device(SdoServer):
    """A server, the store behind it, and a short way to ask it."""

    def __init__(self, **options):
        objects = {(0x2000, 0): b"\5", (0x2001, 0): b"\1\2", (0x2007, 0): b"0123456789", (0x2008, 0): b""}
        super().__init__(NODE, MemoryStore(objects), **options)

    def ask(self, *requests, now=0):
        said = []
        for request in requests:
            self.receive(frame(request), now)
            said += [str(one) for one in self.frames()]
        return said


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


@pytest.mark.parametrize(
    ("request_", "size", "value"),
    [
        ("603#2201200007000000", 2, b"\7\0"),  # no size: the object's own length counts
        ("603#2201200007000000", None, b"\7\0\0\0"),
        ("603#2B01200007000000", 2, b"\7\0"),
        ("603#2701200007080900", None, b"\7\x08\x09"),
    ],
)
def test_an_expedited_download_has_as_many_bytes_as_it_reports(device, request_, size, value):
    if size:
        device.store.sizes[0x2001, 0] = size
    assert device.ask(request_) == ["583#6001200000000000"]
    assert device.store.objects[0x2001, 0] == value


@pytest.mark.parametrize("code", [0x06010001, 0x06010002, 0x06090011, 0x08000021, 0x08000022])
@pytest.mark.parametrize("command", ["40", "23", "21", "A4", "C6", "22"])
def test_what_the_store_reports_no_to_is_aborted_with_its_code(device, command, code):
    device.store.aborts[0x2000, 0] = code
    answer = device.ask(f"603#{command}0020007F000000")
    assert answer == [f"583#80002000{code.to_bytes(4, 'little').hex().upper()}"]
    assert device.next_deadline() is None


@pytest.mark.parametrize("command", ["21", "C6"])
@pytest.mark.parametrize(("announced", "code"), [("01", "13000706"), ("03", "12000706")])
def test_an_announced_length_that_cannot_be_right_ends_with_the_first_frame(device, command, announced, code):
    device.store.sizes[0x2001, 0] = 2
    assert device.ask(f"603#{command}012000{announced}000000") == [f"583#80012000{code}"]


@pytest.mark.parametrize("command", ["21", "C6"])
def test_what_is_over_the_limit_is_refused_at_once(command):
    device = Device(max_size=100)
    assert device.ask(f"603#{command}08200065000000") == ["583#8008200005000405"]
    assert device.ask(f"603#{command}08200064000000")[0][4] in "6A"


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


def test_what_fits_another_transfer_ends_the_one_under_way_by_name(device):
    assert device.ask("603#4007200000000000", "603#0000000000000000")[1] == "583#8007200001000405"
    assert device.ask("603#6000000000000000") == ["583#8000000001000405"]


def test_a_new_initiate_ends_the_old_transfer_without_a_word(device):
    said = device.ask("603#4007200000000000", "603#6000000000000000", "603#4000200000000000", "603#7000000000000000")
    assert said[2:] == ["583#4F00200005000000", "583#8000000001000405"]


def test_the_clients_abort_ends_the_transfer(device):
    said = device.ask("603#4007200000000000", "603#8007200000000405", "603#6000000000000000")
    assert said[1:] == ["583#8000000001000405"]
    assert device.next_deadline() is None


def test_a_transfer_that_is_at_standstill_is_aborted():
    device = Device(timeout_ns=1000 * MS)
    device.ask("603#4007200000000000")
    device.tick(999 * MS)
    assert device.frames() == []
    device.tick(1000 * MS)
    assert [str(one) for one in device.frames()] == ["583#8007200000000405"]
    assert device.next_deadline() is None


def test_every_segment_keeps_a_transfer_alive():
    device = Device(timeout_ns=1000 * MS)
    device.ask("603#4007200000000000", now=0)
    device.ask("603#6000000000000000", now=900 * MS)
    device.tick(1500 * MS)
    assert device.ask("603#7000000000000000", now=1600 * MS) == ["583#1937383900000000"]


def test_a_copy_of_a_request_whose_answer_has_not_left_is_not_answered_again(device):
    for _ in range(2):
        device.receive(frame("603#4000200000000000"), 0)
    assert len(device.frames()) == 1
    assert device.ask("603#4000200000000000") == ["583#4F00200005000000"]


def test_a_request_given_up_and_made_again_is_answered_again(device):
    for request in ("4000200000000000", "8000200000000405", "4000200000000000"):
        device.receive(frame("603#" + request), 0)
    assert len(device.frames()) == 2


def test_a_reset_drops_everything(device):
    device.receive(frame("603#4007200000000000"), 0)
    device.reset()
    assert (device.frames(), device.next_deadline()) == ([], None)
    assert device.ask("603#6000000000000000") == ["583#8000000001000405"]


def test_a_server_without_block_transfer_aborts_the_command_as_unknown():
    device = Device(block=False)
    assert device.ask("603#A40020007F000000", "603#C600200008000000") == ["583#8000000001000405"] * 2
