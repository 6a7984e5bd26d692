"""Rows 8 to 16: SDO servers with ways of their own, met while the robot boots."""

import pytest
from support.faultbench import LEFT, RIGHT
from support.robots import copy_robby

from canopen_control.cia301.abort import AbortCode
from canopen_control.runtime.core import RobotState

RPDO_COB_ID_1, RPDO_COB_ID_3 = 0x1400, 0x1402


@pytest.fixture
def booted(bench):
    """Return what boots robby with a fault of its left drive until it runs or has failed."""

    def boot(fault, **how):
        robby = bench(drives=(RIGHT,), **how)
        robby.power_on(LEFT, [fault] if fault else [])
        robby.robot.start()
        robby.until(lambda: robby.robot.state in (RobotState.RUNNING, RobotState.STOPPED), ms=20_000)
        robby.left = robby.robot.nodes["left_drive"]
        return robby

    return boot


def requests(robby):
    return [frame.data for label, frame in robby.bus.history if label == "master" and frame.can_id == 0x603]


def test_row_08_a_request_that_is_not_answered_is_sent_once_more(booted):
    robby = booted("sdo_silent_once")
    assert robby.robot.state is RobotState.RUNNING
    assert robby.left.sdo.retried == 1
    assert robby.left.boot_steps[-1].error == ""


def test_row_08_a_drive_that_answers_nothing_is_an_error_with_its_name_and_object(booted):
    robby = booted("sdo_silent")
    assert "node 3 (left_drive)" in robby.robot.failure
    assert "0x1000" in robby.robot.failure
    sent = requests(robby)
    assert [data[0] for data in sent] == [0x40, 0x80] * (len(sent) // 2), "no storm: each is given up before the next"
    for request, abort in zip(sent[::2], sent[1::2], strict=True):
        assert abort == b"\x80" + request[1:4] + AbortCode.TIMED_OUT.to_bytes(4, "little"), "with its own object"


def test_row_08_a_late_answer_is_never_taken_for_another_one(booted):
    robby = booted("sdo_late")
    assert robby.left.sdo.ignored > 0
    assert "boot error B" in robby.robot.failure, "and not a wrong device type, or a wrong vendor"


def test_row_09_an_answer_about_another_object_is_ignored_until_the_time_is_over(booted):
    robby = booted("sdo_wrong_mux")
    assert robby.left.sdo.ignored >= 2
    assert "no answer" in robby.robot.failure


def test_row_10_a_busy_drive_is_asked_again_and_then_the_reason_is_reported(booted):
    robby = booted("sdo_busy")
    assert robby.left.sdo.retried > 3
    assert "boot error J" in robby.robot.failure
    assert "0x08000022" in robby.robot.failure
    assert "present device state" in robby.robot.failure


def test_row_10_a_drive_that_is_busy_for_a_moment_boots(bench):
    robby = bench(drives=(RIGHT,))
    robby.power_on(LEFT)
    robby.run(50)
    robby.robot.start()
    robby.switch("sdo_busy")
    robby.run(300)
    assert robby.robot.state is not RobotState.RUNNING
    robby.switch("sdo_busy", on=False)
    robby.until(lambda: robby.robot.state is RobotState.RUNNING)
    assert robby.robot.failure is None


def test_row_11_optional_objects_may_be_missing(booted, tmp_path):
    lines = {
        "    - {index: 0x60C2, sub_index: 1, value: 20}       # interpolation period: the SYNC period ...\n": "",
        "    - {index: 0x60C2, sub_index: 2, value: -3}       # ... in 10^-3 s\n": "",
    }
    robby = booted("optional_missing", config=copy_robby(tmp_path, bus=lines))
    assert robby.robot.state is RobotState.RUNNING
    assert any("0x60C2" in text for text in robby.texts("boot_warning"))


def test_row_11_what_bus_yml_asks_for_must_be_there(booted):
    robby = booted("optional_missing")
    assert "boot error J" in robby.robot.failure
    assert "0x60C2:01" in robby.robot.failure
    assert "object does not exist" in robby.robot.failure


@pytest.mark.parametrize("fault", ["sdo_toggle_error", "sdo_segment_lost"])
def test_row_12_a_broken_segmented_transfer_is_begun_again_at_most_twice(booted, fault):
    robby = booted("")
    robby.switch(fault)
    robby.bus.clear_history()
    done = []
    robby.left.read(0x1008, 0, done.append)
    robby.until(lambda: done)
    assert done[0].error is not None
    begun = [data for data in requests(robby) if data[0] == 0x40]
    assert 2 <= len(begun) <= 3
    assert robby.robot.state is RobotState.RUNNING, "the cycle does not care"
    robby.switch(fault, on=False)
    robby.left.read(0x1008, 0, done.append)
    robby.until(lambda: len(done) == 2)
    assert done[1].data.startswith(b"TMCM")


def test_row_13_a_server_without_block_transfer_gets_segments(booted):
    robby = booted("")
    robby.switch("sdo_no_block")
    done = []
    robby.left.sdo.read(0x1008, 0, block=True).context = done.append
    robby.robot.bus_of(robby.left).send_waiting()
    robby.until(lambda: done)
    assert done[0].error is None
    assert robby.left.sdo.block_supported is False


def test_row_14_an_answer_that_is_too_short_is_not_a_value(booted):
    robby = booted("sdo_short_answer")
    assert robby.robot.state is RobotState.STOPPED
    assert "0x1000:00" in robby.robot.failure
    assert robby.left.identity is None


def test_row_15_a_fixed_mapping_that_lacks_something_is_an_error_and_leaves_no_live_pdo(booted):
    robby = booted("mapping_fixed")
    assert "boot error J" in robby.robot.failure
    assert "RPDO 1" in robby.robot.failure
    assert "lacks 0x6060" in robby.robot.failure
    written = [data for data in requests(robby) if data[0] == 0x23 and data[1:4] == b"\x00\x14\x01"]
    assert written[-1][7] & 0x80, "left invalid"


def test_row_15_a_fixed_mapping_that_will_do_is_used(booted, tmp_path):
    """The factory's RPDO 2 holds 6040 and 6060, its TPDO 2 6041 and 6061: they are what is asked for."""
    config = copy_robby(tmp_path)
    path = config / "bus.yml"
    head, tpdo, tail = path.read_text().partition("  tpdo:\n")
    nodes = tail.partition("nodes:")[2]
    path.write_text(f"{head}{tpdo}{PDOS}nodes:{nodes}")
    robby = booted("mapping_fixed", config=config)
    assert robby.robot.state is RobotState.RUNNING, robby.robot.failure
    robby.hold(10.0, 10.0, ms=600)
    assert robby.speed(LEFT) == -robby.speed(RIGHT) != 0


def test_row_16_bit_30_is_kept_as_the_drive_has_it(booted):
    robby = booted("")
    for number, live in ((RPDO_COB_ID_1, True), (RPDO_COB_ID_3, False)):
        cob_id = robby.drives[LEFT].get(number, 1)
        assert cob_id >> 30 & 1 == 1
        assert (cob_id >> 31 == 0) is live
    written = [data for data in requests(robby) if data[0] == 0x23 and data[1:4] == b"\x00\x14\x01"]
    assert written
    assert all(data[7] & 0x40 for data in written)


PDOS = """
    1: {enabled: false}
    2: {enabled: true, cob_id: auto, transmission: 1, mapping: [{index: 0x6041}, {index: 0x6061}]}
    3: {enabled: true, cob_id: auto, transmission: 1, mapping: [{index: 0x6041}, {index: 0x6064}]}
    4: {enabled: false}
  rpdo:
    1: {enabled: false}
    2: {enabled: true, cob_id: auto, mapping: [{index: 0x6040}, {index: 0x6060}]}
    3: {enabled: false}
    4: {enabled: true, cob_id: auto, mapping: [{index: 0x6040}, {index: 0x60FF}]}
"""
