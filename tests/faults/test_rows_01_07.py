"""Rows 1 to 7: boot-ups, heartbeats and NMT states."""

import pytest
from support.faultbench import CYCLE_MS, LEFT, RAMP_MS, RIGHT
from support.robots import copy_robby

from canopen_control.cia301.nmt import NmtCommand, NmtState
from canopen_control.frame import CanFrame
from canopen_control.hardware.axis_statechart import Action
from canopen_control.runtime.core import RobotState
from canopen_control.virtual.fault_table import FaultSwitches

HEARTBEAT_MS = 500  # five of 100 ms


def test_row_01_a_late_boot_up_is_waited_for_while_the_other_drive_boots(bench, tmp_path):
    config = copy_robby(tmp_path, bus={"  sync_period": "  boot_time: 10000\n  sync_period"})
    robby = bench(drives=(RIGHT,), config=config)
    robby.power_on(LEFT, ["boot_late"])
    robby.robot.start()
    right = robby.until(lambda: robby.robot.nodes["right_drive"].ready)
    assert right < 500
    took = robby.until(lambda: robby.robot.nodes["left_drive"].ready, ms=8000) + right
    assert 5000 < took < 8000


def test_row_01_a_drive_that_never_boots_is_error_b_with_its_name(bench):
    robby = bench(drives=(RIGHT,))
    robby.power_on(LEFT, ["no_boot"])
    robby.robot.start()
    robby.until(lambda: robby.robot.state is RobotState.STOPPED, ms=20_000)
    assert "node 3 (left_drive): boot error B" in robby.robot.failure
    assert "right_drive" not in robby.robot.failure


def test_row_02_a_drive_that_resets_itself_is_configured_again_and_waits_for_an_enable(turning):
    turning.switch("spontaneous_reset")
    event, after = turning.collected("restarted")
    assert after < 50
    assert "node 3 (left_drive)" in event.text
    assert turning.stopped_after(RIGHT) < after + CYCLE_MS + RAMP_MS + CYCLE_MS
    turning.until(lambda: turning.robot.nodes["left_drive"].ready)
    assert turning.drives[LEFT].get(0x2000) == 3, "what was not stored is configured again"
    assert turning.drives[LEFT].get(0x6083) == 16000
    turning.expect_stays_down()
    turning.goes_on()


@pytest.mark.rest
@pytest.mark.parametrize("fault", ["silent", "heartbeat_lost"])
def test_row_03_a_silent_drive_is_lost_after_the_consumer_time_and_the_rest_stops(turning, fault):
    turning.switch(fault)
    event, after = turning.collected("heartbeat_lost")
    assert HEARTBEAT_MS - 100 <= after <= HEARTBEAT_MS + CYCLE_MS
    assert "node 3 (left_drive)" in event.text
    assert turning.stopped_after(RIGHT) <= after + CYCLE_MS + RAMP_MS + CYCLE_MS
    turning.disabled_after()
    joint = turning.joint(LEFT)
    assert joint.states["velocity"].value != joint.states["velocity"].value, "nan: nothing is known"
    assert "not operational" in turning.axis_refused()
    turning.bus.clear_history()
    turning.run(3000)
    assert turning.robot.hint.endswith(
        ": wait for left_drive, then canopen-control axis fault-reset all if a drive is in fault, then "
        "canopen-control axis enable all"
    )
    requests = [frame for _, frame in turning.bus.history if frame.can_id == 0x603]
    assert len(requests) < 12, "no SDO storm"
    turning.switch(fault, on=False)
    turning.until(lambda: turning.robot.nodes["left_drive"].ready, ms=4000)
    turning.expect_stays_down()
    if fault == "silent":  # its own 0x1016 made it a fault
        assert "fault" in turning.axis_refused()
    turning.axis(Action.FAULT_RESET)
    turning.goes_on()


def test_row_03_a_drive_that_is_only_silent_is_commanded_to_stop(turning):
    turning.switch("heartbeat_lost")
    after = turning.collected("heartbeat_lost")[1]
    assert turning.stopped_after(LEFT) <= after + CYCLE_MS + RAMP_MS + CYCLE_MS
    (text,) = turning.texts("stop")
    assert text.endswith(
        "; to continue when left_drive has returned: canopen-control axis fault-reset all if a drive is in fault, then "
        "canopen-control axis enable all"
    )


@pytest.mark.rest
def test_row_04_heartbeats_that_come_unevenly_are_not_alarm(turning):
    turning.switch("heartbeat_jitter")
    turning.hold(10.0, 10.0, ms=10_000)
    assert not [event for event in turning.events if event.level > 0], [event.text for event in turning.events]
    assert turning.robot.state is RobotState.RUNNING


def test_row_05_a_drive_that_leaves_operational_stops_the_robot(turning):
    turning.switch("leaves_operational")
    event, after = turning.collected("nmt")
    assert after <= 100 + CYCLE_MS, "the next heartbeat tells it"
    assert "PRE_OPERATIONAL" in event.text
    assert turning.stopped_after() <= after + CYCLE_MS + RAMP_MS + CYCLE_MS
    turning.until(lambda: turning.robot.nodes["left_drive"].ready, ms=4000)
    turning.expect_stays_down()
    turning.goes_on()


def test_row_06_a_lost_nmt_start_is_sent_again_and_then_an_error_that_names_the_node(bench):
    robby = bench(drives=(RIGHT,))
    robby.power_on(LEFT, ["nmt_start_ignored"])
    robby.robot.start()
    robby.until(lambda: robby.robot.state is RobotState.STOPPED, ms=20_000)
    assert "node 3 (left_drive)" in robby.robot.failure
    starts = [frame for _, frame in robby.bus.history if frame == CanFrame(0, bytes((NmtCommand.START, LEFT)))]
    assert len(starts) >= 3
    assert not [frame for label, frame in robby.bus.history if label == "master" and frame.can_id == 0x203]


def test_row_07_a_drive_that_is_operational_already_is_reset_before_it_is_configured(bench):
    robby = bench(drives=(RIGHT,))
    robby.power_on(LEFT, ["already_operational"])
    robby.run(100)
    assert robby.drives[LEFT].nmt.state is NmtState.OPERATIONAL
    robby.start()
    mine = [frame for label, frame in robby.bus.history if label == "master"]
    reset = mine.index(CanFrame(0, bytes((NmtCommand.RESET_COMMUNICATION, LEFT))))
    first = next(number for number, frame in enumerate(mine) if frame.can_id == 0x603)
    assert reset < first
    robby.hold(10.0, 10.0, ms=600)
    assert robby.speed(LEFT) == -robby.speed(RIGHT) != 0


def test_row_03_heartbeats_of_eight_bytes_do_not_count_and_are_named_before_the_node_is_lost(turning):
    device = turning.drives[LEFT]

    def padded(_node, frame, _now):
        beat = frame.can_id == 0x703 and frame.data != b"\0"
        return [(0, CanFrame(frame.can_id, frame.data.ljust(8, b"\0")) if beat else frame)]

    switches = device.fault_switches or FaultSwitches(device)
    switches.set_quirks((padded,), ())
    lost, _ = turning.collected("heartbeat_lost")
    (event,) = turning.found("heartbeat_malformed")
    assert "its heartbeat has 8 bytes instead of 1, so it does not count" in event.text
    assert event.time < lost.time
