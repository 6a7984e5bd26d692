"""All signals of a device by name, and any object by its address."""

import pytest
from support.virtualbench import servo_od

from canopen_control.data_files import data_path
from canopen_control.od.eds import read_eds
from canopen_control.profiles.device_type import Profile
from canopen_control.profiles.profile_tables import object_signal, profile_signals

MODULE = read_eds(data_path("eds", "generic_cia401.eds"), 5).od


def test_a_device_has_the_signals_of_its_profile_and_a_drive_none():
    assert "di0" in profile_signals(MODULE, Profile.IO)
    assert profile_signals(MODULE, Profile.DRIVE) == profile_signals(servo_od(), Profile.NONE) == {}


@pytest.mark.parametrize(
    ("name", "address", "bit", "output"),
    [
        ("0x6401:02", (0x6401, 2), None, False),
        ("0x6200:01.4", (0x6200, 1), 4, True),
        ("0x1001", (0x1001, 0), None, False),
    ],
)
def test_any_object_is_a_signal_by_its_address(name, address, bit, output):
    signal = object_signal(MODULE, name)
    assert (signal.address, signal.bit, signal.output) == (address, bit, output)
    assert signal.value(16, signal.gain({})) == (16.0 if bit is None else 1.0)


@pytest.mark.parametrize("name", ["0x6401:09", "0x1008", "di0", "6401:01", "0x", ""])
def test_what_is_no_number_of_the_device_is_none(name):
    assert object_signal(MODULE, name) is None
