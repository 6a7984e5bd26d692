import math

import pytest
from support.parameter_node import session_with

from canopen_control.cia402.loop_gains import LoopGain, gain_objects
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError, DriveError
from canopen_control.od.eds import read_eds
from canopen_control.service.tune_gains import LoopGains, gain_values, revert_gains, set_gains

OD = read_eds(data_path("eds", "generic_cia402.eds"), 5).od
PER_RAD = 65536 / math.tau
GAINS = LoopGains(velocity_p=5000.0, reset=0.02, position_p=15.7, crossover=60.0, margin=1.0)
P, TI, KV, FF = (0x60F9, 1), (0x60F9, 2), (0x60FB, 1), (0x60FB, 2)


class Kept:
    """Keeps gains in memory."""

    def __init__(self):
        self.held = {}

    def read(self):
        return self.held

    def keep(self, _od, values):
        self.held = dict(values)

    def forget(self):
        self.held = {}


def values(**changed):
    return gain_values(OD, gain_objects(OD), GAINS, PER_RAD) | changed


def held(session):
    return [session.read_value(OD[address]) for address in (P, TI, KV, FF)]


def test_a_gain_at_the_shaft_is_one_of_the_drives_own_units():
    wanted = values()
    assert wanted[P] * 1e-5 * PER_RAD == pytest.approx(5000.0, rel=1e-4)
    assert wanted[TI] == pytest.approx(wanted[P] / 0.02, rel=1e-4)
    assert (wanted[KV], wanted[FF]) == (15_700, 1000)


@pytest.mark.parametrize("gain", [1e-12, 1e12])
def test_a_gain_that_the_object_cannot_hold_is_told(gain):
    design = LoopGains(gain, 0.02, 15.0, 60.0, 1.0)
    with pytest.raises(ConfigError, match=r"0x60F9:01 Velocity loop proportional gain would be .* it holds 1 to"):
        gain_values(OD, gain_objects(OD), design, PER_RAD)


def test_gains_are_set_and_taken_back():
    session, kept = session_with(OD), Kept()
    before = held(session)
    changes = set_gains(session, values(), kept)
    assert held(session) == list(values().values())
    assert [str(each) for each in changes][2] == "0x60FB:01 Position loop proportional gain: 20000 -> 15700"
    revert_gains(session, kept)
    assert held(session) == before
    with pytest.raises(DriveError, match="no gains were set on this drive from here"):
        revert_gains(session, kept)


def test_gains_that_are_set_twice_go_back_to_those_before_the_first_time():
    session, kept = session_with(OD), Kept()
    before = held(session)
    set_gains(session, values(), kept)
    set_gains(session, values() | {P: 7}, kept)
    revert_gains(session, kept)
    assert held(session) == before


def test_what_was_before_is_kept_before_anything_changes(monkeypatch):
    """A computer that dies in the middle leaves a drive whose gains can be taken back."""
    session, kept = session_with(OD), Kept()
    before = held(session)
    seen = []
    write = session.transfers.write

    def watched(*what):
        seen.append(bool(kept.held))
        write(*what)

    monkeypatch.setattr(session.transfers, "write", watched)
    set_gains(session, values(), kept)
    assert seen
    assert all(seen)
    revert_gains(session, kept)
    assert held(session) == before


def test_an_enabled_drive_takes_none(monkeypatch):
    session, kept = session_with(OD), Kept()
    before = held(session)
    monkeypatch.setattr(type(session), "powered_axes", lambda _self: [0])
    with pytest.raises(DriveError, match="is enabled; nothing was written"):
        set_gains(session, values(), kept)
    assert held(session) == before


def test_a_drive_that_refuses_one_is_as_it_was():
    session, kept = session_with(OD), Kept()
    before = held(session)
    with pytest.raises(DriveError, match="refused gains, and is as it was: 0x6060"):
        set_gains(session, {P: 500, (0x6060, 0): 77}, kept)
    assert held(session) == before


def test_every_gain_has_a_place_in_the_bundled_servo():
    assert set(gain_objects(OD)) == set(LoopGain)
