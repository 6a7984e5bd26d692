"""Two joints on one drive whose motors share one set of objects (`motor_subindices`), through the whole robot."""

import pytest
from support.two_motors import NODE, folder, speeds, wheels
from support.two_motors import robot as make_robot

from canopen_control.check.checker import CheckOptions, check_robot
from canopen_control.cia402.state import State
from canopen_control.data_files import data_path
from canopen_control.errors import BusConfigError, DriveError
from canopen_control.hardware.axis_statechart import Action
from canopen_control.od.issues import Severity
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot


@pytest.fixture
def robot(tmp_path):
    created = []

    def make(**options):
        created.append(make_robot(tmp_path, **options))
        return created[-1]

    yield make
    for item in created:
        item.close()


def states(robot):
    return {axis.state for axis in wheels(robot).values()}


def act(robot, action, joint):
    """Ask for an action on one joint; return the list that its end is put into."""
    ends = []
    robot.simulated.core.axis(action, "wheels", ends.append, joint=joint)
    return ends


@pytest.mark.parametrize("together", [False, True])
def test_both_wheels_turn_at_their_own_speeds(robot, together):
    created = robot(together=together)
    assert states(created) == {State.OPERATION_ENABLED}
    created.command("vel", 2.0, -3.0, seconds=1)
    created.run(0.9)
    assert speeds(created) == pytest.approx([2.0, -3.0], rel=0.01)
    assert [created.velocity("left"), created.velocity("right")] == pytest.approx([2.0, -3.0], rel=0.01)
    assert created.position("left") == pytest.approx(-created.position("right") * 2 / 3, rel=0.05)
    assert created.breaches == []
    created.stop()
    created.until(lambda: not created.moving)
    created.run(0.2)
    assert State.OPERATION_ENABLED not in states(created)


def test_the_mapping_in_the_drive_is_that_of_its_own_objects(robot):
    device = robot(together=True).simulated.drives[NODE].device
    assert [device.get(0x1600, slot) for slot in range(3)] == [2, 0x60400010, 0x60FF0320]
    assert [device.get(0x1A00, slot) for slot in range(3)] == [2, 0x60410020, 0x606C0320]
    assert [device.get(0x6083, motor) for motor in (1, 2)] == [20000, 20000]


@pytest.mark.parametrize("motor", [0, 1])
def test_a_fault_of_one_motor_stops_the_other_along_its_ramp(robot, motor):
    created = robot()
    created.command("vel", 6.0, 6.0, seconds=5)
    created.run(1)
    device = created.simulated.drives[NODE].device
    device.drives[motor].fault(0x7305, device.clock.now)
    created.run(0.05)
    assert 0.5 < speeds(created)[1 - motor] < 6.0  # it did not lose its power at once
    created.until(lambda: not created.moving, 2)
    created.run(0.2)
    assert device.drives[motor].state is State.FAULT
    assert device.drives[1 - motor].state is not State.OPERATION_ENABLED
    faulty = ("left", "right")[motor]
    assert any(f"{faulty}: fault" in event.sentence for event in created.events)
    assert any(faulty in event.sentence and "0x7305" in event.sentence for event in created.events)
    created.reset_faults()
    created.run(0.5)
    assert State.OPERATION_ENABLED not in states(created)  # a fault reset enables nothing
    created.enable()
    created.command("vel", 1.0, 2.0, seconds=1)
    created.run(0.8)
    assert speeds(created) == pytest.approx([1.0, 2.0], rel=0.02)


@pytest.mark.parametrize("apart", [False, True])
def test_what_is_asked_of_one_wheel_is_for_both(robot, apart):
    created = robot(apart=apart)
    created.disable()
    created.run(0.5)
    ends = act(created, Action.ENABLE, "left")
    created.run(1)
    assert ends == [None]
    assert states(created) == {State.OPERATION_ENABLED}
    words = "left and right share one controlword: enable applies to all of them"
    assert any(words in event.sentence for event in created.events)
    created.command("vel", 4.0, 4.0, seconds=5)
    created.run(0.5)
    ends = act(created, Action.DISABLE, "right")
    created.run(0.05)
    assert all(0.5 < speed < 4.0 for speed in speeds(created))
    created.run(1)
    assert ends == [None]
    assert not created.moving
    assert State.OPERATION_ENABLED not in states(created)


def test_a_quick_stop_of_one_wheel_stops_both(robot):
    created = robot()
    created.command("vel", 4.0, 2.0, seconds=5)
    created.run(0.5)
    act(created, Action.QUICK_STOP, "right")
    created.until(lambda: not created.moving, 1)
    assert State.OPERATION_ENABLED not in states(created)
    created.run(1)
    assert not created.moving


def test_the_death_of_the_master_stops_both_wheels(robot):
    created = robot()
    created.command("vel", 4.0, -4.0, seconds=5)
    created.run(0.5)
    created.kill()
    created.run(1)
    assert speeds(created) == [0.0, 0.0]
    assert State.OPERATION_ENABLED not in states(created)


def _without(*places):
    def edit(text):
        for place in places:
            head, rest = text.split(f"[{place}]\n", 1)
            text = head + rest[rest.index("\n[") + 1 :]
        return text

    return edit


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"key": "motor_subindices: [1, 1]"}, "subindex 1 is listed twice; each motor needs its own subindex"),
        ({"key": "motor_subindices: [1]"}, "a subindex for each of two or more motors is needed, such as [1, 2]"),
        ({"key": "motor_subindices: [1, 4]"}, "0x607A:04, 0x60FF:04"),
        ({"edit": _without("606Csub2")}, "0x606C:02 is not in it"),
        ({"mode": "position_mode: 1"}, "PP starts each motion with bits of the controlword"),
        ({"mode": "velocity_mode: 3\n    velocity_target: 0x60FF:01"}, "remove one of the two keys"),
    ],
)
def test_a_wrong_key_is_one_sentence_with_its_line(tmp_path, options, words):
    with pytest.raises(BusConfigError, match=r"bus.yml:\d+:\d+") as error:
        read_robot(find_robot(str(folder(tmp_path, **options))))
    assert words in str(error.value)


def test_a_drive_with_one_motor_has_no_motors_in_subindices(tmp_path):
    folder(tmp_path)
    (tmp_path / "device.eds").write_text(data_path("eds", "generic_cia402.eds").read_text())
    with pytest.raises(BusConfigError, match="its targets and actual values have no subindices: it has one motor"):
        read_robot(find_robot(str(tmp_path)))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"axes": "00"}, "joints left and right are both axis 0 of node 2 (wheels)"),
        ({"more": ('<param name="stop_group">a</param>', "")}, "give them one stop_group"),
    ],
)
def test_joints_that_cannot_be_two_motors_are_refused(tmp_path, options, words):
    result = check_robot(find_robot(str(folder(tmp_path, **options))), CheckOptions()).findings
    assert [str(item) for item in result if item.severity is Severity.ERROR and words in str(item)]


@pytest.mark.parametrize(
    ("action", "options", "words"),
    [(Action.HOME, {}, "HM starts motions by bits of the controlword"), (Action.MODE, {"mode": "PP"}, "PP starts")],
)
def test_what_would_start_both_motors_is_refused(robot, action, options, words):
    core = robot().simulated.core
    with pytest.raises(DriveError, match=words):
        core.axis(action, "wheels", lambda _error: None, **options)


def test_a_drive_that_restarts_is_enabled_again(robot):
    created = robot()
    created.command("vel", 2.0, 2.0, seconds=10)
    created.run(0.5)
    created.drives[NODE].power_off(0.5)
    created.run(2)
    assert not created.moving
    created.enable()
    created.command("vel", 1.0, -1.0, seconds=1)
    created.run(0.8)
    assert speeds(created) == pytest.approx([1.0, -1.0], rel=0.02)
    assert created.breaches == []


def test_the_time_to_a_stop_is_that_of_each_motor(tmp_path):
    bus = folder(tmp_path) / "bus.yml"
    bus.write_text(bus.read_text().replace("0x6084, sub_index: 2, value: 20000", "0x6084, sub_index: 2, value: 5000"))
    stops = check_robot(find_robot(str(tmp_path)), CheckOptions()).stops
    bys = [case.by for stop in stops for case in stop.cases if case.cause == "a stop is requested"]
    assert bys == ["ramp of 0x6084 (20000)", "ramp of 0x6084 (5000)"]


def test_a_motor_without_a_joint_rests_while_the_other_turns_and_check_names_it(robot, tmp_path):
    created = robot(axes=("0", None))
    created.command("vel", 2.0, seconds=1)
    created.run(0.9)
    assert speeds(created) == pytest.approx([2.0, 0.0], rel=0.01)
    result = [str(finding) for finding in check_robot(find_robot(str(tmp_path)), CheckOptions()).findings]
    assert [item for item in result if "axis 1 of wheels has no joint" in item and "bus.yml:11:" in item]
