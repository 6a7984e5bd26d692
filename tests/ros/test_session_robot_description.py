from __future__ import annotations

import pytest
from support.ros import URDF

pytestmark = pytest.mark.ros


def test_whoever_comes_late_still_gets_the_description(stage):
    stage.peer.order("subscribe", topic="/robot_description", of="std_msgs/msg/String", qos="latched")
    assert stage.peer.message("/robot_description") == {"data": URDF}


def test_it_is_kept_by_a_reliable_publisher(stage):
    publisher = stage.peer.publisher("/robot_description")
    assert (publisher["reliability"], publisher["durability"]) == ("RELIABLE", "TRANSIENT_LOCAL")
    assert publisher["node"] == "canopen_control_bridge"
