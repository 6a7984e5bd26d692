"""By default nothing of a robot leaves this host: a separate network, with a listener at its exit."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from support import ros

ALONE = Path(__file__).parents[1] / "support/alone.py"
PROGRAM = [sys.executable, "-m", "canopen_control"]


def missing():
    """Return why no network of one's own can be had here, None when it can."""
    if shutil.which("unshare") is None or shutil.which("ip") is None:
        return "unshare and ip are needed: apt install util-linux iproute2"
    if subprocess.run(["unshare", "--net", "true"], capture_output=True).returncode:
        return "a network of its own needs root"
    return None


pytestmark = [pytest.mark.ros, pytest.mark.skipif(missing() is not None, reason=str(missing()))]


def outcome(**setting):
    """Run a robot and who hears it in a network of their own; return what left it and what was heard."""
    environment = ros.ros_environment(0)
    for name in ("ROS_AUTOMATIC_DISCOVERY_RANGE", "FASTRTPS_DEFAULT_PROFILES_FILE", "ROS_DOMAIN_ID"):
        environment.pop(name)
    programs = [
        [*PROGRAM, "run", "robby", "--mock", "--ros"],
        [*PROGRAM, "ros", "topic", "echo", "/joint_states", "--once", "--timeout", "30", "--for", "30"],
        [*PROGRAM, "ros", "service", "call", "/controller_manager/list_controllers",
         "controller_manager_msgs/srv/ListControllers", "--timeout", "30"],
    ]  # fmt: skip
    command = ["unshare", "--net", sys.executable, str(ALONE), *map(json.dumps, programs)]
    done = subprocess.run(command, env={**environment, **setting}, capture_output=True, text=True, timeout=110)
    assert done.returncode == 0, done.stdout + done.stderr
    reported = json.loads(done.stdout)
    received = "left_wheel_joint" in reported["said"][0] and "robby_forward_controller" in reported["said"][1]
    assert received, reported
    return reported["packets"]


def test_with_the_variables_as_we_set_them_no_packet_leaves_the_loopback_interface():
    assert outcome() == 0


def test_the_subnet_setting_shows_packets_so_that_the_listener_is_not_deaf():
    assert outcome(ROS_AUTOMATIC_DISCOVERY_RANGE="SUBNET") > 0


def test_the_older_variable_keeps_them_here_too():
    assert outcome(ROS_LOCALHOST_ONLY="1") == 0
