"""The default SYNC producer for an arm on the CAN of a real kernel is the kernel."""

import pytest
from canopen_control_bench.arm import arm_at, edit

from canopen_control.client import RobotClient
from canopen_control.rpc.messages.robot import GetStatus

pytestmark = pytest.mark.socketcan


def test_the_kernels_sync_is_the_default_of_an_arm(stage, vcan, tmp_path):
    config = arm_at(tmp_path, 10)
    edit(config / "bus.yml", {"heartbeat_multiplier: 5 ": "heartbeat_multiplier: 50 "})
    robot = stage.start("run", config, "--as", "smooth", "--can", vcan, "--no-flight-recorder")
    robot.until("smooth runs", 60)
    assert "SYNC is sent by the kernel, and the cycle follows it: joint_1, joint_2, joint_3 and 3 more" in robot.out
    with RobotClient.connect("smooth") as client:
        (bus,) = client.ask(GetStatus()).buses.values()
        assert bus.sync == "SYNC every 100 ms by the kernel, the cycle follows an eighth of a period after it"
    assert robot.end() == 0, robot
