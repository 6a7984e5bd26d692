import dataclasses
import math

import pytest
from support.parameter_node import session_with

from canopen_control.cia402.loop_gains import GainObject, LoopGain
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError
from canopen_control.od.eds import read_eds
from canopen_control.service.tune_gains import parse_gain, settable_gains

SERVO, TMCM = (read_eds(data_path("eds", f"{name}.eds"), 5).od for name in ("generic_cia402", "TMCM-1270"))


def test_a_named_gain_is_an_object_and_a_scale():
    assert parse_gain("Velocity_P=0x3210:01*1e-3") == (LoopGain.VELOCITY_P, GainObject(0x3210, 1, 0.001))


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("velocity_p", "say which object holds which gain"),
        ("speed=0x3210:01*1", "the gains are velocity_p, velocity_i, position_p, velocity_feed_forward"),
        ("velocity_p=0x3210:01*zero", "'zero' is no scale"),
        ("velocity_p=0x3210:01*-1", "give a number above 0"),
        ("velocity_p=0x3210:01*nan", "give a number above 0"),
        ("velocity_p=0x3210:01*inf", "give a number above 0"),
    ],
)
def test_what_is_no_gain_is_told(text, why):
    with pytest.raises(ConfigError, match=why):
        parse_gain(text)


def test_what_is_named_wins_and_is_worth_what_it_says_at_the_shaft():
    per_rad = 4096 / math.tau
    objects = settable_gains(session_with(SERVO), 0, ["velocity_p=0x6081:00*0.5", "position_p=0x6083:00*0.1"], per_rad)
    assert objects[LoopGain.VELOCITY_P] == GainObject(0x6081, 0, 0.5 / per_rad)
    assert objects[LoopGain.POSITION_P] == GainObject(0x6083, 0, 0.1)
    assert objects[LoopGain.VELOCITY_I].index == 0x60F9


def test_an_object_that_is_not_there_is_told():
    with pytest.raises(ConfigError, match="has no 0x3210:01 in its EDS"):
        settable_gains(session_with(SERVO), 0, ["velocity_p=0x3210:01*1"], 1.0)


def test_a_drive_whose_gains_nobody_knows_is_told():
    with pytest.raises(ConfigError, match=r"nobody knows which of its objects hold velocity_p and velocity_i"):
        settable_gains(session_with(TMCM), 0, [], 1.0)


def test_the_objects_of_a_known_maker_are_named_and_nothing_is_set_without_their_scale():
    entries = dict(SERVO.entries) | {(0x1018, 1): dataclasses.replace(SERVO[0x1018, 1], default=0xFB)}
    device = dataclasses.replace(SERVO.device, vendor_name="maxon motor ag")
    od = dataclasses.replace(SERVO, entries=entries, device=device)
    with pytest.raises(ConfigError, match=r"holds gains in 0x60F9:01 .*--gain velocity_p=0x60F9:01\*SCALE"):
        settable_gains(session_with(od), 0, [], 1.0)
    named = ["velocity_p=0x60F9:01*0.5", "velocity_i=0x60F9:02*0.5"]
    assert len(settable_gains(session_with(od), 0, named, 1.0)) == 2
