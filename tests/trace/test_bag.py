"""A bag is read back: by rosbags here, by rclpy's own messages where there is a ROS."""

import builtins
import json
import math
import os
import subprocess
import sys

import pytest
from support.apiclient import Client
from support.robots import FORWARD, LEFT, Bench
from support.samples import controllers_of, event_of, sample_of

from canopen_control.errors import ConfigError
from canopen_control.runtime.api import ApiServer
from canopen_control.trace.bag import BagMessages, BagWriter

rosbags = pytest.importorskip("rosbags.rosbag2", reason="rosbags is not installed: pip install canopen-control[bag]")

READ_WITH_RCLPY = """
import importlib, json, sys
from pathlib import Path
from rclpy.serialization import deserialize_message
from rosbags.rosbag2 import Reader

def plain(value):
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        return value[0]
    return value if isinstance(value, (str, int, float)) else [plain(each) for each in value]

found = {}
with Reader(Path(sys.argv[1])) as reader:
    for connection, stamp, data in reader.messages():
        package, _, name = connection.msgtype.split("/")
        if package == "tf2_msgs":
            continue
        kind = getattr(importlib.import_module(package + ".msg"), name)
        found.setdefault(connection.topic, []).append([stamp, plain(deserialize_message(bytes(data), kind))])
print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def story(tmp_path_factory):
    """Two seconds of robby: what the API says, samples while the wheels turn, an error."""
    folder = tmp_path_factory.mktemp("run")
    folder.chmod(0o700)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", str(folder))
        return tell(Bench("bag"))


def tell(bench):
    bench.api = ApiServer(bench.robot)
    bench.start()
    client = Client(bench)
    told = {"controllers": client.ask("controllers")["result"], "urdf": client.ask("description")["result"]["urdf"]}
    client.ask("subscribe", state_rate=50.0, events=True)
    told["messages"] = messages = client.messages()
    for tenth in range(30):
        if tenth < 20:
            bench.command(3.0, 4.0)
        if tenth == 20:
            bench.power_off(LEFT)
        bench.run(100)
        messages += client.messages()
    client.close()
    bench.api.close()
    bench.close()
    return told


@pytest.fixture
def private_folders():
    """Not needed: the story has its own folder, and nothing else here runs a robot."""


@pytest.fixture(scope="module")
def bag(story, tmp_path_factory):
    path = tmp_path_factory.mktemp("bag") / "run"
    with BagWriter(path, "robby", controllers=controllers_of(story["controllers"]), urdf=story["urdf"]) as writer:
        for message in story["messages"]:
            if "state" in message:
                writer.state(sample_of(message["state"]))
            elif "event" in message:
                writer.event(event_of(message["event"]))
    assert writer.messages > 0
    writer.close()
    return path


def states(story):
    return [message["state"] for message in story["messages"] if "state" in message]


def read(path):
    store, found = BagMessages().store, {}
    with rosbags.Reader(path) as reader:
        for connection, stamp, data in reader.messages():
            found.setdefault(connection.topic, []).append((stamp, store.deserialize_cdr(data, connection.msgtype)))
    return found


def told(story):
    return [each["samples"]["joint_state_broadcaster"] for each in states(story)]


@pytest.mark.rest
def test_every_update_of_the_broadcaster_is_a_joint_state_with_its_stamp(story, bag):
    messages = read(bag)["/joint_states"]
    assert len(messages) == len(told(story)) > 100
    for (stamp, message), sample in zip(messages, told(story), strict=True):
        assert stamp / 1e9 == pytest.approx(sample["time"], abs=1e-6)
        assert message.header.stamp.sec == int(sample["time"])
        assert message.name == sample["names"]
        for index, name in enumerate(message.name):
            joint = sample["joints"][name]
            for kind in ("position", "velocity", "effort"):
                value, expected = getattr(message, kind)[index], joint.get(kind)
                assert math.isnan(value) if expected is None else value == expected


def test_each_broadcaster_is_written_on_its_topic_with_its_frame_once_per_update(story, tmp_path):
    west = {"name": "west", "state": "active", "publishes": ["west/joint_states"], "frame_id": "west_base"}
    silent = {"name": "gpio", "state": "active", "is_broadcaster": True}
    readings = controllers_of([silent, west, *story["controllers"]])
    joints = {"left_wheel_joint": {"position": 1.5}, "caster": dict.fromkeys(("position", "velocity", "effort"), 0.0)}
    mine = {"kind": "joint_states", "time": 5.0, "names": ["left_wheel_joint", "caster"], "joints": joints}
    with BagWriter(tmp_path / "two", "robby", controllers=readings, urdf=story["urdf"]) as writer:
        for sample in states(story)[-3:]:
            writer.state(sample_of({**sample, "samples": {**sample["samples"], "west": mine}}))
    found = read(tmp_path / "two")
    ((stamp, message),) = found["/west/joint_states"]
    assert (stamp, message.name, message.header.frame_id) == (5 * 10**9, ["left_wheel_joint", "caster"], "west_base")
    assert list(message.position) == [1.5, 0.0]
    assert math.isnan(message.velocity[0])
    assert message.velocity[1] == message.effort[1] == 0.0
    assert [each.header.frame_id for _, each in found["/joint_states"]] == ["base_link"] * 3
    assert len(found["/tf"]) == 3


def test_commands_are_written_when_they_change_under_a_name_that_nobody_listens_to(bag):
    found = read(bag)
    commands = [list(message.data) for _, message in found[f"/{FORWARD}/commands_out"]]
    assert [3.0, 4.0] in commands
    assert len(commands) < 10
    assert f"/{FORWARD}/commands" not in found


def test_wheels_turn_in_tf_and_what_is_fixed_is_there_once(story, bag):
    found = read(bag)
    turning = {transform.child_frame_id: transform.transform.rotation.w for transform in found["/tf"][50][1].transforms}
    assert len(turning) == 2
    first = {each.child_frame_id: each.transform.rotation.w for each in found["/tf"][0][1].transforms}
    assert all(turning[name] != first[name] for name in first)
    assert len(found.get("/tf_static", ())) <= 1
    assert found["/robot_description"][0][1].data == story["urdf"]


def test_events_are_log_messages_with_their_level_and_node(bag):
    logs = [message for _, message in read(bag)["/rosout"]]
    lost = [message for message in logs if "heartbeat" in message.msg]
    assert lost[0].level == 40
    assert lost[0].name == "robby.left_drive"


def test_diagnostics_come_once_a_second_and_tell_the_loss(bag):
    arrays = read(bag)["/diagnostics"]
    assert 2 <= len(arrays) <= 5
    last = {status.name: status for status in arrays[-1][1].status}
    assert "robby: left_drive" in last


def test_odometry_of_a_base_that_drives_sideways_is_on_its_own_topic(story, tmp_path):
    sample = {"kind": "odometry", "time": 1000.25, "x": 1.0, "y": 2.0, "heading": 0.0, "linear": 0.5, "lateral": 0.25}
    reading = {"name": "base", "state": "active", "topic": "reference", "tells": "odometry"}
    with BagWriter(tmp_path / "odom", "robby", controllers=controllers_of([reading]), urdf=story["urdf"]) as writer:
        writer.state(sample_of({**states(story)[-1], "samples": {"base": sample}}))
    ((_, odometry),) = read(tmp_path / "odom")["/base/odometry"]
    assert (odometry.twist.twist.linear.x, odometry.twist.twist.linear.y) == (0.5, 0.25)


def test_the_true_pose_of_a_simulated_base_is_in_the_frame_of_its_odometry(story, tmp_path):
    sample = {"kind": "odometry", "time": 1000.25, "x": 0.0, "y": 0.0, "heading": 0.0, "frame_id": "odom"}
    truth = {"time": 1000.5, "x": 5.0, "y": 1.5, "z": 0.1, "heading": math.pi, "odom": [5.0, 0.0, math.pi / 2]}
    state = {**states(story)[0], "samples": {"base": sample}, "true_pose": truth}
    with BagWriter(tmp_path / "truth", "robby", urdf=story["urdf"]) as writer:
        for _ in range(2):  # known once, sampled twice
            writer.state(sample_of(state))
        writer.state(sample_of({**state, "samples": {}, "true_pose": truth | {"time": 1001.0}}))
    ((stamp, message),) = read(tmp_path / "truth")["/ground_truth"]
    assert (stamp, message.header.frame_id) == (1_000_500_000_000, "odom")
    place = message.pose.position
    assert (place.x, place.y, place.z) == pytest.approx((1.5, 0.0, 0.1))
    assert message.pose.orientation.z == pytest.approx(math.sqrt(0.5))


@pytest.mark.rest
def test_odometry_becomes_odom_tf_and_the_limited_twist(story, tmp_path):
    sample = {
        "kind": "odometry", "time": 1000.25, "x": 1.0, "y": 2.0, "heading": math.pi, "linear": 0.5, "angular": -0.25,
        "frame_id": "odom", "child_frame_id": "base_link", "pose_covariance": [1, 2, 3, 4, 5, 6], "limited": [0.4, 0.1],
    }  # fmt: skip
    with BagWriter(tmp_path / "odom", "robby", urdf=story["urdf"]) as writer:
        for _ in range(2):  # published once, sampled twice
            writer.state(sample_of({**states(story)[0], "samples": {"base": sample}}))
    found = read(tmp_path / "odom")
    assert len(found["/base/odom"]) == len(found["/base/cmd_vel_out"]) == 1
    odometry = found["/base/odom"][0][1]
    assert (odometry.header.frame_id, odometry.child_frame_id) == ("odom", "base_link")
    assert odometry.pose.pose.orientation.z == pytest.approx(1.0)
    assert list(odometry.pose.covariance)[::7] == [1, 2, 3, 4, 5, 6]
    assert odometry.twist.twist.linear.x == 0.5
    assert found["/base/cmd_vel_out"][0][1].twist.angular.z == 0.1
    assert {each.header.frame_id for each in found["/tf"][0][1].transforms} >= {"odom"}


def test_a_bag_never_overwrites(bag):
    with pytest.raises(ConfigError, match="something already"):
        BagWriter(bag, "robby")


def test_without_rosbags_it_says_what_to_type(monkeypatch, tmp_path):
    real = builtins.__import__

    def without(name, *args, **kwargs):
        if name.startswith("rosbags"):
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ConfigError, match=r"pip install 'canopen-control\[bag\]'"):
        BagWriter(tmp_path / "x", "robby")


@pytest.mark.ros
def test_rclpys_own_messages_say_the_same(story, bag):
    environment = {key: value for key, value in os.environ.items() if key != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"}
    done = subprocess.run(
        [sys.executable, "-c", READ_WITH_RCLPY, str(bag)], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    sample, (stamp, message) = told(story)[60], found["/joint_states"][60]
    assert message["header"]["stamp"]["sec"] * 10**9 + message["header"]["stamp"]["nanosec"] == stamp
    left = message["name"].index("left_wheel_joint")
    assert message["velocity"][left] == sample["joints"]["left_wheel_joint"]["velocity"]
    assert message["position"][left] == sample["joints"]["left_wheel_joint"]["position"]
    assert [3.0, 4.0] in [each["data"] for _, each in found[f"/{FORWARD}/commands_out"]]
    assert any(each["level"] == 40 and each["name"] == "robby.left_drive" for _, each in found["/rosout"])
    statuses = {each["name"]: each for _, array in found["/diagnostics"] for each in array["status"]}
    assert statuses["robby: left_drive"]["hardware_id"] == "node 3"
    assert found["/robot_description"][0][1]["data"] == story["urdf"]
