"""The bridge as a process: start, end, and the complete path from a topic to the wheels and back."""

from __future__ import annotations

import json
import os
import select
import signal
import statistics
import subprocess
import sys
import time
from contextlib import ExitStack
from itertools import pairwise

import pytest
from support import ros
from support.processes import go_first
from support.robots import copy_robby

from canopen_control.client import RobotClient, find_robots
from canopen_control.host.environment import clean_environment
from canopen_control.host.spawn import spawn
from canopen_control.rpc.messages.robot import Subscribe
from canopen_control.rpc.messages.state import RobotEvent

pytestmark = pytest.mark.ros
COMMANDS, TYPE = "/robby_forward_controller/commands", "std_msgs/msg/Float64MultiArray"


@pytest.fixture
def number():
    with ros.domain() as number:
        yield number


def test_a_foreign_middleware_is_one_sentence_and_exit_code_1(number):
    with ros.bridge(number, RMW_IMPLEMENTATION="rmw_cyclonedds_cpp") as process:
        output, _ = process.communicate(timeout=ros.TIMEOUT)
    assert process.returncode == 1
    assert output.startswith("canopen-control: RMW_IMPLEMENTATION is rmw_cyclonedds_cpp, but")
    assert output.count("\n") == 1


def test_without_a_robot_it_reports_this(number):
    with ros.bridge(number) as process:
        output, _ = process.communicate(timeout=ros.TIMEOUT)
    assert process.returncode == 1
    assert output.startswith("canopen-control: no robot 'fake' is running")


@pytest.mark.timed
@pytest.mark.parametrize(
    ("end", "words"),
    [
        (lambda child, robot: child.cut_lifeline(), ""),
        (lambda child, robot: robot.leave(), "has closed the connection"),
    ],
    ids=["its lifeline is cut", "the robot closes its API"],
)
def test_started_by_a_parent_it_ends_when(number, end, words):
    with ros.FakeRobot() as robot:
        child = start_as_run_does(number)
        try:
            assert ros.eventually(lambda: robot.collected)
            end(child, robot)
            assert child.wait(2.0) == 0
            assert words in "".join(child.last_lines())
        finally:
            child.kill()
            child.wait()


def start_as_run_does(number, **options):
    with pytest.MonkeyPatch.context() as patch:
        for name, value in ros.ros_environment(number).items():
            patch.setenv(name, value)
        command = [sys.executable, "-m", "canopen_control.ros.bridge", "--name", "fake"]
        child = spawn(command, name="ros", ros=True, **options)
    go_first(child.pid)
    return child


@pytest.mark.timed
def test_started_before_its_robot_it_waits_for_the_gate_and_then_shows_it(number):
    child = start_as_run_does(number, gated=True)
    try:
        with ros.Peer(number) as peer:
            peer.order("subscribe", topic="/joint_states", of="sensor_msgs/msg/JointState")
            assert ros.eventually(lambda: "/canopen_control_bridge" in peer.order("graph")["nodes"])
            with ros.FakeRobot() as robot:
                assert not robot.collected
                child.open_gate()
                peer.message("/joint_states")
                child.cut_lifeline()
                assert child.wait(2.0) == 0
    finally:
        child.kill()
        child.wait()


@pytest.mark.parametrize(("is_open", "code", "words"), [(True, 1, "no robot 'fake' is running"), (False, 0, "")])
def test_started_before_a_robot_that_never_comes_it_ends(number, is_open, code, words):
    child = start_as_run_does(number, gated=True)
    try:
        if is_open:
            child.open_gate()
        else:
            child.cut_lifeline()
        assert child.wait(ros.TIMEOUT) == code
        assert words in "".join(child.last_lines())
    finally:
        child.kill()
        child.wait()


@pytest.mark.timed
@pytest.mark.parametrize("number_of_signal", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_it_within_two_seconds(number, number_of_signal):
    with ros.FakeRobot() as robot, ros.bridge(number) as process:
        assert ros.eventually(lambda: robot.collected)
        process.send_signal(number_of_signal)
        assert process.wait(2.0) == 0


def test_started_by_hand_it_waits_for_the_robot_to_return(number):
    with ros.Peer(number) as peer, ExitStack() as stack:
        with ros.FakeRobot():
            process = stack.enter_context(ros.bridge(number))
            peer.order("subscribe", topic="/joint_states", of="sensor_msgs/msg/JointState")
            peer.message("/joint_states")
        with ros.FakeRobot() as robot:
            robot.time = 1_800_000_000.0
            peer.message("/joint_states", lambda message: message["header"]["stamp"]["sec"] == 1_800_000_000)
            assert process.poll() is None


def test_while_it_waits_for_its_robot_a_reason_is_printed_once(number):
    with ExitStack() as stack:
        with ros.FakeRobot() as robot:
            process = stack.enter_context(ros.bridge(number))
            assert ros.eventually(lambda: robot.collected)
        time.sleep(1.8)  # several attempts to connect
        process.terminate()
        output, _ = process.communicate(timeout=ros.TIMEOUT)
    lines = output.splitlines()
    assert len(lines) >= 2
    assert len(lines) == len(set(lines))


def test_a_second_bridge_of_a_robot_is_refused_and_the_first_continues(number):
    with ros.FakeRobot() as robot, ros.bridge(number) as first:
        assert ros.eventually(lambda: robot.collected)
        with ros.bridge(number) as second:
            output, _ = second.communicate(timeout=ros.TIMEOUT)
        assert second.returncode == 1
        assert output == (
            f"canopen-control: fake already has a ROS bridge in domain {number}, process {first.pid}; "
            f"end that bridge first, or set another ROS_DOMAIN_ID for this one\n"
        )
        assert first.poll() is None


def test_use_sim_time_is_reported_with_what_it_does(number):
    with ros.FakeRobot() as robot, ros.bridge(number, "--ros-args", "-p", "use_sim_time:=true") as process:
        assert ros.eventually(lambda: robot.collected)
        process.terminate()
        output, _ = process.communicate(timeout=ros.TIMEOUT)
    assert output.startswith("canopen-control: use_sim_time: stamps are the time on /clock, and 0 until")


def test_parameters_come_from_a_file_and_names_are_remapped(number, tmp_path):
    path = tmp_path / "bridge.yaml"
    path.write_text("/**:\n  ros__parameters: {rate: 20.0, cmd_vel_type: Twist, cmd_vel_topic: drive}\n")
    arguments = ["--ros-args", "--params-file", str(path), "-r", "joint_states:=wheels", "-r", "__ns:=/one"]
    with ros.FakeRobot() as robot, ros.bridge(number, *arguments), ros.Peer(number) as peer:
        assert ros.eventually(
            lambda: "/one/drive" in (topics := peer.order("graph")["topics"]) and "/one/wheels" in topics
        )
        assert robot.commands("subscribe")[0]["state_rate"] == 20.0


def test_a_parameter_that_does_not_fit_is_one_sentence(number):
    with ros.FakeRobot(), ros.bridge(number, "--ros-args", "-p", "cmd_vel_type:=Quaternion") as process:
        output, _ = process.communicate(timeout=ros.TIMEOUT)
    assert process.returncode == 1
    assert output.startswith("canopen-control: parameter cmd_vel_type is 'Quaternion'; give one of auto, Twist")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--ros-args", "--bogus"], "unknown arguments: ['--bogus']"),
        (["--namespace", "9x"], "namespace must not have a token that starts with a number"),
    ],
)
def test_what_ros_does_not_take_is_one_line(number, arguments, words):
    with ros.FakeRobot(), ros.bridge(number, *arguments) as process:
        output, _ = process.communicate(timeout=ros.TIMEOUT)
    assert process.returncode == 1
    assert output.startswith("canopen-control: ROS 2 could not be started: ")
    assert words in output
    assert output.count("\n") == 1


def test_the_frames_of_two_robots_in_one_graph_have_their_namespaces(number):
    with (
        ros.FakeRobot("one") as one,
        ros.bridge(number, "--namespace", "/one", name="one"),
        ros.Peer(number, "--interfaces") as peer,
    ):
        sample = {"kind": "odometry", "time": 1.0, "x": 1.0, "y": 0.0, "heading": 0.0, "linear": 0.0, "angular": 0.0}
        one.samples = {"base": {**sample, "frame_id": "odom", "child_frame_id": "base_link"}}
        peer.order("subscribe", topic="/tf", of="tf2_msgs/msg/TFMessage")
        with ros.FakeRobot("two") as two, ros.bridge(number, "--frame-prefix", "second/", name="two"):
            two.samples = one.samples
            observed = set()

            def both():
                for message in peer.waiting("/tf"):
                    observed.update(
                        (item["header"]["frame_id"], item["child_frame_id"]) for item in message["transforms"]
                    )
                for robot in (one, two):
                    robot.samples["base"]["time"] += 0.01
                return {("one/odom", "one/base_link"), ("second/odom", "second/base_link")} <= observed

            assert ros.eventually(both)


class Robby:
    """`canopen-control run robby --mock --ros` in a process of its own."""

    def __init__(self, number, *arguments, with_ros=True, config="robby", restarts=False):
        environment = ros.ros_environment(number)
        if not restarts:  # the ROS wheels would start it anew, with the libraries of rclpy: its bridge is a fork then
            environment["_ROS_WHEELS_BOOTSTRAP_COMPLETE"] = "1"
        arguments = ["--ros", *arguments] if with_ros else arguments
        command = [sys.executable, "-m", "canopen_control", "run", str(config), "--mock", *arguments]
        self.process = subprocess.Popen(
            command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.terminate()
        self.output, _ = self.process.communicate(timeout=ros.TIMEOUT)

    def bridge_pid(self):
        """Wait for the bridge; its command line is empty for a moment while the ROS wheels start it anew."""
        results = []
        assert ros.eventually(lambda: results.append(self._find_bridge()) or results[-1] is not None)
        return results[-1]

    def _find_bridge(self):
        for pid in filter(str.isdigit, os.listdir("/proc")):
            try:
                with open(f"/proc/{pid}/stat") as stat:
                    parent = stat.read().rpartition(")")[2].split()[1]
                with open(f"/proc/{pid}/cmdline") as line:
                    words = line.read()
            except OSError:
                continue
            if parent == str(self.process.pid) and "canopen_control.ros.bridge" in words:
                return int(pid)
        return None


def test_a_bridge_that_is_a_fork_of_the_run_serves_and_ends_with_it(number):
    with Robby(number, restarts=True) as robby, ros.Peer(number) as peer:
        peer.order("subscribe", topic="/joint_states", of="sensor_msgs/msg/JointState")
        peer.order("publish", topic=COMMANDS, of=TYPE, data={"data": [10.0, 10.0]}, rate=1)
        peer.message("/joint_states", lambda message: message["velocity"] == [10.0, 10.0])
        pid = robby.bridge_pid()
        with open(f"/proc/{pid}/environ") as environment:
            assert "_ROS_WHEELS_BOOTSTRAP_COMPLETE=1" in environment.read()
    assert robby.process.returncode == 0
    assert not os.path.exists(f"/proc/{pid}")


@pytest.mark.parametrize(
    ("sync_ms", "update_rate", "own", "hz"), [(20, 50, 25, 25), (10, 100, 0, 100), (20, 10, 0, 10)]
)
def test_joint_states_come_once_per_update_of_their_broadcaster(number, tmp_path, sync_ms, update_rate, own, hz):
    states = "JointStateBroadcaster\n"
    rates = {"update_rate: 50 ": f"update_rate: {update_rate} ", states: f"{states}      update_rate: {own}\n"}
    cycle = {"sync_period: 20000": f"sync_period: {sync_ms * 1000}"}
    config = copy_robby(tmp_path, bus=cycle, controllers=rates)
    count = max(20, hz // 2)
    with Robby(number, config=config), ros.Peer(number) as peer:
        peer.order("subscribe", topic="/joint_states", of="sensor_msgs/msg/JointState")
        stamps = [peer.message("/joint_states")["header"]["stamp"] for _ in range(count)]
    times = [stamp["sec"] + stamp["nanosec"] / 1e9 for stamp in stamps]
    periods = [later - earlier for earlier, later in pairwise(times)]
    assert statistics.median(periods) == pytest.approx(1 / hz, rel=0.05)
    assert min(periods) > 0.0, "no update is published twice"


def test_the_death_of_the_bridge_is_reported_and_the_robot_continues(number):
    with Robby(number) as robby:
        status = [sys.executable, "-m", "canopen_control", "status", "--json", "--name", "robby"]

        def runs():
            done = subprocess.run(status, env=clean_environment(ros=False), capture_output=True, text=True)
            state = json.loads(done.stdout) if done.returncode == 0 else {"state": "not there"}
            return state if state["state"] == "running" else None

        assert ros.eventually(lambda: runs() is not None)
        os.kill(robby.bridge_pid(), signal.SIGKILL)
        assert ros.eventually(
            lambda: any(item["kind"] == "process_ended" for item in (runs() or {"events": []})["events"])
        )
    assert robby.process.returncode == 0


def test_a_bridge_outlives_the_runtime_and_shows_the_next_one(number):
    with ros.Peer(number) as peer:
        peer.order("subscribe", topic="/joint_states", of="sensor_msgs/msg/JointState")
        peer.order("publish", topic=COMMANDS, of=TYPE, data={"data": [10.0, 10.0]}, rate=10)
        with Robby(number, with_ros=False) as first:
            assert ros.eventually(lambda: "robby" in find_robots())
            with ros.bridge(number, name="robby") as process:
                before = peer.message("/joint_states", lambda message: message["position"][0] > 5.0)
                first.process.kill()
                first.process.wait()
                with Robby(number, with_ros=False):
                    after = peer.message("/joint_states", lambda message: message["position"][0] < 5.0)
                    peer.message("/joint_states", lambda message: message["velocity"] == [10.0, 10.0])
                    assert after["header"]["stamp"]["sec"] >= before["header"]["stamp"]["sec"]
                    assert process.poll() is None


@pytest.mark.timed
def test_the_death_of_the_runtime_ends_the_bridge(number):
    with Robby(number) as robby:
        pidfd = os.pidfd_open(robby.bridge_pid())
        robby.process.kill()
        try:
            assert select.select([pidfd], [], [], 5.0)[0], "the bridge still runs"
        finally:
            os.close(pidfd)


def test_the_wheels_stop_with_a_killed_bridge_at_once_and_another_one_is_started(number, tmp_path):
    """Without a time-out in the YAML, while a publisher goes on."""
    config = copy_robby(tmp_path, controllers={"    command_timeout: 2.0 ": "    # "})
    with Robby(number, config=config) as robby, ros.Peer(number) as peer:
        first = robby.bridge_pid()
        peer.order("subscribe", topic="/joint_states", of="sensor_msgs/msg/JointState")
        peer.order("publish", topic=COMMANDS, of=TYPE, data={"data": [10.0, 10.0]}, rate=10)
        peer.message("/joint_states", lambda message: message["velocity"] == [10.0, 10.0])
        with RobotClient.connect("robby") as client:
            client.ask(Subscribe(state_rate=50, events=True))
            os.kill(first, signal.SIGKILL)
            kinds, stood = [], False
            for message in client.messages(10.0):
                if isinstance(message, RobotEvent):
                    kinds.append(message.kind)
                elif "commander_gone" in kinds:
                    stood = all(joint.command == 0.0 for joint in message.joints.values())
                    break
            assert stood
            assert kinds[0] in ("commander_gone", "process_ended")
        peer.waiting("/joint_states")
        peer.message("/joint_states", lambda message: message["velocity"] == [10.0, 10.0])
        assert robby.bridge_pid() != first
    assert "ros is gone, so its command has ended" in robby.output
    assert "process ros: it is restarted (1 of 3 times a minute)" in robby.output
