"""A bus without ros2_control: which nodes are drives, their names, and the remaining nodes."""

import pytest
from support.busalone import IO, AloneBench, write_drives, write_io, write_two_axis_drive
from support.generic import write_generic
from support.two_motors import folder

from canopen_control.check.checker import CheckOptions, check_robot
from canopen_control.errors import ConfigError, ControlError, DriveError, RobotConfigError
from canopen_control.hardware.axis_statechart import Action
from canopen_control.od.issues import Severity
from canopen_control.runtime.core import RobotState
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot
from canopen_control.runtime.status import nodes_message, status_message


@pytest.fixture
def bench(request):
    benches = []

    def make(config, drives):
        benches.append(AloneBench(f"alone{abs(hash(request.node.nodeid)) % 10**8}", config=config, drives=drives))
        benches[-1].start()
        return benches[-1]

    yield make
    for benche in benches:
        benche.close()


def check(config, **how):
    return check_robot(find_robot(str(config)), CheckOptions(**how))


def errors(report):
    return [str(finding) for finding in report.findings if finding.severity is Severity.ERROR]


@pytest.mark.parametrize("nested", [True, False])
def test_a_bus_with_no_drive_at_all_runs_and_is_spoken_to(bench, tmp_path, nested):
    robot = bench(write_io(tmp_path, nested=nested), (IO,))
    assert robot.robot.state is RobotState.RUNNING
    assert robot.robot.hint is None
    assert robot.texts("running") == ["terminals runs: io_module"]
    node = status_message(robot.robot).nodes["io_module"]
    assert (node.nmt_state, node.ready, node.axes) == ("OPERATIONAL", True, ())
    answers = []
    robot.robot.nodes["io_module"].read(0x1000, 0, answers.append)
    robot.until(lambda: answers)
    assert answers[0].data == (0x30191).to_bytes(4, "little")


def test_what_has_no_axis_reports_this_and_a_stop_of_nothing_is_done(bench, tmp_path):
    robot = bench(write_io(tmp_path), (IO,))
    for name, word in (("all", "no axis"), ("io_module", "has no axis")):
        with pytest.raises(ControlError, match=word):
            robot.robot.axis(Action.ENABLE, name, print)
    answers = []
    robot.robot.stop(answers.append)
    robot.until(lambda: answers)
    assert answers == [None]
    robot.robot.shutdown("the test is over")
    robot.run(100)
    assert robot.texts("stopped") == ["terminals has stopped"]
    assert robot.robot.failure is None


def test_each_drive_is_a_joint_of_its_own_name_and_off_until_it_is_enabled(bench, tmp_path):
    robot = bench(write_drives(tmp_path, io=""), (2, 3, IO))
    assert robot.robot.state is RobotState.DISABLED
    assert "axis enable" in robot.robot.hint
    assert list(robot.robot.joints) == ["drive_one", "drive_two"]
    assert {node.name: node.joints for node in nodes_message(robot.robot).nodes} == {
        "drive_one": ["drive_one"],
        "drive_two": ["drive_two"],
        "io_module": [],
    }
    assert not robot.powered(2)
    assert not robot.powered(3)
    robot.enable()
    assert robot.robot.state is RobotState.RUNNING


def test_the_axes_of_one_device_are_joints_by_its_channel_names(bench, tmp_path):
    config = write_two_axis_drive(tmp_path)
    bus = config / "bus.yml"
    bus.write_text(bus.read_text().replace("{node_id: 2}", "{node_id: 2, channel_names: [shoulder]}"))
    robot = bench(config, (2,))
    assert list(robot.robot.joints) == ["shoulder", "drive_one_1"]
    robot.enable("drive_one")
    robot.mode("PV")
    assert robot.target(1.0, "drive_one_1") is None
    robot.run(1500)
    assert robot.robot.joints["drive_one_1"].states["velocity"].value == pytest.approx(1.0, rel=0.05)
    assert robot.robot.joints["shoulder"].states["velocity"].value == 0.0


def test_a_drive_under_a_proxy_driver_is_not_moved_and_a_driver_without_a_drive_is_reported(tmp_path):
    config = write_drives(tmp_path, io="")
    bus = config / "bus.yml"
    text = bus.read_text().replace("ProxyDriver", "Cia402Driver")
    bus.write_text(text.replace("  drive_two:\n", "  drive_two:\n    driver: ros2_canopen::ProxyDriver\n"))
    setup = read_robot(find_robot(str(config)))
    assert [joint.name for tag in setup.description.hardware for joint in tag.joints] == ["drive_one"]
    texts = [finding.text for finding in check(config).findings if finding.severity is Severity.WARNING]
    assert any("drive_two" in item and "cannot be enabled" in item for item in texts)
    assert any("io_module" in item and "no controlword" in item for item in texts)


def test_a_good_bus_is_good(tmp_path):
    report = check(write_drives(tmp_path, io=""))
    assert errors(report) == []
    texts = [finding.text for finding in report.findings if finding.severity is Severity.WARNING]
    assert all("outputs" in item for item in texts)  # which this I/O module leaves as they are when the master is lost
    assert report.budgets["can"].fits


def test_all_errors_are_reported_at_once_with_their_places(tmp_path):
    config = write_io(tmp_path, nested=False)
    bus = config / "bus.yml"
    bus.write_text(bus.read_text().replace("node_id: 5", "node_id: 300") + "other: {dcf: absent.eds, node_id: 7}\n")
    reported = errors(check(config))
    assert len(reported) == 2
    assert all(str(bus) in item for item in reported)
    with pytest.raises(ConfigError, match="absent"):
        read_robot(find_robot(str(config)))


def without(config, *mappings):
    """Take these mappings out of the drives' PDOs."""
    bus = config / "bus.yml"
    text = bus.read_text()
    for mapping in mappings:
        assert mapping in text
        text = text.replace(mapping, "mapping: []")
    bus.write_text(text)
    return config


CONTROL = "mapping: [{index: 0x6040}, {index: 0x6060}]"
STATUS = "mapping: [{index: 0x6041}, {index: 0x6061}, {index: 0x60FD}]"
TARGETS = (
    "mapping: [{index: 0x607A}, {index: 0x60FF}]",
    "mapping: [{index: 0x6071}, {index: 0x6042}, {index: 0x60C1, sub_index: 1}]",
)


@pytest.mark.parametrize(("mapping", "word"), [(CONTROL, "no RPDO carries 0x6040"), (STATUS, "no TPDO carries 0x6041")])
def test_a_drive_that_no_pdo_commands_is_a_proxy_and_reported_once_with_what_to_map(bench, tmp_path, mapping, word):
    config = without(write_drives(tmp_path), mapping)
    report = check(config)
    assert errors(report) == []
    assert not report.passes(strict=True)
    reported = [finding.text for finding in report.findings if word in finding.text]
    assert len(reported) == 2  # drives
    assert all("it is a proxy, and cannot be enabled; map it in bus.yml" in item for item in reported)
    robot = bench(config, (2, 3))
    assert robot.robot.state is RobotState.RUNNING
    assert robot.robot.joints == {}
    assert sum(word in item for item in robot.texts("doubt")) == 2  # said as it starts


def test_a_drive_whose_rpdos_carry_no_target_is_watched_homed_and_refuses_what_needs_one(bench, tmp_path):
    config = without(write_drives(tmp_path), *TARGETS)
    report = check(config)
    assert errors(report) == []
    assert not report.passes(strict=True)
    assert sum("no RPDO carries a target" in finding.text for finding in report.findings) == 2
    robot = bench(config, (2, 3))
    assert list(robot.robot.joints) == ["drive_one", "drive_two"]
    assert robot.at("position") == 0.0
    with pytest.raises(DriveError, match=r"drive_one.*no RPDO carries 0x607A:00.*map it in bus.yml"):
        robot.robot.axis(Action.ENABLE, "drive_one", print)
    with pytest.raises(DriveError, match=r"no RPDO carries 0x60FF:00"):
        robot.robot.axis(Action.MODE, "drive_one", print, mode="PV")
    assert "drive_one is only observed and will not move" in robot.target(1.0)
    assert not robot.powered(2)
    assert robot.axis(Action.HOME, "drive_one", method=37) is None


def observed(folder):
    """Write two drives, of which drive_one has no target in an RPDO."""
    config = write_drives(folder)
    bus = config / "bus.yml"
    lines = "    node_id: 2\n    rpdo:\n      2: {enabled: false}\n      3: {enabled: false}\n"
    bus.write_text(bus.read_text().replace("    node_id: 2\n", lines))
    return config


OBSERVED = (
    "drive_one is only observed and will not move, since no RPDO contains a target: "
    "map 0x607A or 0x60FF in bus.yml, then start the robot again"
)


def test_the_advice_alongside_a_drive_without_a_target_works(bench, tmp_path):
    robot = bench(observed(tmp_path), (2, 3))
    assert robot.robot.state is RobotState.DISABLED
    assert robot.robot.hint == "drive_two is not enabled and will not move: canopen-control axis enable all"
    answers = []
    assert robot.robot.axis(Action.ENABLE, "all", answers.append) == OBSERVED
    robot.until(lambda: answers)
    assert answers == [None]
    assert (robot.robot.state, robot.robot.hint) == (RobotState.RUNNING, None)
    assert (robot.powered(2), robot.powered(3)) == (False, True)
    robot.mode("PV", "drive_two")
    assert robot.target(1.0, "drive_two") is None
    assert robot.target(1.0, "drive_one") == f"{OBSERVED}; an earlier command is refused and not kept"


def test_a_bus_whose_drives_all_lack_a_target_waits_for_no_enable(bench, tmp_path):
    robot = bench(without(write_drives(tmp_path), *TARGETS), (2, 3))
    assert (robot.robot.state, robot.robot.hint) == (RobotState.RUNNING, None)
    with pytest.raises(DriveError, match=r"drive_one.*no RPDO carries 0x607A:00.*map it in bus.yml"):
        robot.robot.axis(Action.ENABLE, "all", print)


def test_a_drive_that_no_joint_of_a_robot_names_is_a_proxy_alongside_the_others_and_reported(tmp_path):
    config = write_generic(tmp_path)
    bus = config / "bus.yml"
    bus.write_text(bus.read_text() + "  spare:\n    node_id: 9\n")
    texts = [finding.text for finding in check(config, controllers=["velocity"]).findings if "spare" in finding.text]
    assert any("no joint of" in item and "cannot be enabled" in item for item in texts)
    setup = read_robot(find_robot(str(config)), controllers=["velocity"])
    assert "spare" not in [joint.name for tag in setup.description.hardware for joint in tag.joints]


def with_spare(folder, driver="ros2_canopen::Cia402Driver", name="spare"):
    """Write a robot of two drives that has a third one, which no joint names."""
    config = write_generic(folder)
    bus = config / "bus.yml"
    bus.write_text(bus.read_text() + f"  {name}:\n    node_id: 9\n    driver: {driver}\n")
    return config


@pytest.mark.rest
def test_a_robot_may_have_a_drive_that_takes_targets_alongside_its_joints(tmp_path):
    config = with_spare(tmp_path)
    reported = [finding.text for finding in check(config, controllers=["velocity"]).findings if "spare" in finding.text]
    assert any("it has its own controller" in item and "axis enable spare, command spare" in item for item in reported)
    robot = AloneBench("mixed", config=config, drives=(2, 3, 9), controllers=["velocity"])
    try:
        robot.start()
        assert list(robot.robot.joints)[-1] == "spare"
        assert robot.robot.state is RobotState.RUNNING  # those of its own controllers are enabled
        assert (robot.powered(2), robot.powered(9)) == (True, False)
        assert "not enabled" in robot.target(1.0, "spare")
        robot.enable("spare")
        robot.mode("PV", "spare")
        assert robot.target(1.0, "spare") is None
        robot.run(1000)
        assert robot.at("velocity", 9) == pytest.approx(1.0, rel=0.05)
        robot.power_off(9)  # one stop group, as in any robot
        robot.run(2000)
        assert not robot.powered(2)
        assert any("stopping" in item and "spare" in item for item in robot.texts("stop"))
    finally:
        robot.close()


@pytest.mark.rest
def test_a_drive_alongside_the_others_that_need_not_be_there_stops_and_keeps_none_of_them(tmp_path):
    config = with_spare(tmp_path)
    (config / "bus.yml").write_text((config / "bus.yml").read_text() + "    required: false\n")
    robot = AloneBench("mixed", config=config, drives=(2, 3), controllers=["velocity"])
    try:
        robot.start()
        assert robot.robot.state is RobotState.RUNNING
        robot.power_on(9)
        robot.until(lambda: robot.robot.nodes["spare"].ready)
        robot.enable("spare")
        robot.power_off(9)
        robot.run(2000)
        assert robot.powered(2)
        robot.robot.stop(print)
        robot.run(2000)
        assert not robot.powered(2)
    finally:
        robot.close()


@pytest.mark.parametrize(
    ("how", "why"),
    [
        ({"driver": "ros2_canopen::ProxyDriver"}, "it is a proxy, and cannot be enabled"),
        ({"name": "velocity"}, "it is a proxy, since a joint, part or controller is also named 'velocity'"),
    ],
)
def test_one_that_is_to_be_none_or_whose_name_is_taken_is_a_proxy(tmp_path, how, why):
    config = with_spare(tmp_path, **how)
    assert any(why in finding.text for finding in check(config, controllers=["velocity"]).findings)
    setup = read_robot(find_robot(str(config)), controllers=["velocity"])
    assert len([joint for tag in setup.description.hardware for joint in tag.joints]) == 2


def test_a_mocked_robot_has_no_drive_alongside_its_joints(tmp_path):
    setup = read_robot(find_robot(str(with_spare(tmp_path))), controllers=["velocity"], mock=True)
    assert "spare" not in setup.to_activate
    assert "spare" in read_robot(find_robot(str(tmp_path / "generic")), controllers=["velocity"]).to_activate


def test_there_is_nothing_to_mock(tmp_path):
    config = write_io(tmp_path)
    with pytest.raises(RobotConfigError, match="--mock"):
        read_robot(find_robot(str(config)), mock=True)
    assert any("--mock" in error for error in errors(check(config, mock=True)))


def test_a_folder_with_half_of_a_robot_still_reports_what_is_missing(tmp_path):
    config = write_io(tmp_path)
    (config / "ros2_controllers.yaml").write_text("controller_manager: {ros__parameters: {}}\n")
    with pytest.raises(RobotConfigError, match=r"has no .*urdf"):
        find_robot(str(config))


def test_a_node_that_is_not_there_ends_the_start_with_its_name(tmp_path):
    config = write_io(tmp_path)
    bus = config / "bus.yml"
    bus.write_text(bus.read_text().replace("{node_id: 1}", "{node_id: 1, boot_time: 500}"))
    robot = AloneBench("absent", config=config, drives=())
    robot.robot.start()
    robot.until(lambda: robot.robot.state is RobotState.STOPPED)
    assert "no frame was received from io_module" in robot.robot.failure
    robot.close()


def test_one_that_is_not_required_is_gone_on_without_and_joins_when_it_comes(bench, tmp_path):
    config = write_io(tmp_path)
    bus = config / "bus.yml"
    bus.write_text(bus.read_text().replace("node_id: 5,", "node_id: 5, required: false,"))
    robot = bench(config, ())
    assert robot.robot.state is RobotState.RUNNING
    robot.power_on(IO)
    robot.until(lambda: robot.robot.nodes["io_module"].ready)


def test_drivers_of_ros2_canopen_before_its_time_are_known(tmp_path):
    config = write_drives(tmp_path)
    bus = config / "bus.yml"
    driver = "    driver: ros2_canopen::LifecycleMotionControllerDriver\n"
    bus.write_text(bus.read_text().replace("  drive_one:\n", f"  drive_one:\n{driver}"))
    setup = read_robot(find_robot(str(config)))
    assert list(setup.controllers.controllers) == ["drive_one", "drive_two"]


def test_two_axes_of_one_name_are_refused_with_their_node(tmp_path):
    config = write_two_axis_drive(tmp_path)
    bus = config / "bus.yml"
    bus.write_text(bus.read_text().replace("{node_id: 2}", "{node_id: 2, channel_names: [arm, arm]}"))
    with pytest.raises(RobotConfigError, match=r"bus.yml:\d+: drive_one has an axis 'arm', and so has drive_one"):
        read_robot(find_robot(str(config)))
    assert len(errors(check(config))) == 1


def test_both_motors_behind_one_controlword_have_a_joint(tmp_path):
    folder(tmp_path)
    for name in ("cart.urdf", "ros2_controllers.yaml"):
        (tmp_path / name).unlink()
    setup = read_robot(find_robot(str(tmp_path)))
    assert [joint.name for tag in setup.description.hardware for joint in tag.joints] == ["wheels_0", "wheels_1"]
