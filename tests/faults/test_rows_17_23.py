"""Rows 17 to 23: process data that stay away or are malformed, SYNC, and emergencies."""

import math
import time

import pytest
from support.faultbench import CYCLE_MS, LEFT, RAMP_MS, RIGHT
from support.generic import write_generic

from canopen_control.cia402.state import State
from canopen_control.frame import CanFrame
from canopen_control.hardware.axis_statechart import Action
from canopen_control.runtime.core import RobotState

TOLD_MS = 2 * CYCLE_MS  # a TPDO is sent with the next SYNC and read at the edge after it
STALE_MS = 10 * CYCLE_MS  # missed_syncs of robby's bus.yml


def test_row_17_a_short_tpdo_is_dropped_counted_and_reported_once_and_no_old_bytes_are_used(turning):
    joint = turning.joint(LEFT)
    turning.switch("tpdo_short")
    after = turning.collected("pdo_short")[1]
    assert after <= TOLD_MS
    stop, stopped = turning.collected("stop")
    assert stopped <= STALE_MS + 2 * CYCLE_MS
    assert "left_drive" in stop.text
    assert turning.stopped_after() <= stopped + RAMP_MS + CYCLE_MS
    assert len(turning.found("pdo_short")) == 2, "once for each of its TPDOs"
    assert joint.axis.statusword.pdo.short > 10
    assert joint.age_ns(turning.reactor.now()) > 100_000_000, "the age goes on"
    turning.disabled_after()
    turning.switch("tpdo_short", on=False)
    turning.collected("pdo_back")
    turning.expect_stays_down()
    turning.goes_on()


def test_row_17_a_long_tpdo_is_reported_once_and_used(turning):
    turning.switch("tpdo_long")
    event, after = turning.collected("pdo_long")
    assert after <= TOLD_MS
    assert "4 bytes instead of 3" in event.text
    turning.hold(10.0, 10.0, ms=1000)
    assert len(turning.found("pdo_long")) == 1
    assert turning.robot.state is RobotState.RUNNING


def test_row_17_each_wrong_length_is_reported_again_and_once(turning):
    turning.switch("tpdo_short")
    assert "2 bytes instead of 3; it is dropped" in turning.collected("pdo_short")[0].text
    turning.switch("tpdo_short", on=False)
    turning.switch("tpdo_long")
    event, after = turning.collected("pdo_long")
    assert after <= TOLD_MS
    assert "4 bytes instead of 3; the rest is ignored" in event.text
    turning.switch("tpdo_long", on=False)
    turning.switch("tpdo_short")
    turning.run(200)
    assert len(turning.found("pdo_short")) == 2, "once for each of its TPDOs"


def test_row_18_missing_tpdos_stop_the_robot_and_the_status_comes_by_sdo(turning):
    turning.switch("tpdo_missing")
    event, after = turning.collected("pdo_stale")
    assert STALE_MS <= after <= STALE_MS + 2 * CYCLE_MS
    assert "0x183" in event.text
    assert turning.stopped_after() <= after + CYCLE_MS + RAMP_MS + CYCLE_MS
    assert turning.disabled_after() < 1500, "seen by SDO, step by step: no cached 'enabled'"
    reads = [frame for _, frame in turning.bus.history if frame == CanFrame(0x603, bytes.fromhex("4041600000000000"))]
    assert reads
    turning.until(lambda: turning.joint(LEFT).machine.state is State.SWITCH_ON_DISABLED, ms=200)


def test_row_18_without_a_word_in_bus_yml_three_syncs_are_enough(bench, tmp_path):
    robby = bench(config=write_generic(tmp_path), drives=(2, 3), controllers=["velocity"])
    robby.victim = 2
    robby.start()
    robby.robot.command("velocity", [2.0, 2.0], "test")
    robby.run(500)
    robby.switch("tpdo_missing")
    stale, stop = robby.collected("pdo_stale")[1], robby.collected("stop")[1]
    assert 30 <= stale <= 50, "SYNC comes every 10 ms"
    assert stop <= stale + 10
    robby.until(lambda: robby.standing())


def test_row_18_late_tpdos_are_used_and_their_age_is_known(turning):
    turning.switch("tpdo_late")
    turning.hold(10.0, 10.0, ms=1000)
    assert turning.robot.state is RobotState.RUNNING
    assert turning.joint(LEFT).age_ns(turning.reactor.now()) <= CYCLE_MS * 1_000_000


def test_row_19_a_tpdo_that_never_comes_is_a_named_error_soon_after_the_start(bench):
    robby = bench(drives=(RIGHT,))
    robby.power_on(LEFT, ["tpdo_missing"])
    robby.robot.start()
    robby.until(lambda: robby.found("ready"))
    robby.began = robby.reactor.now()
    robby.until(lambda: len(robby.found("ready")) == 2)
    event, _ = robby.collected("pdo_missing")
    assert "check its transmission type" in event.text
    assert event.time - robby.found("ready")[1].time <= (STALE_MS + 2 * CYCLE_MS) * 1e6
    assert not robby.powered(LEFT)


def test_row_20_a_drive_that_does_not_receive_sync_is_stopped(turning):
    turning.switch("sync_deaf")
    assert turning.collected("stop")[1] <= STALE_MS + 3 * CYCLE_MS
    assert turning.stopped_after() <= STALE_MS + 3 * CYCLE_MS + RAMP_MS + CYCLE_MS


def test_row_20_a_wrong_length_of_sync_is_explained(turning):
    turning.bus.inject(CanFrame(0x083, bytes.fromhex("4082110000000000")))
    event, _ = turning.collected("emcy")
    assert "0x8240" in event.text
    assert "0x1019" in event.text


def test_row_20_our_own_missed_syncs_are_counted_and_reported(turning):
    turning.reactor.clock.now_ns += 200_000_000
    turning.run(100)
    assert turning.robot.pacer.missed >= 9
    assert turning.found("cycle_missed")


@pytest.mark.rest
def test_row_21_a_flood_of_emergencies_neither_fills_the_log_nor_slows_the_cycle(turning):
    turning.switch("emcy_flood")
    begin = time.process_time()
    turning.hold(10.0, 10.0, ms=3000)
    flooded = time.process_time() - begin
    reported = turning.found("emcy")
    assert 2 <= len(reported) <= 4, "the first, and sums"
    assert reported[0].details is not None
    assert reported[-1].count >= 10, "ten a second"
    assert turning.found("emcy_flood")
    assert "EMCY within a second" in turning.found("emcy_flood")[0].text
    assert len(turning.robot.events.recent) <= 256
    assert turning.robot.state is RobotState.RUNNING
    assert turning.robot.pacer.missed == 0
    assert flooded < 10, "a busy machine; it is far less"


def test_row_22_an_unknown_and_short_emergency_is_shown_raw(turning):
    turning.switch("emcy_short")
    event, _ = turning.collected("emcy")
    assert "0xABCD" in event.text
    assert "4 bytes" in event.text
    for length in range(9):
        turning.bus.inject(CanFrame(0x083, bytes(range(length))))
    turning.hold(10.0, 10.0, ms=200)
    assert turning.robot.state is RobotState.RUNNING


def test_row_22_an_emergency_without_a_register_is_reported(turning):
    turning.bus.inject(CanFrame(0x083, bytes.fromhex("1043")))
    event, _ = turning.collected("emcy_short")
    assert "an EMCY message of 2 bytes (data 10 43) is ignored" in event.text


def test_row_23_error_reset_with_an_error_left_keeps_the_others(turning):
    left = turning.robot.nodes["left_drive"]
    turning.bus.inject(CanFrame(0x083, bytes.fromhex("1043090000000000")))  # 0x4310, temperature
    turning.bus.inject(CanFrame(0x083, bytes.fromhex("20320D0000000000")))  # 0x3220, voltage
    turning.run(50)
    assert left.log.errors.active == (0x4310, 0x3220)
    turning.switch("emcy_partial_reset")
    event, _ = turning.collected("emcy_reset")
    assert "still active: 0x4310" in event.text
    assert left.log.errors.active == (0x4310,)
    assert left.error is not None
    turning.bus.inject(CanFrame(0x083, bytes(8)))
    turning.run(50)
    assert left.log.errors.active == ()
    assert left.error is None


@pytest.mark.parametrize("fault", ["tpdo_missing", "tpdo_short"])
def test_nothing_is_enabled_on_stale_feedback(turning, fault):
    turning.switch(fault)
    turning.disabled_after()
    assert turning.axis(Action.ENABLE) is not None
    assert not turning.powered(LEFT)
    assert not math.isnan(turning.joint(RIGHT).states["velocity"].value)
