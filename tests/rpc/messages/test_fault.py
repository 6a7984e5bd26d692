"""The record of a fault, by its source: on the wire and as text."""

import pytest

from canopen_control.cia301.emcy import EmcyMessage
from canopen_control.rpc.messages.fault import FaultEvent
from canopen_control.rpc.wire import convert, plain

EMCY = FaultEvent.of_emcy(EmcyMessage(3, 0x8611, 0x21, b"\1\0\0\0\0"))


def test_an_emergency_keeps_code_register_and_data():
    assert FaultEvent(0x8611, 0x21, "0100000000") == EMCY
    assert not EMCY.is_over
    assert FaultEvent.of_emcy(EmcyMessage(3, 0x0000, 0)).is_over


@pytest.mark.parametrize(
    ("fault", "text"),
    [
        (EMCY, "0x8611 (following error), register 0x21 (generic, device profile), data 01 00 00 00 00"),
        (FaultEvent(0, 0, "0000000000"), "0x0000 (error reset or no error), register 0x00"),
        (FaultEvent(error_code=0x4310, statusword=0x238), "0x4310 (drive temperature too high), statusword 0x0238"),
        (FaultEvent(error_register=8), "register 0x08 (temperature)"),
        (FaultEvent(), ""),
    ],
)
def test_a_fault_in_words_leaves_out_what_is_unknown(fault, text):
    assert fault.text == text


def test_ros_takes_the_known_fields_as_text():
    assert EMCY.values == {"error_code": "0x8611", "error_register": "0x21", "data": "01 00 00 00 00"}
    assert FaultEvent(statusword=0x238).values == {"statusword": "0x0238"}


def test_on_the_wire_stand_only_the_known_fields():
    fault = FaultEvent(error_code=0x4310, statusword=0x238)
    assert plain(fault) == {"error_code": 0x4310, "statusword": 0x238}
    assert convert({"error_code": 0x4310, "later": 1}, FaultEvent) == FaultEvent(0x4310)
