import pytest
from support.arm import ARM

from canopen_control.errors import RobotConfigError
from canopen_control.urdf.description import parse_description
from canopen_control.urdf.joint_element import Mimic

ROBOT = """\
<robot name="base">
  <link name="base"/><link name="wheel"/>
  <joint name="wheel_joint" type="continuous"><parent link="base"/><child link="wheel"/></joint>
  {}
</robot>
"""
ROS1 = """
  <transmission name="wheel_trans">
    <type>transmission_interface/SimpleTransmission</type>
    <joint name="wheel_joint"><hardwareInterface>hardware_interface/VelocityJointInterface</hardwareInterface></joint>
    <actuator name="wheel_motor"><mechanicalReduction>30</mechanicalReduction></actuator>
  </transmission>"""
ROS2 = """
  <ros2_control name="base" type="system">
    <hardware><plugin>canopen_control/CanopenSystem</plugin></hardware>
    <joint name="wheel_joint"><command_interface name="velocity"/></joint>
    <transmission name="t">
      <plugin>transmission_interface/SimpleTransmission</plugin>
      <actuator name="motor" role="actuator1"/>
      <joint name="wheel_joint" role="joint1">
        <mechanical_reduction>-2.5</mechanical_reduction><offset>0.5</offset>
      </joint>
    </transmission>
  </ros2_control>"""


def test_a_ros_1_transmission_reports_what_a_ros2_control_tag_would():
    robot = parse_description(ROBOT.format(ROS1), "b.urdf")
    assert robot.ros1
    (tag,) = robot.hardware
    assert tag.plugin == "canopen_control/CanopenSystem"
    (joint,) = tag.joints
    assert (joint.name, joint.parameters) == ("wheel_joint", {"device_name": "wheel_motor"})
    assert list(joint.command_interfaces) == ["velocity"]
    assert tag.transmissions[0].reduction == 30.0
    assert robot.notes == (
        "b.urdf:5: wheel_joint turns once for 30 turns of wheel_motor; the scales of bus.yml apply to the motor shaft",
    )


def test_gazebos_ros_1_plugin_makes_it_a_simulation():
    plugin = '<gazebo><plugin name="c" filename="libgazebo_ros_control.so"/></gazebo>'
    assert parse_description(ROBOT.format(ROS1 + plugin)).hardware[0].plugin == "gazebo_ros_control/DefaultRobotHWSim"


def test_ros2_controls_own_spelling_is_read_and_ros_1s_next_to_it_has_no_effect():
    robot = parse_description(ROBOT.format(ROS2 + ROS1), "b.urdf")
    assert not robot.ros1
    (transmission,) = robot.hardware[0].transmissions
    assert (transmission.reduction, transmission.offset) == (-2.5, 0.5)
    assert any("wheel_trans is from ROS 1 and has no effect" in note for note in robot.notes)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("SimpleTransmission", "DifferentialTransmission", "its type is 'transmission_interface/Differ.*Simple"),
        ("VelocityJointInterface", "VelocityJointInterfac", "did you mean 'VelocityJointInterface'"),
        (">30<", ">many<", "'many' of <mechanicalReduction> is not a number"),
        (">30<", ">0<", "<mechanicalReduction> is 0"),
        ('joint name="wheel_joint"><hard', 'joint name="weel_joint"><hard', "did you mean 'wheel_joint'"),
    ],
)
def test_errors_are_reported_with_their_line(old, new, message):
    with pytest.raises(RobotConfigError, match=r"b\.urdf:\d+:\d+: .*" + message):
        parse_description(ROBOT.format(ROS1.replace(old, new)), "b.urdf")


def test_a_joint_has_one_transmission():
    twice = ROS1 + ROS1.replace("wheel_trans", "other")
    with pytest.raises(RobotConfigError, match="wheel_joint has two transmissions: wheel_trans, other"):
        parse_description(ROBOT.format(twice))


def test_the_ros2_control_tag_is_read_with_its_parameters():
    (system,) = parse_description(ARM).hardware
    assert (system.name, system.kind, system.plugin) == ("arm", "system", "canopen_ros2_control/RobotSystem")
    assert (system.parameters, system.place.line) == ({"bus_config": "x.yml"}, 18)
    shoulder, grip2 = system.joints
    assert shoulder.parameters == {"device_name": "drive"}
    position = shoulder.command_interfaces["position"]
    assert (position.minimum, position.maximum, position.initial_value) == (-1.5, 1.5, 0.25)
    assert list(shoulder.state_interfaces) == ["position"]
    assert grip2.mimic == Mimic("grip", -1.0, 0.5)
    assert (system.sensors[0].name, list(system.gpios[0].command_interfaces)) == ("force", ["out"])


def test_a_plugin_and_a_parameter_given_twice_are_notes_and_the_value_of_ros2_control_applies():
    description = parse_description(
        """<robot name="r"><link name="a"/><link name="b"/>
  <joint name="j" type="continuous"><parent link="a"/><child link="b"/></joint>
  <ros2_control name="s" type="system">
    <hardware><plugin>a/A</plugin>
      <plugin>b/B</plugin>
      <param name="p">1</param>
      <param name="p">2</param></hardware>
    <joint name="j"><param name="device_name">x</param>
      <param name="device_name">y</param></joint>
  </ros2_control></robot>""",
        "r.urdf",
    )
    (tag,) = description.hardware
    assert (tag.plugin, tag.parameters, tag.joints[0].parameters) == ("a/A", {"p": "2"}, {"device_name": "y"})
    assert description.notes == (
        "r.urdf:5: <ros2_control name='s'>: plugin is given twice, and 'a/A' applies; remove the other",
        "r.urdf:7: <ros2_control name='s'>: param 'p' is given twice, and '2' applies; remove the other",
        "r.urdf:9: <joint name='j'>: param 'device_name' is given twice, and 'y' applies; remove the other",
    )


@pytest.mark.parametrize(("text", "node_id"), [("2", "2"), ("02", "2"), (" 2 ", "2"), ("0x0A", "10"), ("left", "left")])
def test_a_node_id_is_a_number_in_any_notation(text, node_id):
    """Cia402System of ros2_canopen reads it with std::stoi."""
    tag = ROS2.replace(
        '<joint name="wheel_joint"><', f'<joint name="wheel_joint"><param name="node_id">{text}</param><'
    )
    (joint,) = parse_description(ROBOT.format(tag)).hardware[0].joints
    assert joint.parameters == {"node_id": node_id}
