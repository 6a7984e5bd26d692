"""One homing, and everything as it was afterwards."""

import math

import pytest
from support.faultbench import FaultBench
from support.generic import write_generic
from support.makers import drive, folder, sentences

from canopen_control.errors import DriveError, NotYetEnabled
from canopen_control.hardware.axis_statechart import Action
from canopen_control.hardware.joint import JointDrive
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot
from canopen_control.testing.tested_robot import TestedRobot

LIMIT = 0.8  # rad/s


@pytest.fixture
def servo(tmp_path):
    bench = FaultBench("homing", config=write_generic(tmp_path), drives=(2, 3), controllers=["velocity"])
    bench.start()
    yield bench
    bench.close()


def test_a_drive_that_was_off_is_off_again_afterwards(servo):
    assert servo.axis(Action.DISABLE) is None
    servo.run(200)
    assert servo.axis(Action.HOME, "2", method=17) is None
    servo.run(300)
    assert servo.joint(2).homed
    assert not servo.powered(2)
    assert not servo.powered(3)


def test_a_drive_that_was_on_follows_again_afterwards(servo):
    assert servo.axis(Action.HOME, "2", method=37) is None
    servo.run(100)
    servo.robot.command("velocity", [1.0, 1.0], "test")
    servo.run(500)
    assert servo.speed(2) == pytest.approx(10430, rel=0.01)


def test_commands_are_not_followed_meanwhile(servo):
    answers = []
    servo.robot.axis(Action.HOME, "2", answers.append, method=17)
    servo.run(100)
    before = servo.robot.buses["can"].network.image.output(2, 0x60FF).value
    with pytest.raises(NotYetEnabled, match="homing is under way"):
        servo.robot.command("velocity", [5.0, 5.0], "test")
    servo.run(100)
    assert not answers
    assert servo.robot.buses["can"].network.image.output(2, 0x60FF).value == before == 0
    servo.until(lambda: answers)
    assert answers == [None]


def test_without_a_method_the_one_of_the_drive_is_used(servo):
    servo.drives[2].store.set(0x6098, 0, 35)
    assert servo.axis(Action.HOME, "2") is None
    assert servo.joint(2).homed


def test_two_at_once_are_refused_and_a_reserved_method_too(servo):
    servo.robot.axis(Action.HOME, "2", lambda _error: None, method=17)
    with pytest.raises(DriveError, match="already in progress"):
        servo.joint(2).home(17)
    with pytest.raises(DriveError, match="homing method 15"):
        servo.joint(3).home(15)


def test_a_method_that_cannot_be_written_ends_it(servo):
    servo.switch("sdo_busy", node=2)
    reason = servo.axis_refused(Action.HOME, "2", method=17)
    assert "0x6098" in reason
    assert servo.joint(2).homing is None
    assert not servo.joint(2).homed


@pytest.fixture
def slow(tmp_path):
    sdo = "- {index: 0x6099, sub_index: 1, value: 65536}\n    - {index: 0x6099, sub_index: 2, value: 8000}"
    files = write_generic(tmp_path, velocity=LIMIT, sdo=sdo)
    bench = FaultBench("homing", config=files, drives=(2, 3), controllers=["velocity"])
    bench.start()
    yield bench
    bench.close()


def test_the_speeds_of_homing_are_lowered_to_the_velocity_limit(slow):
    most = int(LIMIT * 65536 / math.tau)
    assert slow.axis(Action.HOME, "2", method=17) is None
    assert [slow.drives[2].get(0x6099, sub) for sub in (1, 2)] == [most, 8000]
    (reported,) = slow.texts("parameters")
    assert f"0x6099:01 was reduced from 65536 to {most}, the velocity limit of the description" in reported


def test_a_homing_that_does_not_move_leaves_the_speeds_alone(slow):
    assert slow.axis(Action.HOME, "2", method=37) is None
    assert slow.drives[2].get(0x6099, 1) == 65536


def test_there_is_not_a_homing_whose_speed_cannot_be_bounded(slow):
    run, why = slow.joint(2).home_position, []
    slow.joint(2).parameters.bound_homing = lambda done: done("0x6099:01 stays 65536, faster than the limit")
    slow.robot.axis(Action.HOME, "2", why.append, method=17)
    slow.until(lambda: why)
    assert "0x6099:01 stays 65536" in why[0]
    assert not run.known
    assert run.homing is None


def test_a_lost_node_ends_it(servo):
    answers = []
    servo.robot.axis(Action.HOME, "2", answers.append, method=17)
    servo.run(200)
    servo.power_off(2)
    servo.until(lambda: answers)
    assert "node 2 (drive_one)" in answers[0]
    assert servo.joint(2).homing is None


@pytest.mark.sources  # a property is replaced
@pytest.mark.parametrize("moving", [False, True])
def test_a_drive_without_bit_10_is_homed_once_it_is_at_standstill(robot, monkeypatch, moving):
    created = robot("csp")
    for node in (2, 3):
        created.drives[node].quirk("homing_without_bit_10")
    if moving:  # a drive that still backs off from its switch
        monkeypatch.setattr(JointDrive, "at_standstill", property(lambda _self: False))
    created.do("axis", name="home")
    created.run(3.0)
    assert created.simulated.core.joints["pan"].homed is not moving


def _home(made, method=37):
    answers = []
    made.simulated.core.axis(Action.HOME, "pan_drive", answers.append, method=method)
    made.until(lambda: answers, 20)
    return answers[0]


@pytest.mark.parametrize(("syncs", "quirks"), [(10, []), (1, ["homing_zero_late"]), (1, ["homing_zero_late=1"])])
def test_an_axis_in_csp_stays_where_it_was_homed_when_the_new_zero_arrives_late(tmp_path, syncs, quirks):
    """With transmission type 10, or in a drive that updates 0x6064 after bit 12."""
    bus = folder(tmp_path, "csp") / "bus.yml"
    position = "transmission: {}, mapping: [{{index: 0x6064}}"
    bus.write_text(bus.read_text().replace(position.format(1), position.format(syncs)))
    tested_robot = TestedRobot(read_robot(find_robot(str(tmp_path))), quirks={"all": quirks})
    try:
        tested_robot.run(0.5)
        for step in range(50):
            tested_robot.command("pos", 0.01 * step, 0.01 * step)
            tested_robot.run(0.02)
        tested_robot.run(0.5)
        before = drive(tested_robot, 2).mover.plant.position
        assert _home(tested_robot) is None
        tested_robot.run(1)
        assert drive(tested_robot, 2).mover.plant.position == pytest.approx(before, abs=10)
        assert tested_robot.position("pan") == pytest.approx(0.0, abs=0.001)
        assert tested_robot.state == "running"
    finally:
        tested_robot.close()


def test_an_axis_that_is_homed_far_from_its_old_zero_has_made_no_jump(robot):
    created = robot("pv")
    created.command("vel", 1.5, 1.5, seconds=6)
    created.run(9)
    assert created.position("pan") > 8.0
    assert _home(created) is None
    created.run(0.1)
    assert created.position("pan") == pytest.approx(0.0, abs=0.001)
    assert created.state == "running"
    assert not any("jumped" in sentence or "stopping" in sentence for sentence in sentences(created))


@pytest.mark.parametrize("end", ["stop", "halt", "quick-stop", "timeout", "error"])
def test_a_homing_that_ends_on_its_way_stops_by_the_ramp_of_homing_and_never_reverses(robot, end):
    """In CSP a drive that still turns would reverse towards the target at its last position."""
    created = robot("csp", keys="homing_timeout_seconds: 2")
    for node_id in (2, 3):
        store = created.simulated.drives[node_id].device.store
        for index, subindex, value in ((0x6099, 1, 400_000), (0x6099, 2, 40_000), (0x609A, 0, 400_000)):
            store.set(index, subindex, value)
    axis, answers, speeds = drive(created, 2), [], []
    axis.mover.switches.negative = -1e9
    created.simulated.core.axis(Action.HOME, "pan_drive", answers.append, method=17)
    created.run(1.6)
    assert axis.mover.plant.velocity < -390_000
    if end == "stop":
        created.stop()
    elif end == "error":
        axis.readings.statusword.forced.inject(0x2000)
    elif end != "timeout":
        created.do("axis", name=end)
    for _ in range(250):
        created.run(0.01)
        speeds.append(axis.mover.plant.velocity)
    assert max(speeds) < 1000
    assert speeds[-1] == 0.0
    assert (axis.modes.number, axis.power.controlword & 0x10) == (8, 0)
    assert "home not reached" in answers[0]
