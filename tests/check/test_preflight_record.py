"""A passed preflight: valid for these files and these drives; without one, the speed is limited."""

import math
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.devices import with_measured_joint
from support.onbus import TMCM, OnBus
from support.robots import Bench, copy_robby
from support.samples import status_dict

from canopen_control.check import preflight_record
from canopen_control.check.preflight_record import (
    SLOW,
    PreflightRecord,
    SpeedCap,
    config_hash,
    explain,
    find_record,
    limit_speed,
    read_serials,
    save_record,
    slow_reason,
)
from canopen_control.cli.main import main
from canopen_control.errors import ConfigError
from canopen_control.hardware.axis import AxisObjectLimits
from canopen_control.hardware.interfaces import CommandInterface, StateInterface
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot

SERIALS = {"left_drive": 3, "right_drive": 2}
JOINTS = ("left_wheel_joint", "right_wheel_joint")


def setup_of(folder):
    return read_robot(find_robot(str(folder)), can=["memory:clearance"])


@pytest.mark.rest
def test_the_hash_is_of_what_the_files_hold_and_not_of_where_they_are(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    here, there = copy_robby(tmp_path), copy_robby(tmp_path / "elsewhere")
    assert config_hash(setup_of(here)) == config_hash(setup_of(there))
    for name in ("bus.yml", "ros2_controllers.yaml", "robby.urdf.xacro"):
        before = config_hash(setup_of(there))
        with (there / name).open("a") as file:
            file.write("\n")
        assert config_hash(setup_of(there)) != before


def test_a_pass_is_kept_found_and_replaced(tmp_path):
    setup = setup_of(copy_robby(tmp_path))
    assert find_record(setup) is None
    save_record(setup, {"left_drive": 1}, ())
    path = save_record(setup, SERIALS, JOINTS)
    record = find_record(setup)
    assert (record.config, record.serials, record.channel) == (config_hash(setup), SERIALS, "memory:clearance")
    assert record.joints == JOINTS
    assert explain(setup, record, SERIALS) is None
    for rubbish in ("", "[]", '{"serials": 3}', '{"config": 1, "serials": {"a": "b"}, "time": 0, "channel": ""}'):
        path.write_text(rubbish)
        assert find_record(setup) is None


@pytest.mark.parametrize(
    ("serials", "reason"),
    [
        ({"left_drive": 9, "right_drive": 2}, "left_drive is not the drive that passed"),
        ({"left_drive": 3, "right_drive": None}, "right_drive does not answer"),
    ],
)
def test_another_drive_is_not_a_pass(tmp_path, serials, reason):
    setup = setup_of(copy_robby(tmp_path))
    assert reason in explain(setup, PreflightRecord(config_hash(setup), SERIALS), serials)


def test_no_pass_and_changed_files_are_distinguished(tmp_path):
    setup = setup_of(copy_robby(tmp_path))
    assert "has not passed" in explain(setup, None, SERIALS)
    assert "files have changed" in explain(setup, PreflightRecord("0", SERIALS), SERIALS)


def test_only_the_joints_in_doubt_are_slow():
    bench = Bench("half")
    limit_speed(bench.robot, ["left_wheel_joint"])
    bench.start()
    bench.hold(10.0, -10.0, ms=1000)
    speeds = [joint["velocity"] for joint in status_dict(bench.robot)["joints"].values()]
    assert speeds == pytest.approx([SLOW, -10.0], rel=0.01)
    bench.close()


@pytest.mark.parametrize(
    ("joints", "doubted", "why"),
    [
        (JOINTS, None, ""),
        (JOINTS[:1], JOINTS[1:], "the preflight could not turn right_wheel_joint"),
        (None, JOINTS, "this robot has not passed a preflight on this machine"),
    ],
)
def test_a_pass_covers_the_joints_that_were_turned(tmp_path, monkeypatch, private_folders, joints, doubted, why):
    setup = setup_of(copy_robby(tmp_path))
    monkeypatch.setattr(preflight_record, "read_serials", lambda _setup: SERIALS)
    if joints is not None:
        save_record(setup, SERIALS, joints)
    result = slow_reason(setup)
    assert (None if result is None else result.joints) == doubted
    assert why in ("" if result is None else result.why)


def test_a_pass_that_cannot_be_saved_is_one_sentence(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", "/dev/null")
    with pytest.raises(ConfigError, match=r"Not a directory; the pass is not recorded: set XDG_STATE_HOME to a wri"):
        save_record(setup_of(copy_robby(tmp_path)), SERIALS, JOINTS)


def test_a_robot_without_joints_needs_no_pass(tmp_path, private_folders):
    assert main(["init", str(tmp_path / "lamps"), "--eds", "generic_cia401.eds", "--node-id", "5"]) == 0
    assert slow_reason(setup_of(tmp_path / "lamps")) is None


def test_serial_numbers_are_asked_of_the_drives(private_folders):
    with OnBus("memory:serials", {3: TMCM}):
        setup = read_robot(find_robot("robby"), can=["memory:serials"])
        assert read_serials(setup) == {"left_drive": 3, "right_drive": None}


@pytest.mark.usefixtures("private_folders")
def test_a_joint_that_is_only_measured_is_not_a_doubt(tmp_path, monkeypatch):
    setup = setup_of(with_measured_joint(tmp_path))
    monkeypatch.setattr(preflight_record, "read_serials", lambda _setup: SERIALS)
    save_record(setup, SERIALS, JOINTS)
    assert slow_reason(setup) is None


# The speed limit by interface: requested and limited values in each cycle.


PERIOD = 0.02


class Registry:
    """Interfaces by name; `of` returns one."""

    def __init__(self, commands, states):
        self.command_interfaces = [CommandInterface("joint", name) for name in commands]
        self.state_interfaces = [StateInterface("joint", name, value) for name, value in states.items()]

    def of(self, name):
        (command,) = (item for item in self.command_interfaces if item.interface == name)
        command.owner = "controller"
        return command

    def state(self, name):
        (state,) = (item for item in self.state_interfaces if item.interface == name)
        return state


def capped(commands, **states):
    registry = Registry(commands, states)
    return registry, SpeedCap(registry, {"joint"}, 1.0)


def test_a_position_goes_to_its_command_at_the_cap_from_where_the_joint_is():
    registry, cap = capped(["position"], position=5.0)
    command, here = registry.of("position"), registry.state("position")
    values = []
    for _ in range(150):
        command.value = 7.0  # a controller that is due every cycle
        cap.enforce(PERIOD)
        values.append(command.value)
        here.value = command.value
    assert values[0] == pytest.approx(5.02)
    steps = [after - before for before, after in zip([5.0, *values], values, strict=False)]
    assert max(steps) == pytest.approx(PERIOD)
    assert values[-1] == 7.0
    assert sum(step > 1e-9 for step in steps) == 100


def test_a_controller_that_is_not_due_does_not_hold_the_joint_up():
    registry, cap = capped(["position"], position=0.0)
    command, here = registry.of("position"), registry.state("position")
    command.value = -1.0
    for _ in range(50):
        cap.enforce(PERIOD)
        here.value = command.value
    assert command.value == -1.0


def test_a_joint_that_has_not_followed_restarts_where_it_is():
    registry, cap = capped(["position"], position=0.0)
    command, here = registry.of("position"), registry.state("position")
    for _ in range(100):
        command.value = 10.0
        cap.enforce(PERIOD)
    assert command.value <= 0.5 + PERIOD, "it was not enabled, and nothing winds up"
    here.value = -3.0  # moved by hand
    command.value = 10.0
    cap.enforce(PERIOD)
    assert command.value == pytest.approx(-3.0 + PERIOD)


def test_without_a_controller_or_a_command_nothing_is_made_up():
    registry, cap = capped(["position", "effort"], position=1.0, velocity=3.0)
    command = registry.of("position")
    cap.enforce(PERIOD)
    assert math.isnan(command.value)
    command.value, command.owner = 4.0, None
    cap.enforce(PERIOD)
    assert command.value == 4.0


def test_a_joint_at_an_unknown_position_stays():
    registry, cap = capped(["position"], position=math.nan)
    command = registry.of("position")
    command.value = 1.0
    cap.enforce(PERIOD)
    assert math.isnan(command.value)


@pytest.mark.parametrize(
    ("speed", "expected", "left"),
    [(0.9, 5.0, 5.0), (1.1, 5.0, 0.0), (1.1, -5.0, -5.0), (-1.1, -5.0, 0.0), (-1.1, 5.0, 5.0), (math.nan, 5.0, 5.0)],
)
def test_an_effort_is_taken_away_above_the_cap_unless_it_brakes(speed, expected, left):
    registry, cap = capped(["effort"], velocity=speed)
    command = registry.of("effort")
    command.value = expected
    cap.enforce(PERIOD)
    assert command.value == left


def test_what_cannot_be_capped_is_named_and_other_joints_are_left_alone():
    registry = Registry(["position", "effort"], {})
    assert SpeedCap(registry, {"joint"}, 1.0).unlimited == ["joint/position", "joint/effort"]
    assert SpeedCap(registry, {"another"}, 1.0).unlimited == []


@given(st.lists(st.tuples(st.floats(-50, 50), st.floats(0, 1)), max_size=60))
def test_whatever_is_commanded_the_target_moves_no_faster_than_the_cap(commands):
    registry, cap = capped(["position"], position=0.0)
    command, here = registry.of("position"), registry.state("position")
    last = 0.0
    for expected, followed in commands:
        command.value = expected
        cap.enforce(PERIOD)
        assert abs(command.value - here.value) <= 0.5 + PERIOD + 1e-9
        if abs(last - here.value) <= 0.5:
            assert abs(command.value - last) <= PERIOD + 1e-9
        last = command.value
        here.value += (command.value - here.value) * followed


@pytest.mark.parametrize("reduction", [1.0, 50.0, -0.5])
def test_a_drive_behind_a_transmission_is_capped_by_the_turns_of_its_joint(reduction):
    registry, cap = capped(["velocity"])
    drive = SimpleNamespace(
        joint="joint", commands={"velocity": registry.of("velocity")}, axis=SimpleNamespace(limits=AxisObjectLimits())
    )
    cap.bound([drive], {"joint": reduction})
    command, limits = registry.of("velocity"), drive.axis.limits
    assert (command.minimum, command.maximum) == (-abs(reduction), abs(reduction))
    assert (limits.described, limits.words) == (abs(reduction), "the speed limit of this run")


@pytest.mark.rest
def test_a_robot_that_is_commanded_positions_is_slow_too():
    bench = Bench("cappedarm", config="arm6", drives=range(2, 8))
    joints = list(bench.robot.joints)
    assert limit_speed(bench.robot, joints, 0.3) == []
    bench.start()
    before, fastest = positions(bench), 0.0
    for _ in range(100):
        bench.robot.command("arm_position_controller", [1.0] * 6, "test")
        bench.run(20)
        fastest = max(fastest, *((now - then) / 0.02 for now, then in zip(positions(bench), before, strict=True)))
        before = positions(bench)
    assert fastest == pytest.approx(0.3, rel=0.01), "the description says 2 rad/s"
    assert before == pytest.approx([0.3 * 2] * 6, abs=0.02)
    for _ in range(100):
        bench.robot.command("arm_position_controller", [1.0] * 6, "test")
        bench.run(20)
    assert positions(bench) == pytest.approx([1.0] * 6, abs=0.01)
    bench.close()


def positions(bench):
    return [bench.robot.registry.state(f"{joint}/position").value for joint in bench.robot.joints]


@pytest.mark.parametrize(
    ("quantity", "expected", "left"),
    [("velocity", 5.0, 1.0), ("velocity", -5.0, -1.0), ("velocity", 0.5, 0.5), ("velocity", math.nan, math.nan),
     ("position", 5.0, PERIOD), ("position", math.nan, math.nan), ("effort", 5.0, 0.0), ("target", math.nan, math.nan)],
)  # fmt: skip
def test_a_target_is_capped_as_what_the_mode_makes_of_it(quantity, expected, left):
    registry, cap = capped(["target"], position=0.0, velocity=2.0)
    command = registry.of("target")
    command.quantity, command.value = quantity, expected
    cap.enforce(PERIOD)
    assert command.value == pytest.approx(left, nan_ok=True)
    assert cap.unlimited == []
