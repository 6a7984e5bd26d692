"""All errors in a robot's files are found at once; and the load of its buses."""

import re
import shutil
from pathlib import Path

import pytest
from support.peerfiles import write_peer_files
from support.robots import copy_robby, split_robby

from canopen_control.check.checker import CheckOptions, check_robot, start_warnings
from canopen_control.data_files import data_names, data_path
from canopen_control.od.issues import Severity
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot


def check(config, **options):
    return check_robot(find_robot(str(config)), CheckOptions(**options))


def texts(report, severity):
    return [str(finding) for finding in report.findings if finding.severity is severity]


def test_robby_has_no_error_and_no_warning_and_its_bus_is_nearly_free():
    report = check("robby")
    assert report.passes(strict=True), texts(report, Severity.WARNING)
    assert report.count(Severity.NOTE) == len(report.findings)
    assert (report.budgets["can"].bits, report.budgets["can"].worst_bits) == (775, 935)


@pytest.mark.parametrize("name", data_names("config"))
def test_every_bundled_robot_may_be_run(name):
    report = check(name)
    assert report.passes(), texts(report, Severity.ERROR)


def test_errors_of_all_three_files_are_found_together_and_each_once(tmp_path):
    config = copy_robby(
        tmp_path,
        bus={"node_id: 3": "node_id: 300", "sync_period: 20000": "sync_perriod: 20000"},
        controllers={"update_rate: 50": "update_rate: fast"},
        description={"</robot>": "</robo>"},
    )
    report = check(config)
    errors = texts(report, Severity.ERROR)
    assert len(errors) == len(set(errors)) == 4, errors
    for words in ("300 is out of range 1..127", "did you mean 'sync_period'", "update_rate", "robby.urdf.xacro"):
        assert sum(words in error for error in errors) == 1, errors
    assert report.budgets == {}
    assert not report.passes()


def test_a_link_that_occurs_twice_is_reported_with_its_place(tmp_path):
    config = copy_robby(tmp_path, description={"</robot>": '  <link name="base_link"/>\n</robot>'})
    (reported,) = [finding for finding in check(config).findings if "is defined twice" in finding.text]
    assert (reported.severity, reported.column) == (Severity.ERROR, 3)
    assert re.fullmatch(
        r"link 'base_link' is defined twice, first at .*robby\.urdf\.xacro:\d+:\d+; rename one", reported.text
    )


@pytest.mark.parametrize("name", ["bus.yml", "ros2_controllers.yaml", "robby.urdf.xacro"])
def test_a_file_that_cannot_be_read_is_named_once(tmp_path, monkeypatch, name):
    folder = copy_robby(tmp_path)
    monkeypatch.chdir(folder)
    (folder / name).write_bytes(b"\xff\xfe")
    for config in (".", str(folder)):
        report = check(config)
        errors = [
            str(finding) for finding in report.findings if finding.severity is Severity.ERROR and name in finding.path
        ]
        assert len(errors) == 1
        assert errors[0].count(name) == 1


def test_an_error_of_bus_yml_is_shown_with_its_line_and_a_caret(tmp_path):
    report = check(copy_robby(tmp_path, bus={"node_id: 3": "node_id: 300"}))
    finding = next(item for item in report.findings if item.severity is Severity.ERROR)
    lines = (tmp_path / "robby" / "bus.yml").read_text().splitlines()
    assert lines[finding.line - 1][finding.column - 1 :] == "300"
    assert finding.source.splitlines() == [f"    {lines[finding.line - 1]}", f"    {' ' * (finding.column - 1)}^"]


REPORTS = Path(__file__).parents[1] / "data" / "reports"


def report(tmp_path, name, controllers=None):
    """Return robby's files with those of a report in their place."""
    config = copy_robby(tmp_path)
    files = [controllers] if controllers else sorted((REPORTS / name).iterdir())
    for path in files:
        shutil.copy(path, config / ("ros2_controllers.yaml" if controllers else path.name))
    return config


@pytest.mark.parametrize("name", ["baudrate_and_rpdo_inhibit", "identity_keys"])
def test_keys_that_ros2_canopen_takes_are_not_warning(tmp_path, name):
    checked = check(report(tmp_path, name))
    assert checked.passes(strict=True), checked.findings


def test_pdos_that_are_off_may_be_missing_in_the_eds(tmp_path):
    checked = check(report(tmp_path, "io_fewer_pdos"))
    assert checked.passes(), texts(checked, Severity.ERROR)
    reported = texts(checked, Severity.WARNING)
    assert all("the node's own" in item for item in reported), reported


def test_keys_with_wrong_names_are_reported_with_the_right_ones(tmp_path):
    path = tmp_path / "r"
    shutil.copytree(REPORTS / "misnamed_keys", path)
    errors = texts(check(path), Severity.ERROR)
    expected = (
        "write `channel` under `master:`",
        "write `node_id` under `master:`",
        "write `driver` under `master:`",
        "write `package` under `master:`",
        "write `driver`",
        "write `velocity_mode: 9` (CSV)",
        "write `1:` under `tpdo:`",
        "write `1:` under `rpdo:`",
        "the mapping has 88 bits, a PDO at most 64",  # of the PDO under the wrong name
    )
    assert len(errors) == len(expected), errors
    for text, words in zip(errors, expected, strict=True):
        assert words in text


@pytest.mark.parametrize("path", sorted((REPORTS / "yaml_wild").iterdir()), ids=lambda path: path.stem)
def test_wildcards_and_nested_namespaces_of_parameter_files_are_not_warning(tmp_path, path):
    checked = check(report(tmp_path, "yaml_wild", path))
    assert checked.passes(strict=True), checked.findings


def test_what_does_not_fit_together_is_found_too(tmp_path):
    config = copy_robby(tmp_path, bus={"left_drive:": "leftdrive:"})
    errors = texts(check(config), Severity.ERROR)
    assert len(errors) == 1
    assert "did you mean 'leftdrive'" in errors[0]


def line_of(path, text):
    return next(number for number, line in enumerate(path.read_text().splitlines(), 1) if text in line)


def texts_of(config, severity):
    return [text.replace(f"{config}/", "") for text in texts(check(config), severity)]


def test_a_cycle_that_cannot_fit_is_refused_with_the_shortest_period(tmp_path):
    config = copy_robby(tmp_path, bus={"baudrate: 1000": "baudrate: 20"})
    assert texts_of(config, Severity.ERROR) == [
        f"bus.yml:{line_of(config / 'bus.yml', 'sync_period:')}: error: a cycle of 20 ms is too short for its 935 bits "
        "at 20 kbit/s; the shortest possible period is 46.75 ms; raise sync_period, raise the bit rate, or map less"
    ]
    assert check(config).budgets["can"].shortest_period_ns == 46_750_000


def test_a_period_in_ms_is_one_finding(tmp_path):
    config = copy_robby(tmp_path, bus={"sync_period: 20000": "sync_period: 20"})
    (error,) = texts_of(config, Severity.ERROR)
    assert error.endswith("; sync_period is in us; write 20000 for 20 ms")
    assert not [text for text in texts_of(config, Severity.NOTE) if "SYNC rate" in text]
    assert not [text for text in texts_of(config, Severity.WARNING) if "0x60C2" in text]


def test_without_sync_it_is_the_update_rate_that_the_bus_cannot_carry(tmp_path):
    config = copy_robby(
        tmp_path, bus={"sync_period: 20000": "sync_period: 0"}, controllers={"update_rate: 50": "update_rate: 2000"}
    )
    (error,) = [item for item in texts_of(config, Severity.ERROR) if "is too short for" in item]
    line = line_of(config / "ros2_controllers.yaml", "update_rate")
    assert re.fullmatch(
        rf"ros2_controllers\.yaml:{line}: error: a cycle of 0\.5 ms "
        r"is too short for its \d+ bits at 1000 kbit/s; the shortest possible period is 0\.\d+ ms; "
        "lower update_rate, raise the bit rate, or map less",
        error,
    )


def test_a_load_above_seventy_per_cent_is_a_warning(tmp_path):
    slow = {"baudrate: 1000": "baudrate: 125", "sync_period: 20000": "sync_period: 10000"}
    config = copy_robby(tmp_path, bus=slow)
    line = line_of(config / "bus.yml", "sync_period:")
    assert texts_of(config, Severity.WARNING)[0] == (
        f"bus.yml:{line}: warning: the bus has a load of 76% by process data and heartbeats alone; "
        "above 70% too little bandwidth is left for SDO and EMCY; raise sync_period, raise the bit rate, or map less"
    )
    assert check(config).passes()
    assert not check(config).passes(strict=True)


def test_a_drive_that_brakes_for_longer_than_a_stop_may_last_is_a_warning(tmp_path):
    config = tmp_path / "arm"
    shutil.copytree(data_path("config", "arm6"), config)
    text = (config / "bus.yml").read_text()
    slow = "  sdo:\n    - {index: 0x6084, sub_index: 0, value: 10000}\n"
    (config / "bus.yml").write_text(text.replace("  sdo:\n", slow, 1))
    result = texts_of(config, Severity.WARNING)
    assert len(result) == 6
    assert "joint_1 needs 209 s to brake from 2086076 units/s (ramp of 0x6084 (10000)); a stop that takes" in result[0]
    assert "becomes a quick stop; write a faster ramp" in result[0]
    text = (config / "bus.yml").read_text().replace("vel_to_dev: 1043037", "vel_to_dev: 10430370")
    (config / "bus.yml").write_text(
        text.replace("vel_from_dev: 9.587379924285258e-07", "vel_from_dev: 9.587379924285258e-08")
    )
    unit = "read the unit of the ramp in the manual: if it is that of the velocities per s, write a faster ramp"
    assert any(unit in each for each in texts_of(config, Severity.WARNING))


@pytest.mark.parametrize(("limit", "speed"), [("-2.0", "2086076"), ("0", "6553600")])
def test_stop_times_use_the_speed_to_which_commands_are_limited(tmp_path, limit, speed):
    """A velocity limit of 0 is unknown (the drive's 0x607F applies), and of a negative one the magnitude counts."""
    config = tmp_path / "arm"
    shutil.copytree(data_path("config", "arm6"), config)
    text = (config / "arm6.urdf").read_text()
    (config / "arm6.urdf").write_text(text.replace('velocity="2.0"', f'velocity="{limit}"'))
    assert f"s at most from {speed} units/s" in check(config).stops[0].words


def test_several_buses_are_checked_each_for_itself_and_together(tmp_path):
    config = copy_robby(tmp_path, bus={"  right_drive:\n    node_id: 2\n": "  right_drive:\n    node_id: 2\n"})
    text = (config / "bus.yml").read_text()
    (config / "bus_arm.yml").write_text(text.replace("sync_period: 20000", "sync_period: 10000"))
    errors = texts(check(config), Severity.ERROR)
    assert any(
        "bus_arm.yml" in error and "all buses of a robot must have the same SYNC period" in error for error in errors
    )
    assert sum("a node named left_drive is also in" in error for error in errors) == 1


def test_peer_merge_and_the_difference_to_it_are_reported(tmp_path):
    changed = {"  left_drive:\n    node_id: 3\n": "  left_drive:\n    node_id: 3\n    heartbeat_producer: 50\n"}
    config = copy_robby(tmp_path, bus=changed)
    (ours,) = texts(check(config), Severity.WARNING)
    (theirs,) = texts(check(config, peer_merge=True), Severity.WARNING)
    assert "heartbeat_producer is used; ros2_canopen would use 100" in ours
    assert "--peer-merge uses 100" in theirs


def test_an_eds_full_of_doubts_is_summed_up(tmp_path):
    config = copy_robby(tmp_path)
    eds = data_path("eds", "TMCM-1270.eds").read_text(encoding="latin-1")
    (config / "TMCM-1270.eds").write_text(eds.replace("DataType=0x0007", "DataType=0x0099", 1), encoding="latin-1")
    notes = texts(check(config), Severity.NOTE)
    assert any("1 issue in this file" in note and "eds check" in note for note in notes), notes


def without_bus(folder, name):
    target = folder / name
    shutil.copytree(data_path("config", name), target)
    (target / "bus.yml").unlink()
    return target


def test_a_robot_on_drives_needs_one(tmp_path):
    config = without_bus(tmp_path, "robby")
    (error,) = texts(check(config), Severity.ERROR)
    assert re.fullmatch(
        rf".*robby\.urdf\.xacro:\d+: error: \w+ moves CANopen drives, but {config} has no bus\.yml; "
        r"write a bus\.yml, give --bus, or use --mock",
        error,
    )
    assert check(config, mock=True).passes()


def test_a_description_that_names_another_bus_file_reports_it_and_no_lack_of_interfaces(tmp_path):
    config = without_bus(tmp_path, "robby")  # a fork of ros2_canopen renamed its bus.yml to bus.yaml
    named = tmp_path / "config" / "bus.yml"
    named.parent.mkdir()
    (named.parent / "bus.yaml").touch()
    description = config / "robby.urdf.xacro"
    text = re.sub(r"<(command|state)_interface.*?/>", "", description.read_text())
    plugin = "canopen_ros2_control/RobotSystem</plugin>"
    assert plugin in text
    description.write_text(text.replace(plugin, f'{plugin}\n<param name="bus_config">"{named}"</param>'))
    errors = texts(check(config), Severity.ERROR)
    assert [error.partition(": error: ")[2] for error in errors] == [
        f"robby moves CANopen drives, but its bus_config {named} is not a file; "
        f"give --bus {named.parent / 'bus.yaml'}, or use --mock"
    ]


def test_a_start_reports_every_warning_of_the_check_and_no_note(tmp_path):
    config = copy_robby(tmp_path, bus={"polling: false": "polling: false\n  foo_bar: 1"})
    shutil.copy(REPORTS.parent / "tutorials" / "gazebo_diff_drive.yaml", config / "ros2_controllers.yaml")
    expected = [finding for finding in check(config).findings if finding.severity is Severity.WARNING]
    warnings = start_warnings(read_robot(find_robot(str(config))))
    assert len(warnings) == len(expected) > 5
    assert all(any(item.text in text for text in warnings) for item in expected)
    assert start_warnings(read_robot(find_robot("robby"))) == []


UNSUPERVISED = re.compile(r"(?ms)^\[(?:1016|1016sub\d|100C|100D)\].*?(?=^\[)|^\d+=0x(?:1016|100C|100D)\s*?\n")


@pytest.mark.parametrize("broken", ["eds", "node_id"])
def test_a_drive_that_is_refused_does_not_lack_the_interfaces_of_its_plugin(tmp_path, broken):
    config = write_peer_files(tmp_path, "robot_control")
    eds, bus = config / "cia402_slave.eds", config / "bus.yml"
    if broken == "eds":
        eds.write_text(UNSUPERVISED.sub("", eds.read_text()))
    else:
        bus.write_text(bus.read_text().replace("node_id: 2", "node_id: [2]", 1))
    reported = texts(check(config), Severity.ERROR)
    expected = "nothing would stop this drive" if broken == "eds" else "expected an integer"
    assert len(reported) == {"eds": 2, "node_id": 1}[broken]
    assert all(expected in text for text in reported)


def test_bus_files_that_are_not_read_are_notes_with_a_name_that_is(tmp_path):
    robby = copy_robby(tmp_path)
    bus = (robby / "bus.yml").read_text()
    for name in ("bus2.yml", "bus-arm.yaml", "bus_old.yml"):
        (robby / name).write_text(bus)
    (robby / "other.yml").write_text("a: 1\n")
    findings = check_robot(find_robot(str(robby)), CheckOptions()).findings
    unread = {Path(item.path).name: item.text.rpartition(" ")[2] for item in findings if "not read" in item.text}
    assert unread == {"bus2.yml": "bus_2.yml", "bus-arm.yaml": "bus_arm.yml"}


def test_a_key_without_a_meaning_is_a_note_with_its_line():
    findings = check_robot(find_robot("robby"), CheckOptions()).findings
    lines = Path(find_robot("robby").bus).read_text().splitlines()
    keys = [item.text.partition(":")[0] for item in findings if "has no meaning" in item.text]
    assert keys
    for item in findings:
        if "has no meaning" in item.text:
            assert lines[item.line - 1].lstrip().startswith(item.text.partition(":")[0])


NODE = '<param name="device_name">${side}_drive</param>'


def test_two_buses_may_have_the_same_node_id(tmp_path):
    """The axes of two robots, each of which was made for a bus of its own, often have the same node-IDs."""
    config = split_robby(tmp_path)
    path = config / "bus_right.yml"
    path.write_text(path.read_text().replace("node_id: 2", "node_id: 3"))
    assert texts_of(config, Severity.ERROR) == []


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ('<param name="node_id">3</param>', "left_wheel_joint: node_id 3 is left_drive and right_drive, on two buses;"),
        (NODE + '<param name="node_id">3</param>', ""),
        (NODE + '<param name="node_id">2</param>', "left_wheel_joint: device_name left_drive is node 3, but node_id"),
        (NODE + '<param name="channel">1</param>', "has no axis 1, since 0x6841 statusword (axis 1) is not in its EDS"),
    ],
)
def test_a_joint_names_one_axis_and_only_one(tmp_path, parameters, words):
    """RobotSystem of ros2_canopen takes device_name, its Cia402System node_id."""
    config = split_robby(tmp_path, description={NODE: parameters})
    path = config / "bus_right.yml"
    path.write_text(path.read_text().replace("node_id: 2", "node_id: 3"))
    errors = texts_of(config, Severity.ERROR)
    assert len(errors) == bool(words)
    assert words in "".join(errors)


@pytest.mark.parametrize(
    ("edits", "words"),
    [
        ({"bus": {"index: 0x6064": "index: 6064"}}, "bus.yml"),
        ({"description": {"${side}_drive</param>": "${side}_driv</param>"}}, "device_name 'left_driv' is not a node"),
    ],
)
def test_what_follows_from_an_error_is_not_reported_too(tmp_path, edits, words):
    result = check(copy_robby(tmp_path, **edits))
    errors = [str(item) for item in result.findings if item.severity is Severity.ERROR]
    assert words in errors[0]
    assert not any("state interface" in str(item) or "names it" in str(item) for item in result.findings)


@pytest.mark.parametrize(
    ("robot", "limit"), [("arm6", "the velocity limit of the joint, its <limit> or 0x607F"), ("alone", "0x607F")]
)
def test_a_slow_ramp_is_reported_with_a_limit_that_exists(tmp_path, robot, limit):
    config = tmp_path / robot
    shutil.copytree(data_path("config", "arm6"), config)
    text = (config / "bus.yml").read_text()
    slow = "  sdo:\n    - {index: 0x6084, sub_index: 0, value: 10000}\n"
    (config / "bus.yml").write_text(text.replace("  sdo:\n", slow, 1))
    if robot == "alone":
        (config / "arm6.urdf").unlink()
        (config / "ros2_controllers.yaml").unlink()
    (first, *_) = [text for text in texts_of(config, Severity.WARNING) if "s to brake from" in text]
    assert first.endswith(f"write a faster ramp to the drive under `sdo`, or lower {limit}")
