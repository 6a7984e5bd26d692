"""ROS launch files in YAML: the same elements as those of the file in XML."""

import textwrap

import pytest

from canopen_control.errors import RobotConfigError
from canopen_control.runtime.launch_file import launched_robot, read_launch, read_yaml_launch

FILE = """\
    launch:
      - arg:
          name: side
          default: left
      - let: {name: gain, value: 2}
      - node:
          pkg: controller_manager
          exec: ros2_control_node
          param:
            - from: $(dirname)/controllers.yaml
            - {name: robot_description, value: $(command 'xacro $(dirname)/robot.urdf.xacro side:=$(var side)')}
      - group:
          - push_ros_namespace: {namespace: arm}
          - node: {pkg: controller_manager, exec: spawner, args: one two, unless: $(var fast)}
      - group:
          if: $(var fast)
          children:
            - node: {pkg: controller_manager, exec: spawner, args: three}
      - include:
          file: other.launch.yaml
          arg:
            - {name: side, value: right}
"""


def text(source=FILE):
    return textwrap.dedent(source)


def test_entities_are_elements_with_their_lines():
    root = read_yaml_launch(text(), "x.launch.yaml")
    assert [child.tag for child in root.children] == ["arg", "let", "node", "group", "group", "include"]
    assert root.children[0].attributes == {"name": "side", "default": "left"}
    assert root.children[1].attributes == {"name": "gain", "value": "2"}
    assert [child.attributes.get("name") for child in root.children[2].children] == [None, "robot_description"]
    assert [child.tag for child in root.children[3].children] == ["push_ros_namespace", "node"]
    assert root.children[4].attributes == {"if": "$(var fast)"}
    assert root.children[4].children[0].attributes["args"] == "three"
    assert root.children[2].place.line == 7


def test_a_file_is_read_as_that_in_xml(tmp_path):
    path = tmp_path / "x.launch.yaml"
    path.write_text(text())
    launch = read_launch(path)
    assert launch.arguments == {"side": "left", "gain": "2"}
    assert [(node.executable, [word.text for word in node.arguments]) for node in launch.nodes] == [
        ("ros2_control_node", []),
        ("spawner", ["one", "two"]),
        ("spawner", ["three"]),
    ]
    assert launch.nodes[1].condition.negated
    assert [(include.file, include.arguments) for include in launch.includes] == [
        ("other.launch.yaml", {"side": "right"})
    ]
    assert any("robot.urdf.xacro side:=$(var side)" in item.text for item in launch.texts)


def test_a_robot_is_launched_by_it(tmp_path):
    (tmp_path / "bus.yml").write_text("")
    path = tmp_path / "x.launch.yaml"
    path.write_text(
        text("""\
    launch:
      - arg: {name: config, default: bus.yml}
      - node: {pkg: controller_manager, exec: spawner, args: "arm_controller -c /controller_manager"}
      - include: {file: there_is_none.launch.yaml}
    """)
    )
    launched = launched_robot(path, {})
    assert launched.spawned == ("arm_controller",)
    assert launched.known == ("config",)
    assert any("there_is_none.launch.yaml" in text for text in launched.uncertainties)


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("controller_manager:\n  ros__parameters: {}\n", "the key `launch` has no list"),
        ("launch: {}\n", "the key `launch` has no list"),
        ("launch: [\n", "x.launch.yaml:2:1"),
        ("", "the key `launch` has no list"),
    ],
)
def test_another_file_is_refused(source, words):
    with pytest.raises(RobotConfigError, match=words):
        read_yaml_launch(source, "x.launch.yaml")
