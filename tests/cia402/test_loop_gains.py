import dataclasses

import pytest

from canopen_control.cia402.loop_gains import LoopGain, gain_objects
from canopen_control.data_files import data_path
from canopen_control.od.eds import read_eds

SERVO = read_eds(data_path("eds", "generic_cia402.eds"), 5).od


def test_the_servo_of_this_project_has_all_four():
    assert {gain: (each.index, each.subindex) for gain, each in gain_objects(SERVO).items()} == {
        LoopGain.VELOCITY_P: (0x60F9, 1),
        LoopGain.VELOCITY_I: (0x60F9, 2),
        LoopGain.POSITION_P: (0x60FB, 1),
        LoopGain.VELOCITY_FEED_FORWARD: (0x60FB, 2),
    }


def test_an_axis_that_is_not_there_has_none():
    assert gain_objects(SERVO, 1) == {}


@pytest.mark.parametrize("name", ["TMCM-1270.eds", "generic_cia401.eds"])
def test_a_device_without_loops_has_none(name):
    assert gain_objects(read_eds(data_path("eds", name), 5).od) == {}


def test_another_makers_numbers_are_of_another_scale():
    entry = dataclasses.replace(SERVO[0x1018, 1], default=0xFB)
    entries = dict(SERVO.entries) | {(0x1018, 1): entry}
    assert gain_objects(dataclasses.replace(SERVO, entries=entries)) == {}
