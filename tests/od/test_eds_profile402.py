"""The table of the drive profile's types."""

import pytest

from canopen_control.data_files import data_path
from canopen_control.od.eds import TYPES, read_eds
from canopen_control.od.model import DataType


@pytest.mark.parametrize(
    ("address", "data_type"),
    [
        ((0x6040, 0), DataType.UNSIGNED16),
        ((0x6041, 0), DataType.UNSIGNED16),
        ((0x6060, 0), DataType.INTEGER8),
        ((0x6071, 0), DataType.INTEGER16),
        ((0x607A, 0), DataType.INTEGER32),
        ((0x60FF, 0), DataType.INTEGER32),
        ((0x60C2, 1), DataType.UNSIGNED8),
        ((0x60C2, 2), DataType.INTEGER8),
        ((0x6502, 0), DataType.UNSIGNED32),
    ],
)
def test_the_types_everybody_relies_on(address, data_type):
    assert TYPES[address] == (data_type,)


@pytest.mark.parametrize("name", ["TMCM-1270.eds", "generic_cia402.eds"])
def test_the_bundled_drives_have_these_types(name):
    od = read_eds(data_path("eds", name)).od
    compared = [address for address in TYPES if address in od]
    assert len(compared) > 40
    assert [address for address in compared if od[address].data_type not in TYPES[address]] == []
