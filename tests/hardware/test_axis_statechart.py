"""The statechart of an axis: forbidden entries of the table, and runs alone and with a stop group."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.cia402.drive import DriveMachine
from canopen_control.cia402.drive_goal import DriveGoal
from canopen_control.hardware.axis_statechart import (
    ENABLED_STATES,
    LIMITS_NS,
    STOPPED,
    STOPPING,
    TABLE,
    Action,
    AxisPhase,
    AxisStatechart,
    DriveCommand,
    PhaseTrigger,
    StopGroup,
)
from canopen_control.hardware.interfaces import CommandInterface
from canopen_control.runtime.core import STOP_TIMEOUT_NS

ENDS_ENABLE = (PhaseTrigger.STOP, PhaseTrigger.QUICK_STOP, PhaseTrigger.DRIVE_LOST_ENABLE, PhaseTrigger.NODE_LOST)
REACHED = [
    PhaseTrigger.ENABLE,
    PhaseTrigger.GROUP_READY,
    PhaseTrigger.DRIVE_ENABLED,
    PhaseTrigger.GROUP_ENABLED,
    PhaseTrigger.MOTION_PERMITTED,
]
MOVING = (AxisPhase.FOLLOWING, AxisPhase.HOMING)


def make(*triggers, holds_load=False):
    power = AxisStatechart(DriveMachine("a drive"), [CommandInterface("joint", "velocity")], holds_load=holds_load)
    for trigger in triggers:
        power.fire(trigger, 0)
    return power


def test_the_actions_are_those_of_the_command_line():
    assert [item.value for item in Action] == ["enable", "disable", "halt", "quick-stop", "fault-reset", "home", "mode"]


def test_every_state_has_its_rows_and_can_be_reached():
    assert set(TABLE) == set(AxisPhase)
    reached, observed = {AxisPhase.DISABLED}, set()
    while reached - observed:
        observed |= (new := reached - observed)
        reached |= {row.state for state in new for row in TABLE[state].values()}
    assert reached == set(AxisPhase)
    assert {trigger for rows in TABLE.values() for trigger in rows} == set(PhaseTrigger)


def test_an_enable_leads_to_following_through_the_states_at_rest():
    power = make()
    states = []
    for trigger in REACHED:
        assert power.fire(trigger, 0)
        states.append(power.state)
    assert states == [
        AxisPhase.SWITCHING_ON,
        AxisPhase.ENABLING,
        AxisPhase.ENABLED,
        AxisPhase.READY,
        AxisPhase.FOLLOWING,
    ]
    assert power.following


@pytest.mark.parametrize("state", AxisPhase)
def test_only_an_enable_leads_up_and_never_straight_to_motion(state):
    for trigger, row in TABLE[state].items():
        if row.state in ENABLED_STATES and state not in ENABLED_STATES:
            assert trigger is PhaseTrigger.ENABLE
        if trigger is PhaseTrigger.ENABLE and state is not AxisPhase.HOMING:  # which no command moves
            assert row.state not in MOVING
        if {DriveCommand.PREPARE, DriveCommand.RELEASE, DriveCommand.RESUME} & set(row.commands):
            assert trigger in (PhaseTrigger.ENABLE, PhaseTrigger.GROUP_READY, PhaseTrigger.DRIVE_ENABLED)


@pytest.mark.parametrize("state", AxisPhase)
def test_a_fault_reset_changes_no_state_and_enables_nothing(state):
    assert TABLE[state][PhaseTrigger.FAULT_RESET] == (state, (DriveCommand.RESET,))


@pytest.mark.parametrize("state", ENABLED_STATES)
@pytest.mark.parametrize("trigger", ENDS_ENABLE)
def test_every_reason_to_stop_is_received_in_every_state_of_an_enabled_axis(state, trigger):
    row = TABLE[state][trigger]
    assert row.state not in ENABLED_STATES
    controlled = row.state in STOPPING or bool({DriveCommand.DISABLE, DriveCommand.QUICK_STOP} & set(row.commands))
    assert controlled, "by the master's ramp or the drive's own, never by taking the voltage away"
    assert DriveCommand.CUT not in row.commands


@pytest.mark.parametrize("state", AxisPhase)
def test_only_a_stop_that_is_overdue_cuts_the_voltage_and_never_that_of_a_load(state):
    cuts = [trigger for trigger, row in TABLE[state].items() if DriveCommand.CUT in row.commands]
    assert set(cuts) <= {PhaseTrigger.TIMEOUT}
    assert not cuts or state in (AxisPhase.FORCED_QUICK_STOP, AxisPhase.QUICK_STOPPING), "after a quick stop"


@pytest.mark.parametrize("holds_load", [False, True])
@pytest.mark.parametrize("moving", [len(REACHED), 2])
def test_a_drive_that_does_nothing_it_is_reported_is_escalated_to_the_end_in_time(holds_load, moving):
    power, now, states = make(*REACHED[:moving], holds_load=holds_load), 0, []
    power.fire(PhaseTrigger.STOP, now)
    while power.state is not AxisPhase.STOP_FAILED:
        now += 100_000_000
        assert now < STOP_TIMEOUT_NS, "within the time that a robot has to stop"
        states += [power.state] if power.overdue(now) else []
    assert states[0] is AxisPhase.FORCED_QUICK_STOP
    assert (AxisPhase.VOLTAGE_DISABLED in states) is not holds_load
    assert power.state is AxisPhase.STOP_FAILED


def test_a_target_that_stands_gives_a_stop_no_more_time():
    power = make(*REACHED)
    power.fire(PhaseTrigger.STOP, 5)
    power.fire(PhaseTrigger.TARGET_AT_STANDSTILL, 1000)
    assert power.deadline == 5 + LIMITS_NS[AxisPhase.RAMPING_DOWN]
    assert power.since == 5


@given(st.lists(st.sampled_from(list(PhaseTrigger)), max_size=60), st.booleans())
def test_whatever_happens_an_axis_moves_only_after_an_enable_and_the_drive_is_reported_the_same(triggers, holds_load):
    power = make(holds_load=holds_load)
    machine, command = power._machine, power._commands[0]
    enabled = False
    for now, trigger in enumerate(triggers):
        before = power.state
        changed = power.fire(trigger, now)
        assert changed is (power.state is not before)
        enabled = trigger is PhaseTrigger.ENABLE or (enabled and trigger not in ENDS_ENABLE)
        assert enabled or power.state not in ENABLED_STATES
        assert power.following is command.enabled is (power.state is AxisPhase.FOLLOWING)
        assert (machine.goal is DriveGoal.ENABLED) is (power.enable_requested or power.falling)
        if trigger is PhaseTrigger.ENABLE:
            assert not power.following, "a command must be newer"
        if power.state is AxisPhase.SWITCHING_ON:
            assert machine.held_in_switched_on
        if power.following:
            assert not machine.halted


class Joint:
    """A joint and a drive that does what the walk says."""

    def __init__(self):
        self.statechart = make()
        self.is_enabled_or_ready = self.at_rest = False

    @property
    def enable_requested(self):
        return self.statechart.enable_requested

    def has_settled(self, now):
        return self.at_rest

    def stop(self, now):
        self.statechart.fire(PhaseTrigger.STOP, now)


OF_THE_DRIVE = [each for each in PhaseTrigger if not each.name.startswith("GROUP_")]
STEPS = st.one_of(
    st.tuples(st.integers(0, 2), st.sampled_from(OF_THE_DRIVE)),
    st.tuples(st.integers(0, 2), st.sampled_from(["is_enabled_or_ready", "at_rest"])),
    st.just((0, "stop")),
)


@given(st.lists(st.lists(STEPS, max_size=4), max_size=30))
def test_the_joints_of_a_group_are_enabled_together_and_stop_together(cycles):
    group = StopGroup()
    group.joints = [Joint(), Joint(), Joint()]
    for now, cycle in enumerate(cycles):
        for number, what in cycle:
            joint = group.joints[number]
            if what == "stop":
                moved = [item for item in group.joints if item.enable_requested]
                assert group.stop(now) == moved
                assert not any(item.enable_requested for item in group.joints)
            elif isinstance(what, PhaseTrigger):
                joint.statechart.fire(what, now)
            else:
                setattr(joint, what, not getattr(joint, what))
        waiting = [item for item in group.joints if item.statechart.state is AxisPhase.SWITCHING_ON]
        braking = [item for item in group.joints if item.statechart.falling]
        group.coordinate(now)
        states = [item.statechart.state for item in group.joints]
        if AxisPhase.SWITCHING_ON in states or AxisPhase.ENABLING in states:
            assert AxisPhase.FOLLOWING not in states, "none moves while another one is on its way up"
        let = [item for item in waiting if item.statechart.state is not AxisPhase.SWITCHING_ON]
        assert let in ([], waiting), "all of them or none"
        assert not let or all(item.is_enabled_or_ready for item in waiting)
        down = [item for item in braking if item.statechart.state is AxisPhase.DISABLING]
        assert down in ([], braking)
        assert not down or all(item.at_rest for item in braking)
        assert group.busy is any(item.statechart.rising or item.statechart.falling for item in group.joints)


def test_stopped_is_reported_of_states_in_which_nothing_is_on_its_way():
    assert not set(STOPPED) & {*ENABLED_STATES, *STOPPING, *LIMITS_NS}
