"""The profile of a dictionary: by 0x1000, by its objects, and drives with any device type."""

import pytest
from support.virtualbench import T, entry, servo_od

from canopen_control.data_files import data_path
from canopen_control.od.eds import read_eds
from canopen_control.od.model import ObjectDictionary
from canopen_control.profiles import Profile, profile_of


def dictionary(*entries, device_type=0):
    od = ObjectDictionary(node_id=5)
    if device_type is not None:
        od.add(entry(0x1000, 0, T.UNSIGNED32, device_type, "ro"))
    for item in entries:
        od.add(entry(*item))
    return od


@pytest.mark.parametrize(
    ("device_type", "profile"),
    [
        (0x000F0191, Profile.IO),
        (0x00030191, Profile.IO),
        (0x00020194, Profile.MEASURING),
        (0x00010196, Profile.ENCODER),
        (0x0002019A, Profile.INCLINOMETER),
        (0x000001A2, Profile.BATTERY),
        (0x000001A3, Profile.CHARGER),
        (0x000001C6, Profile.ENERGY),
        (0x00020192, Profile.NONE),  # a drive has a controlword
        (0x00020198, Profile.NONE),
    ],
)
def test_the_low_word_of_the_device_type_is_the_profile(device_type, profile):
    assert profile_of(dictionary(device_type=device_type)) is profile


@pytest.mark.parametrize("device_type", [0, 0x00030191, 0x00010196])
def test_what_has_a_controlword_and_a_statusword_is_a_drive_whatever_it_calls_itself(device_type):
    od = servo_od()
    od.add(entry(0x1000, 0, T.UNSIGNED32, device_type, "ro"))
    od.add(entry(0x6200, 1, T.UNSIGNED8))
    assert profile_of(od) is Profile.DRIVE


@pytest.mark.parametrize("device_type", [0, None])
@pytest.mark.parametrize(
    ("objects", "profile"),
    [
        ([(0x6000, 1, T.UNSIGNED8)], Profile.IO),
        ([(0x6411, 1, T.INTEGER16)], Profile.IO),
        ([(0x6001, 0, T.UNSIGNED32), (0x6004, 0, T.UNSIGNED32)], Profile.ENCODER),
        ([(0x6000, 0, T.UNSIGNED16), (0x6010, 0, T.INTEGER16)], Profile.INCLINOMETER),
        ([(0x6150, 1, T.UNSIGNED8), (0x7130, 1, T.INTEGER16)], Profile.MEASURING),
        ([(0x6060, 0, T.UNSIGNED32), (0x6081, 0, T.UNSIGNED8), (0x6010, 0, T.INTEGER16)], Profile.BATTERY),
        ([(0x6060, 0, T.INTEGER8), (0x6081, 0, T.UNSIGNED32)], Profile.NONE),  # of a drive without its words
        ([(0x2000, 0, T.UNSIGNED8)], Profile.NONE),
    ],
)
def test_without_a_device_type_the_objects_report(device_type, objects, profile):
    assert profile_of(dictionary(*objects, device_type=device_type)) is profile


def test_the_bundled_module_is_one_and_every_profile_has_words():
    assert profile_of(read_eds(data_path("eds", "generic_cia401.eds")).od) is Profile.IO
    assert all(profile.words for profile in Profile)
