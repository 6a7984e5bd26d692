from __future__ import annotations

import math
import time

import pytest
from support import ros
from support.ros import Peer, bridge
from support.tf_buffer import TransformBuffer, stamp_ns

pytestmark = pytest.mark.ros
URDF = """<robot name="fake"><link name="base"/><link name="camera"/><link name="wheel"/>
  <joint name="mount" type="fixed"><parent link="base"/><child link="camera"/><origin xyz="0 0 0.5"/></joint>
  <joint name="left" type="continuous"><parent link="base"/><child link="wheel"/><axis xyz="0 1 0"/></joint>
</robot>"""
ODOMETRY = {"kind": "odometry", "time": 5.0, "x": 1.0, "y": 2.0, "heading": math.pi, "linear": 0.0, "angular": 0.0,
            "frame_id": "odom", "child_frame_id": "base", "enable_odom_tf": True, "limited": None}  # fmt: skip
TYPE = "tf2_msgs/msg/TFMessage"


@pytest.fixture(scope="module")
def scene(ros_folder):
    """A robot that has frames, in a namespace, and a ROS program that made the class of the messages itself."""
    with pytest.MonkeyPatch.context() as patch, ros.domain() as number:
        for name, value in ros_folder.items():
            patch.setenv(name, value)
        patch.setattr(ros, "URDF", URDF)
        with (
            ros.FakeRobot() as robot,
            bridge(number, "--namespace", "/two", **ros_folder),
            Peer(number, "--interfaces") as peer,
        ):
            robot.joints["left"]["position"] = math.pi / 2
            peer.order("subscribe", topic="/tf", of=TYPE, qos="best_effort")
            yield robot, peer


def children(message):
    return {item["child_frame_id"]: item for item in message["transforms"]}


def test_fixed_joints_are_latched_for_late_subscribers(scene):
    _, peer = scene
    peer.order("subscribe", topic="/tf_static", of=TYPE, qos="latched")
    (camera,) = peer.message("/tf_static")["transforms"]
    assert (camera["header"]["frame_id"], camera["child_frame_id"]) == ("two/base", "two/camera")
    assert camera["transform"]["translation"] == {"x": 0.0, "y": 0.0, "z": 0.5}
    peer.order("unsubscribe", topic="/tf_static")


def test_a_joint_that_moves_is_published_with_the_time_of_the_sample(scene):
    _, peer = scene
    wheel = children(peer.message("/tf"))["two/wheel"]
    assert (wheel["header"]["frame_id"], ros.stamp_of(wheel)) == ("two/base", 1_700_000_000.25)
    assert wheel["transform"]["rotation"]["y"] == pytest.approx(math.sqrt(0.5))


def test_joints_are_silent_without_a_broadcaster_and_odometry_continues(scene):
    robot, peer = scene
    robot.switch(joint_state_broadcaster="inactive")
    robot.samples = {"base": ODOMETRY}
    alone = peer.message(
        "/tf", lambda message: "two/base" in children(message) and "two/wheel" not in children(message), 5
    )
    base = children(alone)["two/base"]
    assert (base["header"]["frame_id"], base["header"]["stamp"]["sec"]) == ("two/odom", 5)
    assert base["transform"]["translation"] == {"x": 1.0, "y": 2.0, "z": 0.0}
    assert base["transform"]["rotation"]["z"] == pytest.approx(1.0)


def test_odometry_and_the_limited_twist_are_in_the_frames_of_the_transforms(scene):
    robot, peer = scene
    robot.switch(base="active")
    for topic, kind in (("odom", "nav_msgs/msg/Odometry"), ("cmd_vel_out", "geometry_msgs/msg/TwistStamped")):
        peer.order("subscribe", topic=f"/two/base/{topic}", of=kind)
    frames = {}

    def collected():
        robot.samples = {"base": {**ODOMETRY, "time": time.time(), "limited": [0.1, 0.2]}}
        for topic in ("odom", "cmd_vel_out"):
            for message in peer.waiting(f"/two/base/{topic}"):
                frames[topic] = message["header"]["frame_id"], message.get("child_frame_id")
        return len(frames) == 2

    assert ros.eventually(collected)
    assert frames == {"odom": ("two/odom", "two/base"), "cmd_vel_out": ("two/base", None)}


def reached(peer, buffer, frame):
    """Take the transforms that have come, and return up to when a frame is known, 0 for never."""
    for message in peer.waiting("/tf"):
        buffer.take(message)
    return buffer.reaches(frame)


def test_every_odometry_is_found_in_the_transforms_and_so_is_each_link_at_its_time(scene):
    robot, peer = scene
    robot.switch(base="active", joint_state_broadcaster="active")
    buffer, reported = TransformBuffer(), []
    peer.order("subscribe", topic="/tf_static", of=TYPE, qos="latched")
    buffer.take(peer.message("/tf_static"), fixed=True)
    peer.order("subscribe", topic="/two/base/odom", of="nav_msgs/msg/Odometry")
    robot.time = 1_700_000_099.0  # stamps of joints are a little later: theirs begin before those of odometry
    assert ros.eventually(lambda: reached(peer, buffer, "two/wheel") > 0)
    for number in range(25):
        robot.time = 1_700_000_100.0 + number / 16
        turned = {"x": 0.1 * number, "heading": 0.2 * number, "time": robot.time}
        robot.samples = {"base": {**ODOMETRY, **turned}}
        reported.append(
            peer.message("/two/base/odom", lambda message, at=robot.time: ros.stamp_of(message) == round(at, 2))
        )
    last = stamp_ns(reported[-1]["header"])
    assert ros.eventually(lambda: reached(peer, buffer, "two/wheel") > last)
    for message in reported:
        odom, base, now = message["header"]["frame_id"], message["child_frame_id"], stamp_ns(message["header"])
        pose = message["pose"]["pose"]
        place, turn = buffer.lookup(odom, base, now)
        assert place == pytest.approx([pose["position"][axis] for axis in "xyz"])
        assert turn == pytest.approx([pose["orientation"][axis] for axis in "xyzw"])
        assert buffer.lookup(odom, "two/camera", now)[0] == pytest.approx((place[0], place[1], 0.5))
        assert buffer.lookup(odom, "two/wheel", now)[0] == pytest.approx(place)
        assert buffer.lookup("two/camera", "two/wheel", now)[0] == pytest.approx((0.0, 0.0, -0.5))
    for topic in ("/tf_static", "/two/base/odom"):
        peer.order("unsubscribe", topic=topic)
    with pytest.raises(LookupError, match="frame odom does not exist"):
        buffer.lookup("odom", "two/base", last)
    with pytest.raises(LookupError, match="extrapolation"):
        buffer.lookup("two/odom", "two/base", 4_000_000_000_000_000_000)


@pytest.mark.parametrize(
    ("prefix", "name", "shown"),
    [
        ("", "odom", "odom"),
        ("one/", "odom", "one/odom"),
        ("one/", "one/odom", "one/odom"),
        ("one/", "", ""),
        ("one", "one_wheel", "oneone_wheel"),
    ],
)
def test_a_frame_gets_the_prefix_that_it_does_not_have(prefix, name, shown):
    code = f"""
from types import SimpleNamespace
from canopen_control.ros.session import RosSession
print(RosSession.frame(SimpleNamespace(_options=SimpleNamespace(frame_prefix={prefix!r})), {name!r}))
"""
    assert ros.run_ros(code) == f"{shown}\n"
