import pytest

from canopen_control.errors import RobotConfigError
from canopen_control.urdf.document import read_document
from canopen_control.urdf.joint_element import read_interfaces

JOINT = """<joint name="j">
<command_interface name="velocity"><param name="min">-2</param><param name="max">3</param></command_interface>
<command_interface name="effort"><limits enable="false"/></command_interface>
<state_interface name="position"><param name="initial_value">0.5</param></state_interface>{}</joint>"""


def read(tag, more=""):
    document = read_document(JOINT.format(more), "r.urdf")
    interfaces = read_interfaces(document, document.root, tag)
    document.raise_if_any()
    return interfaces


def test_bounds_initial_values_and_switched_off_limits():
    commands = read("command_interface")
    assert list(commands) == ["velocity", "effort"]
    assert (commands["velocity"].minimum, commands["velocity"].maximum, commands["velocity"].limited) == (-2, 3, True)
    assert not commands["effort"].limited
    assert read("state_interface")["position"].initial_value == 0.5
    assert not read("command_interface", "<limits enable=' FALSE '/>")["velocity"].limited


def test_an_interface_given_twice_is_an_error():
    with pytest.raises(RobotConfigError, match=r"r\.urdf:4:\d+: j: state_interface 'position' is defined twice"):
        read("state_interface", '<state_interface name="position"/>')
