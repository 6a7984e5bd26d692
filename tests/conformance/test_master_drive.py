"""Checks of controlwords and reactions: each detects a master with one fault."""

import pytest
from support.broken_masters import COMMANDS, ChainsEnable, HoldsBit7, failures, ids, worked
from support.scripted_master import ScriptedMaster

from canopen_control.cia402.state import State


@pytest.mark.parametrize(("check_id", "kind", "faults"), COMMANDS, ids=ids(COMMANDS))
def test_a_broken_master_is_found(check_id, kind, faults):
    failed = failures(kind, faults)
    assert check_id in failed, failed


@pytest.mark.parametrize(("check_id", "kind"), [("MW02", ChainsEnable), ("MW03", HoldsBit7), ("MW04", ScriptedMaster)])
def test_fault_resets(check_id, kind):
    master = worked(kind)
    if check_id != "MW04":  # which is reset without a fault
        master.device.drives[0].fault(0x4310, master.now)
        master.wait(0.5)
        assert master.device.drives[0].state is State.FAULT
    master.fault_reset()
    assert master.verdicts()[0].keys() == {check_id}
