"""A passed preflight: valid for these files and these drives; without one, the speed is limited."""

import pytest
from support.devices import with_measured_joint
from support.onbus import TMCM, OnBus
from support.robots import Bench, copy_robby
from support.samples import status_dict

from canopen_control.check import preflight_record
from canopen_control.check.preflight_record import (
    SLOW,
    PreflightRecord,
    config_hash,
    explain,
    find_record,
    limit_speed,
    read_serials,
    save_record,
    slow_reason,
)
from canopen_control.cli.main import main
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot

SERIALS = {"left_drive": 3, "right_drive": 2}
JOINTS = ("left_wheel_joint", "right_wheel_joint")


def setup_of(folder):
    return read_robot(find_robot(str(folder)), can=["memory:clearance"])


@pytest.mark.rest
def test_the_hash_is_of_what_the_files_hold_and_not_of_where_they_are(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    here, there = copy_robby(tmp_path), copy_robby(tmp_path / "elsewhere")
    assert config_hash(setup_of(here)) == config_hash(setup_of(there))
    for name in ("bus.yml", "ros2_controllers.yaml", "robby.urdf.xacro"):
        before = config_hash(setup_of(there))
        with (there / name).open("a") as file:
            file.write("\n")
        assert config_hash(setup_of(there)) != before


def test_a_pass_is_kept_found_and_replaced(tmp_path):
    setup = setup_of(copy_robby(tmp_path))
    assert find_record(setup) is None
    save_record(setup, {"left_drive": 1}, ())
    path = save_record(setup, SERIALS, JOINTS)
    record = find_record(setup)
    assert (record.config, record.serials, record.channel) == (config_hash(setup), SERIALS, "memory:clearance")
    assert record.joints == JOINTS
    assert explain(setup, record, SERIALS) is None
    for rubbish in ("", "[]", '{"serials": 3}', '{"config": 1, "serials": {"a": "b"}, "time": 0, "channel": ""}'):
        path.write_text(rubbish)
        assert find_record(setup) is None


@pytest.mark.parametrize(
    ("serials", "reason"),
    [
        ({"left_drive": 9, "right_drive": 2}, "left_drive is not the drive that passed"),
        ({"left_drive": 3, "right_drive": None}, "right_drive does not answer"),
    ],
)
def test_another_drive_is_not_a_pass(tmp_path, serials, reason):
    setup = setup_of(copy_robby(tmp_path))
    assert reason in explain(setup, PreflightRecord(config_hash(setup), SERIALS), serials)


def test_no_pass_and_changed_files_are_distinguished(tmp_path):
    setup = setup_of(copy_robby(tmp_path))
    assert "has not passed" in explain(setup, None, SERIALS)
    assert "files have changed" in explain(setup, PreflightRecord("0", SERIALS), SERIALS)


def test_only_the_joints_in_doubt_are_slow():
    bench = Bench("half")
    limit_speed(bench.robot, ["left_wheel_joint"])
    bench.start()
    bench.hold(10.0, -10.0, ms=1000)
    speeds = [joint["velocity"] for joint in status_dict(bench.robot)["joints"].values()]
    assert speeds == pytest.approx([SLOW, -10.0], rel=0.01)
    bench.close()


@pytest.mark.parametrize(
    ("joints", "doubted", "why"),
    [
        (JOINTS, None, ""),
        (JOINTS[:1], JOINTS[1:], "the preflight could not turn right_wheel_joint"),
        (None, JOINTS, "this robot has not passed a preflight on this machine"),
    ],
)
def test_a_pass_covers_the_joints_that_were_turned(tmp_path, monkeypatch, private_folders, joints, doubted, why):
    setup = setup_of(copy_robby(tmp_path))
    monkeypatch.setattr(preflight_record, "read_serials", lambda _setup: SERIALS)
    if joints is not None:
        save_record(setup, SERIALS, joints)
    result = slow_reason(setup)
    assert (None if result is None else result.joints) == doubted
    assert why in ("" if result is None else result.why)


def test_a_robot_without_joints_needs_no_pass(tmp_path, private_folders):
    assert main(["init", str(tmp_path / "lamps"), "--eds", "generic_cia401.eds", "--node-id", "5"]) == 0
    assert slow_reason(setup_of(tmp_path / "lamps")) is None


def test_serial_numbers_are_asked_of_the_drives(private_folders):
    with OnBus("memory:serials", {3: TMCM}):
        setup = read_robot(find_robot("robby"), can=["memory:serials"])
        assert read_serials(setup) == {"left_drive": 3, "right_drive": None}


@pytest.mark.usefixtures("private_folders")
def test_a_joint_that_is_only_measured_is_not_a_doubt(tmp_path, monkeypatch):
    setup = setup_of(with_measured_joint(tmp_path))
    monkeypatch.setattr(preflight_record, "read_serials", lambda _setup: SERIALS)
    save_record(setup, SERIALS, JOINTS)
    assert slow_reason(setup) is None
