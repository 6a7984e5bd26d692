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
    states = {each: InterfaceInfo(each, initial_value=start if each == "position" else math.nan) for each in ALL}
    return ControlJoint(
        name, how.pop("parameters", {}), {each: InterfaceInfo(each) for each in commands}, states, **how
    )


def system(*parts, limits=FREE, sensors=(), gpios=(), make_motor=None, **parameters) -> SimulatedSystem:
    joints = {each.name: Joint(each.name, "revolute", "a", each.name, limits=limits) for each in parts}
    tag = Ros2ControlSystem("sim", "system", PLUGINS[0], parameters, tuple(parts), tuple(sensors), tuple(gpios))
    made = SimulatedSystem(tag, joints, make_motor)
    made.configure()
    made.activate()
    return made


def values(made: SimulatedSystem) -> dict[str, float]:
    return {each.name: each.value for each in made.state_interfaces}


def claim(made: SimulatedSystem, name: str, value: float) -> None:
    made.perform_command_mode_switch([name], [])
    next(each for each in made.command_interfaces if each.name == name).value = value


def run(made: SimulatedSystem, ms: int, step: int = 10, start: int = 0) -> None:
    for now in range(start, start + ms + 1, step):
        assert made.read(now * MS, step / 1000) is ReturnType.OK


def test_a_velocity_is_approached_with_the_time_constant():
    made = system(part(), time_constant="0.1")
    claim(made, "j/velocity", 2.0)
    run(made, 90)
    assert values(made)["j/velocity"] == pytest.approx(2.0 * (1 - math.exp(-1)))
    run(made, 2000, start=100)
    assert values(made)["j/velocity"] == pytest.approx(2.0)
    assert values(made)["j/position"] == pytest.approx(2.0 * (2.11 - 0.1), rel=1e-6)  # one time constant behind


@given(st.floats(-20, 20), st.lists(st.integers(1, 200), min_size=1, max_size=10))
def test_how_time_is_cut_into_steps_does_not_matter_for_a_velocity(target, steps):
    fine, coarse = FirstOrderMotor(UrdfLimits()), FirstOrderMotor(UrdfLimits())
    coarse.follow("velocity", target, sum(steps) / 1000)
    for each in steps:
        fine.follow("velocity", target, each / 1000)
    assert fine.position == pytest.approx(coarse.position, abs=1e-9)
    assert fine.velocity == pytest.approx(coarse.velocity, abs=1e-9)


def test_a_position_is_reached_without_overshoot_and_held_when_it_is_released():
    made = system(part(start=0.5))
    assert values(made)["j/position"] == 0.5
    claim(made, "j/position", 1.5)
    highest = 0.0
    for now in range(0, 3000, 10):
        made.read(now * MS, 0.01)
        highest = max(highest, values(made)["j/position"])
    assert values(made)["j/position"] == pytest.approx(1.5, abs=1e-3)
    assert highest <= 1.5 + 1e-3
    made.perform_command_mode_switch([], ["j/position"])
    run(made, 1000, start=3000)
    assert values(made)["j/position"] == pytest.approx(1.5, abs=1e-2)


def test_an_effort_moves_inertia_against_damping():
    made = system(part(), inertia="0.02", damping="0.1")
    claim(made, "j/effort", 0.5)
    run(made, 3000)
    assert values(made)["j/velocity"] == pytest.approx(5.0, rel=1e-3)
    assert values(made)["j/effort"] == pytest.approx(0.5, rel=1e-2)


@given(st.sampled_from(ALL), st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=20))
def test_it_never_leaves_the_limits_of_the_description(interface, commands):
    motor = FirstOrderMotor(UrdfLimits(-1.0, 2.0, 3.0, 4.0), inertia=0.1, damping=1.0)
    for each in commands:
        motor.follow(interface, each, 0.1)
        assert -1.0 <= motor.position <= 2.0
        assert abs(motor.velocity) <= (4.0 if interface == "effort" else 3.0) + 1e-9


def test_without_a_command_and_after_a_release_it_comes_to_rest():
    made = system(part())
    claim(made, "j/velocity", 5.0)
    run(made, 500)
    made.perform_command_mode_switch([], ["j/velocity"])
    run(made, 500, start=510)
    assert values(made)["j/velocity"] == pytest.approx(0.0, abs=1e-6)
    made.perform_command_mode_switch(["j/velocity"], [])
    made.command_interfaces[1].value = math.nan
    run(made, 100, start=1020)
    assert values(made)["j/velocity"] == pytest.approx(0.0, abs=1e-6)


def test_time_that_no_cycle_saw_passes_too():
    made = system(part())
    claim(made, "j/velocity", 1.0)
    made.read(0, 0.01)
    made.read(2_000 * MS, 0.01)
    assert made.simulated_ns == 2_010 * MS
    assert values(made)["j/position"] == pytest.approx(2.01 - 0.02, abs=1e-3)


def test_an_infinite_command_is_an_error():
    made = system(part())
    claim(made, "j/velocity", math.inf)
    assert made.read(0, 0.01) is ReturnType.ERROR


def test_mimic_joints_sensors_and_gpios_follow():
    follower = part("k", commands=(), mimic=Mimic("j", -2.0, 0.5))
    sensor = ControlJoint("imu", {}, {}, {"yaw": InterfaceInfo("yaw", initial_value=0.25)})
    gpio = ControlJoint(
        "io", {}, {"out": InterfaceInfo("out")}, {"out": InterfaceInfo("out"), "in": InterfaceInfo("in")}
    )
    made = system(part(), follower, sensors=[sensor], gpios=[gpio])
    claim(made, "j/velocity", 1.0)
    claim(made, "io/out", 3.0)
    run(made, 1000)
    found = values(made)
    assert found["k/position"] == pytest.approx(-2.0 * found["j/position"] + 0.5)
    assert found["k/velocity"] == pytest.approx(-2.0 * found["j/velocity"])
    assert (found["imu/yaw"], found["io/out"], found["io/in"]) == (0.25, 3.0, 0.0)
    made.prepare_command_mode_switch(["io/out"], [])
    made.perform_command_mode_switch([], ["io/out"])


def test_a_switch_that_makes_no_sense_is_refused():
    made = system(part(commands=("position", "velocity", "acceleration")))
    with pytest.raises(ControlError, match="cannot be commanded together"):
        made.prepare_command_mode_switch(["j/position", "j/velocity"], [])
    with pytest.raises(ControlError, match="supports only position, velocity and effort"):
        made.prepare_command_mode_switch(["j/acceleration"], [])
    with pytest.raises(UnknownInterface):
        made.prepare_command_mode_switch(["k/velocity"], [])


@pytest.mark.parametrize("text", ["0", "-1", "soon", "inf"])
def test_a_parameter_that_is_not_a_number_above_zero_is_refused(text):
    with pytest.raises(RobotConfigError, match="time_constant is"):
        system(part(parameters={"time_constant": text}))


def test_the_lifecycle_goes_there_and_back_and_nothing_moves_outside():
    made = system(part())
    claim(made, "j/velocity", 1.0)
    made.deactivate()
    run(made, 100)
    assert values(made)["j/velocity"] == 0.0
    made.cleanup()
    assert made.state is LifecycleState.UNCONFIGURED
    assert made.read(0, 0.01) is ReturnType.OK
    assert made.write(0, 0.01) is ReturnType.OK
    made.shutdown()
    assert made.state is LifecycleState.FINALIZED


def test_another_engine_can_take_the_motors_place():
    class Rail:
        position = velocity = effort = 0.0

        def follow(self, interface, target, seconds) -> None:
            self.position, self.velocity = self.position + 1.0, target

    made = system(part(), make_motor=lambda limits: Rail())
    claim(made, "j/velocity", 7.0)
    run(made, 10)
    assert (values(made)["j/position"], values(made)["j/velocity"]) == (2.0, 7.0)
