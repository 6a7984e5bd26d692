from __future__ import annotations

import pytest
from support.bases import OMNI, base
from support.control import S

STEP = S // 100


def test_its_interfaces_are_upstreams():
    _, _, made = base(OMNI)
    assert made.command_interface_names() == ["a/velocity", "b/velocity", "c/velocity"]
    assert made.state_interface_names() == ["a/position", "b/position", "c/position"]
    _, _, made = base(OMNI, position_feedback=False)
    assert made.state_interface_names() == ["a/velocity", "b/velocity", "c/velocity"]
    _, _, made = base(OMNI, open_loop=True)
    assert made.state_interface_names() == []


@pytest.mark.parametrize("how", [{}, {"position_feedback": False}, {"open_loop": True}])
def test_where_it_drives_is_where_it_believes_to_be(how):
    hardware, control, made = base(OMNI, **how)
    for each in hardware.state_interfaces:
        each.value = 40.0 if each.interface == "position" else 0.0  # wherever the wheels stand at first
    control.switch(["base"], now=1000 * S)
    for step in range(201):
        now = 1000 * S + step * STEP
        control.command("base", [0.1, 0.2, 0.0], now)
        control.update(now, 0.01)
        for each in hardware.command_interfaces:
            position = next(one for one in hardware.state_interfaces if one.name == f"{each.joint}/position")
            position.value += each.value * 0.01
            hardware.set(f"{each.joint}/velocity", each.value)
    sample = made.sample(0)
    assert (sample.x, sample.y) == (pytest.approx(0.2, rel=0.01), pytest.approx(0.4, rel=0.01))
    assert (sample.linear, sample.lateral) == (pytest.approx(0.1), pytest.approx(0.2))


def test_its_wheels_stand_on_no_two_sides():
    _, _, made = base(OMNI)
    assert (made.wheel_base().left, made.wheel_base().separation) == ((), 0.0)
