"""What broadcasters and grippers tell is in a bag, once per publication, on the topics of the ROS bridge."""

import math

import pytest

from canopen_control.rpc.messages.samples import (
    BatteriesSample,
    BatteryReading,
    GpioSample,
    GripperSample,
    ImuSample,
    PoseSample,
    RangeSample,
    WrenchSample,
)
from canopen_control.rpc.messages.state import StateSample
from canopen_control.trace.bag import SENSORS, BagMessages, BagWriter

rosbags = pytest.importorskip("rosbags.rosbag2", reason="rosbags is not installed: pip install canopen-control[bag]")
SAMPLES = {
    "imu": ImuSample(
        time=1.5, frame_id="imu_link", orientation=(0.0, 0.0, 0.6, 0.8), angular_velocity=(0.1, None, 0.3),
        linear_acceleration=(0.0, 0.0, 9.81), orientation_covariance=[0.5] * 9,
        angular_velocity_covariance=[-1.0, *[0.0] * 8], linear_acceleration_covariance=[0.0] * 9,
    ),
    "front": RangeSample(time=1.5, frame_id="nose", range=1.25, radiation_type=1, min_range=0.5, max_range=4.0),
    "wrist": WrenchSample(time=1.5, frame_id="tool0", force=(1.0, 2.0, None), torque=(0.5, 0.25, 0.125)),
    "gps": PoseSample(time=1.5, frame_id="map", position=(1.0, 2.0, 3.0), orientation=(0.0, 0.0, 0.6, 0.8),
                      child_frame_id="base"),
    "power": BatteriesSample(
        time=1.5, together=BatteryReading(name="", voltage=24.5, percentage=0.75, present=True),
        batteries=[BatteryReading(name="left", current=-3.5, power_supply_status=2), BatteryReading(name="right")],
    ),
    "io": GpioSample(time=1.5, parts={"io": {"lamp": 1.0, "pressed": None}, "valve": {"open": 0.5}}),
    "gripper": GripperSample(time=1.5, joint="finger", position=0.01, velocity=0.0, effort=2.0, target=0.04,
                             executing=True, stalled=False, reached_goal=False),
}  # fmt: skip
KINDS = {
    "/imu/imu": "sensor_msgs/msg/Imu",
    "/front/range": "sensor_msgs/msg/Range",
    "/wrist/wrench": "geometry_msgs/msg/WrenchStamped",
    "/gps/pose": "geometry_msgs/msg/PoseStamped",
    "/power/battery_state": "sensor_msgs/msg/BatteryState",
    "/power/raw_battery_states": "control_msgs/msg/BatteryStateArray",
    "/io/gpio_states": "control_msgs/msg/DynamicInterfaceGroupValues",
    "/gripper/commands_out": "std_msgs/msg/Float64MultiArray",
}


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """What a bag holds of controllers that were looked at twice: type, stamp and message by topic."""
    path, store = tmp_path_factory.mktemp("bag") / "run", BagMessages().store
    with BagWriter(path, "robot") as writer:
        for time in (2.0, 2.1):
            writer.state(StateSample(time=time, samples=SAMPLES))
    topics = {}
    with rosbags.Reader(path) as reader:
        for connection, stamp, data in reader.messages():
            message = store.deserialize_cdr(data, connection.msgtype)
            topics.setdefault(connection.topic, []).append((connection.msgtype, stamp, message))
    return topics


def only(found, topic):
    ((_, _, message),) = found[topic]
    return message


@pytest.mark.parametrize("topic", KINDS)
def test_each_is_there_once_with_its_type_and_stamp(found, topic):
    ((kind, stamp, _),) = found[topic]
    assert (kind, stamp) == (KINDS[topic], 1_500_000_000)


def test_every_row_is_tried_here():
    assert {row.topic for row in SENSORS} == {topic.rpartition("/")[2] for topic in KINDS}


def test_an_imu(found):
    imu = only(found, "/imu/imu")
    assert (imu.header.frame_id, imu.orientation.z, imu.orientation.w) == ("imu_link", 0.6, 0.8)
    assert (imu.angular_velocity.x, imu.linear_acceleration.z) == (0.1, 9.81)
    assert math.isnan(imu.angular_velocity.y)
    assert list(imu.orientation_covariance) == [0.5] * 9
    assert imu.angular_velocity_covariance[0] == -1.0


def test_a_range_a_wrench_and_a_pose_with_its_transform(found):
    front = only(found, "/front/range")
    assert (front.range, front.radiation_type, front.min_range, front.max_range) == (1.25, 1, 0.5, 4.0)
    wrench = only(found, "/wrist/wrench").wrench
    assert (wrench.force.y, wrench.torque.z) == (2.0, 0.125)
    assert math.isnan(wrench.force.z)
    pose = only(found, "/gps/pose").pose
    assert (pose.position.z, pose.orientation.w) == (3.0, 0.8)
    (transform,) = only(found, "/tf").transforms
    assert (transform.header.frame_id, transform.child_frame_id) == ("map", "base")
    assert (transform.transform.translation.y, transform.transform.rotation.z) == (2.0, 0.6)


def test_batteries(found):
    together = only(found, "/power/battery_state")
    assert (together.voltage, together.percentage, together.present) == (24.5, 0.75, True)
    assert math.isnan(together.current)
    left, right = only(found, "/power/raw_battery_states").battery_states
    assert (left.header.frame_id, left.current, left.power_supply_status) == ("left", -3.5, 2)
    assert (right.header.frame_id, len(right.cell_voltage)) == ("right", 0)


def test_inputs_and_outputs_and_where_a_gripper_is_sent(found):
    io = only(found, "/io/gpio_states")
    assert io.interface_groups == ["io", "valve"]
    assert [each.interface_names for each in io.interface_values] == [["lamp", "pressed"], ["open"]]
    assert io.interface_values[0].values[0] == 1.0
    assert math.isnan(io.interface_values[0].values[1])
    assert list(only(found, "/gripper/commands_out").data) == [0.04]
