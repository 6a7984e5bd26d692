"""`provide()` used by another program: the program of the guide, and invalid requests."""

from __future__ import annotations

import pytest
from support.ros import ROOT, run_ros

pytestmark = pytest.mark.ros
IMPORTS = """
from canopen_control.ros.interfaces import PACKAGES, provide
assert sorted(provide()) == sorted(PACKAGES), "none of them is installed here"
import pickle
from canopen_interfaces.srv import COReadID
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import DynamicJointState
from controller_manager_msgs.srv import SwitchController
from tf2_msgs.msg import TFMessage
from rclpy.serialization import deserialize_message, serialize_message
assert provide() == [], "a second call makes nothing anew"
from tf2_msgs import msg
assert msg.TFMessage is TFMessage and "TFMessage" in dir(msg) + msg.__all__
request = SwitchController.Request(activate_controllers=["a"], strictness=SwitchController.Request.STRICT)
assert deserialize_message(serialize_message(request), SwitchController.Request) == request
assert FollowJointTrajectory.Result.SUCCESSFUL == 0
try:
    from control_msgs.msg import Nonsense
except ImportError as error:
    print(error)
"""


def program():
    """Return the program of the guide."""
    page = (ROOT / "docs/guide/ros2.md").read_text(encoding="utf-8")
    return page.partition("```python\n")[2].partition("```")[0]


def test_the_program_of_the_guide_lists_the_controllers(stage):
    ros = run_ros(program(), stage.domain)
    assert ros.splitlines() == ["joint_state_broadcaster active", "forward active", "base inactive"]


def test_the_packages_are_imported_as_any_other():
    assert "cannot import name 'Nonsense' from 'control_msgs.msg'" in run_ros(IMPORTS)


@pytest.mark.parametrize("requested", ["'nav2_msgs'", "['tf2_msgs', 'nav2_msgs']"])
def test_a_package_that_cannot_be_made_is_refused_by_name(requested):
    code = f"""
import sys
from canopen_control.errors import CanopenError
from canopen_control.ros.interfaces import provide
try:
    provide({requested})
except CanopenError as error:
    print(error)
assert "tf2_msgs" not in sys.modules
"""
    assert run_ros(code).startswith("nav2_msgs cannot be created; install the package (packages that can be created: ")
