"""Bases, outputs and sensors of a mocked robot, used from another ROS program."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest
import yaml
from support import ros
from support.bases import ACKERMANN, MECANUM, OMNI, PARAMS, TRICYCLE

pytestmark = pytest.mark.ros
TWIST, ODOMETRY, TF = "geometry_msgs/msg/TwistStamped", "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"
VALUES = "control_msgs/msg/DynamicInterfaceGroupValues"
STATE = {TRICYCLE: "SteeringControllerStatus", MECANUM: "MecanumDriveControllerState"}
NAMES = {TRICYCLE: "truck", ACKERMANN: "car", MECANUM: "mec", OMNI: "omni"}
SIDEWAYS = {MECANUM, OMNI}
SENSORS = {
    "imu": {f"{what}.{axis}": 0.5 for what in ("angular_velocity", "linear_acceleration") for axis in "xyz"}
    | {"orientation.x": 0.0, "orientation.y": 0.0, "orientation.z": 0.6, "orientation.w": 0.8},
    "sonar": {"range": 1.25},
    "wrist": {f"{what}.{axis}": 2.5 for what in ("force", "torque") for axis in "xyz"},
    "gps": {f"position.{axis}": 3.0 for axis in "xyz"}
    | {"orientation.x": 0.0, "orientation.y": 0.0, "orientation.z": 0.0, "orientation.w": 1.0},
    "pack": {"battery_voltage": 24.5},
}
FRAME = {"frame_id": "link"}
CONTROLLERS = {
    "joint_state_broadcaster": ("joint_state_broadcaster/JointStateBroadcaster", {}),
    "io": ("gpio_controllers/GpioCommandController", {
        "gpios": ["box"], "command_interfaces": {"box": {"interfaces": ["lamp"]}},
        "state_interfaces": {"box": {"interfaces": ["lamp", "pressed"]}},
    }),
    "imu_b": ("imu_sensor_broadcaster/IMUSensorBroadcaster", {"sensor_name": "imu", **FRAME}),
    "sonar_b": ("range_sensor_broadcaster/RangeSensorBroadcaster", {"sensor_name": "sonar", **FRAME}),
    "wrist_b": ("force_torque_sensor_broadcaster/ForceTorqueSensorBroadcaster", {"sensor_name": "wrist", **FRAME}),
    "gps_b": ("pose_broadcaster/PoseBroadcaster", {"pose_name": "gps", **FRAME}),
    "pack_b": ("battery_state_broadcaster/BatteryStateBroadcaster", {"batteries": ["pack"]}),
}  # fmt: skip
TOLD = {
    "/imu_b/imu": ("sensor_msgs/msg/Imu", lambda message: message["orientation"]["w"], 0.8),
    "/sonar_b/range": ("sensor_msgs/msg/Range", lambda message: message["range"], 1.25),
    "/wrist_b/wrench": ("geometry_msgs/msg/WrenchStamped", lambda message: message["wrench"]["torque"]["z"], 2.5),
    "/gps_b/pose": ("geometry_msgs/msg/PoseStamped", lambda message: message["pose"]["position"]["y"], 3.0),
    "/pack_b/battery_state": ("sensor_msgs/msg/BatteryState", lambda message: message["voltage"], 24.5),
}


def prefixed(kind):
    """Return the parameters of a base, its joints with the name of the base before them, and these joints."""
    name, inputs = NAMES[kind], PARAMS[kind]
    result, joints = {"odom_frame_id": f"{name}_odom", "base_frame_id": name}, {}
    for key, value in inputs.items():
        named = isinstance(value, str) or (isinstance(value, list) and isinstance(value[0], str))
        if not named:
            result[key] = value
            continue
        result[key] = [f"{name}_{item}" for item in value] if isinstance(value, list) else f"{name}_{value}"
        for item in result[key] if isinstance(value, list) else [result[key]]:
            joints[item] = "position" if key.startswith("steering") else "velocity"
    return result, joints


def write_robot(folder):
    """Write a robot on mock hardware whose joints suffice for every kind of base, with sensors and an output."""
    sections = {name: (kind, params) for name, (kind, params) in CONTROLLERS.items()}
    joints = {}
    for kind, name in NAMES.items():
        params, own = prefixed(kind)
        sections[name] = (kind, params)
        joints |= own
    states = "".join(f"<state_interface name='{item}'/>" for item in ("position", "velocity"))
    tags = "".join(
        f"<joint name='{name}'><command_interface name='{kind}'/>{states}</joint>" for name, kind in joints.items()
    )
    for sensor, values in SENSORS.items():
        inner = "".join(
            f"<state_interface name='{name}'><param name='initial_value'>{value}</param></state_interface>"
            for name, value in values.items()
        )
        tags += f"<sensor name='{sensor}'>{inner}</sensor>"
    lamp = "<command_interface name='lamp'/><state_interface name='lamp'/><state_interface name='pressed'/>"
    tags += f"<gpio name='box'>{lamp}</gpio>"
    links = "".join(
        f"<link name='to_{joint}'/><joint name='{joint}' type='continuous'><parent link='body'/>"
        f"<child link='to_{joint}'/><axis xyz='0 0 1'/></joint>"
        for joint in joints
    )
    plugin = "<plugin>mock_components/GenericSystem</plugin><param name='calculate_dynamics'>true</param>"
    system = f"<ros2_control name='all' type='system'><hardware>{plugin}</hardware>{tags}</ros2_control>"
    folder.mkdir()
    (folder / "all.urdf").write_text(f"<robot name='all'><link name='body'/>{links}{system}</robot>")
    manager = {"update_rate": 50, **{name: {"type": kind} for name, (kind, _) in sections.items()}}
    files = {"controller_manager": {"ros__parameters": manager}}
    files |= {name: {"ros__parameters": params} for name, (_, params) in sections.items() if params}
    (folder / "ros2_controllers.yaml").write_text(yaml.safe_dump(files, sort_keys=False))
    return folder


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """All controllers active, and another ROS program."""
    folder = tmp_path_factory.mktemp("bases")
    config = write_robot(folder / "all")
    with ros.stage(folder) as stage:
        robot = stage.start("run", config, "--mock", "--ros", **stage.environment)
        robot.until("all runs")
        with ros.Peer(stage.domain, "--interfaces") as peer:
            service = "/controller_manager/{}"
            for name in NAMES.values():
                if peer.call(
                    service.format("load_controller"), "controller_manager_msgs/srv/LoadController", name=name
                ):
                    peer.call(
                        service.format("configure_controller"),
                        "controller_manager_msgs/srv/ConfigureController",
                        name=name,
                    )
            swap = {"activate_controllers": [*NAMES.values(), "io"], "strictness": 1}
            assert peer.call(
                service.format("switch_controller"), "controller_manager_msgs/srv/SwitchController", **swap
            )["ok"]
            yield SimpleNamespace(peer=peer, robot=robot)


@pytest.mark.parametrize("kind", NAMES)
def test_a_twist_from_another_program_moves_a_base_whose_odometry_and_transform_report_this(scene, kind):
    name, peer = NAMES[kind], scene.peer
    commands, reported = (
        (f"/{name}/cmd_vel", f"/{name}/odom") if kind == OMNI else (f"/{name}/reference", f"/{name}/odometry")
    )
    peer.order("subscribe", topic=reported, of=ODOMETRY)
    expected = {"linear": {"x": 0.4, "y": 0.2 if kind in SIDEWAYS else 0.0}, "angular": {"z": 0.1}}
    peer.order("publish", topic=commands, of=TWIST, data={"twist": expected}, rate=20)

    def far(message):
        position = message["pose"]["pose"]["position"]
        return math.hypot(position["x"], position["y"]) > 0.1

    moving = peer.message(reported, far)
    assert (moving["header"]["frame_id"], moving["child_frame_id"]) == (f"{name}_odom", name)
    assert moving["pose"]["pose"]["position"]["x"] > 0.05
    sideways = moving["twist"]["twist"]["linear"]["y"]
    assert sideways == pytest.approx(0.2, abs=0.02) if kind in SIDEWAYS else sideways == 0.0
    peer.order("subscribe", topic="/tf", of=TF)
    peer.message("/tf", lambda message: name in {item["child_frame_id"] for item in message["transforms"]})
    peer.order("unsubscribe", topic="/tf")
    peer.order("silence", topic=commands)
    peer.message(reported, lambda message: message["twist"]["twist"]["linear"]["x"] == 0.0)  # by its timeout
    pose = {"x": 5.0, "y": -2.0, "yaw": 1.5}
    assert peer.call(f"/{name}/set_odometry", "control_msgs/srv/SetOdometry", **pose)["success"]
    there = peer.message(
        reported, lambda message: message["pose"]["pose"]["position"]["x"] == pytest.approx(5.0, abs=0.05)
    )
    assert there["pose"]["pose"]["orientation"]["z"] == pytest.approx(math.sin(0.75), abs=0.05)
    peer.order("unsubscribe", topic=reported)


@pytest.mark.parametrize("kind", STATE)
def test_a_base_reports_its_wheels(scene, kind):
    topic = f"/{NAMES[kind]}/controller_state"
    scene.peer.order("subscribe", topic=topic, of=f"control_msgs/msg/{STATE[kind]}")
    message = scene.peer.message(topic)
    wheels = message.get("traction_wheels_velocity") or [message["front_left_wheel_velocity"]]
    assert all(map(math.isfinite, wheels))
    scene.peer.order("unsubscribe", topic=topic)


def test_an_output_follows_a_command_by_name_until_its_controller_is_deactivated(scene):
    peer = scene.peer
    peer.order("subscribe", topic="/io/gpio_states", of=VALUES)

    def lamp(message):
        return dict(
            zip(
                message["interface_values"][0]["interface_names"], message["interface_values"][0]["values"], strict=True
            )
        )

    on = {"interface_groups": ["box"], "interface_values": [{"interface_names": ["lamp"], "values": [1.0]}]}
    peer.order("publish", topic="/io/commands", of=VALUES, data=on, rate=20)
    message = peer.message("/io/gpio_states", lambda each: lamp(each)["lamp"] == 1.0)
    assert message["interface_groups"] == ["box"]
    peer.order("silence", topic="/io/commands")
    off = {"deactivate_controllers": ["io"], "strictness": 2}
    assert peer.call("/controller_manager/switch_controller", "controller_manager_msgs/srv/SwitchController", **off)[
        "ok"
    ]
    listed = peer.call("/controller_manager/list_controllers", "controller_manager_msgs/srv/ListControllers")[
        "controller"
    ]
    assert {item["name"]: item["state"] for item in listed}["io"] == "inactive"


@pytest.mark.parametrize("topic", TOLD)
def test_a_sensor_is_reported_as_the_hardware_has_it(scene, topic):
    kind, part, value = TOLD[topic]
    scene.peer.order("subscribe", topic=topic, of=kind)
    assert part(scene.peer.message(topic)) == pytest.approx(value)
    scene.peer.order("unsubscribe", topic=topic)
