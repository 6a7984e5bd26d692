"""Rows 39 to 47: the bus itself, identities, parameters, and the end of the master."""

import itertools

import pytest
from support.faultbench import CYCLE_MS, LEFT, RAMP_MS, RIGHT, SPEED
from support.observers import Observer
from support.robots import copy_robby

from canopen_control.bus import error_frames
from canopen_control.bus.port import BusEvent, BusEventKind
from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.nmt import NmtCommand
from canopen_control.cia301.sdo_server import SdoServerAbort
from canopen_control.hardware.axis_statechart import Action
from canopen_control.runtime.core import RobotCore, RobotState

CONSUMER_MS = 500


def test_row_39_when_our_controller_is_off_the_bus_all_nodes_are_lost_and_booted_when_it_is_back(turning):
    turning.began = turning.reactor.now()
    turning.bus.bus_off("master")
    event, after = turning.collected("bus_bus_off")
    assert after <= CYCLE_MS
    assert "bus-off" in event.text
    lost = turning.found("bus_lost")
    assert len(lost) == 2
    assert "node 3 (left_drive)" in lost[0].text
    assert turning.stopped_after() <= CONSUMER_MS + RAMP_MS + CYCLE_MS, "by the drives' own consumers"
    turning.run(2000)
    assert turning.errors == []
    assert turning.robot.state is RobotState.FAULT
    turning.bus.restart("master")
    turning.until(lambda: all(node.ready for node in turning.robot.nodes.values()), ms=3000)
    turning.expect_stays_down()
    assert turning.axis(Action.FAULT_RESET) is None
    turning.goes_on()


def test_row_39_an_interface_that_goes_down_is_the_same(turning):
    bus = turning.robot.buses["can"]
    bus.port.events = lambda: [BusEvent(BusEventKind.DOWN, "the interface is down")]
    bus.receive()
    bus.port.events = list
    assert turning.robot.state is RobotState.FAULT
    assert turning.found("bus_down")
    turning.run(CONSUMER_MS + RAMP_MS)
    bus.port.events = lambda: [BusEvent(BusEventKind.UP, "the interface is up")]
    bus.receive()
    bus.port.events = list
    turning.until(lambda: all(node.ready for node in turning.robot.nodes.values()))
    turning.axis(Action.FAULT_RESET)
    turning.goes_on()


def test_row_39_error_passive_is_shown_and_nothing_stops(turning):
    turning.bus.report("master", error_frames.passive_frame())
    assert turning.collected("bus_error_passive")[0].level == 1
    turning.switch("error_passive")
    assert "0x8120" in turning.collected("emcy")[0].text
    turning.hold(10.0, 10.0, ms=500)
    assert turning.robot.state is RobotState.RUNNING


def test_row_39_frames_that_do_not_fit_are_reported_once_and_then_in_sum(turning):
    port = turning.robot.buses["can"].port
    for _ in range(50):
        port.stats.lost += 3
        turning.hold(10.0, 10.0, ms=100)
    reported = turning.found("bus_queue_full")
    assert "a frame was lost" in reported[0].sentence
    assert 2 <= len(reported) <= 3
    assert reported[-1].count > 50


def test_row_39_a_drive_that_is_off_the_bus_is_lost_by_name(turning):
    turning.switch("bus_off")
    assert turning.collected("heartbeat_lost")[1] <= CONSUMER_MS + CYCLE_MS
    assert turning.stopped_after() <= CONSUMER_MS + RAMP_MS + 2 * CYCLE_MS
    turning.switch("bus_off", on=False)
    turning.until(lambda: turning.robot.nodes["left_drive"].ready, ms=4000)
    turning.expect_stays_down()
    turning.axis(Action.FAULT_RESET)
    turning.goes_on()


def test_row_40_a_second_device_with_the_same_id_is_diagnosed(turning):
    turning.switch("duplicate_node")
    event, after = turning.collected("duplicate_node")
    assert after <= 2000
    assert "two devices seem to have this node-ID" in event.text
    turning.hold(10.0, 10.0, ms=2000)
    assert len(turning.found("duplicate_node")) == 1
    assert turning.robot.state is RobotState.RUNNING


def test_row_40_two_boot_ups_at_once_are_diagnosed(bench):
    robby = bench(drives=(RIGHT,))
    robby.power_on(LEFT, ["duplicate_node"])
    robby.robot.start()
    robby.until(lambda: robby.found("duplicate_node"))
    assert "two boot-ups" in robby.found("duplicate_node")[0].text


def test_row_40_another_product_is_refused_another_revision_only_named(bench):
    robby = bench(drives=(RIGHT,))
    robby.power_on(LEFT, ["wrong_identity"])
    robby.robot.start()
    robby.until(lambda: robby.robot.state is RobotState.STOPPED, ms=20_000)
    assert "boot error M" in robby.robot.failure
    assert "0x000004F7, expected 0x000004F6" in robby.robot.failure


def test_row_40_another_revision_is_a_warning_unless_bus_yml_insists(bench, tmp_path):
    config = copy_robby(tmp_path, bus={"  revision_number: 0              # any firmware revision\n": ""})
    robby = bench(drives=(RIGHT,), config=config)
    robby.power_on(LEFT, ["wrong_revision"])
    robby.start()
    assert any("revision" in text for text in robby.texts("boot_warning"))


def test_row_41_a_drive_under_local_control_is_not_enabled_and_reports_why(turning):
    turning.switch("local_control")
    event, after = turning.collected("control")
    assert after <= 3 * CYCLE_MS
    assert "bit 9 is 0" in event.text
    turning.stopped_after()
    turning.disabled_after()
    reason = turning.axis_refused(Action.ENABLE, "left_drive")
    assert "under local control" in reason
    assert "`ignore_remote: true`" in reason
    turning.switch("local_control", on=False)
    turning.run(100)
    turning.expect_stays_down()
    turning.goes_on()


@pytest.mark.rest
def test_row_41_a_drive_that_never_sets_bit_9_is_enabled_where_bus_yml_reports_this(bench, tmp_path):
    config = copy_robby(tmp_path, bus={"  velocity_mode: 3": "  ignore_remote: true\n  velocity_mode: 3"})
    robby = bench(config=config, faults=["local_control"])
    robby.start()
    robby.hold(5.0, 5.0, ms=500)
    assert robby.speed(LEFT)
    assert robby.texts("control") == []


def test_row_42_a_value_that_the_drive_changes_is_read_back_and_reported(bench):
    robby = bench(drives=(RIGHT,))
    robby.power_on(LEFT, ["parameter_clamped"])
    robby.start()
    assert any("0x6083:00 holds" in text for text in robby.texts("boot_warning"))


def test_row_43_a_drive_that_turns_against_its_command_stops_the_robot(bench):
    robby = bench(drives=(RIGHT,))
    robby.power_on(LEFT, ["direction_inverted"])
    robby.start()
    robby.began = robby.reactor.now()
    while not robby.found("direction"):
        robby.command(10.0, 10.0)
        robby.run(10)
    event, after = robby.collected("direction")
    assert after <= 1000
    assert "node 3 (left_drive): it turns against its command" in event.text
    assert robby.stopped_after() <= after + RAMP_MS + 2 * CYCLE_MS
    robby.expect_stays_down()


def test_row_43_a_drive_that_only_lags_does_not(bench):
    robby = bench().turning()
    for _ in range(10):
        robby.hold(10.0, 10.0, ms=200)
        robby.hold(-10.0, -10.0, ms=200)
    assert not robby.found("direction")


def test_row_44_nmt_stop_makes_a_trinamic_fault_and_the_robot_stops(turning):
    left = turning.robot.nodes["left_drive"]
    turning.began = turning.reactor.now()
    left.command(NmtCommand.STOP, turning.reactor.now())
    turning.robot.bus_of(left).send_waiting()
    assert turning.collected("node_lost")[1] <= CYCLE_MS
    assert turning.stopped_after() <= RAMP_MS + 3 * CYCLE_MS
    turning.run(3000)
    assert not left.ready, "it was commanded: nobody boots it behind the user's back"
    left.command(NmtCommand.START, turning.reactor.now())
    turning.robot.bus_of(left).send_waiting()
    turning.until(lambda: left.ready)
    turning.run(100)
    assert turning.joint(LEFT).machine.fault
    assert turning.axis(Action.FAULT_RESET) is None
    turning.goes_on()


def test_row_45_objects_that_can_only_be_written_without_power_are_written_when_it_is_gone(bench):
    """An earlier master died and left the drive turning; it refuses its settings until it stands without power."""
    robby = bench().turning()
    robby.robot.pacer.stop()
    robby.robot.buses["can"].close()
    drive, refused = robby.drives[LEFT], []

    def only_without_power(_entry, value):
        if robby.powered(LEFT):
            refused.append(value)
            raise SdoServerAbort(AbortCode.DEVICE_STATE)
        return value

    drive.store.set(0x2000, 0, 4)
    drive.store.guard([0x2000], only_without_power)
    second = RobotCore(robby.setup, robby.reactor)
    second.start()
    robby.until(lambda: all(node.ready for node in second.nodes.values()), ms=5000)
    assert refused
    assert drive.get(0x2000) == 3
    second.close()


def test_row_46_when_the_master_dies_the_drives_stop_by_themselves(turning):
    for drive in turning.drives.values():
        assert drive.get(0x1016, 1) == 1 << 16 | CONSUMER_MS, "written, so that it watches us"
    turning.began = turning.reactor.now()
    turning.robot.pacer.stop()
    turning.robot.buses["can"].close()
    turning.until(turning.standing)
    took = (turning.reactor.now() - turning.began) / 1e6
    assert CONSUMER_MS - 100 <= took <= CONSUMER_MS + RAMP_MS + CYCLE_MS


def test_row_47_syncs_are_on_an_exact_grid_and_a_set_point_more_or_less_is_not_a_fault(turning):
    times = []
    turning.robot.observers.append(Observer(after_cycle=times.append))
    sent = []
    real = turning.robot.buses["can"].port.send

    def send(records):
        sent.extend(turning.reactor.now() for number in range(0, len(records), 16) if records[number] == 0x80)
        real(records)

    turning.robot.buses["can"].port.send = send
    turning.hold(10.0, 10.0, ms=5000)
    assert len(sent) == 250
    assert {late - early for early, late in itertools.pairwise(sent)} == {CYCLE_MS * 1_000_000}
    for number in range(20):  # 100 ppm at 20 ms: a SYNC too many, or one too few, every 200 s; here every 100 ms
        syncs = itertools.count()
        turning.bus.drop(lambda _label, frame, syncs=syncs: frame.can_id == 0x080 and next(syncs) == 0)
        turning.hold(10.0, 10.0, ms=100)
        assert number < 20
    assert turning.robot.state is RobotState.RUNNING
    assert turning.speed(RIGHT) == pytest.approx(SPEED, rel=0.01)
    assert not [event for event in turning.events if event.level == 2], [event.text for event in turning.events]


@pytest.mark.parametrize("fault", ["rpdo_late", "rpdo_lost"])
def test_rpdos_that_come_late_or_get_lost_now_and_then_stop_nothing(turning, fault):
    turning.switch(fault)
    turning.hold(10.0, 10.0, ms=3000)
    assert turning.robot.state is RobotState.RUNNING
    assert abs(turning.speed(LEFT)) == pytest.approx(SPEED, rel=0.01)
    assert not [event for event in turning.events if event.level == 2], [event.text for event in turning.events]
