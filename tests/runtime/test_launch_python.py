"""Launch files in Python, read by their syntax: declarations, nodes, names and computed values."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.launch_files import LAUNCH

from canopen_control.errors import RobotConfigError
from canopen_control.runtime.launch_python import read_python


def texts(source):
    return [item.text for item in read_python(source, "x.launch.py").texts]


def arguments(source):
    return read_python(source, "x.launch.py").arguments


def computed(source):
    return read_python(source, "x.launch.py").computed


def test_arguments_have_their_defaults_and_lines():
    python = read_python(LAUNCH, "x.launch.py")
    assert python.generates
    assert python.arguments == {"mock": "false", "channel": None}
    assert LAUNCH.splitlines()[python.argument_lines["mock"] - 1].strip().startswith('DeclareLaunchArgument("mock"')


def test_a_command_is_one_text_with_packages_and_arguments_left_in():
    assert texts(LAUNCH) == [
        "xacro $(find robby_bringup)/urdf/base/robby.urdf.xacro use_mock_hardware:=$(var mock)",
        "$(find robby_bringup)/config/first/ros2_controllers.yaml",
    ]


def test_nodes_have_package_executable_plugin_and_arguments():
    nodes = read_python(LAUNCH, "x.launch.py").nodes
    assert [(node.package, node.plugin or node.executable) for node in nodes] == [
        ("controller_manager", "ros2_control_node"),
        ("controller_manager", "spawner"),
        ("controller_manager", "spawner"),
        ("rclcpp_components", "component_container"),
        ("usb_cam", "usb_cam::UsbCamNode"),
    ]
    assert [argument.text for argument in nodes[1].arguments] == [
        "joint_state_broadcaster",
        "--controller-manager",
        "/controller_manager",
    ]


@pytest.mark.parametrize(
    ("expression", "text"),
    [
        ('"a" + "/b.yaml"', "a/b.yaml"),
        ('Path("a") / "b.yaml"', "a/b.yaml"),
        ('f"{WHERE}/b.yaml"', "here/b.yaml"),
        ('os.path.join(WHERE, "b.yaml")', "here/b.yaml"),
        ('PathJoinSubstitution([FindPackageShare(package="p"), "b.yaml"])', "$(find p)/b.yaml"),
        ('[LaunchConfiguration("where"), "/b.yaml"]', "$(var where)/b.yaml"),
        ('ParameterValue("b.yaml", value_type=str)', "b.yaml"),
        ('LaunchConfiguration("where").perform(context) + "/b.yaml"', "$(var where)/b.yaml"),
    ],
)
def test_a_text_is_followed_through_what_launch_files_write(expression, text):
    assert texts(f'WHERE = "here"\nx({expression})\n') == [text]


def test_a_xacro_that_the_file_processes_itself_is_the_same_command():
    source = (
        'import xacro\nGIVEN = {"prefix": "left right", "mock": LaunchConfiguration("mock"), "side": f()}\n'
        'doc = xacro.process_file(os.path.join(get_package_share_directory("p"), "a.urdf.xacro"), mappings=GIVEN)\n'
    )
    assert texts(source) == ["xacro $(find p)/a.urdf.xacro prefix:='left right' mock:=$(var mock)"]
    assert computed(source) == [(2, "an argument of xacro")]
    assert texts('xacro.process_file(f() + "a.xacro")') == []
    assert computed('xacro.process_file(f() + "a.xacro")') == [(1, "the name of a file that ends in 'a.xacro'")]


@pytest.mark.parametrize(
    ("expression", "text"),
    [
        ('MoveItConfigsBuilder("arm").to_moveit_configs()', "xacro $(find arm_moveit_config)/config/arm.urdf.xacro"),
        ('MoveItConfigsBuilder("arm", package_name="p")', "xacro $(find p)/config/arm.urdf.xacro"),
        ('MoveItConfigsBuilder("arm", "robot_description", "p").a()', "xacro $(find p)/config/arm.urdf.xacro"),
        (
            'MoveItConfigsBuilder("arm", package_name="p").robot_description("urdf/a.urdf").b(f())',
            "xacro $(find p)/urdf/a.urdf",
        ),
        (
            'MoveItConfigsBuilder("arm").robot_description(file_path=FindPackageShare("d") + "/a.urdf.xacro",'
            ' mappings={"can": LaunchConfiguration("can"), "side": f()}).c()',
            "xacro $(find d)/a.urdf.xacro can:=$(var can)",
        ),
    ],
)
def test_the_description_of_a_moveit_configuration_is_the_same_command(expression, text):
    assert texts(f"config = (\n    {expression}\n)\n") == [text]


def test_the_demo_of_a_moveit_configuration_takes_the_controllers_of_its_package():
    source = (
        'config = MoveItConfigsBuilder("arm", package_name="p").to_moveit_configs()\ngenerate_demo_launch(config)\n'
    )
    assert texts(source) == ["xacro $(find p)/config/arm.urdf.xacro", "$(find p)/config/ros2_controllers.yaml"]
    assert texts("generate_demo_launch(f())\n") == []


def test_a_moveit_configuration_with_a_computed_name_is_reported_with_its_line():
    assert computed("MoveItConfigsBuilder(f())\n") == [(1, "the description of MoveItConfigsBuilder")]


@pytest.mark.parametrize(
    "expression", ['glob("*.yaml")[0]', 'open("x").read() + ".yaml"', 'TWICE + "/b.yaml"', 'given + "/b.yaml"']
)
def test_what_is_computed_is_not_a_text(expression):
    source = f'TWICE = "a"\nTWICE = "b"\ndef f(given):\n    x({expression})\n'
    assert not any(text in ("a/b.yaml", "b/b.yaml") for text in texts(source))
    assert all(text in ("*.yaml", ".yaml", "/b.yaml") for text in texts(source))


def test_names_that_are_computed_are_reported_with_their_lines():
    assert computed("DeclareLaunchArgument(name())\n") == [(1, "the name of an argument")]
    assert computed('DeclareLaunchArgument("a", default_value=f())\n') == [(1, "the default of the argument 'a'")]
    assert computed("Node(package=f(),\n     arguments=[g()])\n") == [
        (2, "an argument of a node"),
        (1, "the package of a node"),
    ]
    assert computed('Command(["xacro ", f()])\n') == [(1, "a command")]


@pytest.mark.parametrize(
    ("expression", "ending"),
    [
        ('f() + ".urdf"', ".urdf"),
        ('f"{f()}_controllers.yaml"', "_controllers.yaml"),
        ('os.path.join(here(), "..", "config", f"{which}.yaml")', ".yaml"),
        ('here() / "config/bus.yml"', "bus.yml"),
        ('"a" % f()', ""),
        ('f() + "text"', ""),
        ('f""', ""),
    ],
)
def test_a_file_whose_name_is_put_together_is_reported_by_its_end_and_never_guessed(expression, ending):
    python = read_python(f"f()\nx = [{expression}]\n", "x.launch.py")
    assert python.computed == ([(2, f"the name of a file that ends in {ending!r}")] if ending else [])
    assert python.texts == []


def test_names_that_stand_for_each_other_end():
    source = 'A = B\nB = A\nx(A + ".yaml")\n'
    assert (texts(source), computed(source)) == ([], [(3, "the name of a file that ends in '.yaml'")])


def test_names_that_double_each_other_end_too():
    lines = [f"A{n} = A{n - 1} + A{n - 1}\n" for n in range(1, 39)]
    assert texts("".join(['A0 = "ab"\n', *lines, 'x(A38 + ".yaml")\n'])) == []
    assert texts("".join(['A0 = "ab"\n', *lines, 'x(A2 + ".yaml")\n'])) == ["abababab.yaml"]


@pytest.mark.parametrize(("source", "line"), [("def f(:\n", 1), ("x = 1\n  y = 2\n", 2), ("a\0b", 1)])
def test_what_is_not_a_python_reports_where(source, line):
    with pytest.raises(RobotConfigError, match=rf"x\.launch\.py:{line}: not valid Python: "):
        read_python(source, "x.launch.py")


def test_nothing_in_a_file_is_run(tmp_path):
    gone = tmp_path / "gone"
    read_python(f"import os\nos.mkdir({str(gone)!r})\nopen({str(gone)!r}, 'w')\n", "x.launch.py")
    assert not gone.exists()


@given(st.lists(st.sampled_from([*LAUNCH.splitlines(keepends=True), "(\n", "x = [\n", "]\n", '"""\n']), max_size=30))
def test_whatever_the_file_it_is_read_or_refused_in_a_sentence(lines):
    refusal = "x.launch.py:"
    try:
        read_python("".join(lines), "x.launch.py")
    except RobotConfigError as error:
        refusal = str(error)
    assert refusal.startswith("x.launch.py:")


def test_a_parameter_file_that_nav2_edits_is_that_file_and_what_it_replaces_is_known():
    source = """
config = PathJoinSubstitution([FindPackageShare("bot"), "config", "controllers.yaml"])
config = ReplaceString(source_file=config, replacements={"__namespace__/": (LaunchConfiguration("ns"), "/")})
def generate_launch_description():
    node = Node(package="controller_manager", executable="ros2_control_node", parameters=[config])
    return LaunchDescription([GroupAction(actions=[PushROSNamespace(LaunchConfiguration("ns")), node])])
"""
    launch = read_python(source, "x.launch.py")
    assert [file.text for file in launch.nodes[0].parameters] == ["$(find bot)/config/controllers.yaml"]
    assert launch.replaced == {"__namespace__/": "$(var ns)/"}
    assert launch.pushed == ["$(var ns)"]


@pytest.mark.parametrize(
    ("listed", "started"),
    [
        ("first, second, later, more", ["first", "second", "third", "fourth"]),
        ("first", ["first"]),
        ("first, later", ["first", "third"]),
        ("first, more", ["first", "fourth"]),
        ("", []),
    ],
)
def test_an_action_that_nothing_reads_is_not_started(listed, started):  # as in ros2_canopen's robot_control_setup
    def spawner(name):
        return f"Node(package='controller_manager', executable='spawner', arguments=['{name}'])"

    source = f"""
def generate_launch_description():
    first = {spawner("first")}
    second = {spawner("second")}
    third = {spawner("third")}
    later = RegisterEventHandler(OnProcessExit(target_action=first, on_exit=[third]))
    more = GroupAction([{spawner("fourth")}])
    return LaunchDescription([{listed}])
"""
    nodes = read_python(source, "x.launch.py").nodes
    assert sorted(node.arguments[0].text for node in nodes) == sorted(started)


def test_actions_that_are_added_one_by_one_are_started():
    source = "node = Node(package='a', executable='b')\nld = LaunchDescription()\nld.add_action(node)\n"
    assert len(read_python(source, "x.launch.py").nodes) == 1
