"""Set-points of an arm on the CAN of a real kernel while its machine is busy: as evenly as the kernel sends SYNC.

What was on the wire, by the kernel's own times, is given to a drive that takes each SYNC as the exact time; how
unevenly it moves is compared with the same set-points on SYNCs that come in time.
"""

import itertools
import statistics
import subprocess
import sys
import time

import pytest
from canopen_control_bench.arm import CONTROLLER, ENDS, JOINTS, NODES, arm_at, edit, planned
from support.guest import SYNC
from support.setpoints import evenly, replay

from canopen_control.client import RobotClient
from canopen_control.rpc.messages.samples import TrajectoryPoint
from canopen_control.rpc.messages.trajectory import SendTrajectory
from canopen_control.virtual.device_model import PLAIN

pytestmark = pytest.mark.socketcan
HERTZ, SECONDS = 25, 3.0  # six drives and their master share the guest's one processor
PERIOD = 1 / HERTZ
BUSY = f"""
import random, time
while True:
    end = time.monotonic() + {0.2 * PERIOD} * random.random()
    while time.monotonic() < end:
        pass
    time.sleep({0.6 * PERIOD} * random.random())
"""


def follow(client, seconds):
    """Let the arm follow a trajectory to the end."""
    plan = planned([0.0] * 6, [0.3 * each for each in ENDS], seconds, round(20 * seconds))
    points = [
        TrajectoryPoint(
            positions=list(each.positions),
            velocities=list(each.velocities),
            accelerations=list(each.accelerations),
            time_from_start=each.time / 1e9,
        )
        for each in plan.points
    ]
    verdict = client.ask(SendTrajectory(controller=CONTROLLER, joints=JOINTS, points=client.send_points(points)))
    assert verdict.accepted, verdict
    time.sleep(seconds + 0.2)


def test_the_kernels_sync_is_the_default_of_an_arm_and_a_busy_machine_is_not_heard(stage, vcan, listen, tmp_path):
    config = arm_at(tmp_path, HERTZ)
    edit(config / "bus.yml", {"heartbeat_multiplier: 5 ": "heartbeat_multiplier: 50 "})
    hears = listen(vcan, SYNC, *(0x200 + node for node in NODES))
    robot = stage.start("run", config, "--name", "smooth", "--can", vcan, "--no-flight-recorder")
    robot.until("smooth runs", 60)
    assert "SYNC is sent by the kernel, and the cycle follows it: joint_1, joint_2, joint_3 and 3 more" in robot.out
    with RobotClient.connect("smooth") as client, subprocess.Popen([sys.executable, "-c", BUSY]) as busy:
        since = time.time()
        try:
            follow(client, SECONDS)
        finally:
            busy.kill()
    frames = [each for each in hears.frames if each[0] > since - PERIOD]
    assert robot.end() == 0, robot
    syncs = [when for when, identifier, _ in frames if identifier == SYNC]
    gaps = sorted(after - before for before, after in itertools.pairwise(syncs))
    assert statistics.median(gaps) == pytest.approx(PERIOD, rel=0.01)
    assert gaps[len(gaps) * 3 // 4] < 1.1 * PERIOD, "the guest itself may be held up at times"
    for node in NODES:
        told = replay(frames, node, PERIOD, PLAIN)
        ideal = replay(evenly(frames, PERIOD), node, PERIOD, PLAIN)
        assert told.acceleration_ripple < 3 * ideal.acceleration_ripple, "10 where the process sends SYNC"
        assert told.missed + told.doubled + told.overwritten < 0.3 * len(syncs), "it is held up itself"
