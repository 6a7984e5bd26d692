"""A joint and its drive axis: values sent to the drive, and their time."""

import math

import pytest
from support.arm6 import copy_arm
from support.robots import LEFT, RIGHT, Bench, copy_robby

from canopen_control.cia402.modes import OperationMode
from canopen_control.cia402.state import State
from canopen_control.errors import RobotConfigError
from canopen_control.hardware.axis_statechart import Action, AxisPhase
from canopen_control.runtime.axis_request import reached


def test_before_its_node_is_there_nothing_is_known_and_nothing_enabled():
    bench = Bench("parts1", drives=())
    joint = bench.joint(LEFT)
    assert (joint.state, joint.statusword, joint.claimed) == (None, None, None)
    assert (joint.enabled, joint.following, joint.enable_requested, joint.homed) == (False, False, False, False)
    assert joint.age_ns(0) is None
    assert joint.has_settled(0)
    assert joint.tracking.figures() is None
    bench.close()


def test_holds_load_is_true_or_false(tmp_path):
    config = copy_arm(tmp_path)
    path, old = config / "arm6.urdf", '<param name="device_name">joint_1_drive</param>'
    path.write_text(path.read_text().replace(old, old + '<param name="holds_load">perhaps</param>'))
    with pytest.raises(RobotConfigError, match="holds_load is 'perhaps'; it must be true or false"):
        Bench("parts2", config=config)


@pytest.fixture
def robby():
    bench = Bench("joint")
    yield bench
    bench.close()


def targets(bench, node_id):
    image = bench.robot.buses["can"].network.image
    return {name: image.output(node_id, index).value for name, index in (("position", 0x607A), ("velocity", 0x60FF))}


def test_before_it_is_enabled_the_target_is_standstill_whatever_is_commanded(robby):
    robby.robot.start()
    joint = robby.joint(LEFT)
    observed = []
    while not joint.enabled:
        joint.commands["velocity"].value = 10.0
        robby.run(20)
        if not joint.enabled:
            observed.append(targets(robby, LEFT)["velocity"])
    assert set(observed) == {0}


def test_the_idle_position_target_is_where_the_drive_is(robby):
    robby.start()
    robby.hold(5.0, 5.0, ms=500)
    robby.hold(0.0, 0.0, ms=500)
    assert targets(robby, RIGHT)["position"] == robby.drives[RIGHT].get(0x6064)


def test_a_node_that_is_not_there_has_no_values(robby):
    robby.start()
    robby.power_off(LEFT)
    robby.until(lambda: not robby.joint(LEFT).node.ready)
    robby.run(40)
    joint = robby.joint(LEFT)
    assert math.isnan(joint.states["velocity"].value)
    assert joint.state is None
    assert joint.statechart.state is AxisPhase.DISABLED


def test_the_mode_of_bus_yml_wins_over_what_the_drive_lists(robby, tmp_path):
    joint = robby.joint(LEFT)
    assert joint.targets.mode_for("velocity") == OperationMode.PV
    config = copy_robby(tmp_path, bus={"velocity_mode: 3": "velocity_mode: 9"})
    other = Bench("joint2", config=config)
    assert other.joint(LEFT).targets.mode_for("velocity") == OperationMode.CSV
    other.close()


@pytest.mark.parametrize(
    ("mapped", "index"), [("{index: 0x6041, sub_index: 0}", 0x6041), ("{index: 0x6040, sub_index: 0}", 0x6040)]
)
def test_what_the_control_loop_needs_must_be_mapped(tmp_path, mapped, index):
    other = "0x60FD" if index == 0x6041 else "0x6081"
    config = copy_robby(tmp_path, bus={mapped: f"{{index: {other}, sub_index: 0}}"})
    with pytest.raises(RobotConfigError, match=rf"left_wheel_joint.*0x{index:04X}"):
        Bench("joint3", config=config)


def test_modes_that_no_pdo_carries_are_written_and_confirmed_by_sdo(tmp_path):
    unmapped = {"{index: 0x6061, sub_index: 0}": "{index: 0x60FD, sub_index: 0}"}
    unmapped["        - {index: 0x6060, sub_index: 0}   # mode of operation\n"] = ""
    bench = Bench("joint5", config=copy_robby(tmp_path, bus=unmapped))
    bench.start()
    bench.hold(5.0, 5.0, ms=500)
    assert bench.drives[LEFT].get(0x6061) == OperationMode.PV
    assert bench.velocity(LEFT) == pytest.approx(5.0, rel=0.01)
    bench.close()


def test_a_command_interface_needs_its_target_in_an_rpdo(tmp_path):
    config = copy_robby(tmp_path, bus={"        - {index: 0x60FF, sub_index: 0}   # target velocity\n": ""})
    with pytest.raises(RobotConfigError, match="0x60FF"):
        Bench("joint4", config=config)


def test_halt_holds_and_enable_continues(robby):
    robby.start()
    robby.hold(5.0, 5.0, ms=500)
    joint = robby.joint(LEFT)
    joint.halt()
    robby.hold(5.0, 5.0, ms=500)
    assert robby.speed(LEFT) == 0
    assert reached(joint, Action.HALT)
    joint.enable()
    robby.hold(5.0, 5.0, ms=500)
    assert robby.velocity(LEFT) == pytest.approx(5.0, rel=0.01)


def test_quick_stop_ends_disabled_or_holding_and_is_not_undone_by_commands(robby):
    robby.start()
    robby.hold(5.0, 5.0, ms=500)
    joint = robby.joint(LEFT)
    joint.quick_stop()
    robby.hold(5.0, 5.0, ms=1000)
    assert robby.speed(LEFT) == 0
    assert joint.state is not State.OPERATION_ENABLED
    assert reached(joint, Action.QUICK_STOP)


def test_standing_still_is_zero_without_a_sign(robby):
    robby.start()
    robby.run(100)
    assert math.copysign(1.0, robby.velocity(LEFT)) == 1.0
