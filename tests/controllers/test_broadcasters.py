from __future__ import annotations

import math

import pytest
from support.control import Hardware, S, add, manager

from canopen_control.controllers.broadcasters import QUANTITIES, read_params
from canopen_control.controllers.params import Params
from canopen_control.errors import ControlError, RobotConfigError, UnknownInterface
from canopen_control.hardware.interfaces import ReturnType

IMU = "imu_sensor_broadcaster/IMUSensorBroadcaster"
RANGE = "range_sensor_broadcaster/RangeSensorBroadcaster"
WRENCH = "force_torque_sensor_broadcaster/ForceTorqueSensorBroadcaster"
AXES = ("force.x", "force.y", "force.z", "torque.x", "torque.y", "torque.z")
POSE = [*(f"position.{axis}" for axis in "xyz"), *(f"orientation.{axis}" for axis in "xyzw")]
OF_IMU = [f"orientation.{axis}" for axis in "xyzw"]
OF_IMU += [f"{what}.{axis}" for what in ("angular_velocity", "linear_acceleration") for axis in "xyz"]


def robot_of_sensor_broadcasters(type_name, states, activate=True, **params):
    """Return hardware, the manager and a broadcaster; each state is its number among them, the first one 1.0."""
    hardware = Hardware("l/velocity", states=tuple(states))
    for number, each in enumerate(hardware.state_interfaces, 1):
        each.value = float(number)
    control = manager(hardware)
    broadcaster = add(control, "b", type_name, frame_id="link", **params)
    if activate:
        control.switch(["b"], now=0)
    return hardware, control, broadcaster


def test_an_imu_is_reported_with_the_names_of_ros2_control_and_its_covariances():
    covariance = [float(number) for number in range(9)]
    _, control, imu = robot_of_sensor_broadcasters(
        IMU, [f"imu/{item}" for item in reversed(OF_IMU)], sensor_name="imu", static_covariance_orientation=covariance
    )
    control.broadcast(S, 0.01)
    sample = imu.sample(0)
    assert (sample.time, sample.frame_id) == (1.0, "link")
    assert sample.orientation == (10.0, 9.0, 8.0, 7.0)
    assert sample.angular_velocity == (6.0, 5.0, 4.0)
    assert sample.linear_acceleration == (3.0, 2.0, 1.0)
    assert sample.orientation_covariance == covariance
    assert sample.angular_velocity_covariance == [0.0] * 9
    reading = control.list()[0]
    assert (reading.tells, reading.is_broadcaster, reading.frame_id) == ("imu", True, "link")


def test_a_range_is_reported_with_what_is_known_of_the_sensor():
    hardware, control, sonar = robot_of_sensor_broadcasters(
        RANGE, ["sonar/range"], sensor_name="sonar", radiation_type=1, min_range=0.1, max_range=2.0, field_of_view=0.3
    )
    control.broadcast(S, 0.01)
    sample = sonar.sample(0)
    assert (sample.range, sample.radiation_type, sample.field_of_view) == (1.0, 1, 0.3)
    assert (sample.min_range, sample.max_range, sample.variance) == (0.1, 2.0, 0.0)
    hardware.set("sonar/range", math.nan)
    control.broadcast(2 * S, 0.01)
    assert sonar.sample(0).range is None


def test_forces_and_torques_have_their_offset_and_then_their_multiplier():
    _, control, wrist = robot_of_sensor_broadcasters(
        WRENCH,
        [f"wrist/{item}" for item in AXES],
        sensor_name="wrist",
        offset={"force": {"z": -1.0}, "torque": {"x": 0.5}},
        multiplier={"force": {"z": 10.0}, "torque": {"z": -1.0}},
    )
    control.broadcast(S, 0.01)
    sample = wrist.sample(0)
    assert sample.force == (1.0, 2.0, 20.0)
    assert sample.torque == (4.5, 5.0, -6.0)


def test_what_is_not_named_of_forces_and_torques_is_not_known():
    names = {"force": {"z": "scale/load"}, "torque": {"y": "arm/effort"}}
    _, control, scale = robot_of_sensor_broadcasters(WRENCH, ["arm/effort", "scale/load"], interface_names=names)
    assert control.list()[0].required_state_interfaces == ("scale/load", "arm/effort")
    sample = scale.sample(0)
    assert sample.force == (None, None, 2.0)
    assert sample.torque == (None, 1.0, None)


@pytest.mark.parametrize(
    ("type_name", "states", "missing"),
    [
        (IMU, [f"s/{item}" for item in OF_IMU[1:]], "s/orientation.x"),
        (RANGE, ["s/distance"], "s/range"),
        (WRENCH, [f"s/{item}" for item in AXES[:5]], "s/torque.z"),
    ],
)
def test_an_interface_that_is_not_there_keeps_it_from_being_activated(type_name, states, missing):
    _, control, _ = robot_of_sensor_broadcasters(type_name, states, activate=False, sensor_name="s")
    with pytest.raises(UnknownInterface, match=missing):
        control.switch(["b"], now=0)
    assert control.states == {"b": "inactive"}


@pytest.mark.parametrize(("type_name", "states"), [(IMU, OF_IMU), (RANGE, ["range"]), (WRENCH, AXES)])
def test_it_claims_nothing_and_publishes_once_per_update(type_name, states):
    hardware, control, broadcaster = robot_of_sensor_broadcasters(
        type_name, [f"s/{state}" for state in states], sensor_name="s"
    )
    assert broadcaster.sample(0).time == 0.0
    hardware.state_interfaces[0].value = 77.0
    control.update(S, 0.01)
    assert broadcaster.sample(0).time == 0.0
    assert broadcaster.update(2 * S, 0.01) is ReturnType.OK
    assert broadcaster.sample(0).time == 2.0
    assert "77.0" in str(broadcaster.sample(0))
    assert control.list()[0].claims == ()


def test_a_pose_is_reported_with_the_frame_whose_transform_it_is():
    states = [f"gps/{item}" for item in POSE]
    hardware, control, gps = robot_of_sensor_broadcasters("pose_broadcaster/PoseBroadcaster", states, pose_name="gps")
    control.broadcast(S, 0.01)
    sample = gps.sample(0)
    assert (sample.position, sample.orientation) == ((1.0, 2.0, 3.0), (4.0, 5.0, 6.0, 7.0))
    assert (sample.frame_id, sample.child_frame_id) == ("link", "gps")
    hardware.set("gps/position.y", math.nan)
    control.broadcast(2 * S, 0.01)
    assert gps.sample(0).position == (1.0, None, 3.0)


def test_a_pose_of_interfaces_by_their_names_is_not_a_transform_unless_its_frame_is_named():
    names = {"position": dict(zip("xyz", ("a/x", "a/y", "a/z"), strict=True)),
             "orientation": dict(zip("xyzw", ("b/i", "b/j", "b/k", "b/w"), strict=True))}  # fmt: skip
    states = [item for part in names.values() for item in part.values()]
    kind = "pose_broadcaster/PoseBroadcaster"
    _, _, pose = robot_of_sensor_broadcasters(kind, states, interface_names=names)
    assert pose.sample(0).child_frame_id is None
    _, control, pose = robot_of_sensor_broadcasters(
        kind, states, interface_names=names, tf={"child_frame_id": "base", "publish_rate": 5.0}
    )
    assert pose.sample(0).child_frame_id == "base"
    assert any("tf.publish_rate has no effect" in event.text for event in control.events())
    _, _, pose = robot_of_sensor_broadcasters(
        kind, states, interface_names=names, tf={"child_frame_id": "base", "enable": False}
    )
    assert pose.sample(0).child_frame_id is None


def read(**params):
    return read_params(Params.of(params), "power")


def test_the_older_spellings_are_taken():
    assert read(state_joints=["main"], main={"capacity": 2.0}).facts[0].capacity == 2.0
    one = read(sensor_name="pack", design_capacity=8.0, power_supply_technology=2)
    assert one.measured("pack") == ["pack/voltage", *[""] * (len(QUANTITIES) - 1)]
    assert (one.names, one.facts[0].design_capacity, one.facts[0].power_supply_technology) == (("pack",), 8.0, 2)


@pytest.mark.parametrize(
    ("params", "words"),
    [
        ({}, "no 'batteries'; give only batteries under"),
        ({"batteries": ["a"], "sensor_name": "b"}, "both 'sensor_name' and 'batteries'"),
        ({"batteries": ["a", "a"]}, "batteries contains a name twice: a; list"),
        ({"batteries": ["a"], "interfaces": {"a": {"battery_curent": True}}}, "interfaces.a.battery_curent (did you"),
        ({"batteries": ["a"], "interfaces": {"b": {"battery_current": True}}}, "interfaces.b.battery_current"),
        ({"batteries": ["a"], "a": {"minimum_voltage": 9.0, "maximum_voltage": 9.0}}, "a: minimum_voltage is 9"),
        ({"batteries": ["a"], "a": {"power_supply_technology": 9}}, "power_supply_technology"),
    ],
)
def test_what_cannot_be_is_reported(params, words):
    with pytest.raises(RobotConfigError) as caught:
        read(**params)
    assert words in str(caught.value)


TYPE = "battery_state_broadcaster/BatteryStateBroadcaster"


def robot_of_battery_broadcaster(states, **params):
    """Return hardware with these states, and an active broadcaster."""
    hardware = Hardware("l/velocity", states=tuple(states))
    for name, value in states.items():
        hardware.set(name, value)
    control = manager(hardware)
    broadcaster = add(control, "power", TYPE, **params)
    control.switch(["power"], now=0)
    return hardware, control, broadcaster


def test_a_battery_is_reported_with_what_is_read_and_what_is_known_of_it():
    states = {"main/battery_voltage": 24.5, "main/battery_current": -3.0, "main/battery_percentage": 80.0,
              "main/battery_power_supply_status": 2.0, "main/battery_temperature": 31.0}  # fmt: skip
    read = ("battery_current", "battery_percentage", "battery_power_supply_status")
    interfaces = {"main": dict.fromkeys(read, True)}
    _, control, power = robot_of_battery_broadcaster(
        states, batteries=["main"], interfaces=interfaces, main={"capacity": 40.0, "serial_number": "77"}
    )
    control.broadcast(S, 0.01)
    sample = power.sample(0)
    (main,) = sample.batteries
    assert (sample.time, main.name, main.voltage, main.current, main.percentage) == (1.0, "main", 24.5, -3.0, 0.8)
    assert (main.power_supply_status, main.power_supply_health, main.present) == (2, 0, True)
    assert (main.temperature, main.charge, main.capacity, main.serial_number) == (None, None, 40.0, "77")


def test_without_a_percentage_it_is_that_of_the_voltage_where_its_bounds_are_known():
    hardware, _, power = robot_of_battery_broadcaster(
        {"a/battery_voltage": 22.5, "b/battery_voltage": 22.5},
        batteries=["a", "b"],
        a={"minimum_voltage": 20.0, "maximum_voltage": 25.0},
    )
    assert [battery.percentage for battery in power.sample(0).batteries] == [0.5, None]
    hardware.set("a/battery_voltage", math.nan)
    power.update(S, 0.01)
    reported = power.sample(0).batteries[0]
    assert (reported.voltage, reported.percentage, reported.present) == (None, None, False)


def test_all_of_them_are_reported_as_one():
    states = {"a/battery_voltage": 24.0, "a/battery_charge": 10.0, "a/battery_power_supply_health": 1.0,
              "b/battery_voltage": 26.0, "b/battery_charge": 5.0, "b/battery_power_supply_health": 3.0}  # fmt: skip
    expected = {"battery_charge": True, "battery_power_supply_health": True}
    _, _, power = robot_of_battery_broadcaster(
        states,
        batteries=["a", "b"],
        interfaces={"a": expected, "b": expected},
        a={"capacity": 40.0, "power_supply_technology": 3, "location": "left"},
        b={"capacity": 20.0, "power_supply_technology": 3, "location": "right"},
    )
    both = power.sample(0).together
    assert (both.voltage, both.charge, both.capacity, both.current) == (25.0, 15.0, 60.0, None)
    assert (both.power_supply_health, both.power_supply_technology, both.location) == (3, 3, "left, right")
    assert both.present


def test_one_that_reports_whether_it_is_there_is_trusted():
    _, _, power = robot_of_battery_broadcaster(
        {"a/battery_voltage": 24.0, "a/battery_present": 0.0},
        batteries=["a"],
        interfaces={"a": {"battery_present": True}},
    )
    assert not power.sample(0).batteries[0].present


DRIVE = ("nmt_state", "statusword", "error_code", "age", "digital_inputs", "position")
GPIO = "canopen_control/GpioBroadcaster"
DIAGNOSTICS = "canopen_control/DiagnosticsBroadcaster"


def robot(type_name, *extra, **params):
    states = (*(f"{joint}/{name}" for joint in ("l", "r") for name in DRIVE), *extra)
    hardware = Hardware("l/velocity", states=states)
    control = manager(hardware)
    broadcaster = add(control, "b", type_name, **params)
    return hardware, control, broadcaster


def test_inputs_of_all_drives_are_reported_by_themselves():
    hardware, control, gpio = robot(GPIO)
    control.switch(["b"], now=0)
    hardware.set("r/digital_inputs", 5.0)
    control.broadcast(S, 0.01)
    sample = gpio.sample(0)
    assert (sample.time, sample.parts) == (1.0, {"l": {"digital_inputs": None}, "r": {"digital_inputs": 5.0}})
    assert gpio.joints == ("l", "r")
    assert control.list()[0].tells == "gpio"
    assert control.list()[0].is_broadcaster


def test_a_gpio_part_is_reported_whole_when_it_is_named():
    _, control, gpio = robot(GPIO, "io/out", "io/in", joints=["io"])
    control.switch(["b"], now=0)
    assert gpio.sample(0).parts == {"io": {"out": None, "in": None}}


def test_joints_and_interfaces_together_restrict_exactly():
    _, control, gpio = robot(GPIO, joints=["r"], interfaces=["position"])
    assert gpio.state_interface_names() == ["r/position"]
    control.switch(["b"], now=0)
    assert gpio.sample(0).parts == {"r": {"position": None}}


def test_nothing_to_report_is_refused_in_words():
    _, control, _ = robot(GPIO, interfaces=["analog"])
    with pytest.raises(ControlError, match="no joint has a state interface of analog"):
        control.switch(["b"], now=0)


@pytest.mark.parametrize(
    ("values", "level", "message"),
    [
        ({"nmt_state": 5.0, "statusword": 0x27, "error_code": 0.0, "age": 0.02}, 0, "operational"),
        ({"nmt_state": 5.0, "statusword": 0x40, "error_code": 0.0, "age": 0.02}, 1, "not enabled: switch on disabled"),
        ({"nmt_state": 42.0, "statusword": 0x27, "error_code": 0.0, "age": 0.02}, 1, "not ready, NMT state 42"),
        (
            {"nmt_state": 127.0, "statusword": 0x27, "error_code": 0.0, "age": 0.02},
            1,
            "not ready, NMT state pre-operational",
        ),
        ({"nmt_state": 5.0, "statusword": 0x08, "error_code": 0.0, "age": 0.02}, 2, "the drive is in fault"),
        (
            {"nmt_state": 5.0, "statusword": 0x08, "error_code": 0x2310, "age": 0.02},
            2,
            "error code 0x2310 (continuous over-current)",
        ),
        ({"nmt_state": 5.0, "statusword": 0x27, "error_code": 0.0, "age": 0.75}, 3, "no news for 0.75 s"),
        ({}, 3, "no message was received from it"),
    ],
)
def test_the_diagnostics_judge_a_joint_by_what_its_drive_reports(values, level, message):
    hardware, control, diagnostics = robot(DIAGNOSTICS)
    control.switch(["b"], now=0)
    for name, value in values.items():
        hardware.set(f"l/{name}", value)
    assert diagnostics.update(S, 0.02) is ReturnType.OK
    sample = diagnostics.sample(0)
    status = sample.joints[0]
    assert sample.time == 1.0
    assert (status.name, status.level, status.message) == ("l", level, message)
    assert set(status.values) == {"nmt_state", "statusword", "error_code", "age"}
    assert values or status.values["age"] is None


def test_a_broadcaster_runs_after_the_commands_were_sent_and_a_commanding_controller_before():
    hardware = Hardware(states=("a/position",))
    control = manager(hardware)
    states = add(control, "states", "joint_state_broadcaster/JointStateBroadcaster")
    control.switch(["states"], now=0)
    hardware.set("a/position", 1.5)
    control.update(S, 0.01)
    assert states.sample(0).joints == {"a": {"position": None}}
    control.broadcast(S, 0.01)
    assert (states.sample(0).joints, states.stamp) == ({"a": {"position": 1.5}}, S)
