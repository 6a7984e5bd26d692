from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st
from support.control import Hardware, same

from canopen_control.hardware.interfaces import ReturnType
from canopen_control.hardware.transmitted_system import TransmittedSystem
from canopen_control.urdf.transmission import Transmission


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
    found = {each.name: each.value for each in outer.state_interfaces}
    assert same(found["j/position"], angle / reduction + offset)
    assert same(found["j/velocity"], angle / reduction)
    assert same(found["j/effort"], effort * reduction)
    assert found["k/position"] == angle
    for command in outer.command_interfaces:
        command.value = angle
    outer.write(0, 0.01)
    assert same(inner.command_interfaces[0].value, angle * reduction)
    assert same(inner.command_interfaces[1].value, (angle - offset) * reduction)
    assert inner.command_interfaces[2].value == angle


def test_no_command_stays_none_and_the_lifecycle_is_the_components():
    inner, outer = system(Transmission("t", "j", "m", 2.0))
    outer.write(0, 0.01)
    assert all(math.isnan(each.value) for each in inner.command_interfaces)
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
