"""The controllers of the tutorials, with their keys and values, mistakes and all, run as they are."""

import math
import shutil
from pathlib import Path

import pytest
from support.configs import changed, found
from support.robots import Bench

from canopen_control.errors import RobotConfigError
from canopen_control.runtime.robot_files import RobotFiles
from canopen_control.runtime.setup import read_robot

TUTORIALS = Path(__file__).parents[1] / "data" / "tutorials"
#: which robot it is, which file, and its base controller
CASES = [
    ("robby", "robby.yaml", "robby_base_controller", 0.035),
    ("diffbot_sim", "gazebo_diff_drive.yaml", "diff_drive_base_controller", 0.3),
]


def robot_files(folder, name, tutorial) -> RobotFiles:
    files = changed(folder, name)
    shutil.copy(TUTORIALS / tutorial, files.controllers)
    return files


def parameter_events(bench):
    return [event.text.splitlines()[0] for event in bench.events if event.kind in ("parameter", "note")]


@pytest.mark.parametrize(("name", "tutorial", "base", "radius"), CASES)
def test_its_base_drives_as_the_numbers_report(tmp_path, name, tutorial, base, radius):
    files = robot_files(tmp_path, name, tutorial)
    bench = Bench(f"tutorial_{name}", config=str(files.bus.parent), controllers=[base], drives=(2, 3))
    bench.start()
    for _ in range(30):
        bench.robot.command(base, [0.3, 0.0], "test")
        bench.run(100)
    for side in ("left", "right"):
        velocity = bench.robot.registry.state(f"{side}_wheel_joint/velocity").value
        assert velocity == pytest.approx(0.3 / radius, rel=0.01)
    odometry = bench.robot.manager.get(base).odometry
    assert odometry.x == pytest.approx(0.3 * 3.0 - 0.3**2 / 2, rel=0.05)  # along the ramp of 1 m/s^2
    assert math.hypot(odometry.y, odometry.heading) < 1e-6
    reported = parameter_events(bench)
    assert sum("'use_stamped_vel' has no effect" in text for text in reported) == 1
    assert sum("is read as 'angular.z.max_acceleration_reverse'" in text for text in reported) == 1
    assert sum("duplicate key" in text for text in reported) >= 1
    bench.close()


def test_the_forward_controller_of_robby_takes_the_last_of_two_values(tmp_path):
    files = robot_files(tmp_path, "robby", "robby.yaml")
    bench = Bench("tutorial_forward", config=str(files.bus.parent), controllers=["robby_forward_controller"])
    bench.start()
    bench.hold(10.0, 10.0, ms=1000)
    assert bench.velocity(2) == pytest.approx(10.0, rel=0.01)
    bench.close()


@pytest.mark.parametrize(("name", "tutorial"), [case[:2] for case in CASES])
def test_strictly_read_the_repeated_keys_are_errors_with_their_lines(tmp_path, name, tutorial):
    files = robot_files(tmp_path, name, tutorial)
    with pytest.raises(RobotConfigError, match=r"ros2_controllers\.yaml:\d+:\d+: .*duplicate key"):
        read_robot(files, strict=True)


def test_check_names_what_is_odd_about_them(tmp_path):
    texts = found(robot_files(tmp_path, "robby", "robby.yaml"))
    assert any("base_link has two parents: world by odometry, and base_footprint" in text for text in texts)
    assert sum("duplicate key" in text for text in texts) == 2
    texts = found(robot_files(tmp_path / "2", "diffbot_sim", "gazebo_diff_drive.yaml"))
    assert any("wheel_separation is 1.25 m, the description's wheels have 0.36 m" in text for text in texts)
    assert any("update_rate 100 Hz is higher than the SYNC rate" in text for text in texts)
