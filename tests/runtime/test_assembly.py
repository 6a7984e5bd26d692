"""What the files of a robot make."""

import shutil

import pytest
from support.configs import changed

from canopen_control.data_files import data_path
from canopen_control.errors import RobotConfigError
from canopen_control.host.reactor import Reactor
from canopen_control.host.timer import ManualClock
from canopen_control.runtime.assembly import Assembly
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot


def assemble(config, **how):
    with Reactor(ManualClock()) as reactor:
        return Assembly(read_robot(find_robot(str(config)), **how), reactor, print, print, print)


def test_drives_make_a_bus_nodes_and_joints():
    made = assemble("robby")
    assert list(made.buses) == ["can"]
    assert sorted(made.nodes) == sorted(made.bus_by_node) == ["left_drive", "right_drive"]
    assert sorted(made.joints) == ["left_wheel_joint", "right_wheel_joint"]
    assert len(made.systems) == len(made.registry.components) == 1


@pytest.mark.parametrize(("config", "how"), [("diffbot_sim", {}), ("robby", {"mock": True})])
def test_what_is_on_no_bus_makes_none(config, how):
    made = assemble(config, **how)
    assert (made.buses, made.nodes, made.joints, made.systems) == ({}, {}, {}, [])
    assert len(made.registry.components) == 1


def test_a_drive_that_no_bus_has_is_refused_with_the_line_of_its_tag(tmp_path):
    files = changed(tmp_path, "diffbot_sim", description={">left_drive<": ">lft_drive<"})
    lines = files.description.read_text().splitlines()
    tag = next(number for number, line in enumerate(lines, 1) if "<ros2_control" in line)
    with pytest.raises(RobotConfigError, match=rf"diffbot\.urdf:{tag}: joint .*'lft_drive'.*did you mean 'left_drive'"):
        assemble(files.description.parent, real=True)


def test_a_description_without_hardware_is_refused(tmp_path):
    folder = tmp_path / "r"
    shutil.copytree(data_path("config", "diffbot_sim"), folder)
    (folder / "diffbot.urdf").write_text('<robot name="r"><link name="base_link"/></robot>')
    with pytest.raises(RobotConfigError, match=r"diffbot\.urdf: no <ros2_control> tag"):
        assemble(folder)
