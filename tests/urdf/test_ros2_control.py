from support.arm import ARM

from canopen_control.urdf.description import parse_description
from canopen_control.urdf.joint_element import Mimic


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
