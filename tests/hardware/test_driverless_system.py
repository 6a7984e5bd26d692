from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.errors import ControlError, RobotConfigError, UnknownInterface
from canopen_control.hardware.driverless_system import PLUGINS, FirstOrderMotor, SimulatedSystem
from canopen_control.hardware.interfaces import LifecycleState, ReturnType
from canopen_control.urdf.joint_element import InterfaceInfo, Joint, Mimic, UrdfLimits
from canopen_control.urdf.ros2_control import ControlJoint, Ros2ControlSystem

MS = 1_000_000
FREE = UrdfLimits()
ALL = ("position", "velocity", "effort")


def part(name="j", start=math.nan, commands=ALL, **how) -> ControlJoint:
    states = {item: InterfaceInfo(item, initial_value=start if item == "position" else math.nan) for item in ALL}
    return ControlJoint(
        name, how.pop("parameters", {}), {command: InterfaceInfo(command) for command in commands}, states, **how
    )


def system(*parts, limits=FREE, sensors=(), gpios=(), make_motor=None, **parameters) -> SimulatedSystem:
    joints = {item.name: Joint(item.name, "revolute", "a", item.name, limits=limits) for item in parts}
    tag = Ros2ControlSystem("sim", "system", PLUGINS[0], parameters, tuple(parts), tuple(sensors), tuple(gpios))
    simulated_system = SimulatedSystem(tag, joints, make_motor)
    simulated_system.configure()
    simulated_system.activate()
    return simulated_system


def values(made: SimulatedSystem) -> dict[str, float]:
    return {interface.name: interface.value for interface in made.state_interfaces}


def claim(made: SimulatedSystem, name: str, value: float) -> None:
    made.perform_command_mode_switch([name], [])
    next(interface for interface in made.command_interfaces if interface.name == name).value = value


def run(made: SimulatedSystem, ms: int, step: int = 10, start: int = 0) -> None:
    for now in range(start, start + ms + 1, step):
        assert made.read(now * MS, step / 1000) is ReturnType.OK


def test_a_velocity_is_approached_with_the_time_constant():
    created = system(part(), time_constant="0.1")
    claim(created, "j/velocity", 2.0)
    run(created, 90)
    assert values(created)["j/velocity"] == pytest.approx(2.0 * (1 - math.exp(-1)))
    run(created, 2000, start=100)
    assert values(created)["j/velocity"] == pytest.approx(2.0)
    assert values(created)["j/position"] == pytest.approx(2.0 * (2.11 - 0.1), rel=1e-6)  # one time constant behind


@given(st.floats(-20, 20), st.lists(st.integers(1, 200), min_size=1, max_size=10))
def test_how_time_is_cut_into_steps_does_not_matter_for_a_velocity(target, steps):
    fine, coarse = FirstOrderMotor(UrdfLimits()), FirstOrderMotor(UrdfLimits())
    coarse.follow("velocity", target, sum(steps) / 1000)
    for step in steps:
        fine.follow("velocity", target, step / 1000)
    assert fine.position == pytest.approx(coarse.position, abs=1e-9)
    assert fine.velocity == pytest.approx(coarse.velocity, abs=1e-9)


def test_a_position_is_reached_without_overshoot_and_held_when_it_is_released():
    created = system(part(start=0.5))
    assert values(created)["j/position"] == 0.5
    claim(created, "j/position", 1.5)
    highest = 0.0
    for now in range(0, 3000, 10):
        created.read(now * MS, 0.01)
        highest = max(highest, values(created)["j/position"])
    assert values(created)["j/position"] == pytest.approx(1.5, abs=1e-3)
    assert highest <= 1.5 + 1e-3
    created.perform_command_mode_switch([], ["j/position"])
    run(created, 1000, start=3000)
    assert values(created)["j/position"] == pytest.approx(1.5, abs=1e-2)


def test_an_effort_moves_inertia_against_damping():
    created = system(part(), inertia="0.02", damping="0.1")
    claim(created, "j/effort", 0.5)
    run(created, 3000)
    assert values(created)["j/velocity"] == pytest.approx(5.0, rel=1e-3)
    assert values(created)["j/effort"] == pytest.approx(0.5, rel=1e-2)


@given(st.sampled_from(ALL), st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=20))
def test_it_never_leaves_the_limits_of_the_description(interface, commands):
    motor = FirstOrderMotor(UrdfLimits(-1.0, 2.0, 3.0, 4.0), inertia=0.1, damping=1.0)
    for command in commands:
        motor.follow(interface, command, 0.1)
        assert -1.0 <= motor.position <= 2.0
        assert abs(motor.velocity) <= (4.0 if interface == "effort" else 3.0) + 1e-9


def test_a_velocity_limit_of_zero_is_unknown_and_a_negative_effort_limit_is_a_magnitude():
    motor = FirstOrderMotor(UrdfLimits(velocity=0.0, effort=-0.2), inertia=0.02, damping=0.1)
    motor.follow("velocity", 3.0, 1.0)
    assert motor.velocity == pytest.approx(3.0)
    motor.follow("effort", 0.5, 10.0)
    assert motor.velocity == pytest.approx(2.0), "0.2 Nm against a damping of 0.1"


def test_without_a_command_and_after_a_release_it_comes_to_rest():
    created = system(part())
    claim(created, "j/velocity", 5.0)
    run(created, 500)
    created.perform_command_mode_switch([], ["j/velocity"])
    run(created, 500, start=510)
    assert values(created)["j/velocity"] == pytest.approx(0.0, abs=1e-6)
    created.perform_command_mode_switch(["j/velocity"], [])
    created.command_interfaces[1].value = math.nan
    run(created, 100, start=1020)
    assert values(created)["j/velocity"] == pytest.approx(0.0, abs=1e-6)


def test_time_that_no_cycle_saw_passes_too():
    created = system(part())
    claim(created, "j/velocity", 1.0)
    created.read(0, 0.01)
    created.read(2_000 * MS, 0.01)
    assert created.simulated_ns == 2_010 * MS
    assert values(created)["j/position"] == pytest.approx(2.01 - 0.02, abs=1e-3)


def test_an_infinite_command_is_an_error():
    created = system(part())
    claim(created, "j/velocity", math.inf)
    assert created.read(0, 0.01) is ReturnType.ERROR


def test_mimic_joints_sensors_and_gpios_follow():
    follower = part("k", commands=(), mimic=Mimic("j", -2.0, 0.5))
    sensor = ControlJoint("imu", {}, {}, {"yaw": InterfaceInfo("yaw", initial_value=0.25)})
    gpio = ControlJoint(
        "io", {}, {"out": InterfaceInfo("out")}, {"out": InterfaceInfo("out"), "in": InterfaceInfo("in")}
    )
    created = system(part(), follower, sensors=[sensor], gpios=[gpio])
    claim(created, "j/velocity", 1.0)
    claim(created, "io/out", 3.0)
    run(created, 1000)
    result = values(created)
    assert result["k/position"] == pytest.approx(-2.0 * result["j/position"] + 0.5)
    assert result["k/velocity"] == pytest.approx(-2.0 * result["j/velocity"])
    assert (result["imu/yaw"], result["io/out"], result["io/in"]) == (0.25, 3.0, 0.0)
    created.prepare_command_mode_switch(["io/out"], [])
    created.perform_command_mode_switch([], ["io/out"])


def test_a_switch_that_makes_no_sense_is_refused():
    created = system(part(commands=("position", "velocity", "acceleration")))
    with pytest.raises(ControlError, match="cannot be commanded together"):
        created.prepare_command_mode_switch(["j/position", "j/velocity"], [])
    with pytest.raises(ControlError, match="supports only position, velocity and effort"):
        created.prepare_command_mode_switch(["j/acceleration"], [])
    with pytest.raises(UnknownInterface):
        created.prepare_command_mode_switch(["k/velocity"], [])


@pytest.mark.parametrize("text", ["0", "-1", "soon", "inf"])
def test_a_parameter_that_is_not_a_number_above_zero_is_refused(text):
    with pytest.raises(RobotConfigError, match="time_constant is"):
        system(part(parameters={"time_constant": text}))


def test_the_lifecycle_goes_there_and_back_and_nothing_moves_outside():
    created = system(part())
    claim(created, "j/velocity", 1.0)
    created.deactivate()
    run(created, 100)
    assert values(created)["j/velocity"] == 0.0
    created.cleanup()
    assert created.state is LifecycleState.UNCONFIGURED
    assert created.read(0, 0.01) is ReturnType.OK
    assert created.write(0, 0.01) is ReturnType.OK
    created.shutdown()
    assert created.state is LifecycleState.FINALIZED


def test_another_engine_can_take_the_motors_place():
    class Rail:
        position = velocity = effort = 0.0

        def follow(self, interface, target, seconds) -> None:
            self.position, self.velocity = self.position + 1.0, target

    created = system(part(), make_motor=lambda limits: Rail())
    claim(created, "j/velocity", 7.0)
    run(created, 10)
    assert (values(created)["j/position"], values(created)["j/velocity"]) == (2.0, 7.0)
