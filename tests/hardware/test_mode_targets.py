"""Every mode of operation under a controller: what the drive gets, and how it comes to rest."""

import math

import pytest
from support.servos import DECELERATION, command

from canopen_control.hardware.mode_targets import MODES, target_address


@pytest.mark.parametrize(("key", "mode"), [("", 9), ("velocity_mode: 3", 3), ("velocity_mode: 2", 2)])
def test_velocity_by_csv_else_pv_else_vl(servo, key, mode):
    robby = servo("velocity", key)
    command(robby, "velocity", 2.0, 1000)
    assert robby.drives[2].get(0x6061) == mode
    assert robby.joint(2).states["velocity"].value == pytest.approx(2.0, rel=0.02)
    command(robby, "velocity", -1.0, 1000)
    assert robby.joint(2).states["velocity"].value == pytest.approx(-1.0, rel=0.06)  # VL counts whole rpm


@pytest.mark.parametrize(("key", "mode"), [("", 10), ("effort_mode: 4", 4)])
def test_effort_by_cst_else_tq(servo, key, mode):
    robby = servo("effort", key)
    command(robby, "effort", 100.0, 300)
    assert robby.drives[2].get(0x6061) == mode
    assert robby.drives[2].get(0x6071) == 100
    assert robby.joint(2).states["effort"].value == pytest.approx(0.1)
    robby.robot.stop(lambda _error: None)
    robby.run(30)
    assert robby.drives[2].get(0x6071) == 0


@pytest.mark.parametrize(
    ("controller", "key"),
    [("velocity", ""), ("velocity", "velocity_mode: 3"), ("position", ""), ("position", "position_mode: 7")],
)
def test_a_stop_is_a_ramp_in_every_mode(servo, controller, key):
    """In CSV, CSP and IP the master makes it: the drive would stop as fast as it can."""
    robby = servo(controller, key)
    value = 0.0
    for _ in range(100):
        value = value + 0.02 if controller == "position" else 2.0
        command(robby, controller, value, 10)
    fast = abs(robby.speed(2))
    assert fast == pytest.approx(2.0 * 65536 / math.tau, rel=0.03)
    begin = robby.reactor.now()
    robby.robot.stop(lambda _error: None)
    steps, last = [], fast
    while not robby.standing(2):
        robby.run(10)
        steps.append(last - abs(robby.speed(2)))
        last = abs(robby.speed(2))
    took = (robby.reactor.now() - begin) / 1e9
    assert took == pytest.approx(2.0 / DECELERATION, abs=0.05)
    assert max(steps) <= 262144 * 0.01 * 1.6, "no jump"
    assert not robby.found("fault")
    robby.disabled_after()


def test_digital_outputs_and_inputs_travel_where_they_are_mapped(servo):
    robby = servo("velocity")
    robby.joint(2).commands["digital_outputs"].value = float(0x30001)
    robby.run(50)
    assert robby.drives[2].get(0x60FE, 1) == 0x30001
    robby.drives[2].drives[0].set_inputs(1 << 16, robby.reactor.now())
    robby.run(50)
    states = robby.joint(2).states
    assert states["digital_inputs"].value == 1 << 16
    assert states["nmt_state"].value == 5
    assert states["statusword"].value == robby.joint(2).statusword
    assert 0 <= states["age"].value <= 0.02
    assert states["error_code"].value == 0


def test_every_mode_with_a_target_knows_its_object():
    assert {mode: target_address(mode)[0] for mode in MODES} == {
        1: 0x607A, 2: 0x6042, 3: 0x60FF, 4: 0x6071, 7: 0x60C1, 8: 0x607A, 9: 0x60FF, 10: 0x6071,
    }  # fmt: skip
    assert target_address(6) is None
    assert target_address(-3) is None
