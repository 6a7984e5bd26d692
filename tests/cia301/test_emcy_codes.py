from __future__ import annotations

import pytest
from support.services import vectors

from canopen_control.cia301.emcy import ERROR_TEXTS, ErrorRegister, error_text, register_text


@pytest.mark.parametrize(
    ("code", "text"),
    [
        (0x0000, "error reset or no error"),
        (0x00FF, "error reset or no error"),
        (0x8611, "following error"),
        (0x8130, "life guard or heartbeat error"),
        (0x7121, "motor blocked"),
        (0x6301, "data set"),
        (0x5443, "contacts"),
        (0x8199, "communication"),
        (0xFF01, "device specific"),
        (0xF0AA, "additional functions"),
        (0x9123, "external error"),
        (0x0123, "unknown error code 0x0123"),
        (0xA000, "unknown error code 0xA000"),
    ],
)
def test_a_code_has_its_text_or_that_of_its_class(code, text):
    assert error_text(code) == text


def test_every_class_of_the_standard_has_a_text():
    classes = "00 10 20 21 22 23 30 31 32 33 40 41 42 50 60 61 62 63 70 80 81 82 90 F0 FF"
    codes = [int(digits, 16) << 8 for digits in classes.split()]
    codes += [0x8110, 0x8120, 0x8130, 0x8140, 0x8150, 0x8210, 0x8220, 0x8230, 0x8240, 0x8250]
    assert [code for code in codes if code not in ERROR_TEXTS] == []


def test_every_code_has_some_text():
    assert all(error_text(code) for code in range(0x10000))


def test_the_register_bits_are_the_vectors():
    bits = vectors()["emcy"]["register_bits"]
    assert {int(bit): name for bit, name in bits.items() if not name.startswith("reserved")} == {
        int(flag).bit_length() - 1: register_text(flag) for flag in ErrorRegister if flag
    }
    assert register_text(0x21) == "generic, device profile"
    assert register_text(0) == ""
