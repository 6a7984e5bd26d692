"""Targets that are positions: by CSP, IP or PP, and never faster than the drive goes."""

import math

import pytest
from support.servos import command


@pytest.mark.parametrize(("key", "mode"), [("", 8), ("position_mode: 1", 1), ("position_mode: 7", 7)])
def test_position_by_csp_else_pp_else_ip(servo, key, mode):
    robby = servo("position", key)
    value = 0.0
    for step in range(300):  # a slow path: IP has no ramp of its own
        value = min(0.5, step * 0.002)
        command(robby, "position", value, 10)
    robby.run(500)
    assert robby.drives[2].get(0x6061) == mode
    assert robby.joint(2).states["position"].value == pytest.approx(0.5, abs=0.001)
    assert not robby.found("fault")


def test_a_position_jump_in_csp_is_made_with_the_largest_velocity(servo):
    robby = servo("position", sdo="- {index: 0x607F, sub_index: 0, value: 20000}")
    fastest = []
    robby.robot.after_cycle.append(lambda _now: fastest.append(abs(robby.speed(2))))
    command(robby, "position", 5.0, 4000)
    assert robby.joint(2).states["position"].value == pytest.approx(5.0, abs=0.01)
    assert max(fastest) <= 20500


def test_without_a_command_an_enabled_axis_stays_where_it_is(servo):
    robby = servo("position")
    before = robby.drives[2].get(0x6064)
    robby.run(500)
    assert robby.drives[2].get(0x6064) == before
    assert robby.joint(2).enabled


def test_a_new_mode_finds_its_target_at_the_actual_position(servo):
    robby = servo("velocity")
    command(robby, "velocity", 2.0, 1000)
    here = robby.drives[2].get(0x6064)
    robby.robot.switch(["position"], ["velocity"], strict=True)
    fastest = []
    robby.robot.after_cycle.append(lambda _now: fastest.append(abs(robby.speed(2))))
    robby.run(1500)
    assert robby.drives[2].get(0x6061) == 8
    assert abs(robby.drives[2].get(0x6064) - here) < 65536 / 4
    assert max(fastest) < 2.2 * 65536 / math.tau
    assert not robby.found("fault")
