"""Events of a drive that is slow or does not move name the key of bus.yml and the state."""

import pytest
from support.conversation import Device, plan
from support.makers import drive, sentences

from canopen_control.cia402.state import State
from canopen_control.errors import BootError
from canopen_control.hardware.axis_statechart import Action
from canopen_control.master.boot import boot
from canopen_control.virtual.power_machine import PowerMachine


def _broken(made):
    axis = drive(made, 2)
    axis.fault(0x2310, axis._clock.now)
    made.run(0.3)
    return axis


@pytest.mark.sources
def test_a_fault_that_goes_late_has_a_key(robot, monkeypatch):
    reset = PowerMachine._reset_fault

    def late(self, transition, now):
        self._mover.at("reset", now + 3_000_000_000, lambda then: reset(self, transition, then))

    monkeypatch.setattr(PowerMachine, "_reset_fault", late)
    created = robot("pv", keys="fault_reset_timeout_ms: 4000")
    axis = _broken(created)
    answers = []
    created.simulated.core.axis(Action.FAULT_RESET, "all", answers.append)
    created.run(4)
    assert axis.state is State.SWITCH_ON_DISABLED
    assert answers in ([None], [""])
    assert not [sentence for sentence in sentences(created) if "had no effect" in sentence]


@pytest.mark.sources
def test_a_fault_reaction_that_does_not_end_is_named(robot, monkeypatch):
    finish = PowerMachine.finish
    monkeypatch.setattr(
        PowerMachine, "finish", lambda self, target, now: target is State.FAULT or finish(self, target, now)
    )
    created = robot("pv")
    created.command("vel", 0.5, 0.0, seconds=0.5)
    created.run(0.4)
    axis = _broken(created)
    assert axis.state is State.FAULT_REACTION_ACTIVE
    created.reset_faults()
    created.run(3)
    assert any(
        "still in FAULT_REACTION_ACTIVE" in sentence and "none was sent" in sentence for sentence in sentences(created)
    )


@pytest.mark.sources
def test_a_quick_stop_that_is_switched_off_is_named_with_its_object(robot, monkeypatch):
    monkeypatch.setattr(PowerMachine, "_quick_stop", lambda _self, _transition, _now: None)
    created = robot("pv")
    created.command("vel", 0.5, 0.0, seconds=0.5)
    created.run(0.4)
    created.simulated.core.axis(Action.QUICK_STOP, "all", lambda _error: None)
    created.run(1.5)
    assert any(
        "did not leave OPERATION_ENABLED" in sentence and "0x605A" in sentence for sentence in sentences(created)
    )
    assert not created.drives[2].moving


def test_a_node_that_answers_late_is_reported_boot_time():
    node = Device(silent=True)
    with pytest.raises(BootError, match=r"its boot-up message was received: .* increase `boot_time` of the master"):
        node.run(boot(plan(), reset=True))
    node = Device(silent=True)
    node.boots = False
    with pytest.raises(BootError) as caught:
        node.run(boot(plan(), reset=True))
    assert "boot_time" not in str(caught.value)
