from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.control import DIFF_DRIVE, S, add, same, vectors

from canopen_control.controllers.manager import ControllerManager
from canopen_control.errors import ControlError, UnknownInterface
from canopen_control.hardware.interfaces import InterfaceRegistry, LifecycleState, ReturnType
from canopen_control.hardware.plugins import PLUGINS, GenericSystem
from canopen_control.urdf.description import read_description
from canopen_control.urdf.joint_element import InterfaceInfo, Mimic
from canopen_control.urdf.ros2_control import ControlJoint, Ros2ControlSystem

CASES = vectors("mock_generic_system")


def joint(commands, states, name="j", mimic=None) -> ControlJoint:
    return ControlJoint(
        name,
        {},
        {item: InterfaceInfo(item) for item in commands},
        {each: InterfaceInfo(each, initial_value=value) for each, value in states.items()},
        mimic,
    )


def system(*joints, sensors=(), gpios=(), **parameters) -> GenericSystem:
    text = {key: str(value).lower() for key, value in parameters.items()}
    generic_system = GenericSystem(
        Ros2ControlSystem("mock", "system", PLUGINS[0], text, tuple(joints), tuple(sensors), tuple(gpios))
    )
    generic_system.configure()
    generic_system.activate()
    return generic_system


def values(made: GenericSystem) -> dict[str, float]:
    return {item.interface: item.value for item in made.state_interfaces}


def command(made: GenericSystem, name: str, value: float) -> None:
    next(interface for interface in made.command_interfaces if interface.name == name).value = value


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["name"])
def test_it_behaves_as_upstream_does(case):
    given_joint = case.get("joint", {"cmd": ["velocity"], "state": {"velocity": 0.0}})
    states = dict(given_joint["state"])
    if case["params"].get("calculate_dynamics"):
        states = {**dict.fromkeys(("position", "velocity", "acceleration"), 0.0), **states}
    created = system(joint(given_joint["cmd"], states), **case["params"])
    if "mode" in case:
        created.prepare_command_mode_switch([f"j/{case['mode']}"], [])
        created.perform_command_mode_switch([f"j/{case['mode']}"], [])
    for index, (_, period, targets) in enumerate(case["steps"]):
        for name, value in targets.items():
            command(created, f"j/{name}", value)
        result = created.read(0, period)
        if case["expect"] == "ERROR":
            assert result is ReturnType.ERROR
            continue
        assert result is ReturnType.OK
        for name, value in case["expect"][index].items():
            assert same(values(created)[name], value, 1e-4), name


def test_states_without_an_initial_value_start_at_zero_and_positions_at_the_offset():
    created = system(joint(["position"], {"position": math.nan, "velocity": math.nan}), state_following_offset=2.5)
    assert values(created) == {"position": 2.5, "velocity": 0.0}
    with pytest.raises(ControlError, match="position_state_following_offset is 'x'"):
        system(position_state_following_offset="x")


def test_what_is_released_is_at_standstill():
    created = system(joint(["velocity"], {"position": 0.0, "velocity": 0.0}), calculate_dynamics=True)
    created.perform_command_mode_switch(["j/velocity"], [])
    command(created, "j/velocity", 3.0)
    created.read(0, 0.5)
    created.perform_command_mode_switch([], ["j/velocity"])
    command(created, "j/velocity", math.nan)
    created.read(0, 0.5)
    assert values(created) == {"position": 1.5, "velocity": 0.0}


def test_with_dynamics_two_kinds_of_motion_of_one_joint_are_refused_and_without_they_are_not():
    kinds = ["position", "velocity"]
    moving = system(joint(kinds, {}), calculate_dynamics=True)
    with pytest.raises(ControlError, match="cannot be commanded together"):
        moving.prepare_command_mode_switch(["j/position", "j/velocity"], [])
    still = system(joint(kinds, {"position": 0.0, "velocity": 0.0}))
    still.prepare_command_mode_switch(["j/position", "j/velocity"], [])
    with pytest.raises(UnknownInterface):
        still.prepare_command_mode_switch(["k/position"], [])
    command(still, "j/position", 1.0)
    command(still, "j/velocity", 2.0)
    still.read(0, 0.1)
    assert values(still) == {"position": 1.0, "velocity": 2.0}


def test_a_mimic_joint_follows():
    leader = joint(["velocity"], {"position": 0.0, "velocity": 0.0})
    follower = joint([], {"position": 0.0, "velocity": 0.0}, "f", Mimic("j", -2.0, 0.5))
    created = system(leader, follower, calculate_dynamics=True)
    created.perform_command_mode_switch(["j/velocity"], [])
    command(created, "j/velocity", 1.0)
    created.read(0, 0.5)
    assert [interface.value for interface in created.state_interfaces] == [0.5, 1.0, -0.5, -2.0]


def test_sensors_and_gpios_can_be_commanded_if_asked_for():
    sensor, gpio = joint([], {"force": 0.0}, "s"), joint(["out"], {"out": 0.0, "in": 0.0}, "g")
    plain = system(sensors=[sensor], gpios=[gpio])
    assert [interface.name for interface in plain.command_interfaces] == ["g/out"]
    mocked = system(sensors=[sensor], gpios=[gpio], mock_sensor_commands=True, mock_gpio_commands=True)
    assert [interface.name for interface in mocked.command_interfaces] == ["s/force", "g/out", "g/in"]
    command(mocked, "s/force", 4.0)
    command(mocked, "g/out", 1.0)
    mocked.read(0, 0.1)
    assert values(mocked) == {"force": 4.0, "out": 1.0, "in": 0.0}


def test_the_lifecycle_goes_its_ways_and_reached_states_are_not_errors():
    generic_system = GenericSystem(Ros2ControlSystem("mock", "system", PLUGINS[0]))
    generic_system.activate()
    assert generic_system.state is LifecycleState.UNCONFIGURED
    for _ in range(2):
        generic_system.configure()
        assert generic_system.state is LifecycleState.INACTIVE
    for _ in range(2):
        generic_system.activate()
        assert generic_system.state is LifecycleState.ACTIVE
    generic_system.cleanup()
    assert generic_system.state is LifecycleState.UNCONFIGURED
    generic_system.shutdown()
    assert generic_system.state is LifecycleState.FINALIZED
    assert generic_system.write(0, 0.1) is ReturnType.OK


def test_robby_without_hardware_drives_where_it_is_reported(config_folder):
    description = read_description(config_folder / "robby.urdf.xacro", mappings={"use_mock_hardware": "true"})
    generic_system = GenericSystem(description.hardware[0])
    assert description.hardware[0].plugin in PLUGINS
    registry = InterfaceRegistry()
    registry.register(generic_system)
    generic_system.configure()
    generic_system.activate()
    control = ControllerManager(registry, 50, joints=description.movable_joints)
    base = add(
        control,
        "base",
        DIFF_DRIVE,
        left_wheel_names=["left_wheel_joint"],
        right_wheel_names=["right_wheel_joint"],
        wheel_separation=0.24,
        wheel_radius=0.035,
        cmd_vel_timeout=0.0,
    )
    control.switch(["base"], now=0)
    control.command("base", [0.2, math.pi / 2], 0)
    for step in range(1, 4 * 50 + 2):
        generic_system.read(step * S // 50, 0.02)
        control.update(step * S // 50, 0.02)
        generic_system.write(step * S // 50, 0.02)
    assert math.hypot(base.odometry.x, base.odometry.y) < 1e-9
    assert same(base.odometry.heading, 2 * math.pi)


@pytest.fixture
def config_folder():
    from pathlib import Path

    return Path(__file__).parents[2] / "config" / "robby"


@given(st.lists(st.tuples(st.floats(-1e3, 1e3) | st.just(math.nan), st.floats(1e-3, 1.0)), max_size=30))
def test_a_velocity_is_integrated_whatever_comes(steps):
    created = system(joint(["velocity"], {"position": 1.0, "velocity": 0.0}), calculate_dynamics=True)
    created.perform_command_mode_switch(["j/velocity"], [])
    expected = 1.0
    for value, period in steps:
        command(created, "j/velocity", value)
        assert created.read(0, period) is ReturnType.OK
        expected += 0.0 if math.isnan(value) else value * period
        assert same(values(created)["position"], expected)
