"""The claimed interface, its mode and its target."""

import math
from dataclasses import replace

import pytest
from support.busalone import AloneBench, write_drives
from support.generic import write_generic
from support.robots import Bench, copy_robby

from canopen_control.cia402.modes import OperationMode
from canopen_control.errors import DriveError, RobotConfigError, UnsupportedMode
from canopen_control.hardware.joint import Action
from canopen_control.hardware.joint_targets import choose_mode, listed_modes


@pytest.fixture
def servo(tmp_path):
    bench = Bench("targets", config=write_generic(tmp_path), drives=(2, 3), controllers=["velocity"])
    bench.start()
    yield bench
    bench.close()


def test_a_claim_brings_its_mode_and_its_command(servo):
    targets = servo.joint(2).targets
    assert targets.claimed == "velocity"
    assert targets.mode is OperationMode.CSV
    assert targets.mode_serves(OperationMode.PP) == "position"
    assert targets.mode_serves(OperationMode.HM) is None


def test_a_new_mode_of_an_enabled_drive_waits_for_a_cycle_at_rest(servo):
    servo.robot.command("velocity", [1.0, 1.0], "test")
    servo.run(300)
    joint = servo.joint(2)
    joint.targets.claim("position")
    assert joint.targets.pending is OperationMode.CSP
    assert joint.machine.mode == OperationMode.CSV
    servo.run(10)
    assert joint.axis.output(0x607A).value == pytest.approx(joint.axis.raw_position, abs=500)
    assert joint.axis.output(0x60FF).value == 0
    servo.run(100)
    assert joint.machine.mode == OperationMode.CSP
    assert joint.enabled


def test_a_mode_that_the_drive_lacks_is_refused(servo):
    with pytest.raises(UnsupportedMode):
        servo.joint(2).targets.set_mode(OperationMode.CSTCA)


def test_the_limits_of_the_description_hold(servo):
    joint = servo.joint(2)
    command = joint.commands["velocity"]
    command.minimum, command.maximum = -0.5, 0.25
    for value, expected in ((1.0, 0.25), (-1.0, -0.5), (0.1, 0.1)):
        servo.robot.command("velocity", [value, value], "test")
        servo.run(20)
        assert joint.axis.output(0x60FF).value == pytest.approx(expected * 65536 / math.tau, abs=1)


def test_a_mode_that_does_not_serve_the_claim_follows_nothing(servo):
    joint = servo.joint(2)
    joint.targets.take_mode(OperationMode.PP)
    servo.robot.command("velocity", [1.0, 1.0], "test")
    servo.run(200)
    assert joint.axis.output(0x60FF).value == 0
    assert joint.targets.handshakes


@pytest.fixture
def bench(tmp_path):
    benches = []

    def make(config, **how):
        benches.append(Bench(f"choice{len(benches)}", config=config, **how))
        return benches[-1]

    yield make
    for each in benches:
        each.close()


def chosen(joint, interface):
    return choose_mode(joint.axis, joint.parameters, interface)


def test_cyclic_goes_before_profile_and_what_the_drive_reads_goes_before_its_eds(bench, tmp_path):
    servo = bench(write_generic(tmp_path), drives=(2, 3), controllers=["velocity"])
    joint = servo.joint(2)
    assert chosen(joint, "velocity") is OperationMode.CSV
    assert chosen(joint, "position") is OperationMode.CSP
    assert chosen(joint, "effort") is OperationMode.CST
    joint.parameters.values[0x6502, 0] = 1 << 0 | 1 << 1
    assert chosen(joint, "position") is OperationMode.PP
    assert chosen(joint, "velocity") is OperationMode.VL
    with pytest.raises(UnsupportedMode):
        chosen(joint, "effort")
    assert listed_modes(joint.axis, joint.parameters) == (OperationMode.PP, OperationMode.VL)


def test_a_mode_of_bus_yml_must_be_listed_and_its_target_mapped(bench, tmp_path):
    robby = bench(str(copy_robby(tmp_path, bus={"  position_mode: 1\n": "  position_mode: 8\n  effort_mode: 1\n"})))
    joint = robby.joint(3)
    assert chosen(joint, "position") is OperationMode.CSP
    joint.parameters.values[0x6502, 0] = 0x3FF
    object.__setattr__(joint.node.config.motion, "velocity_mode", 2)
    with pytest.raises(DriveError, match=r"no RPDO carries 0x6042:00, the target of mode VL"):
        chosen(joint, "velocity")


def test_a_list_of_nothing_says_nothing_and_bus_yml_has_the_word(bench, tmp_path):
    servo = bench(write_generic(tmp_path, modes="velocity_mode: 3"), drives=(2, 3), controllers=["velocity"])
    joint = servo.joint(2)
    joint.parameters.values[0x6502, 0] = 0
    assert chosen(joint, "position") is OperationMode.CSP  # the EDS tells
    eds = joint.node.od.entries
    eds[0x6502, 0] = replace(eds[0x6502, 0], default=None)
    assert listed_modes(joint.axis, joint.parameters) == ()
    assert chosen(joint, "velocity") is OperationMode.PV
    with pytest.raises(DriveError, match=r"0x6502.* give position_mode in bus.yml"):
        chosen(joint, "position")
    joint.parameters.values[0x6502, 0] = 0x3EF  # the live drive goes before both
    assert chosen(joint, "position") is OperationMode.CSP


def test_an_interface_that_nothing_serves_is_an_error_of_the_description(bench, tmp_path):
    config = copy_robby(
        tmp_path, description={'<command_interface name="velocity"/>': '<command_interface name="colour"/>'}
    )
    with pytest.raises(RobotConfigError, match="no command interface 'colour'"):
        bench(config)


def test_outputs_must_be_mapped(bench, tmp_path):
    new = '<command_interface name="velocity"/><command_interface name="digital_outputs"/>'
    config = copy_robby(tmp_path, description={'<command_interface name="velocity"/>': new})
    with pytest.raises(RobotConfigError, match="0x60FE"):
        bench(config)


def test_a_target_begins_with_a_mode_in_which_the_drive_makes_the_ramp_or_with_that_of_bus_yml(tmp_path):
    for number, (modes, first) in enumerate([("", "PP"), ("velocity_mode: 9", "CSV"), ("effort_mode: 4", "TQ")]):
        folder = tmp_path / str(number)
        folder.mkdir()
        drives = AloneBench(f"firstmode{number}", config=write_drives(folder, modes=modes), drives=(2, 3))
        drives.start()
        assert drives.joint(2).targets.mode is None  # a claim alone asks for nothing
        drives.enable("drive_one")
        assert drives.joint(2).targets.mode is OperationMode[first]
        drives.close()


def test_a_mode_without_a_target_or_without_an_rpdo_is_refused_where_targets_are_given(tmp_path):
    config = write_drives(tmp_path)
    bus = config / "bus.yml"
    bus.write_text(bus.read_text().replace("{index: 0x6071}, ", ""))
    drives = AloneBench("nomode", config=config, drives=(2, 3))
    drives.start()
    for mode, words in (("HM", "takes no target"), ("CST", "0x6071")):
        assert words in drives.axis(Action.MODE, "drive_one", mode=mode)
    drives.mode("CSV")
    drives.close()


def test_what_a_boot_read_is_no_target_of_an_axis_that_has_moved_since(servo):
    targets = servo.joint(2).targets
    targets.take_mode(OperationMode.CSP)
    targets.hold()
    output, here = targets.current.output, servo.joint(2).axis.raw_position
    output.know(here + 2370)  # as the presets of a boot do
    targets.hold()
    assert output.value == here + 2370  # nobody writes anew what is held
    targets.came()
    targets.hold()
    assert output.value == here
