"""Two robots on two buses in one ROS graph: one with default names, one with names from bus.yml and command line."""

from __future__ import annotations

import signal
import time
from types import SimpleNamespace

import pytest
from support import ros
from support.processes import DriveProbe
from support.robots import PATIENT_ROBBY, copy_robby

pytestmark = [pytest.mark.ros, pytest.mark.timed]
TWIST, TF = "geometry_msgs/msg/Twist", "tf2_msgs/msg/TFMessage"
ARRAY, JOINTS, ODOMETRY = "std_msgs/msg/Float64MultiArray", "sensor_msgs/msg/JointState", "nav_msgs/msg/Odometry"
DONE = {"success": True, "message": ""}
BUS = {
    **PATIENT_ROBBY,
    'driver: "ros2_canopen::Cia402Driver"': 'driver: "ros2_canopen::LifecycleCia402Driver"',
    "  right_drive:\n    node_id: 2\n": "  right_drive:\n    node_id: 2\n    namespace: /arm\n"
    '    remappings: {"~/init": "/arm/begin", "~/nmt_state": "nmt"}\n',
}
PARAMETERS = "/**:\n  ros__parameters: {cmd_vel_topic: drive, cmd_vel_type: Twist}\n"


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """Robots `one` and `two` on virtual drives with their bridges, and another ROS program."""
    folder = tmp_path_factory.mktemp("two")
    (folder / "bridge.yaml").write_text(PARAMETERS)
    first = copy_robby(folder, bus=PATIENT_ROBBY)
    (folder / "second").mkdir()
    second = copy_robby(folder / "second", bus=BUS)
    theirs = ["-p", "rate:=20.0", "-r", "joint_states:=wheels", "--params-file", folder / "bridge.yaml"]
    with ros.stage(folder) as stage:
        common = ["--ros", "--namespace"]
        one = stage.start("run", first, "--as", "one", "--can", "local:one", *common, "one", **stage.environment)
        two = stage.start(
            "run", second, "--as", "two", "--can", "local:two", "--controller", "robby_base_controller",
            *common, "/two", "--ros-args", *theirs, **stage.environment,
        )  # fmt: skip
        for robot, name in ((one, "one"), (two, "two")):
            robot.until(f"{name} runs")
        drives = {name: DriveProbe(name, 3) for name in ("one", "two")}
        try:
            with ros.Peer(stage.domain, "--interfaces") as peer:
                yield SimpleNamespace(peer=peer, one=one, two=two, drives=drives, domain=stage.domain)
        finally:
            for drive in drives.values():
                drive.close()


@pytest.fixture
def call(scene):
    return scene.peer.call


@pytest.fixture
def names(scene):
    def names(kind):
        return set(scene.peer.order("graph")[kind])

    return names


def test_a_command_on_a_topic_moves_the_robot_of_that_namespace_alone(scene):
    topic = "/one/robby_forward_controller/commands"
    scene.peer.order("publish", topic=topic, of=ARRAY, data={"data": [10.0, 10.0]}, rate=10)
    assert ros.eventually(lambda: scene.drives["one"].speed < -2000)
    assert scene.drives["two"].speed == 0.0
    scene.peer.order("subscribe", topic="/one/joint_states", of=JOINTS)
    scene.peer.order("subscribe", topic="/two/wheels", of=JOINTS)
    scene.peer.message("/one/joint_states", lambda message: all(abs(10.0 - item) < 0.1 for item in message["velocity"]))
    assert scene.peer.message("/two/wheels")["velocity"] == [0.0, 0.0]
    scene.peer.order("silence", topic=topic)
    assert ros.eventually(lambda: scene.drives["one"].speed == 0.0)


def test_a_publisher_at_ten_kilohertz_does_no_harm_and_its_newest_value_counts(scene):
    topic = "/one/robby_forward_controller/commands"
    flood = {"topic": topic, "of": ARRAY, "count": 10_000, "rate": 10_000}
    scene.peer.order("subscribe", topic="/one/joint_states", of=JOINTS)
    # the publisher's own rate depends on what else this computer does; ten messages for each cycle of 50 Hz are a flood
    assert scene.peer.order("flood", data=[5.0, 5.0], **flood)["hz"] > 500
    scene.peer.order("publish", topic=topic, of=ARRAY, data={"data": [2.0, 2.0]}, rate=10)
    scene.peer.message("/one/joint_states", lambda message: all(abs(2.0 - item) < 0.1 for item in message["velocity"]))
    assert scene.drives["one"].power == "OPERATION_ENABLED"
    scene.peer.order("silence", topic=topic)


def test_a_message_that_is_not_a_command_neither_stops_nor_renews_a_motion(scene):
    topic, nan = "/one/robby_forward_controller/commands", float("nan")
    scene.peer.order("publish", topic=topic, of=ARRAY, data={"data": [2.0, 2.0]}, rate=10)
    assert ros.eventually(lambda: scene.drives["one"].speed < -400)
    scene.peer.order("silence", topic=topic)
    for number, bad in enumerate(([nan, 1.0], [float("inf")] * 2, [9.0], [9.0] * 3, [])):
        scene.peer.order("renew", topic=topic)
        scene.peer.order("publish", topic=topic, of=ARRAY, data={"data": bad}, rate=50)
        assert number or scene.drives["one"].speed < -400, "the command before still holds"
    assert ros.eventually(lambda: scene.drives["one"].speed == 0.0), "the timeout, though messages come"
    scene.peer.order("silence", topic=topic)


def test_a_publisher_that_dies_stops_the_robot_by_the_timeout(scene):
    with ros.Peer(scene.domain) as other:
        topic = "/one/robby_forward_controller/commands"
        other.order("publish", topic=topic, of=ARRAY, data={"data": [10.0, 10.0]}, rate=10)
        assert ros.eventually(lambda: scene.drives["one"].speed < -2000)
        other.kill()
        assert ros.eventually(lambda: scene.drives["one"].speed == 0.0)
    assert "no command for 2.0" in scene.one.out


def test_an_old_stamp_is_refused_a_future_one_is_now_and_any_frame_will_do(scene):
    topic, odom = "/two/robby_base_controller/cmd_vel", "/two/robby_base_controller/odom"

    def drive(seconds):
        twist = {"header": {"stamp": {"sec": seconds}, "frame_id": "nowhere"}, "twist": {"linear": {"x": 0.2}}}
        scene.peer.order("publish", topic=topic, of="geometry_msgs/msg/TwistStamped", data=twist, rate=20)

    scene.peer.order("subscribe", topic=odom, of=ODOMETRY)
    scene.peer.order("subscribe", topic="/rosout", of="rcl_interfaces/msg/Log", qos="latched")
    drive(1_000_000_000)
    scene.peer.message("/rosout", lambda message: "check the clocks" in message["msg"])
    assert all(item["twist"]["twist"]["linear"]["x"] == 0.0 for item in scene.peer.waiting(odom))
    drive(int(time.time()) + 3600)
    scene.peer.message(odom, lambda message: message["twist"]["twist"]["linear"]["x"] > 0.1)
    scene.peer.order("silence", topic=topic)
    assert ros.eventually(lambda: scene.drives["two"].speed == 0.0), "the timeout holds, whatever the stamp said"


def test_the_frames_of_the_two_never_mix(scene):
    scene.peer.order("subscribe", topic="/tf", of=TF)
    scene.peer.order("subscribe", topic="/tf_static", of=TF, qos="latched")
    pairs = set()

    def both():
        for topic in ("/tf", "/tf_static"):
            for message in scene.peer.waiting(topic):
                pairs.update((item["header"]["frame_id"], item["child_frame_id"]) for item in message["transforms"])
        return {("one/base_link", "one/left_wheel"), ("two/base_link", "two/left_wheel")} <= pairs and any(
            child == "two/base_footprint" for _, child in pairs
        )

    assert ros.eventually(both), pairs
    assert {parent.split("/")[0] == child.split("/")[0] for parent, child in pairs} == {True}
    children = [child for _, child in pairs]
    assert len(children) == len(set(children)), "a frame has one parent"


def test_a_service_acts_on_the_robot_of_its_namespace_alone(scene, call):
    assert call("/one/left_drive/disable") == DONE
    assert ros.eventually(lambda: scene.drives["one"].power != "OPERATION_ENABLED")
    assert scene.drives["two"].power == "OPERATION_ENABLED"
    assert call("/one/left_drive/init") == DONE
    kind = "controller_manager_msgs/srv/ListControllers"
    states = {
        name: {item["name"] for item in call(f"/{name}/controller_manager/list_controllers", kind)["controller"]}
        for name in ("one", "two")
    }
    assert "robby_base_controller" in states["two"] - states["one"]


def test_everything_of_the_two_is_in_their_namespaces_but_what_is_absolute(names):
    robots = [{name for name in names("topics") if name.startswith(f"/{robot}/")} for robot in ("one", "two")]
    assert all(f"/{robot}/robot_description" in result for robot, result in zip(("one", "two"), robots, strict=True))
    others = {"/tf", "/tf_static", "/diagnostics", "/rosout", "/parameter_events"}
    left = {name for name in names("topics") - robots[0] - robots[1] if not name.startswith("/arm/")}
    assert left - {"/lifecycle_manager/transition_event"} <= others


def test_what_comes_after_ros_args_reaches_the_bridge_of_that_run(scene, call, names):
    kind, service = "rcl_interfaces/srv/GetParameters", "/{}/canopen_control_bridge/get_parameters"
    values = call(service.format("two"), kind, names=["rate", "cmd_vel_topic", "frame_prefix"])["values"]
    assert (values[0]["double_value"], values[1]["string_value"]) == (20.0, "drive")
    assert values[2]["string_value"] == "two/"
    assert call(service.format("one"), kind, names=["rate"])["values"][0]["double_value"] == 0.0  # every cycle
    assert "/two/joint_states" not in names("topics")
    scene.peer.order("subscribe", topic="/two/robby_base_controller/odom", of=ODOMETRY)
    scene.peer.order("publish", topic="/two/drive", of=TWIST, data={"linear": {"x": 0.2}}, rate=10)
    scene.peer.message(
        "/two/robby_base_controller/odom", lambda message: message["twist"]["twist"]["linear"]["x"] > 0.1
    )
    scene.peer.order("silence", topic="/two/drive")
    assert ros.eventually(lambda: scene.drives["two"].speed == 0.0)


def test_namespace_and_remappings_of_bus_yml_hold_on_the_running_robot(scene, call, names):
    assert {"/arm/begin", "/arm/right_drive/halt", "/two/left_drive/init"} <= names("services")
    assert {"/arm/right_drive/init", "/two/right_drive/halt", "/arm/left_drive/init"}.isdisjoint(names("services"))
    scene.peer.order("subscribe", topic="/arm/nmt", of="std_msgs/msg/String", qos="latched")
    assert scene.peer.message("/arm/nmt") == {"data": "START"}
    together = "robby_base_controller moves left_drive and right_drive together: {} applies to all of them"
    for path, verb in (("/arm/right_drive/disable", "disable"), ("/arm/begin", "enable")):
        assert call(path) == {"success": True, "message": together.format(verb)}


def test_lifecycle_drivers_of_bus_yml_come_up_and_go_down_by_the_manager(scene, call):
    def change(path, label):
        kind = "lifecycle_msgs/srv/ChangeState"
        return call(f"{path}/change_state", kind, transition={"id": 0, "label": label})["success"]

    def state(path):
        return call(f"{path}/get_state", "lifecycle_msgs/srv/GetState")["current_state"]["label"]

    for label in ("configure", "activate"):
        assert change("/lifecycle_manager", label)
    assert state("/two/left_drive") == state("/arm/right_drive") == state("/two/master") == "active"
    assert change("/lifecycle_manager", "deactivate")
    assert (state("/lifecycle_manager"), state("/two/left_drive")) == ("inactive", "unconfigured")
    assert ros.eventually(lambda: scene.drives["two"].power != "OPERATION_ENABLED")
    assert scene.drives["one"].power == "OPERATION_ENABLED"


def test_the_death_of_one_robot_leaves_the_other_alone(scene):
    scene.peer.order("subscribe", topic="/one/joint_states", of=JOINTS)
    scene.two.send(signal.SIGKILL)
    assert ros.eventually(lambda: not scene.peer.order("endpoints", topic="/two/robot_description")["publishers"])
    scene.peer.waiting("/one/joint_states")
    scene.peer.message("/one/joint_states")
    assert scene.drives["one"].power == "OPERATION_ENABLED"
