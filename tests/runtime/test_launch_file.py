"""Data taken from a launch file: arguments of xacro, and files that are given only there."""

import pytest
from support.launch_files import LAUNCH, make_package

from canopen_control.check.checker import CheckOptions, check_robot
from canopen_control.errors import RobotConfigError
from canopen_control.runtime.launch_file import launched_robot, read_launch, spawned_names, words_of
from canopen_control.runtime.robot_files import find_launch, find_robot
from canopen_control.runtime.setup import read_robot

XML = """\
<launch>
  <arg name="mock" default="false"/>
  <arg name="model" default="robby"/>
  <param name="robot_description"
         value="$(command 'xacro $(find-pkg-share robby_bringup)/urdf/base/$(var model).urdf.xacro use_mock_hardware:=$(var mock)')"/>
</launch>
"""  # noqa: E501 - as long as such lines are


def test_python_gives_arguments_and_files_of_the_package_around_it(tmp_path):
    path = make_package(tmp_path)
    result = launched_robot(path, {})
    assert result.arguments == {"use_mock_hardware?": "false"}
    assert result.uncertainties == ()
    assert result.files == {
        "description": tmp_path / "robby_bringup/urdf/base/robby.urdf.xacro",
        "controllers": tmp_path / "robby_bringup/config/first/ros2_controllers.yaml",
    }


def test_so_does_xml(tmp_path):
    path = make_package(tmp_path).with_name("robby.launch.xml")
    path.write_text(XML)
    result = launched_robot(path, {"mock": "true"})
    assert result.arguments == {"use_mock_hardware?": "true"}
    assert result.files["description"].is_file()


def test_xml_of_ros_1_gives_them_too(tmp_path):
    path = make_package(tmp_path).with_name("robby.launch")
    command = "$(find xacro)/xacro $(find robby_bringup)/urdf/base/robby.urdf.xacro use_mock_hardware:=$(arg mock)"
    path.write_text(
        f'<launch><arg name="mock" default="x"/><param name="robot_description" command="{command}"/></launch>'
    )
    assert launched_robot(path, {}).arguments == {"use_mock_hardware?": "x"}


def test_what_the_user_gives_is_for_the_launch_file_where_it_has_that_else_for_xacro(tmp_path):
    path = make_package(tmp_path)
    assert launched_robot(path, {"mock": "true"}).arguments == {"use_mock_hardware?": "true"}
    assert launched_robot(path, {"use_mock_hardware": "true"}).arguments["use_mock_hardware"] == "true"


def test_a_mistyped_argument_of_the_launch_file_is_refused_with_the_nearest(tmp_path):
    path = make_package(tmp_path)
    first = str(path.parents[1] / "config" / "first")
    with pytest.raises(
        RobotConfigError, match=r"no argument 'mok' of the launch file or of robby.*did you mean 'mock'"
    ):
        find_robot(first, launch=str(path), arguments=["mok:=true"])
    assert find_robot(first, launch=str(path), arguments=["use_mock_hardware:=true"]).arguments == {
        "use_mock_hardware?": "false",
        "use_mock_hardware": "true",
    }


def test_an_argument_without_a_value_is_left_to_xacro(tmp_path):
    path = make_package(
        tmp_path, LAUNCH.replace('"use_mock_hardware:=", mock', '"a:=", LaunchConfiguration("channel")')
    )
    assert launched_robot(path, {}).arguments == {}
    assert launched_robot(path, {"channel": "can0"}).arguments == {"a?": "can0"}


def test_a_robot_is_read_with_what_its_launch_file_gives(tmp_path):
    path = make_package(tmp_path)
    first = str(path.parents[1] / "config" / "first")
    with pytest.raises(RobotConfigError, match="--description"):
        find_robot(first)
    files = find_robot(first, launch=str(path), arguments=["mock:=true"])
    assert files.description.name == "robby.urdf.xacro"
    assert read_robot(files).description.hardware[0].plugin == "mock_components/GenericSystem"
    drives = find_robot(first, launch=str(path))
    assert read_robot(drives).description.hardware[0].plugin == "canopen_ros2_control/RobotSystem"


def test_a_file_of_the_folder_that_the_launch_file_does_not_name_is_reported_with_the_option_for_the_other(tmp_path):
    path = make_package(tmp_path)
    first = path.parents[1] / "config" / "first"
    assert find_robot(str(first), launch=str(path)).not_launched == {}
    named = path.parents[1] / "urdf" / "base" / "robby.urdf.xacro"
    own = first / "other.urdf.xacro"
    own.write_text(named.read_text(encoding="utf-8"), encoding="utf-8")
    files = find_robot(str(first), launch=str(path))
    assert files.not_launched == {"--description": (own, named)}
    warned = [str(finding) for finding in check_robot(files, CheckOptions()).findings if "launch file" in finding.text]
    assert warned == [
        f"{own}: warning: this file of the folder is used; the launch file names {named}; "
        f"give --description {named} to use that one"
    ]
    assert find_robot(str(first), launch=str(path), description=str(named)).not_launched == {}


def test_a_launch_file_may_be_named_by_its_package(tmp_path, monkeypatch):
    path = make_package(tmp_path)
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path))
    assert find_launch("robby_bringup/launch/robby.launch.py") == path
    assert find_launch(str(path)) == path
    files = find_robot("robby_bringup/config/first", launch="robby_bringup/launch/robby.launch.py")
    assert files.description.is_file()
    with pytest.raises(RobotConfigError, match=r"none\.launch\.py: cannot be read"):
        find_robot("robby", launch="robby_bringup/launch/none.launch.py")


def test_a_launch_file_alone_may_name_everything_but_the_bus(tmp_path):
    path = make_package(tmp_path)
    files = find_robot(None, launch=str(path), bus=str(path.parents[1] / "config/first/bus.yml"))
    assert files.controllers.name == "ros2_controllers.yaml"


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ('PACKAGE = "robby_bringup"', "PACKAGE = name()", r"robby\.launch\.py:\d+: a command is computed"),
        ("FindPackageShare(PACKAGE)", 'FindPackageShare("far")', "package 'far' was not found; source its"),
    ],
)
def test_why_a_launch_file_gives_no_description_is_reported(tmp_path, old, new, why):
    path = make_package(tmp_path, LAUNCH.replace(old, new, 1))
    with pytest.raises(RobotConfigError, match=rf"no \*\.urdf\.xacro .*{why}"):
        find_robot(str(path.parents[1] / "config" / "first"), launch=str(path))


def test_one_that_computes_the_names_of_its_files_reports_which(tmp_path):
    launch = tmp_path / "a.launch.py"
    launch.write_text('def generate_launch_description():\n    return open(which() + ".urdf"), f"{which()}.yaml"\n')
    with pytest.raises(
        RobotConfigError, match=r"a\.launch\.py:2: the name of a file that ends in '\.urdf' is computed"
    ):
        find_robot(None, launch=str(launch))
    launch.write_text("def generate_launch_description():\n    return []\n")
    with pytest.raises(RobotConfigError, match=r"--controllers.*a\.launch\.py: it names no file of a robot"):
        find_robot(None, launch=str(launch))


def test_one_that_cannot_be_read_is_a_sentence(tmp_path):
    with pytest.raises(RobotConfigError, match=r"none\.launch\.py: cannot be read: No such file"):
        read_launch(tmp_path / "none.launch.py")
    broken = tmp_path / "x.launch"
    broken.write_text("<launch>")
    with pytest.raises(RobotConfigError, match=r"x\.launch:"):
        read_launch(broken)


def test_a_command_is_split_as_a_shell_does_with_its_substitutions_whole():
    assert words_of("$(find-exec xacro) $(find-pkg-share a)/b.xacro n:='left right' c:=$(var d)") == [
        "xacro", "$(find-pkg-share a)/b.xacro", "n:=left right", "c:=$(var d)"
    ]  # fmt: skip
    assert words_of("$(find $(var p))/a.xacro n:=$(find $(var q))/b c") == [
        "$(find $(var p))/a.xacro", "n:=$(find $(var q))/b", "c"
    ]  # fmt: skip
    assert words_of("a 'b") == ["a", "'b"]


DEVICES = """\
import os
from ament_index_python import get_package_share_directory
SHARE = get_package_share_directory("robby_bringup")
def generate_launch_description():
    return LaunchDescription([IncludeLaunchDescription(
        PythonLaunchDescriptionSource([os.path.join(get_package_share_directory("other"), "launch"), "/x.launch.py"]),
        launch_arguments={"bus_config": os.path.join(SHARE, "config", "first", "bus.yml")}.items(),
    )])
"""


def test_a_launch_file_of_a_bus_alone_is_enough_for_one(tmp_path):
    path = make_package(tmp_path, DEVICES)
    files = find_robot(None, launch=str(path))
    assert files.bus_alone
    assert files.bus == tmp_path / "robby_bringup/config/first/bus.yml"


def test_what_a_bus_alone_does_not_need_may_be_computed(tmp_path):
    computed = DEVICES.replace(".items()", ', "master_bin": found()}.items()').replace("}, ", ", ")
    path = make_package(tmp_path, computed.replace("SHARE =", 'slave = open(which() + "slave.eds")\nSHARE =', 1))
    assert find_robot(None, launch=str(path)).bus_alone


ALL_BY_ARGUMENTS = """\
def launch_setup(context):
    bus_config = PathJoinSubstitution([FindPackageShare(LaunchConfiguration("package")), LaunchConfiguration("bus_file")])
    description = Command([FindExecutable(name="xacro"), " ", PathJoinSubstitution(
        [FindPackageShare(LaunchConfiguration("package")), "urdf/base", LaunchConfiguration("description_file")]
    ), " ", "bus_config:=", bus_config, " "])
    return [Node(package="controller_manager", executable="ros2_control_node", parameters=[
        {"robot_description": description},
        PathJoinSubstitution([FindPackageShare("robby_bringup"), "config/first/ros2_controllers.yaml"]),
    ])]


def generate_launch_description():
    return LaunchDescription([
        DeclareLaunchArgument("package", default_value="robby_bringup"),
        DeclareLaunchArgument("description_file", default_value="robby.urdf.xacro"),
        DeclareLaunchArgument("bus_file", default_value="config/first/bus.yml"),
        OpaqueFunction(function=launch_setup),
    ])
"""  # noqa: E501 - as long as such lines are


def test_packages_and_files_may_be_arguments_and_the_bus_one_of_the_description(tmp_path):
    result = launched_robot(make_package(tmp_path, ALL_BY_ARGUMENTS), {})
    assert result.uncertainties == ()
    assert result.files == {
        "description": tmp_path / "robby_bringup/urdf/base/robby.urdf.xacro",
        "controllers": tmp_path / "robby_bringup/config/first/ros2_controllers.yaml",
        "bus": tmp_path / "robby_bringup/config/first/bus.yml",
    }


ASKING = LAUNCH.replace(
    'DeclareLaunchArgument("channel"),',
    'DeclareLaunchArgument("channel"), DeclareLaunchArgument("use_real_hardware", default_value="false"),\n'
    '        DeclareLaunchArgument("can_interface_name", default_value="vcan0"), DeclareLaunchArgument("gui"),\n'
    '        DeclareLaunchArgument("use_fake_hardware"),',
)


def read(tmp_path, *words, launch=ASKING, **options):
    path = make_package(tmp_path, launch)
    return read_robot(find_robot(str(path.parents[1] / "config/first"), launch=str(path), arguments=words), **options)


@pytest.mark.parametrize("name", ["can_interface_name", "channel"])
def test_an_argument_that_names_a_can_interface_is_the_channel(tmp_path, name):
    setup = read(tmp_path, f"{name}:=can0")
    assert setup.channels == {"can": "can0"}
    assert setup.reaches_real_drives
    assert not setup.real


def test_a_default_that_is_not_given_is_none(tmp_path):
    assert read(tmp_path).channels["can"].startswith("local:")


@pytest.mark.parametrize("word", ["use_real_hardware:=true", "use_real_hardware:=True", "use_real_hardware:=1"])
def test_real_hardware_is_obeyed_and_needs_a_channel(tmp_path, word):
    setup = read(tmp_path, word, "can_interface_name:=can0")
    assert setup.real
    setup.require_places(word)
    with pytest.raises(RobotConfigError, match="where are the drives"):
        read(tmp_path / "b", word).require_places(word)
    assert not read(tmp_path / "c", "use_real_hardware:=false").real


@pytest.mark.parametrize(
    ("words", "options", "why"),
    [
        (["use_real_hardware:=false"], {"real": True}, "contradicts --real"),
        (["use_real_hardware:=true"], {"mock": True}, "contradicts --mock"),
        (["use_real_hardware:=maybe"], {}, "write use_real_hardware:=true"),
        (["can_interface_name:=can0"], {"can": ["vcan0"]}, "contradicts --can vcan0"),
        (["can_interface_name:=can0", "channel:=can1"], {}, "contradict each other"),
        (["use_fake_hardware:=false"], {}, "so it has no effect"),
    ],
)
def test_what_cannot_be_obeyed_is_refused(tmp_path, words, options, why):
    with pytest.raises(RobotConfigError, match=why):
        read(tmp_path, *words, **options)


def test_an_argument_that_reaches_nothing_is_reported(tmp_path):
    reported = [text for _, _, text in read(tmp_path, "gui:=true").notices]
    assert any(text.startswith("gui:=true is used neither") for text in reported)
    assert not any("mock:=false" in text for _, _, text in read(tmp_path / "b", "mock:=false").notices)


# --- as the examples of ros2_control write them: paths by `/`, folders that CMake installs elsewhere, spawners ---

CMAKE = """\
project(rrbot_demo)
install(DIRECTORY description/urdf DESTINATION share/rrbot_demo)
# install(DIRECTORY nowhere/config DESTINATION share/rrbot_demo)
install(
  DIRECTORY bringup/launch bringup/config
  DESTINATION share/${PROJECT_NAME}
)
"""
BY_SLASH = """\
def generate_launch_description():
    share = PathSubstitution(FindPackageShare("rrbot_demo"))
    return LaunchDescription([
        DeclareLaunchArgument("prefix", default_value='""'),
        DeclareLaunchArgument("arm", default_value="forward_position_controller"),
        DeclareLaunchArgument("extra", default_value="false"),
        Node(package="controller_manager", executable="ros2_control_node", parameters=[{"update_rate": 10}]),
        Node(package="robot_state_publisher", executable="robot_state_publisher", parameters=[{
            "robot_description": Command(["xacro", " ", share / "urdf" / "rrbot.urdf.xacro", " ", "prefix:=",
                                          LaunchConfiguration("prefix")])}]),
        Node(package="controller_manager", executable="spawner",
             arguments=["joint_state_broadcaster", "--param-file", share / "config" / "rrbot.yaml"]),
        Node(package="controller_manager", executable="spawner",
             arguments=[LaunchConfiguration("arm"), "-c", "/controller_manager"]),
        Node(package="controller_manager", executable="spawner", arguments=["spare_controller", "--inactive"]),
        Node(package="controller_manager", executable="spawner", arguments=["extra_controller"],
             condition=IfCondition(LaunchConfiguration("extra"))),
    ])
"""
INCLUDES = """\
def launch_setup(context, *args, **kwargs):
    name = LaunchConfiguration("name").perform(context)
    return [IncludeLaunchDescription(
        PythonLaunchDescriptionSource([FindPackageShare(LaunchConfiguration("package")), "/launch/rrbot.launch.py"]),
        launch_arguments={"arm": LaunchConfiguration("which"), "prefix": "left_"}.items(),
    ), IncludeLaunchDescription(PythonLaunchDescriptionSource([FindPackageShare("a_simulator"), "/sim.launch.py"]))]


def generate_launch_description():
    return LaunchDescription([
        DeclareLaunchArgument("package", default_value="rrbot_demo"),
        DeclareLaunchArgument("which", default_value="trajectory_controller"),
        OpaqueFunction(function=launch_setup),
    ])
"""
RRBOT = """\
<robot name="rrbot" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:arg name="prefix" default=""/>
  <xacro:include filename="$(find rrbot_demo)/urdf/links.xacro"/>
  <xacro:links prefix="$(arg prefix)"/>
  <ros2_control name="RRBot" type="actuator">
    <hardware><plugin>mock_components/GenericSystem</plugin></hardware>
    <joint name="$(arg prefix)joint1"><command_interface name="position"/></joint>
  </ros2_control>
  <ros2_control name="RRBotSensor" type="sensor">
    <hardware><plugin>mock_components/GenericSystem</plugin></hardware>
    <joint name="$(arg prefix)joint1"><state_interface name="position"/></joint>
  </ros2_control>
</robot>
"""
LINKS = """\
<robot xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:macro name="links" params="prefix">
    <link name="base"/><link name="arm"/>
    <joint name="${prefix}joint1" type="continuous"><parent link="base"/><child link="arm"/></joint>
  </xacro:macro>
</robot>
"""
CONTROLLERS = """\
controller_manager:
  ros__parameters:
    joint_state_broadcaster: {type: joint_state_broadcaster/JointStateBroadcaster}
    forward_position_controller: {type: forward_command_controller/ForwardCommandController}
    made_elsewhere_controller: {type: my_package/MyController}
forward_position_controller:
  ros__parameters:
    joints: ["$(var prefix)joint1"]
    interface_name: position
"""


@pytest.fixture
def sources(tmp_path):
    """Return the launch folder of a package whose CMake installs folders under other names."""
    package = tmp_path / "example_1"
    files = {
        "package.xml": "<package><name>rrbot_demo</name></package>",
        "CMakeLists.txt": CMAKE,
        "description/urdf/rrbot.urdf.xacro": RRBOT,
        "description/urdf/links.xacro": LINKS,
        "bringup/config/rrbot.yaml": CONTROLLERS,
        "bringup/launch/rrbot.launch.py": BY_SLASH,
        "bringup/launch/two.launch.py": INCLUDES,
    }
    for name, text in files.items():
        (package / name).parent.mkdir(parents=True, exist_ok=True)
        (package / name).write_text(text)
    return package / "bringup" / "launch"


def test_files_are_found_where_sources_have_what_cmake_installs_elsewhere(sources):
    result = launched_robot(sources / "rrbot.launch.py", {})
    package = sources.parents[1]
    assert result.files == {
        "description": package / "description/urdf/rrbot.urdf.xacro",
        "controllers": package / "bringup/config/rrbot.yaml",
    }
    assert result.uncertainties == ()
    assert result.arguments == {"prefix?": ""}  # a shell takes the quotes of '""' away


def test_the_controllers_that_its_spawners_activate_are_those_that_start(sources):
    path = sources / "rrbot.launch.py"
    assert launched_robot(path, {}).spawned == ("joint_state_broadcaster", "forward_position_controller")
    assert launched_robot(path, {"extra": "true", "arm": "other"}).spawned[1:] == ("other", "extra_controller")


def test_a_robot_of_a_launch_file_alone_runs_what_the_file_spawns(sources):
    files = find_robot(None, launch=str(sources / "rrbot.launch.py"))
    setup = read_robot(files, mock=True)
    assert setup.to_activate == ("joint_state_broadcaster", "forward_position_controller")
    assert setup.controllers.warnings == []
    joints = [joint.name for tag in setup.description.hardware for joint in tag.joints]
    assert joints == ["joint1", "joint1"]  # one exports its command, the other its state


def test_included_files_are_followed_with_the_arguments_that_they_are_given(sources):
    result = launched_robot(sources / "two.launch.py", {})
    assert result.spawned == ("joint_state_broadcaster", "trajectory_controller")
    assert result.arguments == {"prefix?": "left_"}
    assert result.uncertainties == ()  # a simulator's own files are nothing of the robot
    assert launched_robot(sources / "two.launch.py", {"which": "other"}).idle == ()


def test_variables_of_a_parameter_file_are_the_arguments_of_the_launch_file(sources):
    files = find_robot(None, launch=str(sources / "two.launch.py"), arguments=["which:=forward_position_controller"])
    setup = read_robot(files, mock=True)
    assert files.variables["prefix"] == "left_"
    assert setup.controllers.warnings == []


def test_an_included_file_that_is_not_there_is_a_doubt_with_its_line(sources):
    path = sources / "lone.launch.py"
    path.write_text(INCLUDES.replace("/launch/rrbot.launch.py", "/launch/gone.launch.py"))
    doubts = launched_robot(path, {}).uncertainties
    assert any(
        f"{path}:3: an included launch file is not read: " in doubt and "does not exist" in doubt for doubt in doubts
    )


def with_parameters(sources, parameters, spawner="", **files):
    """Write parameter files, and name them in the launch file: of the manager, and of a spawner."""
    path = sources / "rrbot.launch.py"
    for name, content in files.items():
        (path.parent / f"{name}.yaml").write_text(content)
    text = path.read_text().replace('[{"update_rate": 10}]', parameters)
    path.write_text(text.replace('"extra_controller"]', f'"forward_position_controller"{spawner}]'))
    return find_robot(None, launch=str(path), arguments=["extra:=true"])


RATE = "controller_manager: {ros__parameters: {update_rate: %s}}"
INTERFACE = "forward_position_controller: {ros__parameters: {interface_name: %s}}"


def test_of_several_parameter_files_the_later_has_precedence_for_each_parameter(sources):
    parameters = '["a.yaml", share / "config" / "rrbot.yaml", {"update_rate": 30}, "b.yaml"]'
    files = with_parameters(sources, parameters, a=RATE % 10 + "\n" + INTERFACE % "effort", b=RATE % 20)
    control = files.read_controllers()
    assert control.update_rate == 20
    assert control.manager_keys["update_rate"].path == str(sources / "b.yaml")
    values = control.controllers["forward_position_controller"].params.flat.value
    assert values == {"interface_name": "position", "joints": ["joint1"]}
    assert control.path.endswith("config/rrbot.yaml")  # it declares the controllers
    assert {path.name for path in files.paths} == {
        "a.yaml",
        "b.yaml",
        "rrbot.yaml",
        "rrbot.launch.py",
        "rrbot.urdf.xacro",
    }


def test_a_parameter_in_the_launch_file_has_its_place_among_the_files(sources):
    files = with_parameters(sources, '[share / "config" / "rrbot.yaml", {"update_rate": 30}]')
    control = files.read_controllers()
    key = control.manager_keys["update_rate"]
    assert (control.update_rate, key.path, key.line) == (30, str(sources / "rrbot.launch.py"), 7)


def test_the_files_of_a_spawner_have_precedence_for_its_controllers_alone(sources):
    rates = "/**: {ros__parameters: {interface_name: velocity}}\n" + RATE % 20
    spawner = ', "--param-file", "a.yaml", "--param-file=b.yaml"'
    parameters = '[share / "config" / "rrbot.yaml"]'
    files = with_parameters(sources, parameters, spawner, a=rates, b=INTERFACE % "effort")
    control = files.read_controllers()
    assert control.update_rate == 100  # the manager does not read them
    assert control.controllers["forward_position_controller"].params.flat.value["interface_name"] == "effort"
    assert "interface_name" not in control.controllers["joint_state_broadcaster"].params.flat.value


def test_errors_of_several_parameter_files_are_reported_together_with_their_places(sources):
    files = with_parameters(
        sources, '["a.yaml", share / "config" / "rrbot.yaml", "b.yaml"]', a=RATE % "fast", b="/**: [1"
    )
    with pytest.raises(RobotConfigError, match=r"b\.yaml:1:\d+: expected ','"):
        files.read_controllers()
    (sources / "b.yaml").write_text("controller_manager: {ros__parameters: {lock_memory: 3}}")
    with pytest.raises(RobotConfigError, match=r"(?s)a\.yaml:1:\d+: .*update_rate.*b\.yaml:1:\d+: .*lock_memory"):
        files.read_controllers()


def test_a_parameter_file_other_than_that_of_the_launch_file_is_read_alone(sources):
    files = with_parameters(sources, '[share / "config" / "rrbot.yaml", {"update_rate": 30}]', other=CONTROLLERS)
    alone = find_robot(None, launch=str(sources / "rrbot.launch.py"), controllers=str(sources / "other.yaml"))
    assert files.parameters
    assert alone.parameters == ()
    assert alone.read_controllers().update_rate == 100


def test_parameters_in_xml_are_those_of_python(sources):
    path = sources / "rates.launch.xml"
    package = sources.parents[1]
    path.write_text(f"""<launch><node pkg="controller_manager" exec="ros2_control_node">
      <param from="{package}/bringup/config/rrbot.yaml"/>
      <param name="update_rate" value="40"/>
      <param name="hardware_components_initial_state"><param name="inactive" value="RRBot"/></param>
      <param name="anything" value="else"/>
    </node></launch>""")
    found = launched_robot(path, {}).parameters
    assert [source.values for source in found] == [
        (),
        (("update_rate", "40", 3),),
        (("hardware_components_initial_state.inactive", "RRBot", 4),),
    ]


def test_a_launch_file_that_names_no_description_reports_this_and_not_that_a_folder_is_missing(sources):
    path = sources / "none.launch.py"
    path.write_text("def generate_launch_description():\n    return LaunchDescription([])\n")
    with pytest.raises(RobotConfigError, match=r"none.launch.py names no description file; give it by --description"):
        find_robot(None, launch=str(path))


def test_files_that_include_each_other_end(sources):
    path = sources / "ring.launch.py"
    path.write_text(INCLUDES.replace("rrbot.launch.py", "ring.launch.py"))
    assert launched_robot(path, {}).spawned == ()


XML_OF_ROS_2 = """\
<launch>
  <arg name="which" default="forward_position_controller"/>
  <arg name="gui" default="true"/>
  <node pkg="controller_manager" exec="ros2_control_node">
    <param from="$(find-pkg-share rrbot_demo)/config/rrbot.yaml"/>
  </node>
  <node pkg="controller_manager" exec="spawner" args="joint_state_broadcaster $(var which) -c /controller_manager"/>
  <node pkg="controller_manager" exec="spawner" args="spare" unless="$(var gui)"/>
  <include file="$(find-pkg-share rrbot_demo)/launch/rrbot.launch.py"><arg name="arm" value="spare"/></include>
</launch>
"""


def test_xml_has_spawners_conditions_and_includes_too(sources):
    path = sources / "rrbot.launch.xml"
    path.write_text(XML_OF_ROS_2)
    result = launched_robot(path, {})
    assert result.spawned == ("joint_state_broadcaster", "forward_position_controller", "spare")
    assert result.files["description"].name == "rrbot.urdf.xacro"


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (["a", "b", "--param-file", "x.yaml"], ["a", "b"]),
        (["-c", "/controller_manager", "a"], ["a"]),
        (["a --controller-ros-args '-r x:=y'"], ["a"]),
        (["a", "--controller-ros-args", "-r /x:=/y"], ["a"]),
        (["a b", "$(var name)"], ["a", "b", "$(var name)"]),
        (["a", "--load-only"], []),
        (["--activate-as-group", "a"], ["a"]),
    ],
)
def test_the_names_in_the_arguments_of_a_spawner(words, names):
    assert spawned_names(words) == names


@pytest.mark.parametrize("option", ['"-t", {}', '"--controller-type", {}', '"--controller-type=" + {}'])
def test_the_type_in_the_arguments_of_a_spawner_is_that_of_its_controllers(sources, option):
    kind = "velocity_controllers/JointGroupVelocityController"
    spawner = ", " + option.format(f'"{kind}"')
    files = with_parameters(sources, '[share / "config" / "rrbot.yaml"]', spawner)
    control = files.read_controllers()
    controller = control.controllers["forward_position_controller"]
    assert (controller.type, controller.params.flat.value["joints"]) == (kind, ["joint1"])
    assert (controller.path, controller.line) == (str(sources / "rrbot.launch.py"), 16)
    assert "joint_state_broadcaster" in control.controllers
    (text,) = [str(item) for item in check_robot(files, CheckOptions(launch=sources / "rrbot.launch.py")).findings
               if "--controller-type" in str(item)]  # fmt: skip
    assert "rrbot.launch.py:16: note: the spawner of ROS 2 Jazzy and later has no option --controller-type" in text
    assert text.endswith(
        "give the type in ros2_controllers.yaml: controller_manager: forward_position_controller: type"
    )
