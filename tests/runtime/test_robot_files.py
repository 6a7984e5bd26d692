import os
import re

import pytest

from canopen_control.errors import RobotConfigError
from canopen_control.runtime.robot_files import find_buses, find_robot


def robot(folder, *names):
    folder.mkdir(exist_ok=True)
    for name in names:
        (folder / name).write_text("")
    return folder


def test_a_folder_has_the_three_files_and_gives_the_name(tmp_path):
    folder = robot(tmp_path / "my robot", "bus.yml", "ros2_controllers.yaml", "x.urdf.xacro")
    files = find_robot(str(folder))
    assert files.name == "my_robot"
    assert files.description == folder / "x.urdf.xacro"


def test_a_bundled_robot_is_found_by_its_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert find_robot("robby").bus.name == "bus.yml"


def test_a_single_file_wins_over_the_folders(tmp_path):
    folder = robot(tmp_path / "r", "bus.yml", "ros2_controllers.yaml", "x.urdf")
    other = tmp_path / "other.yml"
    other.write_text("")
    assert find_robot(str(folder), bus=str(other)).bus == other


def test_the_three_files_alone_are_enough(tmp_path):
    folder = robot(tmp_path / "r", "b.yml", "c.yaml", "d.urdf")
    files = find_robot(
        None, bus=str(folder / "b.yml"), controllers=str(folder / "c.yaml"), description=str(folder / "d.urdf")
    )
    assert files.name == "r"


THREE = ("bus.yml", "ros2_controllers.yaml", "x.urdf")
REFUSED = {
    "an empty folder": ((), {}, r"bus\.yml(.|\n)*ros2_controllers\.yaml(.|\n)*\*\.urdf"),
    "no controllers": (("bus.yml", "x.urdf"), {}, r"ros2_controllers\.yaml"),
    "no description": (("bus.yml", "ros2_controllers.yaml"), {}, r"\*\.urdf"),
    "a further bus alone": (("bus_arm.yml",), {}, r"bus\.yml"),
    "a description that is missing, where bus.yml may be": (
        ("ros2_controllers.yaml",), {},
        r"^\S+ has no \*\.urdf\.xacro or \*\.urdf or \*\.system\.xacro; write one, or .* --description FILE$",
    ),
    "two descriptions": ((*THREE, "y.urdf"), {}, "--description"),
    "a device": (THREE, {"bus": "/dev/zero"}, "/dev/zero is a pipe or a device, not a file"),
    "a file that is not there": (THREE, {"bus": "nowhere.yml"}, r"--bus: no file nowhere\.yml"),
}  # fmt: skip


@pytest.mark.parametrize(("names", "how", "words"), REFUSED.values(), ids=REFUSED)
def test_what_is_not_a_robot_is_reported(tmp_path, names, how, words):
    with pytest.raises(RobotConfigError, match=words):
        find_robot(str(robot(tmp_path / "r", *names)), **how)


def test_an_unknown_robot_names_the_bundled_ones_which_are_no_buses_alone():
    with pytest.raises(RobotConfigError, match="robby"):
        find_robot("nobody")
    assert not find_robot("robby").bus_alone
    assert not find_robot("diffbot_sim").bus_alone


def test_bus_yml_may_be_absent_but_not_alongside_further_buses_and_not_when_it_is_named(tmp_path):
    folder = robot(tmp_path / "r", "ros2_controllers.yaml", "x.urdf")
    files = find_robot(str(folder))
    assert (files.name, files.bus, files.buses) == ("r", None, {})
    alone = find_robot(None, controllers=str(folder / "ros2_controllers.yaml"), description=str(folder / "x.urdf"))
    assert (alone.name, alone.buses) == ("r", {})
    with pytest.raises(RobotConfigError, match=r"has no bus\.yml"):
        find_robot(str(robot(folder, "bus_arm.yml")))
    with pytest.raises(RobotConfigError, match="--bus: no file"):
        find_robot(str(folder), bus="none.yml")


@pytest.mark.parametrize("name", ["bus.yml", "bus_arm.yml", "ros2_controllers.yaml", "x.urdf"])
def test_what_is_not_a_regular_file_is_refused_and_never_opened(tmp_path, name):
    names = {"bus.yml", "ros2_controllers.yaml", "x.urdf"} - {name}
    folder = robot(tmp_path / "r", *names)
    os.mkfifo(folder / name)
    with pytest.raises(RobotConfigError, match=f"{re.escape(str(folder / name))} is a pipe or a device, not a file"):
        find_robot(str(folder))
    (folder / name).unlink()
    (folder / name).mkdir()
    with pytest.raises(RobotConfigError, match=f"{re.escape(str(folder / name))} is a folder, not a file"):
        find_robot(str(folder))
    if name.startswith("bus"):
        with pytest.raises(RobotConfigError, match="is a folder, not a file"):
            find_buses(str(folder))


def test_a_file_of_a_robot_is_not_the_robot_and_its_folder_is_reported(tmp_path):
    folder = robot(tmp_path / "r", "bus.yml", "ros2_controllers.yaml", "x.urdf")
    for find in (find_robot, find_buses):
        with pytest.raises(RobotConfigError, match=f"it is a file; give its folder: {re.escape(str(folder))}$"):
            find(str(folder / "bus.yml"))


def test_a_bus_file_with_another_name_is_named(tmp_path):
    folder = robot(tmp_path / "r", "bus_config.yml", "launch_params.yaml")
    file = folder / "bus_config.yml"
    file.write_text("nodes:\n  left:\n    node_id: 2\n")
    for find in (find_robot, find_buses):
        with pytest.raises(
            RobotConfigError, match=f"has no bus.yml; name the file by --bus: {re.escape(str(file))}(;|$)"
        ):
            find(str(folder))
        with pytest.raises(RobotConfigError, match=f"it is a file; .*, or the file by --bus {re.escape(str(file))}$"):
            find(str(file))


def test_an_empty_name_is_not_a_robot_and_not_the_present_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(robot(tmp_path / "r", "bus.yml", "ros2_controllers.yaml", "x.urdf"))
    assert find_robot(".").name == "r"
    for find in (find_robot, find_buses):
        with pytest.raises(RobotConfigError, match="no robot given: name a folder"):
            find("")


def test_further_buses_stand_alongside_the_first_by_their_names(tmp_path):
    folder = robot(tmp_path / "r", "bus.yml", "bus_arm.yml", "bus_left-leg.yml", "ros2_controllers.yaml", "x.urdf")
    files = find_robot(str(folder))
    assert list(files.buses) == ["can", "arm", "left-leg"]
    assert files.buses["arm"] == folder / "bus_arm.yml"
    assert find_buses(str(folder)) == files.buses
    assert find_robot(str(folder), bus=str(folder / "bus_arm.yml")).buses == {"can": folder / "bus_arm.yml"}


def test_a_copy_of_a_bus_file_is_not_a_further_bus(tmp_path):
    folder = robot(tmp_path / "r", "bus.yml", "bus_template.yml", "bus_arm_old.yml", "ros2_controllers.yaml", "x.urdf")
    assert find_robot(str(folder)).buses == {"can": folder / "bus.yml"}


PLUGIN = """\
<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><link name="base"/>
  <ros2_control name="wheels" type="system"><hardware>
    <plugin>canopen_ros2_control/RobotSystem</plugin><param name="bus_config">{bus}</param>
  </hardware></ros2_control>
</robot>
"""


def test_the_bus_that_a_hardware_plugin_names_is_read_where_nothing_else_names_one(tmp_path):
    folder = robot(tmp_path / "r", "ros2_controllers.yaml")
    other = robot(tmp_path / "config", "bus.yml") / "bus.yml"
    (folder / "x.urdf").write_text(PLUGIN.format(bus=f'"{other}"'))
    assert find_robot(str(folder)).bus == other
    robot(folder, "bus.yml")
    assert find_robot(str(folder)).bus == folder / "bus.yml"
    (folder / "bus.yml").unlink()
    (folder / "x.urdf").write_text(PLUGIN.format(bus="${bus_config}"))
    assert find_robot(str(folder)).bus is None


def test_the_buses_that_several_hardware_plugins_name_have_the_names_of_their_folders(tmp_path):
    folder = robot(tmp_path / "r", "ros2_controllers.yaml")
    buses = [robot(tmp_path / name, "bus.yml") / "bus.yml" for name in ("left", "right", "right/right")]
    tag = PLUGIN[PLUGIN.index("  <ros2") : PLUGIN.index("</robot>")]
    tags = "".join(tag.format(bus=bus).replace('"wheels"', f'"w{number}"') for number, bus in enumerate(buses))
    (folder / "x.urdf").write_text(f'<robot name="r"><link name="base"/>{tags}</robot>')
    assert find_robot(str(folder)).buses == dict(zip(("can", "right", "right_3"), buses, strict=True))


@pytest.mark.parametrize("name", ["bus_can.yml", "bus_a b.yml", "bus_.yml"])
def test_a_further_bus_needs_a_name_that_a_channel_may_have(tmp_path, name):
    folder = robot(tmp_path / "r", "bus.yml", name, "ros2_controllers.yaml", "x.urdf")
    with pytest.raises(RobotConfigError, match="is not a valid name of a bus"):
        find_robot(str(folder))
    with pytest.raises(RobotConfigError, match="is not a valid name of a bus"):
        find_buses(str(folder))


def test_bus_files_are_found_without_the_rest_of_a_robot(tmp_path):
    assert list(find_buses(str(robot(tmp_path / "r", "bus.yml")))) == ["can"]
    with pytest.raises(RobotConfigError, match=r"has no bus\.yml"):
        find_buses(str(robot(tmp_path / "none")))
    with pytest.raises(RobotConfigError, match="name a folder or a bundled robot"):
        find_buses(None)


def test_a_bus_file_alone_is_a_bus_without_controllers(tmp_path):
    files = find_robot(str(robot(tmp_path / "cell", "bus.yml", "bus_arm.yml")))
    assert files.bus_alone
    assert files.controllers == files.description == tmp_path / "cell" / "bus.yml"
    assert list(files.buses) == ["can", "arm"]
    assert find_robot(None, bus=str(tmp_path / "cell" / "bus.yml")).bus_alone


def test_an_argument_names_the_world_from_here_or_in_the_package_of_the_launch_file(tmp_path, monkeypatch):
    folder = robot(tmp_path / "r", "ros2_controllers.yaml", "x.urdf")
    robot(folder / "worlds", "hall.sdf", "maze.world")
    robot(folder / "launch")
    launch = folder / "launch" / "sim.launch.py"
    launch.write_text("DeclareLaunchArgument('world', default_value='empty.sdf')\n")
    monkeypatch.chdir(folder / "worlds")
    assert find_robot(str(folder)).world is None
    assert find_robot(str(folder), launch=str(launch)).world is None  # a default chooses none
    assert find_robot(str(folder), arguments=["gz_args:=-r -v 4 hall.sdf"]).world == folder / "worlds" / "hall.sdf"
    monkeypatch.chdir(tmp_path)
    result = find_robot(str(folder), arguments=["world:=maze.world"], launch=str(launch))
    assert (result.world, result.idle) == (folder / "worlds" / "maze.world", ())
    with pytest.raises(RobotConfigError) as caught:
        find_robot(str(folder), arguments=["world:=none.sdf"])
    assert str(caught.value) == "world:=none.sdf: file none.sdf does not exist"
    with pytest.raises(RobotConfigError, match=r"a:=x\.sdf, b:=y\.sdf: these arguments contradict each other"):
        find_robot(str(folder), arguments=["a:=x.sdf", "b:=y.sdf"])


def test_arguments_of_the_description_are_pairs(tmp_path):
    folder = robot(tmp_path / "r", "bus.yml", "ros2_controllers.yaml", "x.urdf.xacro")
    files = find_robot(str(folder), arguments=["prefix:=a:=b", "side:=", "prefix:=c"])
    assert files.arguments == {"prefix": "c", "side": ""}
    assert files.mappings(mock=True) == {"use_mock_hardware?": "true", "prefix": "c", "side": ""}
    for word in ("prefix=a", ":=a", "a b:=c", "x"):
        with pytest.raises(RobotConfigError, match="is not an argument of the form NAME:=VALUE"):
            find_robot(str(folder), arguments=[word])


# --- ROS packages ---


@pytest.fixture
def package(tmp_path):
    """Return a package with config/ and urdf/."""
    root = tmp_path / "ws" / "my_robot"
    robot(tmp_path / "ws")
    robot(root, "package.xml")
    robot(root / "config", "bus.yml", "ros2_controllers.yaml", "bus_arm.yml")
    robot(root / "urdf", "my_robot.urdf.xacro", "part.xacro")
    return root


@pytest.mark.parametrize("inputs", ["", "config"])
def test_in_a_package_the_description_is_alongside_config(package, inputs):
    files = find_robot(str(package / inputs))
    assert files.name == "my_robot"
    assert files.bus == package / "config" / "bus.yml"
    assert files.description.resolve() == package / "urdf" / "my_robot.urdf.xacro"
    assert list(files.more_buses) == ["arm"]
    assert list(find_buses(str(package / inputs))) == ["can", "arm"]


def test_each_folder_of_config_is_a_robot_with_the_description_of_its_name(package):
    robot(package / "config" / "lift", "bus.yml", "ros2_controllers.yaml")
    robot(package / "urdf" / "lift", "any.urdf.xacro")
    files = find_robot(str(package / "config" / "lift"))
    assert (files.name, files.description) == ("lift", package / "urdf" / "lift" / "any.urdf.xacro")


def test_what_lies_in_several_folders_is_named(package):
    for name in ("a", "b"):
        robot(package / "config" / name, "bus.yml")
        robot(package / "urdf" / name, "x.urdf")
    for path in (package / "config" / "bus.yml", package / "urdf" / "my_robot.urdf.xacro"):
        path.unlink()
    (package / "config" / "bus_arm.yml").unlink()
    with pytest.raises(RobotConfigError, match=r"name one with --description: .*urdf/a/x\.urdf, .*urdf/b/x\.urdf"):
        find_robot(str(package))
    with pytest.raises(RobotConfigError, match=r"name a folder that has one: .*config/a, .*config/b"):
        find_buses(str(package))


def test_a_package_is_found_by_name_if_the_environment_contains_it(package, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "ws"))
    assert find_robot("my_robot").bus == package / "config" / "bus.yml"
    assert find_robot("my_robot/config").name == "my_robot"
    with pytest.raises(RobotConfigError, match="nor a ROS package that is sourced or in ROS_PACKAGE_PATH"):
        find_robot("their_robot")


def test_several_descriptions_are_named(package):
    robot(package / "urdf", "other.urdf.xacro")
    with pytest.raises(RobotConfigError, match=r"--description \(my_robot\.urdf\.xacro, other\.urdf\.xacro\)"):
        find_robot(str(package))


def test_a_bus_alone_has_no_arguments(tmp_path):
    folder = robot(tmp_path / "r", "bus.yml")
    assert find_robot(str(folder)).bus_alone
    with pytest.raises(RobotConfigError, match="a bus without a description and accepts no arguments; omit side:="):
        find_robot(str(folder), arguments=["side:=left"])


def test_a_misspelt_folder_is_suggested(tmp_path, monkeypatch):
    for folder in ("my_cell", "work"):
        (tmp_path / folder).mkdir()
    (tmp_path / "my_cell" / "bus.yml").touch()
    for name, end in (
        ("cell", r"\(did you mean 'my_cell'\?\)"),
        ("robbi", r"\(did you mean 'robby'\?\)"),
        ("wrk", "ROS_PACKAGE_PATH"),  # that folder holds no robot
    ):
        monkeypatch.chdir(tmp_path)
        with pytest.raises(RobotConfigError, match=f"no robot '{name}': .*{end}$"):
            find_buses(name)
    with pytest.raises(RobotConfigError, match=r"\(did you mean 'my_cell'\?\)$"):
        find_buses(str(tmp_path / "my_cel"))
    with pytest.raises(RobotConfigError, match=r"ROS_PACKAGE_PATH$"):
        find_buses(str(tmp_path / "robby"))  # a path, not a bundled robot
    monkeypatch.chdir(tmp_path / "my_cell")
    with pytest.raises(RobotConfigError, match=r"; the folder .*/my_cell has this name: give \.$"):
        find_buses("my_cell")


def test_a_missing_file_is_named_with_what_to_do(tmp_path):
    folder = robot(tmp_path / "r", "bus.yml", "x.urdf")
    with pytest.raises(
        RobotConfigError, match=r"has no ros2_controllers\.yaml; write one, or give .* --controllers FILE"
    ):
        find_robot(str(folder))
    (folder / "controllers.yaml").write_text("/**/controller_manager:\n  ros__parameters:\n    update_rate: 50\n")
    with pytest.raises(RobotConfigError, match=r"name the file by --controllers: \S+/controllers\.yaml$"):
        find_robot(str(folder))
    (folder / "x.urdf").unlink()
    with pytest.raises(RobotConfigError, match="or give a file by --description FILE"):
        find_robot(str(folder), controllers=str(folder / "controllers.yaml"))


def test_a_misnamed_bus_alone_needs_no_other_file(tmp_path):
    folder = robot(tmp_path / "r", "bus.yaml")
    (folder / "bus.yaml").write_text("nodes:\n  left:\n    node_id: 2\n")
    with pytest.raises(RobotConfigError, match=r"has no bus\.yml; name the file by --bus: \S+/bus\.yaml$"):
        find_robot(str(folder))
    assert find_robot(str(folder), bus=str(folder / "bus.yaml")).bus_alone
