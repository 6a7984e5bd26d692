"""Drives that change their mode of operation only while they are disabled (`switching_state`)."""

import pytest
from support.makers import drive, sentences

from canopen_control.cia402.state import State
from canopen_control.hardware.axis_statechart import Action
from canopen_control.virtual.power_machine import PowerMachine
from canopen_control.virtual.profile_modes import HomingMode
from canopen_control.virtual.virtual_drive import VirtualDrive


@pytest.fixture
def fixed_mode(monkeypatch):
    """Drives that change their mode in the states of the set and below alone."""
    refresh, states = VirtualDrive.refresh, {State.OPERATION_ENABLED, State.SWITCHED_ON}

    def hold(self, now, **how):
        mode = self.modes.number
        if self.power.state in states and mode and self._values.get(self._mode_address, 0) != mode:
            self._values[self._mode_address] = mode
        return refresh(self, now, **how)

    monkeypatch.setattr(VirtualDrive, "refresh", hold)
    return states


def _turn_then_position(made):
    made.command("vel", 0.5, 0.0, seconds=0.3)
    made.run(0.5)
    made.activate("pos")
    observed = set()
    for _ in range(150):
        made.run(0.01)
        observed.add(drive(made, 2).state)
    start = made.position("pan")
    for step in range(20):
        made.command("pos", start + 0.01 * (step + 1), 0.0)
        made.run(0.02)
    made.run(0.3)
    return observed, made.position("pan") - start


@pytest.mark.parametrize("number", [2, 3])
@pytest.mark.sources
@pytest.mark.usefixtures("fixed_mode")
def test_an_enabled_drive_goes_down_to_change_its_mode_and_returns(robot, number):
    created = robot("pv", "csp", keys=f"switching_state: {number}")
    observed, way = _turn_then_position(created)
    assert {State.OPERATION_ENABLED, State.READY_TO_SWITCH_ON} <= observed
    assert (State.SWITCH_ON_DISABLED in observed) is (number == 2)
    assert way == pytest.approx(0.2, abs=0.01)
    assert created.state == "running"
    assert created.breaches == []


@pytest.mark.sources
@pytest.mark.usefixtures("fixed_mode")
def test_the_mode_is_sent_when_the_drive_stands_and_is_disabled(robot):
    created = robot("pv", "csp", keys="switching_state: 2")
    created.command("vel", 1.0, 0.0, seconds=0.3)
    created.run(0.3)
    created.activate("pos")
    left = mode = None
    for _ in range(200):
        created.run(0.005)
        axis = drive(created, 2)
        if left is None and axis.state is not State.OPERATION_ENABLED:
            left = abs(created.velocity("pan"))
        if mode is None and axis.objects.number(0x6060) == 8:
            mode = axis.state
    assert left < 0.06
    assert mode is State.SWITCH_ON_DISABLED


@pytest.mark.sources
@pytest.mark.usefixtures("fixed_mode")
def test_without_the_key_the_switch_stops_the_robot_and_names_it_and_an_enable_tries_again(robot):
    created = robot("pv", "csp")
    created.activate("pos")
    created.run(4)
    assert created.state != "running"
    assert any("switching_state: 2" in sentence and "stopping pan" in sentence for sentence in sentences(created))
    created.enable()
    created.until(lambda: created.state == "running", 3)
    assert drive(created, 2).modes.number == 8
    assert created.breaches == []


def test_a_drive_that_changes_its_mode_while_enabled_stays_enabled(robot):
    created = robot("pv", "csp")
    observed, way = _turn_then_position(created)
    assert observed == {State.OPERATION_ENABLED}
    assert way == pytest.approx(0.2, abs=0.01)


@pytest.mark.sources
@pytest.mark.usefixtures("fixed_mode")
def test_a_stop_in_the_middle_of_the_change_ends_disabled(robot):
    created = robot("pv", "csp", keys="switching_state: 2")
    created.activate("pos")
    created.until(lambda: drive(created, 2).state is State.SWITCH_ON_DISABLED, 2)
    created.disable()
    created.run(1)
    assert drive(created, 2).state is State.SWITCH_ON_DISABLED
    created.enable()
    created.until(lambda: created.state == "running", 3)
    assert created.breaches == []


HOMING = "homing_timeout_seconds: 1.5"
SPEEDS = """  sdo:
    - {index: 0x6099, sub_index: 1, value: 400000}
    - {index: 0x6099, sub_index: 2, value: 400000}
    - {index: 0x609A, sub_index: 0, value: 9000000}
"""


@pytest.fixture
def latched(monkeypatch):
    """Drives whose bit 12 stays 1 after a homing until they leave operation."""
    bits, attained = HomingMode.bits, set()

    def stays(self):
        result = bits(self)
        if result & 0x1000:
            attained.add(id(self.mover))
        return result | (0x1000 if id(self.mover) in attained else 0)

    enter = PowerMachine.enter

    def entered(self, state, now):
        if state is not State.OPERATION_ENABLED:
            attained.discard(id(self._mover))
        enter(self, state, now)

    monkeypatch.setattr(HomingMode, "bits", stays)
    monkeypatch.setattr(PowerMachine, "enter", entered)


def _homed_twice(made):
    results = []
    for _ in range(2):
        observed = len(made.events)
        made.simulated.core.axis(Action.HOME, "all", lambda _error: None, method=34)
        made.run(2.5)
        results.append([event.sentence for event in made.events[observed:] if "pan_drive" in event.sentence])
    return results


@pytest.mark.sources
@pytest.mark.usefixtures("latched")
def test_a_homing_bit_that_stays_until_operation_is_left_is_named_with_its_key(robot):
    first, second = _homed_twice(robot("csp", keys=HOMING))
    assert any("homed" in item for item in first)
    assert any("bit 12" in item and "switching_state: 4" in item for item in second)


@pytest.mark.sources
@pytest.mark.usefixtures("latched")
def test_a_drive_that_leaves_operation_before_each_homing_homes_again(robot):
    first, second = _homed_twice(robot("csp", keys=f"{HOMING}\nswitching_state: 4"))
    assert any("homed" in item for item in first)
    assert any("homed" in item for item in second)


def test_a_change_of_mode_is_done_when_the_drive_is_enabled_again(robot):
    created = robot("csp", keys="switching_state: 2")
    core, answers = created.simulated.core, []
    joint = core.joints["pan"]
    core.axis(Action.MODE, "pan_drive", lambda error: answers.append((error, joint.machine.enabled)), mode="PP")
    created.run(3)
    assert answers == [(None, True)]
