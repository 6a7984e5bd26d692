"""Stops of a drive in motion that its RPDOs do not reach, or that obeys only some of them."""

import pytest
from support.makers import drive, sentences

from canopen_control.hardware.axis_statechart import Action
from canopen_control.virtual.profile_modes import HomingMode

PAN = 2
_OFF = 1 << 31  # CiA 301, 7.5.2.35: bit 31 of a COB-ID, the PDO does not exist


def _turning(robot, mode="pv"):
    created = robot(mode)
    created.command("vel", 0.5, 0.5, seconds=30)
    created.run(1.0)
    assert created.velocity("pan") == pytest.approx(0.5, rel=0.01)
    return created


def _stops_within(created, seconds):
    return created.until(lambda: not created.drives[PAN].moving, seconds) <= seconds


@pytest.mark.parametrize("mode", ["pv", pytest.param("csv", marks=pytest.mark.rest)])
def test_a_drive_that_receives_no_sync_is_stopped_by_sdo(robot, mode):
    """Its synchronous RPDOs have no effect, and it sends no synchronous TPDO."""
    created = _turning(robot, mode)
    created.drives[PAN].fault("sync_deaf")
    assert _stops_within(created, 1.2)


@pytest.mark.parametrize(("action", "seconds"), [("quick-stop", 0.2), ("halt", 3.0), ("disable", 3.0)])
def test_a_drive_that_has_switched_its_rpdos_off_is_stopped_by_each_action(robot, action, seconds):
    created = _turning(robot)
    session = created.session(PAN)
    for index, cob_id in ((0x1400, 0x202), (0x1401, 0x302)):
        session.transfers.write(index, 1, (_OFF | cob_id).to_bytes(4, "little"))
    created.do("axis", "pan_drive", name=action)
    assert _stops_within(created, seconds)


@pytest.mark.sources
def test_a_drive_that_goes_on_after_its_homing_has_failed_is_stopped(robot, monkeypatch):
    """There are drives that do not end a homing when bit 4 is cleared."""
    control = HomingMode.control

    def begins_only(self, word, previous, now):
        if not previous & ~word & 0x10:
            control(self, word, previous, now)

    monkeypatch.setattr(HomingMode, "control", begins_only)
    created = robot("csp", keys="homing_timeout_seconds: 2")
    store, axis = created.simulated.drives[PAN].device.store, drive(created, PAN)
    for index, subindex, value in ((0x6099, 1, 400_000), (0x6099, 2, 40_000), (0x609A, 0, 400_000)):
        store.set(index, subindex, value)
    axis.mover.switches.negative = -1e9
    answers = []
    created.simulated.core.axis(Action.HOME, "pan_drive", answers.append, method=17)
    created.until(lambda: answers, 4)
    assert "home not reached" in answers[0]
    assert _stops_within(created, 3.5)
    assert any("it moves on although it has to stand" in sentence for sentence in sentences(created))
