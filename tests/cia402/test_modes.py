from __future__ import annotations

import json
from pathlib import Path

import pytest

from canopen_control.cia402.modes import (
    MODE_BITS,
    TARGET_OBJECTS,
    OperationMode,
    mode_for_interface,
    mode_name,
    require_mode,
    supported_modes,
)
from canopen_control.errors import UnsupportedMode

VECTORS = json.loads((Path(__file__).parents[1] / "data" / "cia402.json").read_text())
TMCM = supported_modes(0xA5)


def test_each_bit_of_0x6502_is_the_mode_of_the_vectors():
    for bit, text in VECTORS["cia402_6502"]["bits"].items():
        (mode,) = supported_modes(1 << int(bit))
        assert f"{mode.name}({mode.value})" == text


def test_reserved_and_vendor_bits_are_not_modes():
    assert supported_modes(1 << 4 | 1 << 11 | 0xFFFF0000) == ()


@pytest.mark.parametrize(
    ("interface", "supported", "mode"),
    [
        ("velocity", 0x1A5, OperationMode.CSV),
        ("velocity", 0xA5, OperationMode.PV),
        ("position", 0xA5, OperationMode.CSP),
        ("position", 0x23, OperationMode.PP),
        ("effort", 0x3EF, OperationMode.CST),
        ("effort", 0x08, OperationMode.TQ),
    ],
)
def test_an_interface_gets_the_cyclic_mode_where_there_is_one(interface, supported, mode):
    assert mode_for_interface(interface, supported_modes(supported)) is mode


def test_an_interface_that_no_mode_serves_is_refused_with_the_modes_there_are():
    with pytest.raises(UnsupportedMode, match=r"CST or TQ for interface 'effort'.*PP, PV, HM, CSP") as error:
        mode_for_interface("effort", TMCM)
    assert error.value.supported == ("PP", "PV", "HM", "CSP")
    with pytest.raises(UnsupportedMode, match="temperature"):
        mode_for_interface("temperature", TMCM)


def test_a_mode_is_required_of_0x6502_but_for_the_manufacturers():
    require_mode(8, TMCM)
    require_mode(-3, TMCM)
    for mode in (0, 9, 10, 7, 2, 5):
        with pytest.raises(UnsupportedMode):
            require_mode(mode, TMCM)


def test_modes_have_names_whatever_the_number():
    assert mode_name(8) == "CSP"
    assert mode_name(0) == "NONE"
    assert mode_name(-3) == "mode -3 (manufacturer)"
    assert mode_name(5) == "mode 5 (reserved)"


def test_bit_10_means_nothing_in_the_cyclic_modes():
    for mode in (OperationMode.CSP, OperationMode.CSV, OperationMode.CST):
        assert 10 not in MODE_BITS[mode].statusword
        assert 12 in MODE_BITS[mode].statusword
    assert 13 in MODE_BITS[OperationMode.CSP].statusword
    assert MODE_BITS[OperationMode.VL].statusword == {}


def is_refused(mode, listed):
    try:
        require_mode(mode, listed)
    except UnsupportedMode:
        return True
    return False


def test_a_drive_that_lists_no_mode_is_not_judged():
    assert is_refused(8, (OperationMode.PP,))
    assert not is_refused(8, ())


def test_every_mode_with_a_target_has_its_object():
    assert {mode: address[0] for mode, address in TARGET_OBJECTS.items()} == {
        1: 0x607A, 2: 0x6042, 3: 0x60FF, 4: 0x6071, 7: 0x60C1, 8: 0x607A, 9: 0x60FF, 10: 0x6071,
    }  # fmt: skip
    assert TARGET_OBJECTS[7] == (0x60C1, 1)
    assert 6 not in TARGET_OBJECTS
    assert -3 not in TARGET_OBJECTS
