import pytest

from canopen_control.errors import RobotConfigError
from canopen_control.hardware.driverless_system import SimulatedSystem
from canopen_control.hardware.plugins import (
    KNOWN,
    GenericSystem,
    PluginKind,
    TransmittedSystem,
    busless_component,
    kind_of,
    transmitted,
)
from canopen_control.urdf.description import UrdfDescription
from canopen_control.urdf.document import ElementPlace
from canopen_control.urdf.joint_element import InterfaceInfo, Joint
from canopen_control.urdf.robot_model import RobotModel
from canopen_control.urdf.ros2_control import ControlJoint, Ros2ControlSystem, Transmission

JOINT = ControlJoint("j", {}, {"velocity": InterfaceInfo("velocity")}, {"position": InterfaceInfo("position")})
ROBOT = UrdfDescription("r.urdf", "", RobotModel("r", joints={"j": Joint("j", "continuous", "a", "b")}))


def tag(plugin: str, **how) -> Ros2ControlSystem:
    return Ros2ControlSystem("s", "system", plugin, joints=(JOINT,), place=ElementPlace(7, 3), **how)


@pytest.mark.parametrize(
    ("plugin", "kind"),
    [
        ("canopen_ros2_control/RobotSystem", PluginKind.CANOPEN),
        ("canopen_ros2_control/Cia402System", PluginKind.CANOPEN),
        ("canopen_ros2_control/CanopenSystem", PluginKind.CANOPEN),
        ("canopen_control/CanopenSystem", PluginKind.CANOPEN),
        ("mock_components/GenericSystem", PluginKind.MOCK),
        ("fake_components/GenericSystem", PluginKind.MOCK),
        ("gazebo_ros2_control/GazeboSystem", PluginKind.SIMULATION),
        ("gz_ros2_control/GazeboSimSystem", PluginKind.SIMULATION),
        ("ign_ros2_control/IgnitionSystem", PluginKind.SIMULATION),
    ],
)
def test_the_plugins_of_others_mean_what_users_expect(plugin, kind):
    assert kind_of(ROBOT, tag(plugin)) is kind


def test_mock_and_real_overrule_whatever_is_written():
    for plugin in (*KNOWN, "my_robot/Hardware"):
        assert kind_of(ROBOT, tag(plugin), mock=True) is PluginKind.MOCK
        assert kind_of(ROBOT, tag(plugin), real=True) is PluginKind.CANOPEN


def test_an_unknown_plugin_is_named_with_its_place_and_the_nearest():
    with pytest.raises(
        RobotConfigError, match=r"r\.urdf:7: no hardware plugin 'gz_ros2_control/GazeboSystem' \(did you"
    ):
        kind_of(ROBOT, tag("gz_ros2_control/GazeboSystem"))


def test_a_robot_that_is_mocked_by_option_moves_its_joints():
    mocked = busless_component(ROBOT, tag("canopen_control/CanopenSystem"), PluginKind.MOCK)
    assert isinstance(mocked, GenericSystem)
    mocked.configure()
    mocked.activate()
    mocked.perform_command_mode_switch(["j/velocity"], [])
    mocked.command_interfaces[0].value = 2.0
    mocked.read(0, 0.5)
    assert mocked.state_interfaces[0].value == 1.0
    assert isinstance(
        busless_component(ROBOT, tag("gz_ros2_control/GazeboSimSystem"), PluginKind.SIMULATION), SimulatedSystem
    )


def test_a_transmission_that_changes_nothing_is_not_between():
    component = busless_component(ROBOT, tag("mock_components/GenericSystem"), PluginKind.MOCK)
    assert transmitted(component, tag("x", transmissions=(Transmission("t", "j", "m"),))) is component
    through = transmitted(component, tag("x", transmissions=(Transmission("t", "j", "m", 2.0),)))
    assert isinstance(through, TransmittedSystem)
