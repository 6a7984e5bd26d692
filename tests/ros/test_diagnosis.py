from __future__ import annotations

import pytest
from support.ros import CONTROLLERS, node
from support.samples import controllers_of, sample_of

from canopen_control.ros.diagnosis import diagnose
from canopen_control.rpc.messages.health import Health


def state(more=(), **changes):
    drive = {
        **node(3, "left"),
        **{key: value for key, value in changes.items() if key in ("nmt_state", "ready", "error", "age_s")},
    }
    drive["axes"][0].update({key: value for key, value in changes.items() if key == "cia402_state"})
    cycle = {"period_s": 0.02, "count": 10, "missed": changes.get("missed", 0), "late_max_s": 0.001}
    document = {"time": 1.0, "state": changes.get("robot", "running"), "nodes": {"left_drive": drive}, "cycle": cycle}
    return sample_of(document | dict(more))


def collected(name, **changes):
    statuses = {
        item.name: item
        for item in diagnose("robby", state(**changes), {view.name: view for view in controllers_of(CONTROLLERS)})
    }
    return statuses[f"robby: {name}"]


def test_a_drive_that_runs_is_ok_and_shows_what_it_is():
    status = collected("left_drive")
    assert (status.level, status.message, status.hardware_id) == (Health.OK, "operational", "node 3")
    assert status.values == {
        "node id": "3", "bus": "can", "NMT state": "OPERATIONAL", "age": "0.010 s", "left state": "OPERATION_ENABLED",
        "left mode": "PROFILE_VELOCITY", "left statusword": "0x1637",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "level", "message"),
    [
        ({"cia402_state": "SWITCH_ON_DISABLED"}, Health.WARN, "not enabled: switch on disabled"),
        ({"cia402_state": "FAULT"}, Health.ERROR, "the drive is in fault"),
        ({"cia402_state": "FAULT", "error": "overheated"}, Health.ERROR, "overheated"),
        ({"ready": False, "error": "no heartbeat"}, Health.ERROR, "no heartbeat"),
        ({"ready": False, "nmt_state": None}, Health.ERROR, "not ready, NMT state unknown"),
        ({"error": "EMCY 0x8130"}, Health.WARN, "EMCY 0x8130"),
    ],
)
def test_what_is_wrong_with_a_drive_has_its_level(changes, level, message):
    status = collected("left_drive", **changes)
    assert (status.level, status.message) == (level, message)


def test_a_drive_in_fault_has_the_fields_of_its_fault():
    drive = node(3, "left") | {"fault": {"error_code": 0x4310, "error_register": 9, "data": "00"}}
    drive["axes"][0] |= {"cia402_state": "FAULT", "fault": {"error_code": 0x4310, "statusword": 0x0618}}
    values = diagnose("robby", sample_of({"time": 1.0, "state": "fault", "nodes": {"left_drive": drive}}), {})[0].values
    expected = {"error_code": "0x4310", "error_register": "0x09", "data": "00"}
    assert {key: values[key] for key in expected} == expected
    assert values["left error code"] == "0x4310 (drive temperature too high)"


def test_missed_cycles_are_reported_once():
    statuses = diagnose("robby", state(missed=5), {}, missed_before=3)
    assert (statuses[-1].level, statuses[-1].message) == (Health.WARN, "2 cycles missed since the last report")
    statuses = diagnose("robby", state(missed=5), {}, missed_before=5)
    assert (statuses[-1].level, statuses[-1].message) == (Health.OK, "the robot is running")


def test_a_robot_whose_drives_are_off_is_a_warning_with_what_to_call():
    hint = "left_drive is not enabled: canopen-control axis enable all"
    sample = state({"hint": hint}, robot="disabled")
    status = diagnose("robby", sample, {})[-1]
    assert status.level is Health.WARN
    assert status.message.endswith("not enabled; left_drive is not enabled: canopen-control axis enable all")


def test_what_a_diagnostics_broadcaster_reports_is_among_them():
    judged = {"name": "left", "level": 3, "message": "no news for 0.75 s", "values": {"age": 0.75, "x": None}}
    sample = state({"samples": {"drives": {"kind": "diagnostics", "time": 1.0, "joints": [judged]}}})
    (status,) = (item for item in diagnose("robby", sample, {}) if item.name == "robby: drives: left")
    assert (status.level, status.message) == (Health.STALE, "no news for 0.75 s")
    assert status.values == {"age": "0.75", "x": "unknown"}
