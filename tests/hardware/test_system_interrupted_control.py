"""Drives in motion while the master stands still, boots their node again or loses it: none is left to itself."""

from functools import partial

import pytest
from support.makers import drive, sentences

from canopen_control.cia301.nmt import NmtCommand
from canopen_control.cia402.state import State

PAN, TILT = 2, 3


def _turning(robot, mode="pv", **how):
    """Return a robot whose axes move."""
    created = robot(mode, **how)
    created.command("vel", 0.5, 0.5, seconds=30)
    created.run(1.0)
    assert created.velocity("pan") == pytest.approx(0.5, rel=0.01)
    return created


def _sent(created, can_id, since):
    return [frame.data for _, who, frame in created.bus.frames[since:] if who == "master" and frame.can_id == can_id]


@pytest.mark.parametrize("mode", ["csv", pytest.param("pv", marks=pytest.mark.rest)])
def test_a_drive_that_stopped_while_the_program_stood_still_is_not_enabled_by_its_return(robot, mode):
    # 0x1029:01 = 1: the node stays OPERATIONAL; 0x605A = 6: the drive stays in QUICK STOP ACTIVE (transition 16)
    created = _turning(robot, mode, keys="error_behavior: {1: 1}")
    for node_id in (PAN, TILT):
        created.simulated.drives[node_id].device.store.set(0x605A, 0, 6)
    since = len(created.bus.frames)
    created.stall(0.5)
    created.run(0.4)
    assert drive(created, PAN).state is State.QUICK_STOP_ACTIVE
    created.run(0.6)
    assert 0x0F not in {data[0] for data in _sent(created, 0x202, since)}
    assert not created.moving
    assert not [sentence for sentence in sentences(created) if "QUICK_STOP_ACTIVE -> OPERATION_ENABLED" in sentence]
    assert any("stood still for longer than the drive waits" in sentence for sentence in sentences(created))
    created.enable()
    created.run(1.0)
    assert created.velocity("pan") == pytest.approx(0.5, rel=0.01)


def test_a_pause_shorter_than_the_drives_wait_for_the_master_stops_nothing(robot):
    created = _turning(robot)
    created.stall(0.15)
    created.run(0.5)
    assert (created.state, round(created.velocity("pan"), 2)) == ("running", 0.5)


@pytest.mark.parametrize("cause", ["nmt start", "bus-off"])
def test_a_node_to_be_kept_alive_that_is_booted_in_motion_is_stopped_meanwhile(robot, cause):
    created = _turning(robot, keys="reset_communication: false")
    core = created.simulated.core
    node, full = core.node("pan_drive"), created.drives[PAN].velocity
    if cause == "bus-off":
        created.do("bus_off", "master", seconds=0.1)
        created.run(0.1)
    else:
        created.simulated.host.call(partial(node.command, NmtCommand.START, core.reactor.now()))
        created.simulated.host.call(core.bus_of(node).send_waiting)
    created.until(lambda: node.boot_step)
    created.until(lambda: not node.boot_step)
    assert node.ready
    assert abs(created.drives[PAN].velocity) < 0.3 * abs(full)


def test_the_stop_of_a_lost_node_does_not_command_position_0(robot):
    created = robot("csp")
    for step in range(50):
        created.command("pos", 0.01 * (step + 1), 0.0)
        created.run(0.02)
    since, position = len(created.bus.frames), created.position("pan")
    assert position > 0.4
    for fault in ("tpdo_missing", "sdo_silent", "heartbeat_lost"):  # the drive still receives
        created.drives[PAN].fault(fault)
    created.run(0.6)
    assert not created.simulated.core.node("pan_drive").ready
    targets = {int.from_bytes(data, "little", signed=True) for data in _sent(created, 0x302, since)}
    assert min(targets) > 0.4 * 65536 * 50 / 6.2832
