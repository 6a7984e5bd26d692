from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st
from support.control import Hardware, same
from support.robots import Bench

from canopen_control.hardware.axis_statechart import Action
from canopen_control.hardware.interfaces import ReturnType
from canopen_control.hardware.plugins import TransmittedSystem
from canopen_control.urdf.ros2_control import Transmission


def system(transmission: Transmission) -> tuple[Hardware, TransmittedSystem]:
    inner = Hardware(
        "j/velocity", "j/position", "k/velocity", states=("j/position", "j/velocity", "j/effort", "k/position")
    )
    return inner, TransmittedSystem(inner, [transmission])


RATIOS = st.floats(0.01, 1000.0).map(lambda each: -each) | st.floats(0.01, 1000.0)


@given(RATIOS, st.floats(-10.0, 10.0), st.floats(-1e4, 1e4), st.floats(-1e3, 1e3))
def test_the_motor_turns_reduction_times_as_far_as_the_joint(reduction, offset, angle, effort):
    inner, outer = system(Transmission("t", "j", "m", reduction, offset))
    for name, value in (("j/position", angle), ("j/velocity", angle), ("j/effort", effort), ("k/position", angle)):
        inner.set(name, value)
    assert outer.read(0, 0.01) is ReturnType.OK
    result = {interface.name: interface.value for interface in outer.state_interfaces}
    assert same(result["j/position"], angle / reduction + offset)
    assert same(result["j/velocity"], angle / reduction)
    assert same(result["j/effort"], effort * reduction)
    assert result["k/position"] == angle
    for command in outer.command_interfaces:
        command.value = angle
    outer.write(0, 0.01)
    assert same(inner.command_interfaces[0].value, angle * reduction)
    assert same(inner.command_interfaces[1].value, (angle - offset) * reduction)
    assert inner.command_interfaces[2].value == angle


def test_no_command_stays_none_and_the_lifecycle_is_the_components():
    inner, outer = system(Transmission("t", "j", "m", 2.0))
    outer.write(0, 0.01)
    assert all(math.isnan(interface.value) for interface in inner.command_interfaces)
    outer.deactivate()
    assert outer.state is inner.state
    outer.cleanup()
    outer.configure()
    outer.activate()
    outer.prepare_command_mode_switch(["j/velocity"], [])
    outer.perform_command_mode_switch(["j/velocity"], ["k/velocity"])
    assert inner.calls == [("prepare", ("j/velocity",), ()), ("perform", ("j/velocity",), ("k/velocity",))]
    outer.shutdown()
    assert outer.state is inner.state
    assert outer.simulated_ns is None
    inner.simulated_ns = 5
    assert outer.simulated_ns == 5


def test_bounds_are_those_of_the_joint_on_its_side_and_are_turned_for_the_motor():
    inner = Hardware("j/velocity", "j/position", "k/velocity")
    for interface in inner.command_interfaces:
        interface.minimum, interface.maximum = -1.0, 2.0
    outer = TransmittedSystem(inner, [Transmission("t", "j", "m", -10.0, 0.5)])
    assert [(interface.minimum, interface.maximum) for interface in outer.command_interfaces] == [(-1.0, 2.0)] * 3
    result = [(interface.minimum, interface.maximum) for interface in inner.command_interfaces]
    assert result == [(-20.0, 10.0), (-15.0, 15.0), (-1.0, 2.0)]


def test_what_no_transmission_turns_is_the_components_own():
    inner, outer = system(Transmission("t", "j", "m", 2.0, 0.0))
    assert outer.command_interfaces[2] is inner.command_interfaces[2]
    assert outer.state_interfaces[3] is inner.state_interfaces[3]
    assert outer.command_interfaces[0] is not inner.command_interfaces[0]


def test_a_joint_reports_that_its_drive_follows_no_commands():
    inner, outer = system(Transmission("t", "j", "m", 2.0, 0.0))
    for enabled in (False, True):
        inner.command_interfaces[0].enabled = enabled
        outer.command_interfaces[0].excluded = True
        outer.read(0, 0.01)
        assert outer.command_interfaces[0].enabled is enabled
    assert not outer.command_interfaces[0].excluded


def test_a_wheel_behind_a_gear_does_not_turn_on_by_an_enable_with_the_command_from_before_its_fault():
    bench = Bench("transmitted", config="mobile_base_ros1", drives=(2, 3), controllers=["wheels_velocity_controller"])
    try:
        bench.start()
        bench.until(lambda: all(joint.enabled for joint in bench.robot.joints.values()))
        bench.robot.command("wheels_velocity_controller", [0.3, 0.3], "test")
        bench.run(300)
        assert abs(bench.speed(2)) > 10000
        switches = bench.drives[2].fault_switches
        for on in (True, False):
            switches.set("drive_fault", on, bench.reactor.now())
            bench.run(200)
        for action in (Action.FAULT_RESET, Action.ENABLE):
            bench.robot.axis(action, "all", lambda _error: None)
            bench.run(300)
        assert all(joint.enabled for joint in bench.robot.joints.values())
        assert (bench.speed(2), bench.speed(3)) == (0, 0)
        bench.robot.command("wheels_velocity_controller", [0.3, 0.3], "test")
        bench.run(300)
        assert abs(bench.speed(2)) > 10000
    finally:
        bench.close()
