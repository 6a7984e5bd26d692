from __future__ import annotations

import pytest
from support.control import FORWARD, S, add, manager, wheels

from canopen_control.controllers.gpio_command import CanopenProxyController, Cia402DeviceController
from canopen_control.errors import RobotConfigError

TYPES = {
    "canopen_ros2_controllers/CanopenProxyController": CanopenProxyController,
    "canopen_ros2_controllers/Cia402DeviceController": Cia402DeviceController,
}


@pytest.mark.parametrize("type_name", TYPES)
def test_it_stands_alongside_the_controller_that_moves_its_joint_and_claims_nothing(type_name):
    control = manager(wheels())
    add(control, "wheels", FORWARD, joints=["l", "r"], interface_name="velocity")
    device = add(control, "device", type_name, joint="l")
    assert type(device) is TYPES[type_name]
    control.switch(["wheels", "device"], now=0)
    control.update(S, 0.01)
    reading = control.list()[1]
    assert (reading.state, reading.joints, reading.claims, reading.topic, reading.tells) == (
        "active",
        ("l",),
        (),
        None,
        None,
    )
    assert not device.moves_joints


@pytest.mark.parametrize("type_name", TYPES)
def test_without_a_joint_it_reports_where_to_give_one(type_name):
    with pytest.raises(RobotConfigError, match="device: no 'joint'; give it under device: ros__parameters: joint:"):
        add(manager(wheels()), "device", type_name)
