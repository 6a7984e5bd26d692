"""Findings on the timing of set-points: each typical mistake with its place and the remedy."""

import re

import pytest
from support.arm6 import copy_arm

from canopen_control.check.checker import CheckOptions, check_robot
from canopen_control.od.issues import Severity
from canopen_control.runtime.robot_files import find_robot

RPDO_TYPE = "      transmission: 0x01          # all axes apply their set-points at the same SYNC\n"
TPDO_2 = '    2:\n      enabled: true\n      cob_id: "auto"\n      transmission: 0x01\n'


def warnings(config):
    report = check_robot(find_robot(str(config)), CheckOptions())
    assert not report.count(Severity.ERROR), [str(finding) for finding in report.findings]
    return [str(finding) for finding in report.findings if finding.severity is Severity.WARNING]


def arm(folder, **edits):
    """Copy arm6 with `old: new` replaced in bus.yml or ros2_controllers.yaml."""
    config = copy_arm(folder)
    for name, (old, new) in edits.items():
        path = config / {"bus": "bus.yml", "controllers": "ros2_controllers.yaml"}[name]
        text = path.read_text()
        assert old in text, old
        path.write_text(text.replace(old, new))
    return config


@pytest.mark.parametrize("kind", [254, 255])
def test_set_points_that_act_on_arrival_are_reported_with_where_the_type_stands(tmp_path, kind):
    reported = warnings(arm(tmp_path, bus=(RPDO_TYPE, f"      transmission: {kind}\n")))
    assert len(reported) == 1, "it stands once, in `defaults`"
    assert re.match(
        r".*bus\.yml:44:21: warning: RPDO 1 of joint_1_drive and of 5 more carries 0x607A, the set-point of joint_1 in "
        rf"CSP, with transmission {kind}: it takes effect on reception, not with SYNC; set rpdo: 1: transmission: 1, "
        r"otherwise the motor follows the computer's jitter",
        reported[0],
    ), reported[0]


@pytest.mark.rest
@pytest.mark.parametrize("who", ["kernel", "other"])
def test_a_cycle_that_comes_half_a_period_behind_the_sync_of_others_is_notified(tmp_path, who):
    keys = f"sync_period: 20000\n  sync_producer: {who}\n  sync_order: last"
    (reported,) = warnings(arm(tmp_path, bus=("sync_period: 20000", keys)))
    assert "bus.yml:" in reported
    assert f"sync_order: last with sync_producer: {who}: the cycle is half a period after SYNC" in reported
    assert "a cycle that is 10 ms late repeats a set-point of joint_1, joint_2, joint_3 and 3 more" in reported
    assert reported.endswith("remove sync_order")
    assert warnings(arm(tmp_path / "b", bus=("sync_period: 20000", keys.replace("last", "first")))) == []


def test_positions_that_are_sent_for_several_syncs_are_reported(tmp_path):
    reported = warnings(arm(tmp_path, controllers=("update_rate: 50 ", "update_rate: 25 ")))
    (text,) = [item for item in reported if "is sent" in item]
    assert "each position of joint_1, joint_2" in text
    assert "is sent 2 times, and in CSP the drive stops in between; set update_rate: 50" in text
    assert re.match(r".*ros2_controllers\.yaml:\d+: warning", text)


def test_rates_that_are_not_whole_multiples_are_reported_with_both_ways_out(tmp_path):
    reported = warnings(arm(tmp_path, controllers=("update_rate: 50 ", "update_rate: 20 ")))
    (text,) = [item for item in reported if "integer fraction" in item]
    assert "controllers run on one of 2 SYNCs, at 25 Hz; set update_rate: 25, or sync_period: 25000" in text


def test_feedback_that_an_inhibit_time_holds_back_is_reported_with_where_it_stands(tmp_path):
    slow = TPDO_2.replace("0x01", "255") + "      inhibit_time: 300\n"
    reported = [warning for warning in warnings(arm(tmp_path, bus=(TPDO_2, slow))) if "(inhibit time)" in warning]
    assert len(reported) == 1, reported
    assert "bus.yml:35:21: warning: TPDO 2 of joint_1_drive and of 5 more is sent every 30 ms at most" in reported[0]
    assert "feedback is older than a period; set tpdo: 2: transmission: 1, or inhibit_time: 0" in reported[0]
    quick = TPDO_2.replace("0x01", "255") + "      inhibit_time: 200\n"
    assert not any("is sent every" in warning for warning in warnings(arm(tmp_path / "2", bus=(TPDO_2, quick))))


def test_an_interpolation_period_that_is_not_syncs_is_reported_with_where_it_stands(tmp_path):
    reported = warnings(arm(tmp_path, bus=("sub_index: 1, value: 20} ", "sub_index: 1, value: 10} ")))
    assert "bus.yml:20:7: warning: defaults.sdo[1]: 0x60C2 is 10 * 10^-3 s, but the SYNC period 0.02 s" in reported[0]


@pytest.mark.parametrize(
    ("key", "reported"),
    [
        ("event_deadline: 39", "bus.yml:44:23: warning: RPDO 1 of joint_1_drive and of 5 more has a deadline of 39 ms"),
        ("event_timer: 10", "bus.yml:44:20: warning: RPDO 1 of joint_1_drive and of 5 more has a deadline of 10 ms"),
        ("event_deadline: 40", ""),
        ("event_deadline: 0", ""),
    ],
)
def test_a_deadline_that_a_late_cycle_misses_is_reported_with_where_it_stands(tmp_path, key, reported):
    report = check_robot(find_robot(str(arm(tmp_path, bus=(RPDO_TYPE, f"      {key}\n{RPDO_TYPE}")))), CheckOptions())
    result = [str(finding) for finding in report.findings if "EMCY 0x8250" in str(finding)]
    assert len(result) == bool(reported), result
    for item in result:
        assert reported in item
        assert "sent with a cycle of 20 ms" in item
        assert item.endswith("set event_deadline: 60 or more, or 0 for none")


@pytest.mark.parametrize(("kind", "seconds"), [(5, ""), (6, "0.12"), (240, "4.8"), (255, "")])
def test_feedback_on_one_of_many_syncs_is_reported(tmp_path, kind, seconds):
    config = arm(tmp_path, bus=(TPDO_2, TPDO_2.replace("0x01", str(kind))))
    reported = [warning for warning in warnings(config) if "SYNCs" in warning]
    assert len(reported) == bool(seconds)
    if seconds:
        assert re.match(
            rf".*bus\.yml:\d+:\d+: warning: TPDO 2 of joint_1_drive and of 5 more is sent on one of {kind} SYNCs, "
            rf"every {seconds} s: its values are old, and a lost drive is noticed late; set tpdo: 2: transmission: 1",
            reported[0],
        ), reported[0]


@pytest.mark.parametrize(("settings", "is_told"), [("0xFF", True), ("0xFF\n      event_timer: 100", False)])
def test_event_driven_feedback_without_an_event_timer_is_told_as_its_loss_is_not_noticed(tmp_path, settings, is_told):
    config = arm(tmp_path, bus=(TPDO_2, TPDO_2.replace("0x01", settings)))
    reported = [warning for warning in warnings(config) if "is sent only when it changes" in warning]
    assert len(reported) == is_told
    if is_told:
        assert re.match(r".*bus\.yml:\d+:\d+: warning: TPDO 2 of joint_1_drive and of 5 more is sent only", reported[0])
        assert "set tpdo: 2: event_timer: 100 (ms), or transmission: 1" in reported[0]
