from __future__ import annotations

import contextlib
import sys
from typing import TYPE_CHECKING

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support import reference_drive as ref
from support.properties import examples
from support.reference_drive import ReferenceDrive

from canopen_control.cia402.drive import DriveMachine
from canopen_control.cia402.drive_goal import DriveGoal
from canopen_control.cia402.events import (
    ControlChanged,
    EnableLost,
    FaultCleared,
    FaultEntered,
    FaultResetFailed,
    ModeConfirmed,
    ModeTimedOut,
    StateChanged,
    StatuswordUndefined,
    TransitionTimedOut,
)
from canopen_control.cia402.modes import OperationMode
from canopen_control.cia402.state import State, decode_statusword
from canopen_control.errors import DriveError, LocalProtocolError

if TYPE_CHECKING:
    from collections.abc import Callable

MS = 1_000_000
MODES = [None, 1, 2, 3, 4, 6, 7, 8, 9, 10, 11, -1]


class Rig:
    """A machine and a reference drive on a bus that carries each word `delay` cycles later; 10 ms per cycle."""

    def __init__(self, delay: int = 1, mode: int | None = None, **drive) -> None:
        self.machine = DriveMachine("left_drive", transition_timeout_ns=1000 * MS, settle_ns=100 * MS)
        self.drive = ReferenceDrive(**drive)
        self.now = 0
        self.words: list[int] = []
        self.events: list = []
        self.status_pipe = [None] * delay
        self.control_pipe = [0] * delay
        self.deaf = False
        if mode is not None:
            self.machine.set_mode(mode)

    def cycle(self, count: int = 1) -> Rig:
        for _ in range(count):
            self.now += 10 * MS
            self.drive.step()
            self.status_pipe.append((self.drive.statusword, self.drive.mode))
            observed = self.status_pipe.pop(0)
            word = self.machine.update(*(observed or (None, None)), self.now)
            self.words.append(word)
            self.control_pipe.append(word)
            arrived = self.control_pipe.pop(0)
            if not self.deaf:
                self.drive.write(arrived)
                if self.machine.mode is not None:
                    self.drive.mode = self.machine.mode
            self.events += self.machine.events()
        return self

    def until(self, state: int, limit: int = 300) -> Rig:
        for _ in range(limit):
            if self.machine.state is not None and self.machine.state.value == state:
                return self
            self.cycle()
        raise AssertionError(f"never in 0x{state:02X}, but {self.machine.state}")

    def enabled(self) -> Rig:
        self.machine.enable()
        self.until(ref.OE).cycle(3)
        assert self.machine.enabled
        self.forget()
        return self

    def forget(self) -> None:
        self.words.clear()
        self.events.clear()
        self.drive.taken.clear()

    def of(self, kind: type) -> list:
        return [event for event in self.events if isinstance(event, kind)]


def test_nothing_received_yet_is_controlword_0():
    machine = DriveMachine("x")
    machine.enable()
    assert machine.update(None, None, 0) == 0
    assert machine.state is None


def test_a_drive_is_enabled_stepwise_and_every_step_is_seen_first():
    rig = Rig()
    rig.machine.enable()
    rig.until(ref.OE)
    assert list(dict.fromkeys(rig.words)) == [0x00, 0x06, 0x07, 0x0F]
    assert rig.drive.taken == [0, 1, 2, 3, 4]
    assert [event.state for event in rig.of(StateChanged)][-3:] == [
        State.READY_TO_SWITCH_ON,
        State.SWITCHED_ON,
        State.OPERATION_ENABLED,
    ]
    assert rig.machine.reached
    assert rig.machine.may_move


def test_without_enable_nothing_ever_rises():
    rig = Rig().cycle(50)
    assert set(rig.words) == {0}
    assert rig.drive.taken == [0, 1]
    assert rig.machine.reached


@pytest.mark.parametrize("delay", [0, 1, 2, 3])
@pytest.mark.parametrize("mode", MODES)
def test_disable_is_the_drives_ramp_then_shutdown_then_no_voltage(delay, mode):
    rig = Rig(delay, mode).enabled()
    rig.machine.disable()
    assert not rig.machine.enabled
    rig.until(ref.SOD)
    assert list(dict.fromkeys(rig.words)) == [0x07, 0x06, 0x00]
    assert rig.drive.taken == [5, 6, 7]
    assert rig.machine.reached
    assert not rig.of(EnableLost)


@pytest.mark.parametrize(
    ("state", "taken"), [(State.SWITCHED_ON, [5]), (State.READY_TO_SWITCH_ON, [5, 6])], ids=lambda value: str(value)
)
def test_a_disabled_drive_may_be_left_higher_but_is_never_lifted_there(state, taken):
    rig = Rig()
    rig.machine.disabled_state = state
    rig.enabled()
    rig.machine.disable()
    rig.cycle(20)
    assert rig.machine.state is state
    assert rig.drive.taken == taken
    assert rig.machine.reached
    rig.drive.lose_mains()
    rig.cycle(20)
    assert rig.machine.state is State.SWITCH_ON_DISABLED
    assert rig.machine.reached


def test_a_state_that_no_disabled_drive_has_is_refused():
    with pytest.raises(LocalProtocolError, match="OPERATION_ENABLED is not a state of a disabled drive"):
        DriveMachine("x", disabled_state=State.OPERATION_ENABLED)


def test_disable_voltage_coasts_at_once():
    rig = Rig().enabled()
    rig.machine.disable_voltage()
    rig.machine.disable()  # no weaker wish replaces it
    rig.machine.quick_stop()
    rig.until(ref.SOD)
    assert set(rig.words) == {0}
    assert rig.drive.taken == [9]
    assert rig.machine.goal is DriveGoal.VOLTAGE_DISABLED
    assert rig.machine.reached


TRANSITIONS = {
    1: ("", []),
    2: ("enable", []),
    3: ("enable", []),
    4: ("enable", []),
    5: ("disable", ["enable"]),
    6: ("disable", ["enable"]),
    7: ("disable", ["enable"]),
    8: ("foreign shutdown", ["enable"]),
    9: ("disable_voltage", ["enable"]),
    10: ("voltage at switched on", []),
    11: ("quick_stop", ["enable"]),
    12: ("quick_stop", ["enable"]),
    13: ("fault", ["enable"]),
    14: ("fault", ["enable"]),
    15: ("fault and reset", ["enable"]),
    16: ("quick stop and enable", ["enable"]),
}


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("number", [0, *TRANSITIONS])
def test_each_transition_is_taken_and_followed_in_every_mode(number, mode):
    rig = Rig(mode=mode, quick_stop_option=6 if number == 16 else 2)
    action, before = TRANSITIONS.get(number, ("", []))
    if before:
        rig.enabled()
    act(rig, action)
    rig.cycle(40)
    assert number in rig.drive.taken
    assert rig.machine.state is decode_statusword(rig.drive.statusword)
    if number not in (2, 3, 4, 16):
        assert not rig.machine.enabled
        assert 0x0F not in {word & 0x0F for word in rig.words[3:]}
    assert not rig.of(TransitionTimedOut)


def act(rig: Rig, action: str) -> None:
    if action in ("enable", "disable", "disable_voltage", "quick_stop"):
        getattr(rig.machine, action)()
    elif action == "foreign shutdown":
        rig.drive.go(8, ref.RTSO)  # by the drive's own keys, without a ramp
    elif action == "voltage at switched on":
        rig.machine.enable()
        rig.until(ref.SO)
        rig.machine.disable_voltage()
        rig.forget()
        rig.words += [0, 0, 0]
        rig.control_pipe = [0]  # the 0x0F that was on its way is not what this row is about
    elif action.startswith("fault"):
        rig.drive.fault()
        if action.endswith("reset"):
            rig.until(ref.FAULT)
            rig.machine.fault_reset()
    elif action:
        rig.machine.quick_stop()
        rig.until(ref.QSA)
        rig.machine.enable()


def test_verbs_may_be_reported_again_and_do_nothing_then():
    rig = Rig().enabled()
    for _ in range(3):
        rig.machine.enable()
        rig.machine.halt(False)
        rig.machine.fault_reset()
        rig.cycle(2)
    assert set(rig.words) == {0x0F}
    for _ in range(3):
        rig.machine.disable()
        rig.cycle(20)
    assert rig.drive.taken == [5, 6, 7]
    assert [type(event) for event in rig.events] == [StateChanged] * 3


# -- quick stop


@pytest.mark.parametrize("option", [2, 6])
def test_enable_continues_from_wherever_the_quick_stop_ended(option):
    rig = Rig(quick_stop_option=option).enabled()
    rig.machine.quick_stop()
    rig.cycle(20)
    assert rig.machine.reached
    assert rig.machine.state is (State.SWITCH_ON_DISABLED if option == 2 else State.QUICK_STOP_ACTIVE)
    rig.machine.enable()
    rig.until(ref.OE).cycle(5)
    assert rig.machine.enabled
    assert rig.drive.taken == ([11, 12, 2, 3, 4] if option == 2 else [11, 16])


@pytest.mark.parametrize("option", [2, 6])
def test_enable_during_the_stop_does_not_cut_the_power(option):
    rig = Rig(quick_stop_option=option, ramp_steps=30).enabled()
    rig.machine.quick_stop()
    rig.until(ref.QSA)
    rig.machine.enable()
    rig.until(ref.OE)
    assert 9 not in rig.drive.taken
    assert rig.drive.taken == ([11, 12, 2, 3, 4] if option == 2 else [11, 16])


def test_a_drive_without_transition_16_is_enabled_through_switch_on_disabled():
    rig = Rig(quick_stop_option=6, knows_16=False).enabled()
    rig.machine.quick_stop()
    rig.cycle(20)
    rig.machine.enable()
    rig.until(ref.OE, 400)
    assert rig.drive.taken == [11, 12, 2, 3, 4]
    assert not rig.of(TransitionTimedOut)


def test_disable_in_a_quick_stop_waits_for_its_end():
    rig = Rig(quick_stop_option=6, ramp_steps=50).enabled()
    rig.machine.quick_stop()
    rig.until(ref.QSA)
    rig.machine.disable()
    rig.cycle(40)
    assert rig.machine.state is State.QUICK_STOP_ACTIVE
    assert set(rig.words) == {0x02}
    rig.until(ref.SOD)
    assert rig.drive.taken == [11, 12]


def test_a_confirmed_standstill_shortens_the_wait():
    rig = Rig(quick_stop_option=6, ramp_steps=50).enabled()
    rig.machine.quick_stop()
    rig.until(ref.QSA)
    rig.machine.disable()
    rig.cycle(5)
    rig.machine.standstill = True
    rig.cycle(5)
    assert rig.machine.state is State.SWITCH_ON_DISABLED


def test_a_quick_stop_that_never_ends_is_reported_and_then_ended():
    rig = Rig(quick_stop_option=6, ramp_steps=10_000).enabled()
    rig.machine.quick_stop()
    rig.until(ref.QSA)
    rig.machine.disable()
    rig.until(ref.SOD)
    (event,) = rig.of(TransitionTimedOut)
    assert event.state is State.QUICK_STOP_ACTIVE
    assert not event.gave_up


def test_disable_does_not_take_back_a_quick_stop_that_is_on_its_way():
    rig = Rig(delay=3, quick_stop_option=6).enabled()
    rig.machine.quick_stop()
    rig.cycle()
    rig.machine.disable()
    rig.until(ref.SOD)
    assert rig.drive.taken == [11, 12]
    assert list(dict.fromkeys(rig.words)) == [0x02, 0x00]


def test_enable_takes_back_a_quick_stop_at_once_and_as_often_as_it_is_reported():
    rig = Rig(quick_stop_option=6).enabled()
    for _ in range(5):
        rig.machine.quick_stop()
        rig.cycle()
        rig.machine.enable()
        rig.cycle(30)
        assert rig.machine.enabled
    assert rig.words[:3] == [0x02, 0x0F, 0x0F]
    assert not rig.of(EnableLost)


def test_enable_tries_transition_16_even_after_a_disable_that_waits_for_the_stop():
    rig = Rig(quick_stop_option=6, ramp_steps=100).enabled()
    rig.machine.quick_stop()
    rig.until(ref.QSA)
    rig.machine.disable()
    rig.cycle(5)
    rig.machine.enable()
    rig.until(ref.OE)
    assert rig.drive.taken == [11, 16]


def test_an_end_of_the_stop_seen_before_the_disable_counts():
    machine = DriveMachine("x")
    machine.update(0x0237, None, 0)
    machine.quick_stop()
    for now, word in enumerate([0x0617, 0x0217, 0x0617]):
        assert machine.update(word, None, now) == 0x02
    machine.disable()
    assert machine.update(0x0617, None, 9) == 0x00


def test_a_quick_stop_of_its_own_ends_the_enable():
    rig = Rig(quick_stop_option=6).enabled()
    rig.drive.quick_stop()
    rig.cycle(30)
    assert len(rig.of(EnableLost)) == 1
    assert rig.machine.state is State.SWITCH_ON_DISABLED
    assert 0x0F not in rig.words[2:]


# -- faults


def test_a_fault_ends_the_enable_and_nothing_is_reset_or_enabled_by_itself():
    rig = Rig().enabled()
    rig.drive.fault()
    rig.cycle(500)
    (event,) = rig.of(FaultEntered)
    assert event.was_enabled
    assert event.state is State.FAULT_REACTION_ACTIVE
    assert not rig.of(EnableLost)
    assert rig.machine.fault
    assert rig.machine.goal is DriveGoal.DISABLED
    assert rig.machine.reached
    assert set(rig.words[3:]) == {0}


def test_a_reset_is_an_edge_and_the_drive_stays_disabled_after_it():
    rig = Rig().enabled()
    rig.drive.fault()
    rig.until(ref.FAULT).forget()
    rig.machine.fault_reset()
    rig.machine.fault_reset()
    rig.cycle(200)
    assert [word for i, word in enumerate(rig.words) if i == 0 or word != rig.words[i - 1]] == [0x00, 0x80, 0x00]
    assert rig.drive.taken == [15]
    assert len(rig.of(FaultCleared)) == 1
    assert rig.machine.state is State.SWITCH_ON_DISABLED
    assert not rig.machine.resetting


def test_a_cause_that_stays_is_reported_and_a_later_reset_is_a_new_edge():
    rig = Rig().enabled()
    rig.drive.fault()
    rig.drive.cause_present = True
    rig.until(ref.FAULT)
    rig.machine.fault_reset()
    rig.cycle(300)
    assert len(rig.of(FaultResetFailed)) == 1
    assert rig.words[-1] == 0
    rig.drive.cause_present = False
    rig.cycle(100)
    assert rig.machine.fault
    rig.machine.fault_reset()
    rig.until(ref.SOD)


def test_enable_in_a_fault_is_refused_and_changes_nothing():
    rig = Rig().enabled()
    rig.drive.fault()
    rig.until(ref.FAULT)
    with pytest.raises(DriveError, match=r"left_drive: cannot be enabled in a fault \(statusword 0x0218\)"):
        rig.machine.enable()
    rig.machine.fault_reset()
    with pytest.raises(DriveError):
        rig.machine.enable()
    rig.cycle(50)
    assert rig.machine.state is State.SWITCH_ON_DISABLED
    assert rig.machine.goal is DriveGoal.DISABLED


def test_an_enable_asked_for_before_the_fault_was_seen_is_discarded():
    machine = DriveMachine("x")
    machine.enable()
    machine.fault_reset()
    words = [machine.update(word, None, now) for now, word in enumerate([0x0208, 0x0208, 0x0208, 0x0240, 0x0240])]
    assert words == [0, 0x80, 0x80, 0, 0]
    assert machine.goal is DriveGoal.DISABLED


def test_a_reset_without_a_fault_sends_nothing():
    rig = Rig().cycle(5)
    rig.machine.fault_reset()
    assert not rig.machine.resetting
    rig.cycle(5)
    assert set(rig.words) == {0}


# -- losing it


def test_lost_mains_clears_the_goal_and_names_the_power_stage():
    rig = Rig().enabled()
    rig.drive.lose_mains()
    rig.cycle(50)
    (event,) = rig.of(EnableLost)
    assert event.power_stage_off
    assert event.state is State.SWITCH_ON_DISABLED
    rig.drive.mains = True
    rig.cycle(50)
    assert set(rig.words[3:]) == {0}
    assert rig.drive.state == ref.SOD
    rig.machine.enable()
    rig.until(ref.OE)


def test_a_supply_that_only_bit_4_shows_as_lost_ends_the_enable():
    rig = Rig().enabled()
    rig.drive.mains = False
    rig.cycle(9)
    assert rig.events == []
    rig.cycle(30)
    (event,) = rig.of(EnableLost)
    assert event.supply_lost
    assert event.state is State.OPERATION_ENABLED
    assert "STO is active (statusword 0x0227, bit 4 is 0)" in event.text
    assert rig.machine.goal is DriveGoal.DISABLED
    assert rig.drive.state == ref.SOD


def test_a_supply_that_dips_for_a_moment_ends_nothing():
    rig = Rig().enabled()
    rig.drive.mains = False
    rig.cycle(8)
    rig.drive.mains = True
    rig.cycle(50)
    assert rig.events == []
    assert rig.machine.enabled


def test_a_drive_that_keeps_falling_back_on_the_way_up_is_not_fought_with():
    machine = DriveMachine("x")
    machine.enable()
    for now in range(20):
        machine.update(0x0221 if now % 2 else 0x0240, None, now)
    assert machine.goal is DriveGoal.DISABLED
    assert sum(isinstance(event, EnableLost) for event in machine.events()) == 1


@pytest.mark.parametrize("delay", [0, 1, 2, 3])
@pytest.mark.parametrize("verb", ["disable", "quick_stop", "disable_voltage"])
def test_an_enable_that_overtakes_a_stop_is_not_taken_for_a_loss(delay, verb):
    rig = Rig(delay).enabled()
    getattr(rig.machine, verb)()
    rig.cycle()
    rig.machine.enable()
    rig.cycle(100)
    assert rig.machine.enabled
    assert rig.machine.may_move
    assert not rig.of(EnableLost)
    rig.drive.lose_mains()
    rig.cycle(5)
    assert len(rig.of(EnableLost)) == 1


def test_a_drive_that_vanishes_is_disabled_and_its_return_enables_nothing():
    rig = Rig(mode=8).enabled()
    assert rig.machine.update(None, None, rig.now) == 0
    events = rig.machine.events()
    assert [type(event) for event in events] == [StateChanged, EnableLost]
    assert not events[1].power_stage_off
    assert not rig.machine.mode_request.confirmed
    rig.drive.state = ref.NRSO
    rig.cycle(50)
    assert rig.machine.state is State.SWITCH_ON_DISABLED
    assert rig.machine.mode == 8
    assert rig.machine.mode_request.confirmed


def test_a_drive_found_enabled_is_ramped_down():
    rig = Rig(delay=0)  # its statusword is received before the first controlword is sent
    rig.drive.state = ref.OE
    rig.until(ref.SOD)
    assert rig.drive.taken == [0, 5, 6, 7]


# -- time


@pytest.mark.parametrize(
    ("stuck", "number", "command"), [(0x0240, 2, 0x06), (0x0221, 3, 0x07), (0x0223, 4, 0x0F), (0x0200, 1, 0x00)]
)
def test_a_transition_that_does_not_come_gives_the_enable_up(stuck, number, command):
    machine = DriveMachine("x", transition_timeouts={4: 50, 3: 30}, transition_timeout_ns=100)
    timeout = {4: 50, 3: 30}.get(number, 100)
    machine.enable()
    assert machine.update(stuck, None, 1000) == command
    assert machine.next_deadline() == 1000 + timeout
    assert machine.update(stuck, None, 1000 + timeout - 1) == command
    machine.update(stuck, None, 1000 + timeout)
    (event,) = (event for event in machine.events() if isinstance(event, TransitionTimedOut))
    assert (event.transition, event.gave_up, event.time, event.statusword) == (number, True, 1000 + timeout, stuck)
    assert machine.goal is DriveGoal.DISABLED
    assert machine.controlword != 0x0F


def test_a_drive_that_never_sends_is_reported_too():
    machine = DriveMachine("x", transition_timeout_ns=100)
    machine.enable()
    machine.update(None, None, 0)
    machine.update(None, None, 100)
    (event,) = machine.events()
    assert isinstance(event, TransitionTimedOut)
    assert event.state is None
    assert machine.goal is DriveGoal.DISABLED


def test_a_drive_that_does_not_stop_is_reported_once_and_commanded_again():
    machine = DriveMachine("x", transition_timeout_ns=100)
    for now in range(0, 1000, 10):
        assert machine.update(0x0237, None, now) == 0x07
    (event,) = (event for event in machine.events() if isinstance(event, TransitionTimedOut))
    assert (event.transition, event.gave_up) == (5, False)


def test_a_quick_stop_that_is_not_obeyed_is_reported_and_a_disable_then_asks_otherwise():
    rig = Rig().enabled()
    rig.deaf = True
    rig.machine.quick_stop()
    rig.machine.disable()
    rig.cycle(150)
    assert [event.transition for event in rig.of(TransitionTimedOut)] == [11]
    assert list(dict.fromkeys(rig.words)) == [0x02, 0x07]


# -- modes


def test_the_mode_is_confirmed_before_operation_is_enabled():
    machine = DriveMachine("x")
    machine.set_mode(8)
    machine.enable()
    words = [machine.update(word, 1, now) for now, word in enumerate([0x0240, 0x0221, 0x0223, 0x0223, 0x0223])]
    assert words == [0x06, 0x07, 0x07, 0x07, 0x07]
    assert machine.mode == 8
    assert machine.update(0x0223, 8, 5) == 0x0F
    assert any(isinstance(event, ModeConfirmed) for event in machine.events())


def test_a_mode_that_is_never_confirmed_is_not_enabled_and_must_be_asked_for_again():
    machine = DriveMachine("x", mode_timeout_ns=100)
    machine.set_mode(8)
    machine.enable()
    words = [machine.update(0x0223, 1, now) for now in range(0, 200, 10)]
    assert 0x0F not in words
    assert [type(event) for event in machine.events()] == [StateChanged, ModeTimedOut, EnableLost]
    assert machine.goal is DriveGoal.DISABLED
    assert machine.mode is None
    with pytest.raises(DriveError, match="its mode was not confirmed; set a mode first"):
        machine.enable()
    machine.set_mode(1)
    machine.enable()
    assert machine.update(0x0223, 1, 300) == 0x0F


def test_a_mode_changed_while_enabled_keeps_targets_back_until_it_is_confirmed():
    rig = Rig(mode=1).enabled()
    rig.machine.mode_bits = 0x10
    rig.machine.set_mode(8)
    assert rig.machine.enabled
    assert not rig.machine.may_move
    rig.cycle(5)
    assert rig.machine.may_move
    assert set(rig.words) == {0x0F}
    assert rig.machine.mode_bits == 0


def test_a_drive_that_stays_in_its_old_mode_continues_in_it():
    machine = DriveMachine("x", mode_timeout_ns=100)
    machine.set_mode(1)
    machine.enable()
    machine.update(0x0223, 1, 0)
    machine.update(0x0237, 1, 1)
    machine.set_mode(8)
    for now in range(2, 200, 10):
        assert machine.update(0x0237, 1, now) == 0x0F
    assert machine.may_move
    assert machine.mode == 1
    assert sum(isinstance(event, ModeTimedOut) for event in machine.events()) == 1


def test_a_drive_that_leaves_its_mode_by_itself_is_disabled():
    machine = DriveMachine("x", mode_timeout_ns=100)
    machine.set_mode(1)
    machine.enable()
    machine.update(0x0223, 1, 0)
    machine.update(0x0237, 1, 1)
    for now in (2, 3, 4):
        assert machine.may_move
        assert machine.update(0x0237, 6, now) == 0x0F
    assert not machine.may_move
    assert machine.update(0x0237, 6, 104) == 0x07
    assert machine.goal is DriveGoal.DISABLED


# -- the other bits


def test_halt_and_mode_bits_are_sent_to_an_enabled_drive_only():
    rig = Rig(mode=7)
    rig.machine.halt()
    rig.machine.mode_bits = 0x70
    rig.machine.enable()
    rig.until(ref.OE)
    assert set(rig.words[:-1]) <= {0x00, 0x06, 0x07, 0x0F}
    assert rig.words[-1] == 0x10F
    rig.machine.mode_bits = 0x270
    assert rig.cycle().words[-1] == 0x37F
    assert not rig.machine.may_move
    rig.machine.halt(False)
    assert rig.cycle().words[-1] == 0x27F
    rig.machine.disable()
    rig.cycle(20)
    assert rig.machine.mode_bits == 0
    rig.machine.enable()
    rig.until(ref.OE)
    assert rig.words[-1] == 0x0F


@pytest.mark.parametrize("delay", [1, 2, 4])
def test_a_halt_in_pp_ends_only_after_the_drive_has_left_operation_enabled(delay):
    """CiA 402-2, table 22, transition 4 clears the set-points; without it the drive would continue to the old one."""
    rig = Rig(mode=1, delay=delay).enabled()
    rig.machine.halt()
    rig.cycle(10)
    rig.forget()
    rig.machine.halt(False)
    rig.cycle(10)
    assert set(rig.words) == {0x10F}  # while the motor turns
    assert not rig.machine.may_move
    rig.machine.standstill = True
    rig.cycle(60)
    assert rig.drive.taken == [5, 4]
    assert rig.words.index(0x107) < rig.words.index(0x0F)
    assert not rig.machine.halted
    assert rig.machine.may_move
    assert rig.of(EnableLost) == rig.of(TransitionTimedOut) == []


def test_a_halt_in_pp_that_is_requested_again_remains():
    rig = Rig(mode=1).enabled()
    rig.machine.halt()
    rig.cycle(3)
    rig.machine.halt(False)
    rig.cycle(3)
    rig.machine.halt()
    rig.machine.standstill = True
    assert set(rig.cycle(60).words) == {0x10F}


def test_an_enable_during_the_stop_of_a_halted_pp_drive_waits_for_the_end_of_the_stop():
    rig = Rig(mode=1, ramp_steps=10).enabled()
    rig.machine.halt()
    rig.cycle(3)
    rig.machine.disable()
    rig.cycle(3)
    rig.forget()
    rig.machine.enable()
    rig.machine.halt(False)
    rig.cycle(30)
    assert rig.words.index(0x07) < rig.words.index(0x0F)
    assert rig.drive.taken == [5, 4]
    assert rig.machine.may_move


def test_bits_that_are_not_a_modes_are_refused():
    machine = DriveMachine("x")
    for bits in (0x0F, 0x80, 0x100, 0x400, -1):
        with pytest.raises(LocalProtocolError, match="bits that are not mode-specific"):
            machine.mode_bits = bits
    assert machine.mode_bits == 0


def test_axes_that_are_held_are_enabled_in_one_cycle():
    rigs = [Rig(delay=0, mode=8), Rig(delay=3, mode=8)]
    for rig in rigs:
        rig.machine.hold_in_switched_on()
        rig.machine.enable()
    while not all(rig.machine.waiting for rig in rigs):
        for rig in rigs:
            rig.cycle()
    for rig in rigs:
        rig.cycle(200)  # no time runs out
        assert rig.machine.state is State.SWITCHED_ON
        rig.machine.hold_in_switched_on(False)
        assert rig.cycle().words[-2:] == [0x07, 0x0F]
        rig.cycle(20)
        rig.machine.hold_in_switched_on()
        rig.cycle(20)
        assert rig.machine.enabled  # it holds back, it takes nothing away


def test_a_held_drive_in_its_quick_stop_stays_there():
    rig = Rig(quick_stop_option=6).enabled()
    rig.machine.quick_stop()
    rig.until(ref.QSA)
    rig.machine.hold_in_switched_on()
    rig.machine.enable()
    rig.cycle(200)
    assert rig.machine.waiting
    rig.machine.hold_in_switched_on(False)
    rig.until(ref.OE)
    assert rig.drive.taken == [11, 16]


def test_bits_that_mean_nothing_here_are_still_kept():
    rig = Rig().enabled()
    for word in (0x8237, 0x42B7, 0x0237, 0x0227):
        assert rig.machine.update(word, None, rig.now) == 0x0F
        assert rig.machine.statusword == word
    rig.machine.update(0x0240, None, rig.now)
    assert rig.machine.statusword == 0x0240
    assert any(isinstance(event, EnableLost) for event in rig.machine.events())


def test_an_undefined_statusword_keeps_the_state_is_counted_and_then_reported():
    rig = Rig().enabled()
    for _ in range(9):
        assert rig.machine.update(0x0001, None, rig.now) == 0x0F
    assert rig.machine.enabled
    assert rig.machine.events() == []
    assert rig.machine.update(0x0001, None, rig.now) == 0x07
    undefined, lost = rig.machine.events()
    assert isinstance(undefined, StatuswordUndefined)
    assert (undefined.updates, undefined.statusword) == (10, 0x0001)
    assert isinstance(lost, EnableLost)
    assert not rig.machine.enabled
    assert rig.machine.state is State.OPERATION_ENABLED
    for _ in range(20):
        rig.machine.update(0x0001, None, rig.now)
    assert rig.machine.events() == []
    assert rig.machine.undefined == 30


def test_local_control_is_reported_when_it_begins_and_ends_but_not_while_the_drive_starts():
    rig = Rig()
    rig.drive.remote = False
    rig.cycle(1)
    rig.cycle(10)
    (event,) = rig.of(ControlChanged)
    assert not event.remote
    assert not rig.machine.remote
    rig.drive.remote = True
    rig.cycle(10)
    assert [event.remote for event in rig.of(ControlChanged)] == [False, True]
    starting = DriveMachine("x")
    starting.update(0x0000, None, 0)
    assert [type(event) for event in starting.events()] == [StateChanged]


def test_a_drive_that_never_sets_bit_9_is_taken_as_it_is_where_that_is_asked_for():
    machine = DriveMachine("x", ignore_remote=True)
    machine.enable()
    assert [machine.update(word, None, now) for now, word in enumerate((0x40, 0x21, 0x23))] == [0x06, 0x07, 0x0F]
    assert machine.update(0x27, None, 3) == 0x0F
    assert machine.remote
    assert not [event for event in machine.events() if isinstance(event, ControlChanged)]


# -- the cycle


def test_a_steady_update_allocates_nothing():
    machine = DriveMachine("x")
    machine.set_mode(8)
    machine.enable()
    for now, word in enumerate([0x0240, 0x0221, 0x0223, 0x1237]):
        machine.update(word, 8, now)
    machine.events()
    assert machine.next_deadline() is None
    now = 10**12
    machine.update(0x1237, 8, now)
    before = sys.getallocatedblocks()
    for _ in range(1000):
        machine.update(0x1237, 8, now)
    assert sys.getallocatedblocks() - before < 5


# -- properties

VERBS = st.sampled_from(["enable", "disable", "quick_stop", "disable_voltage", "fault_reset", "halt", "mode", "bits"])
WORLD = st.sampled_from(["fault", "lose_mains", "mains", "cause", "no cause", "local", "noise", "gone", "reboot"])
STEPS = st.lists(
    st.one_of(st.tuples(st.just("cycle"), st.integers(1, 40)), st.tuples(VERBS | WORLD, st.integers(0, 15))),
    max_size=40,
)


def try_enable(rig: Rig, value: int) -> None:
    with contextlib.suppress(DriveError):
        rig.machine.enable()


def change(**fields: object) -> Callable[[Rig, int], None]:
    return lambda rig, value: [setattr(rig.drive, name, field) for name, field in fields.items()]


ACTIONS: dict[str, Callable[[Rig, int], object]] = {
    "cycle": lambda rig, value: rig.cycle(value),
    "enable": try_enable,
    "disable": lambda rig, value: rig.machine.disable(),
    "quick_stop": lambda rig, value: rig.machine.quick_stop(),
    "disable_voltage": lambda rig, value: rig.machine.disable_voltage(),
    "fault_reset": lambda rig, value: rig.machine.fault_reset(),
    "halt": lambda rig, value: rig.machine.halt(bool(value & 1)),
    "mode": lambda rig, value: rig.machine.set_mode(value),
    "bits": lambda rig, value: setattr(rig.machine, "mode_bits", (value & 7) << 4),
    "fault": lambda rig, value: rig.drive.fault(),
    "lose_mains": lambda rig, value: rig.drive.lose_mains(),
    "mains": change(mains=True),
    "cause": change(cause_present=True),
    "no cause": change(cause_present=False),
    "local": change(remote=False),
    "noise": lambda rig, value: setattr(rig.drive, "noise", value << 12 | (value & 1) << 11 | 0x20 * (value & 1)),
    "gone": lambda rig, value: setattr(rig, "status_pipe", [None] * len(rig.status_pipe)),
    "reboot": lambda rig, value: rig.drive.go(0, ref.NRSO),
}


@settings(max_examples=examples(200))
@given(STEPS, st.integers(0, 3), st.sampled_from([0, 2, 5, 6]), st.booleans())
def test_a_drive_moves_only_after_an_enable_whatever_happens(steps, delay, option, knows_16):
    rig = Rig(delay, quick_stop_option=option, knows_16=knows_16)
    requested = False
    for what, value in steps:
        ACTIONS[what](rig, value)
        requested = requested or what == "enable"
        assert requested or not {4, 16} & set(rig.drive.taken)
        assert rig.machine.goal is DriveGoal.ENABLED or not rig.machine.enabled
    # What was on its way has arrived after this; a goal that is not ENABLED ends without torque.
    rig.machine.disable()
    rig.drive.mains, rig.drive.cause_present, rig.drive.noise = True, False, 0
    rig.cycle(10 + 2 * delay)
    rig.forget()
    rig.cycle(600)
    assert not {4, 16} & set(rig.drive.taken)
    assert rig.machine.reached
    assert rig.drive.state in (ref.SOD, ref.FAULT)


@settings(max_examples=examples(300))
@given(
    st.lists(
        st.tuples(
            st.one_of(st.none(), st.integers(0, 0xFFFF), st.sampled_from([0x240, 0x221, 0x223, 0x237, 0x217, 0x208])),
            st.one_of(st.none(), st.integers(-2, 11)),
            VERBS,
            st.integers(0, 15),
            st.integers(0, 3000 * MS),
        ),
        max_size=60,
    )
)
def test_no_sequence_of_words_and_verbs_makes_it_raise_or_send_0x0f_without_the_goal(steps):
    machine = DriveMachine("x")
    rig = Rig()
    rig.machine = machine
    now = 0
    for word, display, verb, value, passed in steps:
        ACTIONS[verb](rig, value)
        now += passed
        sent = machine.update(word, display, now)
        assert sent == machine.controlword
        assert sent & ~0x3FF == 0
        if sent & 0x8F == 0x0F:
            assert machine.goal is DriveGoal.ENABLED
            state = machine.state
            assert state in (State.SWITCHED_ON, State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE)
            assert state is State.OPERATION_ENABLED or machine.mode_request.confirmed
        if sent & 0x300:
            assert machine.enabled
        if sent & 0x70:  # in mode VL the ramp stays unlocked until the drive has left OPERATION ENABLED
            assert machine.enabled or (machine.state is State.OPERATION_ENABLED and machine.mode == OperationMode.VL)
        if sent & 0x80:
            assert sent == 0x80
            assert machine.fault
        if word is None:
            assert sent == 0
        assert machine.next_deadline() is None or machine.next_deadline() > now
        machine.reached  # noqa: B018 - properties never raise
        machine.may_move  # noqa: B018


@pytest.mark.parametrize("cycles", [1, 4])
def test_a_statusword_of_0_during_the_transitions_does_not_end_the_enable(cycles):
    """The command of NOT READY TO SWITCH ON would disable the drive again."""
    machine, now, words = DriveMachine("left_drive"), 0, []
    machine.update(0x0250, None, now)
    machine.enable()
    for command, shown in ((0x06, 0x0231), (0x07, 0x0233), (0x0F, 0x0237)):
        for word in [machine.statusword] + [0] * cycles:
            now += 10 * MS
            words.append(machine.update(word, None, now))
        assert words[-cycles - 1 :] == [command] * (cycles + 1)
        now += 10 * MS
        machine.update(shown, None, now)
    assert machine.enabled
    now += 10 * MS
    machine.update(0, None, now)
    assert not machine.enabled, "an enabled drive has lost its state"


def test_a_drive_that_stays_not_ready_while_it_is_enabled_is_not_commanded_further():
    machine, now = DriveMachine("left_drive", undefined_limit=10), 0
    machine.update(0x0250, None, now)
    machine.enable()
    machine.update(0x0231, None, 10 * MS)
    words = [machine.update(0, None, (number + 2) * 10 * MS) for number in range(12)]
    assert words == [0x07] * 9 + [0] * 3
    assert machine.state is State.NOT_READY_TO_SWITCH_ON


def test_a_mode_display_that_strays_for_two_updates_does_not_stop_an_enabled_axis():
    rig = Rig(delay=0, mode=8).enabled()
    machine, word = rig.machine, rig.machine.statusword
    assert machine.may_move
    for display in (0, -1):
        rig.now += 10 * MS
        machine.update(word, display, rig.now)
        assert machine.may_move
    rig.now += 10 * MS
    machine.update(word, 8, rig.now)
    for _ in range(3):
        assert machine.may_move, "the count begins at 0 again"
        rig.now += 10 * MS
        machine.update(word, 3, rig.now)
    assert not machine.may_move
