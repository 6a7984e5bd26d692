"""Steps of the checks of a drive."""

import pytest

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.sdo_server import SdoServerAbort
from canopen_control.cia402 import objects as o
from canopen_control.cia402.modes import OperationMode
from canopen_control.cia402.state import State
from canopen_control.conformance.checked_node import CheckFailed, MotionBounds, NotApplicable
from canopen_control.conformance.drive_steps import (
    OE,
    SOD,
    drive_at,
    motion_of,
    moving,
    reaches,
    signed,
    statusword,
    turn,
    watch,
)
from canopen_control.errors import BusError


def test_a_drive_is_brought_to_a_state_and_loses_its_power_at_the_end(bench):
    node = bench()
    with drive_at(node, OE):
        assert statusword(node) & 0x6F == OE.value
    reaches(node, SOD, 0.0)


def test_a_state_that_is_not_reached_is_named(bench):
    with pytest.raises(CheckFailed, match=r"\(SWITCH_ON_DISABLED\) after 0.1 s; expected: FAULT"):
        reaches(bench(), State.FAULT, 0.1)


# Bounds of the motions of a check, and their end.


def _turn_for(node, seconds):
    with moving(node, OperationMode.PV) as motion:
        turn(node, motion, motion.velocity)
        watch(node, motion, seconds)


def test_the_bounds_are_those_of_the_options_or_of_the_objects(bench):
    node = bench()
    motion = motion_of(node)
    assert motion.speed == node.number(o.MAX_PROFILE_VELOCITY) // 100
    assert motion.distance == node.number(o.FEED_CONSTANT, 1) // 2
    node.bounds = MotionBounds(distance=100, speed=200)
    assert motion_of(node)[1:3] == (100, 200)


def test_a_limit_ahead_turns_the_motion_round_and_two_forbid_it(bench):
    node = bench()
    node.device.store.set(o.SOFTWARE_POSITION_LIMIT, 2, 100)
    assert motion_of(node).distance < 0
    node.device.store.set(o.SOFTWARE_POSITION_LIMIT, 1, -100)
    with pytest.raises(NotApplicable, match="0x607D leaves no room"):
        motion_of(node)


def test_a_motion_that_goes_too_far_ends_without_power_at_a_failure(bench):
    node = bench()
    node.bounds = MotionBounds(distance=1000, speed=60_000)
    with pytest.raises(CheckFailed, match="the shaft moved by"):
        _turn_for(node, 1.0)
    assert statusword(node) & 0x6F == 0x40


def test_the_shaft_returns_and_the_parameters_are_as_before(bench):
    node = bench()
    before = node.read(o.PROFILE_ACCELERATION)
    with moving(node, OperationMode.PV) as motion:
        turn(node, motion, motion.velocity)
    assert abs(signed(node, o.POSITION_ACTUAL) - motion.start) < 100
    assert node.read(o.PROFILE_ACCELERATION) == before


@pytest.mark.parametrize("reaction", [0, 1])
def test_a_drive_stops_by_itself_if_the_program_is_killed_while_it_turns(bench, reaction):
    node = bench()
    node.device.store.set(o.ABORT_CONNECTION_OPTION, 0, reaction)
    with pytest.raises(BusError):
        _turn_until_killed(node)


def _turn_until_killed(node):
    with moving(node, OperationMode.PV) as motion:
        turn(node, motion, motion.velocity)
        node.reactor.run_for(3_000_000_000)
        assert node.device.get(o.VELOCITY_ACTUAL) == pytest.approx(motion.velocity, rel=0.1), "its heartbeat goes on"
        node.port.close()
        node.reactor.run_for(2_000_000_000)
        node.device.advance_drives(node.reactor.now())
        assert node.device.get(o.VELOCITY_ACTUAL) == 0
        assert node.device.get(o.STATUSWORD) & 0x04 == 0


def test_the_monitoring_of_a_motion_ends_with_it_and_a_drive_without_it_is_noted(bench):
    node = bench()
    with moving(node, OperationMode.PV):
        assert node.number(0x1016, 1) == 124 << 16 | 1000
    assert node.number(0x1016, 1) == 0
    assert node.notes == []
    node.device.store.guard([0x1016], _refuse)
    with moving(node, OperationMode.PV):
        assert node.number(0x1016, 1) == 0
    assert any("continues to move if this program is killed" in note for note in node.notes)


def _refuse(_entry, _value):
    raise SdoServerAbort(AbortCode.READ_ONLY)
