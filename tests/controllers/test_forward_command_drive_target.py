"""One number for a drive in whatever mode it is: what it means, how long it lives, what ends it."""

import itertools
import math

import pytest
from support.busalone import AloneBench, write_drives

from canopen_control.controllers.forward_command import TargetController
from canopen_control.controllers.params import Params
from canopen_control.errors import ControlError, RobotConfigError
from canopen_control.hardware.axis_power import Action
from canopen_control.hardware.interfaces import TARGET, CommandInterface


@pytest.fixture
def drives(tmp_path, request):
    bench = AloneBench(f"target{abs(hash(request.node.nodeid)) % 10**8}", config=write_drives(tmp_path), drives=(2, 3))
    bench.start()
    yield bench
    bench.close()


@pytest.mark.rest
def test_nothing_moves_before_somebody_enables_the_drive_and_a_target_comes_after_that(drives):
    assert "axis enable" in drives.target(1.0)
    drives.enable("drive_one")
    drives.run(500)
    assert drives.at("position") == 0.0
    assert not drives.powered(3)  # the other one was not asked for
    assert drives.target(1.0) is None
    drives.run(3000)
    assert drives.at("position") == pytest.approx(1.0, abs=0.001)


@pytest.mark.rest
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_is_refused_with_the_name_and_what_was_there_goes_on(drives, value):
    drives.enable("drive_one")
    assert drives.target(0.5) is None
    assert "drive_one/target" in drives.target(value)
    drives.run(3000)
    assert drives.at("position") == pytest.approx(0.5, abs=0.001)


@pytest.mark.parametrize(
    ("mode", "interface", "value", "reached"),
    [("PP", "position", 0.1, 0.1), ("CSP", "position", 0.1, 0.1), ("PV", "velocity", 2.0, 2.0),
     ("VL", "velocity", 2.0, 2.0), ("CSV", "velocity", 2.0, 2.0), ("TQ", "effort", 100.0, 0.1),
     ("CST", "effort", 100.0, 0.1)],
)  # fmt: skip
def test_the_target_is_what_the_mode_takes(drives, mode, interface, value, reached):
    """An effort is in per mille of the rated torque, as 0x6071 has it; what is measured has its scale."""
    drives.enable("drive_one")
    drives.mode(mode)
    assert drives.target(value) is None
    drives.run(1500)
    assert drives.at(interface) == pytest.approx(reached, rel=0.06)
    assert drives.robot.manager.get("drive_one").interface == interface


@pytest.mark.parametrize("mode", ["PV", "CSV"])
def test_a_velocity_that_nobody_renews_ends_after_two_seconds_and_says_so(drives, mode):
    drives.enable("drive_one")
    drives.mode(mode)
    drives.target(2.0)
    drives.run(1900)
    assert drives.at("velocity") == pytest.approx(2.0, rel=0.02)
    drives.run(2000)
    assert drives.at("velocity") == pytest.approx(0.0, abs=0.01)
    assert "targets are 0" in drives.texts("command_timeout")[0]


@pytest.mark.rest
def test_a_position_is_held_for_ever(drives):
    drives.enable("drive_one")
    drives.target(0.5)
    drives.run(10_000)
    assert drives.at("position") == pytest.approx(0.5, abs=0.001)
    assert drives.texts("command_timeout") == []


@pytest.mark.parametrize("ms", [0, 20])
@pytest.mark.parametrize(("before", "after"), [("PV", "PP"), ("PP", "PV"), ("CSV", "CSP"), ("TQ", "PP")])
def test_a_target_is_forgotten_with_its_mode_however_late_it_came(drives, before, after, ms):
    drives.enable("drive_one")
    drives.mode(before)
    drives.target(2.0)
    drives.run(ms)
    drives.mode(after)
    value = drives.joint(2).commands["target"].value
    assert math.isnan(value) or (value == 0.0 and after == "PV")
    drives.run(1000)
    here = drives.at("position")
    drives.run(1000)
    assert drives.at("position") == pytest.approx(here, abs=0.01)


@pytest.mark.rest
def test_a_target_is_forgotten_with_the_mode_it_was_given_in(drives):
    drives.enable("drive_one")
    drives.mode("PV")
    drives.target(2.0)
    drives.run(1000)
    drives.mode("PP")
    drives.run(500)
    here = drives.at("position")
    drives.run(3000)
    assert here > 1.0
    assert drives.at("position") == pytest.approx(here, abs=0.01)  # and not 2.0 rad
    assert drives.target(0.0) is None
    drives.run(5000)
    assert drives.at("position") == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize(("mode", "value"), [("PP", 50.0), ("CSP", 50.0), ("PV", 2.0), ("CSV", 2.0)])
def test_a_target_ends_with_who_gave_it(drives, mode, value):
    """Of a position too, whether the drive or the master makes the way: it stops on the way."""
    bridge = object()
    drives.enable("drive_one")
    drives.mode(mode)
    drives.target(value, holder=bridge)
    drives.run(1500)
    assert abs(drives.speed(2)) > 1
    drives.robot.let_go(bridge)
    drives.run(1500)
    here = drives.at("position")
    drives.run(2000)
    assert drives.at("position") == pytest.approx(here, abs=0.01)
    assert abs(drives.speed(2)) < 1
    assert "is gone" in drives.texts("commander_gone")[0]
    assert drives.joint(2).enabled  # and takes the next one
    assert drives.target(0.0) is None


@pytest.mark.parametrize("mode", ["PP", "PV"])
def test_who_disables_and_enables_does_not_wake_an_old_target(drives, mode):
    drives.enable("drive_one")
    drives.mode(mode)
    drives.target(2.0)
    drives.run(500)
    assert drives.axis(Action.DISABLE, "drive_one") is None
    drives.enable("drive_one")
    here = drives.at("position")
    drives.run(2000)
    assert drives.at("position") == pytest.approx(here, abs=0.01)


@pytest.mark.rest
@pytest.mark.parametrize("mode", ["CSP", "IP"])
def test_a_place_to_go_to_is_reached_along_the_profile_of_the_drive_where_the_mode_has_none(drives, mode):
    """0x6081 and 0x6083 as the drive has them; a step would ask for what no motor can do."""
    drives.enable("drive_one")
    drives.mode(mode)
    assert drives.target(10.0) is None
    speeds = []
    for _ in range(300):
        drives.run(10)
        speeds.append(drives.at("velocity"))
    assert drives.at("position") == pytest.approx(10.0, abs=0.001)
    assert 6.0 < max(speeds) < 6.5  # 65536 counts/s
    changes = [after - before for before, after in itertools.pairwise(speeds)]
    assert max(map(abs, changes)) < 0.6  # 262144 counts/s^2, in a cycle of 10 ms
    assert drives.target(9.0) is None
    drives.run(100)
    assert drives.target(12.0) is None  # while it turns the other way
    drives.run(3000)
    assert drives.at("position") == pytest.approx(12.0, abs=0.001)
    assert drives.found("fault") == []


def test_a_target_that_its_object_cannot_hold_is_refused(drives):
    drives.enable("drive_one")
    drives.mode("TQ")
    assert "holds" in drives.target(1e9)


def test_without_a_mode_there_is_no_target():
    controller = TargetController("arm")
    controller.on_configure(Params.of({"joint": "arm"}))
    controller.on_activate([CommandInterface("arm", TARGET)], [], 0)
    with pytest.raises(ControlError, match="in no mode"):
        controller.set_command([1.0], 0)


def test_it_needs_a_joint():
    with pytest.raises(RobotConfigError, match="no 'joint'"):
        TargetController("arm").on_configure(Params.of({}))
