"""ros2_canopen's own configurations as they are: nothing is wrong with them, and they run."""

import pytest
from support.busalone import AloneBench
from support.peerfiles import NAMES, ROBOTS, write_peer_files

from canopen_control.check.checker import CheckOptions, check_robot
from canopen_control.errors import ControlError
from canopen_control.hardware.axis_statechart import Action
from canopen_control.od.issues import Severity
from canopen_control.runtime.core import RobotState
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot


def nodes_of(config):
    return [node.node_id for node in read_robot(find_robot(str(config))).bus.nodes.values()]


@pytest.mark.parametrize("name", [*NAMES, *ROBOTS])
def test_it_is_checked_and_runs_and_stops_unmodified(tmp_path, name):
    config = write_peer_files(tmp_path, name)
    report = check_robot(find_robot(str(config)), CheckOptions())
    assert [str(finding) for finding in report.findings if finding.severity is Severity.ERROR] == []
    robot = AloneBench(f"peer_{name}", config=config, drives=nodes_of(config))
    try:
        robot.start()
        assert all(node.ready for node in robot.robot.nodes.values())
        if robot.robot.joints:
            robot.enable()
            assert robot.robot.state is RobotState.RUNNING
        else:
            with pytest.raises(ControlError):
                robot.robot.axis(Action.ENABLE, "all", print)
        robot.robot.shutdown("the test is over")
        robot.until(lambda: robot.robot.state is RobotState.STOPPED)
        assert robot.robot.failure is None
    finally:
        robot.close()


def test_what_its_plugin_exports_is_commanded_though_the_description_lists_nothing(tmp_path):
    config = write_peer_files(tmp_path, "robot_control")
    robot = AloneBench("peer_moves", config=config, drives=nodes_of(config))
    robot.start()
    robot.robot.command("forward_position_controller", [0.2, -0.1], "test")
    robot.run(2000)
    assert robot.at("position", 2) == pytest.approx(0.2, abs=0.01)
    assert robot.at("position", 3) == pytest.approx(-0.1, abs=0.01)
    robot.close()


def test_objects_that_its_boot_writes_are_written(tmp_path):
    robot = AloneBench("peer_sdo", config=write_peer_files(tmp_path, "proxy_write_sdo"), drives=(2, 3))
    robot.start()
    assert robot.drives[2].get(0x4000) == 0x12
    assert robot.drives[2].get(0x4004, 7) == 100
    assert robot.drives[3].get(0x4000) == 0
    robot.close()


def test_a_drive_that_nothing_stops_is_one_option_away(tmp_path):
    config = write_peer_files(tmp_path, "cia402")
    eds = config / "cia402_slave.eds"
    eds.write_text(eds.read_text().replace("[1016", "[3016").replace("=0x1016", "=0x3016"))
    files = find_robot(str(config))
    texts = [
        finding.text for finding in check_robot(files, CheckOptions()).findings if finding.severity is Severity.ERROR
    ]
    assert len(texts) == 1
    assert "--allow-unsupervised" in texts[0]
    assert check_robot(files, CheckOptions(allow_unsupervised=True)).passes()
