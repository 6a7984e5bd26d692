"""The claimed interface, its mode and its target; every mode under a controller, and its stop."""

import itertools
import math
from types import SimpleNamespace

import pytest
from support.generic import write_generic
from support.makers import drive
from support.observers import Observer
from support.robots import Bench
from support.servos import DECELERATION, command

from canopen_control.cia402.modes import TARGET_OBJECTS, OperationMode
from canopen_control.cia402.state import State
from canopen_control.cia402.units import PositionUnwrapper, Scale
from canopen_control.errors import UnsupportedMode
from canopen_control.hardware.axis import AxisObjectLimits
from canopen_control.hardware.axis_statechart import Action
from canopen_control.hardware.joint_targets import TARGET_CLASSES, ModeTarget, stop_slope

K = 65536 / math.tau  # counts per rad, and per rad/s
LIMIT = 0.8  # rad/s


@pytest.fixture
def robby(tmp_path):
    bench = Bench("targets", config=write_generic(tmp_path), drives=(2, 3), controllers=["velocity"])
    bench.start()
    yield bench
    bench.close()


def test_a_claim_brings_its_mode_and_its_command(robby):
    targets = robby.joint(2).targets
    assert targets.claimed == "velocity"
    assert targets.mode == OperationMode.CSV
    assert targets.mode_serves(OperationMode.PP) == "position"
    assert targets.mode_serves(OperationMode.HM) is None


def test_a_new_mode_of_an_enabled_drive_waits_for_a_standstill_and_a_cycle_at_rest(robby):
    robby.robot.command("velocity", [1.0, 1.0], "test")
    robby.run(300)
    joint = robby.joint(2)
    joint.targets.claim("position")
    assert joint.targets.pending == OperationMode.CSP
    assert joint.machine.mode == OperationMode.CSV
    robby.until(lambda: joint.targets.pending is None)
    assert joint.at_standstill
    assert joint.axis.output(0x607A).value == pytest.approx(joint.axis.raw_position, abs=500)
    assert joint.axis.output(0x60FF).value == 0
    robby.run(100)
    assert joint.machine.mode == OperationMode.CSP
    assert joint.enabled


def test_a_mode_that_the_drive_lacks_is_refused(robby):
    with pytest.raises(UnsupportedMode):
        robby.joint(2).targets.set_mode(OperationMode.CSTCA)


def test_the_limits_of_the_description_hold(robby):
    joint = robby.joint(2)
    command = joint.commands["velocity"]
    command.minimum, command.maximum = -0.5, 0.25
    for value, expected in ((1.0, 0.25), (-1.0, -0.5), (0.1, 0.1)):
        robby.robot.command("velocity", [value, value], "test")
        robby.run(20)
        assert joint.axis.output(0x60FF).value == pytest.approx(expected * 65536 / math.tau, abs=1)


def test_a_joint_outside_its_range_is_held_where_it_is(servo):
    """A controller that holds the position commands the actual position, which is no command to move."""
    robby = servo("position")
    joint = robby.joint(2)
    joint.commands["position"].minimum, joint.commands["position"].maximum = 0.5, 1.0
    for value, expected in ((0.0, 0.0), (-1.0, 0.0), (0.1, 0.1), (0.0, 0.1), (0.7, 0.7), (0.0, 0.5)):
        command(robby, "position", value, 600)
        assert robby.drives[2].get(0x6064) == pytest.approx(expected * K, abs=2)


def test_a_mode_that_does_not_serve_the_claim_follows_nothing(robby):
    joint = robby.joint(2)
    joint.targets.take_mode(OperationMode.PP)
    robby.robot.command("velocity", [1.0, 1.0], "test")
    robby.run(200)
    assert joint.axis.output(0x60FF).value == 0
    assert joint.targets.handshakes


def test_what_a_boot_read_is_not_a_target_of_an_axis_that_has_moved_since(robby):
    targets = robby.joint(2).targets
    targets.take_mode(OperationMode.CSP)
    targets.hold()
    output, here = targets.current.output, robby.joint(2).axis.raw_position
    output.record(here + 2370)  # as the presets of a boot do
    targets.hold()
    assert output.value == here + 2370  # a held target is not written again
    targets.node_ready()
    targets.hold()
    assert output.value == here


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


@pytest.mark.rest
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


@pytest.mark.rest
def test_a_position_jump_in_csp_is_made_with_the_largest_velocity(servo):
    robby = servo("position", sdo="- {index: 0x607F, sub_index: 0, value: 20000}")
    fastest = []
    robby.robot.observers.append(Observer(after_cycle=lambda _now: fastest.append(abs(robby.speed(2)))))
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
    robby.robot.observers.append(Observer(after_cycle=lambda _now: fastest.append(abs(robby.speed(2)))))
    robby.run(1500)
    assert robby.drives[2].get(0x6061) == 8
    assert abs(robby.drives[2].get(0x6064) - here) < 65536 / 4
    assert max(fastest) < 2.2 * 65536 / math.tau
    assert not robby.found("fault")


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


def test_a_ramp_of_the_drive_that_is_too_fast_is_lowered_before_the_first_set_point(servo):
    robby = servo("position", "position_mode: 1", velocity=LIMIT)
    assert robby.drives[2].get(0x6081) == int(LIMIT * K)
    assert (
        "0x6081 was reduced from 65536 to 8344, the velocity limit of the description" in robby.texts("parameters")[0]
    )


def test_a_ramp_of_the_drive_that_is_slower_stays(servo):
    robby = servo("position", "position_mode: 1", velocity=10.0)
    assert robby.drives[2].get(0x6081) == 65536
    assert robby.texts("parameters") == []


def test_a_position_in_other_units_than_the_velocity_is_bounded_as_well(servo):
    """0x60FF in rpm: the steps of CSP are of position counts."""
    units = "scale_vel_to_dev: 9.549296585513721\n  scale_vel_from_dev: 0.10471975511965977\n  "
    units += f"scale_pos_to_dev: {K}\n  scale_pos_from_dev: {1 / K}"
    robby = servo("position", velocity=LIMIT, extra=units)
    targets = []
    robby.robot.observers.append(
        Observer(after_cycle=lambda _now: targets.append(robby.joint(2).axis.output(0x607A).value))
    )
    command(robby, "position", 50.0, 1000)
    steps = [b - a for a, b in itertools.pairwise(targets)]
    assert max(steps) in (int(LIMIT * K / 100), int(LIMIT * K / 100) + 1)
    assert targets[-1] - targets[0] == pytest.approx(LIMIT * K * 0.98, rel=0.03)


@pytest.mark.rest
def test_a_pace_below_a_count_in_a_cycle_is_kept_too(servo):
    robby = servo("position", velocity=0.002)  # 20.9 counts per s
    first = robby.joint(2).axis.output(0x607A).value
    command(robby, "position", 50.0, 5000)
    assert robby.joint(2).axis.output(0x607A).value - first == pytest.approx(5 * 0.002 * K, abs=2)


@pytest.mark.rest
def test_a_target_that_is_slowed_down_is_reported_once_for_each_occasion(servo):
    robby = servo("velocity", velocity=LIMIT)
    command(robby, "velocity", 6.0, 1000)
    for value in (6.1, 6.2, 6.3):
        command(robby, "velocity", value, 300)
    assert len(robby.texts("held_back")) == 2  # of two joints
    assert "the target of one exceeds the velocity limit of the description" in robby.texts("held_back")[0]
    command(robby, "velocity", 0.5, 2000)
    command(robby, "velocity", 6.0, 300)
    assert len(robby.texts("held_back")) == 4


def test_a_velocity_limit_of_zero_is_one_that_is_not_given(servo):
    robby = servo("velocity", velocity=0)
    command(robby, "velocity", 2.0, 1000)
    assert robby.speed(2) == pytest.approx(2.0 * K, rel=0.02)


def axis(deceleration=math.inf):
    return SimpleNamespace(limits=SimpleNamespace(deceleration=deceleration, blocked=0))


class Mode(ModeTarget):
    hold = follow = ramp_down = value_range = None


@pytest.mark.sources
@pytest.mark.parametrize(("reported", "slope"), [(4000.0, 4000.0), (math.inf, 200.0), (0.0, 200.0), (math.nan, 200.0)])
def test_a_drive_that_reports_no_deceleration_is_stopped_in_half_a_second(reported, slope):
    assert stop_slope(axis(reported), 100) == slope


@pytest.mark.sources  # compiled classes have no interpreted subclasses
def test_a_mode_without_limits_or_events_of_its_own_has_none():
    target = Mode(axis(), SimpleNamespace(value=0), SimpleNamespace())
    assert not target.commands_into_limit(1.0)
    assert target.events() == ()


@pytest.mark.sources  # compiled classes take no stand-ins
def test_a_mode_without_its_own_target_cannot_be_made():
    with pytest.raises(TypeError, match="abstract methods follow, hold, ramp_down, value_range"):
        ModeTarget(axis(), SimpleNamespace(value=0), SimpleNamespace())


def test_every_mode_whose_target_is_known_has_its_class():
    assert TARGET_CLASSES.keys() == TARGET_OBJECTS.keys()


@pytest.mark.sources
@pytest.mark.parametrize("mode", [OperationMode.CSP, OperationMode.IP])
def test_a_position_at_every_sync_stays_within_the_software_limits(mode):
    output = SimpleNamespace(value=0)
    output.set = lambda value: setattr(output, "value", value)
    axis = SimpleNamespace(
        limits=AxisObjectLimits(),
        unwrap=PositionUnwrapper(),
        scale=Scale(1000.0, 0.001),
        raw_position=0,
        out_of_range=math.nan,
    )
    axis.unwrap.update(0)
    axis.limits.low, axis.limits.high = -200, 300
    target = TARGET_CLASSES[mode](axis, output, SimpleNamespace())
    for value, end in ((5.0, 300), (-5.0, -200), (0.1, 100)):
        for _ in range(3):
            target.follow(value, 0, 0.02)
        assert output.value == end


@pytest.mark.rest
@pytest.mark.parametrize(
    ("interface", "key", "value"),
    [
        ("velocity", "velocity_mode: 9", 6.0),
        ("velocity", "velocity_mode: 3", 6.0),
        ("velocity", "velocity_mode: 2", 6.0),
        ("position", "position_mode: 8", 50.0),
        ("position", "position_mode: 1", 50.0),
        ("position", "position_mode: 7", 50.0),
        ("effort", "effort_mode: 10", 300.0),
        ("effort", "effort_mode: 4", 300.0),
    ],
)
@pytest.mark.parametrize("sign", [1, -1])
def test_the_velocity_limit_of_the_description_holds_in_every_mode(servo, interface, key, value, sign):
    robby = servo(interface, key, velocity=LIMIT)
    speeds = []
    robby.robot.observers.append(Observer(after_cycle=lambda _now: speeds.append(sign * robby.speed(2) / K)))
    command(robby, interface, sign * value, 3000)
    # a torque is judged by what it did, and TQ takes it away along its slope (0x6087)
    assert max(speeds) < (1.2 if interface == "effort" else 1.03) * LIMIT
    assert max(speeds) > 0.8 * LIMIT


@pytest.mark.parametrize("after", [2.0, 0.1])
@pytest.mark.parametrize("end", ["halt", "stop"])
def test_an_enable_after_a_halt_or_a_stop_does_not_resume_the_old_set_point(robot, end, after):
    """A drive in PP keeps its set-point while the halt bit is set, and continues to it afterwards."""
    created = robot("pp")
    created.command("pos", 2.5, 2.5, seconds=1)
    created.run(1)
    if end == "halt":
        created.do("axis", name="halt")
    else:
        created.stop()
    created.run(after)
    created.enable()
    created.until(lambda: created.state == "running", 5)
    assert created.stopped_within(0.1)
    position = created.position("pan")
    created.run(2)
    assert created.position("pan") == position < 1.5
    created.command("pos", 1.6, 1.6, seconds=3)
    created.run(3)
    assert created.position("pan") == pytest.approx(1.6, abs=0.01)
    assert created.breaches == []


def _speeds(created, seconds=1.5):
    """Return the speeds of the first drive, one for each SYNC, in counts/s."""
    speeds = []
    for _ in range(round(seconds * 100)):
        created.run(0.01)
        speeds.append(drive(created, 2).mover.plant.velocity)
    return speeds


@pytest.mark.parametrize("first", ["pv", "csv"])
def test_an_axis_that_turns_is_ramped_down_before_it_enters_a_mode_without_a_ramp(robot, first):
    """In CSP a drive would stop at once, and reverse, since its position is older than the mode."""
    created = robot(first, "csp")
    created.command("vel", 1.0, 1.0, seconds=5)
    created.run(1)
    created.activate("pos")
    speeds = _speeds(created)
    steps = [before - after for before, after in itertools.pairwise(speeds) if before > 30_000]
    assert max(steps) == pytest.approx(9000, rel=0.1)  # 0x6084: 900000 counts/s^2
    assert min(speeds) > -26_000  # less than the speed of a standstill
    assert speeds[-1] == 0.0
    assert drive(created, 2).modes.number == OperationMode.CSP
    assert created.state == "running"
    created.command("pos", created.position("pan") + 0.01, created.position("tilt"))
    created.run(0.05)
    assert created.breaches == []


@pytest.mark.parametrize("mode", ["csv", "pv"])
def test_an_axis_that_turns_is_ramped_down_before_it_is_homed(robot, mode):
    created = robot(mode)
    created.command("vel", 1.0, 1.0, seconds=5)
    created.run(1)
    answers = []
    created.simulated.core.axis(Action.HOME, "pan_drive", answers.append, method=37)
    speeds = _speeds(created, 3.0)
    assert max(before - after for before, after in itertools.pairwise(speeds)) < 9900
    assert min(speeds) > -1000
    assert answers == [None]


def test_a_stop_during_the_ramp_before_a_mode_change_ends_disabled(robot):
    created = robot("csv", "csp")
    created.command("vel", 1.0, 1.0, seconds=5)
    created.run(1)
    created.activate("pos")
    created.run(0.1)
    created.stop()
    speeds = _speeds(created)
    assert max(before - after for before, after in itertools.pairwise(speeds) if before > 30_000) < 9900
    assert speeds[-1] == 0.0
    assert drive(created, 2).state is State.SWITCH_ON_DISABLED
    created.enable()
    created.until(lambda: created.state == "running", 3)
    assert drive(created, 2).modes.number == OperationMode.CSP
    assert created.breaches == []
