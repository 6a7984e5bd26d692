import math
import statistics
from dataclasses import replace
from pathlib import Path

import pytest
from support.physicsrobot import PhysicsRobot
from support.robots import Bench, copy_robby, setup_of

from canopen_control.errors import RobotConfigError
from canopen_control.physics.physics_file import PhysicsError
from canopen_control.runtime.physics_plant import (
    PLANT_FILE,
    SensedValues,
    check_physics,
    plant_text,
    sensed_world,
    world_sensors,
    write_buses,
    write_plant,
)
from canopen_control.virtual.bus_group import read_group

IMU = [*(f"orientation.{axis}" for axis in "xyzw"), *(f"angular_velocity.{axis}" for axis in "xyz"),
       *(f"linear_acceleration.{axis}" for axis in "xyz")]  # fmt: skip
POSE = [*(f"position.{axis}" for axis in "xyz"), *(f"orientation.{axis}" for axis in "xyzw")]


def tags(noise="0", frame="base_link"):
    def sensor(name, interfaces, parameters):
        inputs = "".join(f'<param name="{key}">{value}</param>' for key, value in parameters.items())
        states = "".join(f'<state_interface name="{interface}"/>' for interface in interfaces)
        return f'<sensor name="{name}">{inputs}{states}</sensor>'

    imu = sensor("imu", IMU, {"frame_id": frame, "noise": noise, "seed": "3"})
    return f"{imu}{sensor('truth', POSE, {})}{sensor('other', ['voltage'], {})}"


def robby(folder, **how):
    description = {"  </ros2_control>": f"{tags(**how)}</ros2_control>"}
    controllers = {
        "    robby_forward_controller:\n      type": "    imu_broadcaster:\n"
        "      type: imu_sensor_broadcaster/IMUSensorBroadcaster\n\n    robby_forward_controller:\n      type",
        "robby_forward_controller:\n  ros__parameters:": "imu_broadcaster:\n"
        "  ros__parameters: {sensor_name: imu, frame_id: base_link}\n\nrobby_forward_controller:\n  ros__parameters:",
    }
    return copy_robby(folder, description=description, controllers=controllers)


@pytest.fixture
def robot_of_world_sensing(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    robot_of_world_sensing = PhysicsRobot("sensing", config=robby(tmp_path))
    robot_of_world_sensing.start()
    yield robot_of_world_sensing
    robot_of_world_sensing.close()


def collected(robot_of_world_sensing):
    return {interface.name: interface.value for interface in robot_of_world_sensing.robot.registry.state_interfaces}


def sense(robot_of_world_sensing):
    SensedValues(robot_of_world_sensing.robot.sensed, world_sensors(robot_of_world_sensing.setup)).take(
        robot_of_world_sensing.world.describe().sensors
    )


def test_what_the_world_measures_is_in_the_interfaces_and_is_broadcast(robot_of_world_sensing):
    assert math.isnan(collected(robot_of_world_sensing)["imu/orientation.w"])
    robot_of_world_sensing.hold(10.0, 10.0, ms=1000)
    upward = []
    for _ in range(25):  # what an IMU tells at one moment has the chassis's rocking in it
        robot_of_world_sensing.hold(10.0, 10.0, ms=20)
        sense(robot_of_world_sensing)
        robot_of_world_sensing.run(40)
        values = collected(robot_of_world_sensing)
        upward.append(values["imu/linear_acceleration.z"])
    assert statistics.mean(upward) == pytest.approx(9.81, abs=0.5)
    assert values["truth/position.x"] == pytest.approx(robot_of_world_sensing.world.describe().base.x, abs=0.02)
    assert values["truth/position.x"] > 0.1
    assert "other/voltage" not in values
    sample = robot_of_world_sensing.robot.manager.running.samples(0)["imu_broadcaster"]
    assert sample.linear_acceleration[2] == values["imu/linear_acceleration.z"]


def test_without_physics_there_is_nothing_to_measure(tmp_path):
    bench = Bench("unsensed", config=robby(tmp_path), drives=(), mock=True)
    try:
        assert world_sensors(bench.setup) == {}
        assert sensed_world(bench.setup, bench.setup.description.hardware[0]) is None
        assert not SensedValues(bench.robot.sensed, {}).needed
    finally:
        bench.close()


def test_an_error_in_a_tag_is_reported_before_anything_runs_with_its_line(tmp_path):
    with pytest.raises(PhysicsError, match=r"robby\.urdf\.xacro:\d+:\d+: sensor imu: no link 'base_lnk'"):
        PhysicsRobot("missensed", config=robby(tmp_path, frame="base_lnk"))


@pytest.fixture
def robot():
    bench = Bench("physics-plant")
    yield bench
    bench.close()


def test_each_axis_moves_its_joint_by_the_scale_of_bus_yml(robot):
    text = plant_text(robot.setup, robot.robot.joints.values())
    assert text.splitlines()[1:] == [
        "engine: mujoco",
        "urdf: physics.urdf",
        "axes:",
        '  "3": {joint: "left_wheel_joint", scale_pos_to_dev: -254.64790894703253}',
        '  "2": {joint: "right_wheel_joint", scale_pos_to_dev: 254.64790894703253}',
    ]


def test_mecanum_wheels_have_their_rollers():
    robot = Bench("physics-mecanum", config="mecanum", drives=())
    try:
        text = plant_text(robot.setup, robot.robot.joints.values())
    finally:
        robot.close()
    angles = {
        line.split('"')[3].removesuffix("_wheel_joint"): line.split("roller: ")[1] for line in text.splitlines()[4:]
    }
    assert angles == {"front_left": "-45}", "front_right": "45}", "rear_right": "-45}", "rear_left": "45}"}


def test_a_world_is_named_where_one_is_given(robot):
    lines = plant_text(robot.setup, robot.robot.joints.values(), Path("/worlds/my hall.yml")).splitlines()
    assert lines[3:5] == ['world: "/worlds/my hall.yml"', "axes:"]


def test_it_is_written_with_the_description_alongside_the_logs(robot, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    path = write_plant(robot.setup, robot.robot.joints)
    assert path == tmp_path / "canopen_control" / "robby" / PLANT_FILE
    assert (path.parent / "physics.urdf").read_text() == robot.setup.description.urdf_xml


def test_messages_name_the_users_description_where_the_copy_has_its_lines(robot, tmp_path):
    description = replace(robot.setup.description, path=str(tmp_path / "robot.urdf"))
    setup = replace(robot.setup, description=description)
    joints = robot.robot.joints.values()
    (tmp_path / "robot.urdf").write_text(description.urdf_xml)
    assert f'urdf_source: "{tmp_path}/robot.urdf"' in plant_text(setup, joints).splitlines()
    (tmp_path / "robot.urdf").write_text("<robot>${xacro}</robot>")
    assert "urdf_source" not in plant_text(setup, joints)


def test_the_axes_of_a_second_bus_are_named_with_it_and_so_is_the_bus(robot, tmp_path):
    main = robot.setup.bus
    right = replace(main, nodes={"right_drive": main.nodes["right_drive"]})
    left = replace(main, nodes={"left_drive": main.nodes["left_drive"]})
    setup = replace(robot.setup, buses={"can": left, "second": right}, channels={"can": "local:a", "second": "local:b"})
    check_physics(setup)
    axes = [line.split(":  ")[0] for line in plant_text(setup, robot.robot.joints.values()).splitlines()[4:]]
    assert [axis.strip().split(": {")[0] for axis in axes] == ['"3"', '"second:2"']
    buses = read_group(write_buses(tmp_path, [(setup, tmp_path / PLANT_FILE)])).robots["robby"].buses
    assert {name: (bus.channel, list(bus.nodes)) for name, bus in buses.items()} == {
        "can": ("local:a", ["3"]),
        "second": ("local:b", ["2"]),
    }


def test_without_joints_on_drives_there_is_nothing_to_move(robot):
    with pytest.raises(RobotConfigError, match=r"--physics: no joint of .* is moved by a drive"):
        write_plant(robot.setup, {})


def test_a_simulation_plugin_gives_way_to_drives():
    setup = setup_of("diffbot_sim", "memory:gives-way", physics=True)
    assert setup.on_drives
    assert not replace(setup, physics=False).on_drives


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"real": True}, "omit --real"),
        ({"mock": True}, "omit --mock"),
        ({"channels": {"can": "memory:a"}}, "use --can local:NAME"),
        ({"channels": {"can": "can0"}}, "real drives may be on can0"),
    ],
)
def test_what_physics_cannot_do_is_reported(changes, words):
    setup = replace(setup_of("robby", "local:physics-cannot"), **changes)
    with pytest.raises(RobotConfigError, match="--physics") as caught:
        check_physics(setup)
    assert words in str(caught.value)


def test_a_robot_on_one_local_bus_can_and_none_on_the_memory_of_a_process():
    check_physics(setup_of("robby", "local:physics-can"))
    with pytest.raises(RobotConfigError, match="do not run in a process of their own"):
        check_physics(setup_of("robby", "memory:physics-can"))


def test_the_identity_that_bus_yml_requires_is_in_the_buses_file(tmp_path):
    changes = {"right_drive:\n": "right_drive:\n    serial_number: 77\n"}
    setup = setup_of(str(copy_robby(tmp_path, bus=changes)), "local:a")
    (bus,) = read_group(write_buses(tmp_path, [(setup, tmp_path / PLANT_FILE)])).robots["robby"].buses.values()
    assert bus.objects == {"2": {"0x1018:04": 77}}
