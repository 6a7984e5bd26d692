"""The claimed interface, its mode and its target; changes between modes."""

import itertools
import math
from dataclasses import dataclass

import pytest
from support.generic import write_generic
from support.makers import drive, sentences
from support.observers import Observer
from support.robots import Bench
from support.servos import command, start_servos

from canopen_control.cia402.modes import OperationMode
from canopen_control.cia402.state import State
from canopen_control.errors import UnsupportedMode
from canopen_control.hardware.axis_statechart import Action, AxisPhase
from canopen_control.virtual.plant import LagPlant, LoadedPlant

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
    """A controller that holds the position commands the actual position, which does not command a motion."""
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


def test_an_axis_that_coasts_without_an_effort_never_enters_csp_while_it_turns(robot):
    """A torque of 0 does not brake: after five seconds this is reported, and the stop of the group ends it."""
    created = robot("cst", "csp")
    for node_id in (2, 3):
        mover = drive(created, node_id).mover
        mover.plant = LagPlant(position=mover.plant.position, velocity=500_000.0, coast_time_constant=100.0)
    created.command("eff", 0.0, 0.0, seconds=20)
    created.run(0.1)
    created.activate("pos")
    for _ in range(180):
        created.run(0.1)
        axis = drive(created, 2)
        turns = axis.state is State.OPERATION_ENABLED and abs(axis.mover.plant.velocity) > 26_000
        assert not turns or axis.modes.number == OperationMode.CST
    assert any("pan_drive" in text and "it still turns 5 s after" in text for text in sentences(created))
    assert drive(created, 2).modes.number == OperationMode.CSP
    assert created.state != "running"


@dataclass(slots=True)
class YieldingPlant(LoadedPlant):
    """A motor whose loops have no integrator: it yields to its load by a distance from its target."""

    def follow(self, demand, start_ns, end_ns):
        for clock in self._steps(start_ns, end_ns):
            position, velocity = demand.at(clock)
            effort = (velocity + self._correction(position - self.position) - self.velocity) * 50.0
            self._step(max(-self.torque_limit, min(self.torque_limit, effort * self._mass())))


def test_an_enabled_axis_that_yields_to_its_load_keeps_its_target_position(tmp_path):
    robby = start_servos(tmp_path, "yields", "position", modes="position_mode: 8", extra="enable_settle_ms: 3000")
    assert robby.axis(Action.DISABLE) is None
    robby.run(500)
    for device in robby.drives.values():
        mover = device.drives[0].mover
        mover.plant = YieldingPlant(mover.plant.position, position_gain=20.0)
    robby.robot.axis(Action.ENABLE, "all", lambda _error: None)
    robby.until(lambda: robby.joint(2).statechart.state is AxisPhase.READY)
    held, plant = robby.drives[2].get(0x607A), robby.drives[2].drives[0].mover.plant
    plant.external = -50.0  # its brake has opened
    robby.run(2500)
    assert robby.joint(2).statechart.state is AxisPhase.READY
    assert robby.drives[2].get(0x607A) == held
    assert -0.01 < (robby.drives[2].get(0x6064) - held) / K < 0.0
    plant.position += 0.1 * K  # it is turned further by hand, as with STO: it must not jump back
    robby.run(100)
    assert (robby.drives[2].get(0x607A) - held) / K == pytest.approx(0.1, abs=0.02)
    robby.close()


def test_an_axis_that_a_halt_has_stopped_does_not_move_back_to_where_the_halt_began(servo):
    robby = servo("position", modes="position_mode: 8")
    joint, mover = robby.joint(2), robby.drives[2].drives[0].mover
    mover.plant = LagPlant(mover.plant.position, time_constant=0.05)
    for cycle in range(200):
        command(robby, "position", 0.003 * cycle, 10)
    assert robby.axis(Action.HALT) is None
    robby.run(1000)
    here = joint.axis.raw_position
    assert 0.002 < (here - joint.targets.current.output.value) / K < 0.01, "the way of the drive's ramp (0x605D)"
    joint.machine.halt(False)
    joint.targets.hold()  # as while it waits for its group
    assert joint.targets.current.output.value == here
