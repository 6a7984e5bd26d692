"""The run of a judged device, at a master that keeps everything."""

import pytest
from support.broken_masters import worked
from support.scripted_master import ScriptedMaster

REACTIONS = (("fault", 0), ("power", 0), ("leaves", 0), ("flood", 0), ("heartbeat", 0), ("silent", 0))
RESETS = tuple(("reset", number) for number in range(5))


@pytest.mark.parametrize("fault", [*REACTIONS, *RESETS])
def test_a_master_that_keeps_everything_passes_each_fault(fault):
    failed, passed = worked(ScriptedMaster, [fault]).verdicts()
    assert failed == {}
    assert len(passed) > 30


def test_a_late_answer_and_a_refused_write_are_tested():
    assert "MT10" in worked(ScriptedMaster, [("reset", 3)]).verdicts()[1]
    assert "MC14" in worked(ScriptedMaster, [("reset", 4)]).verdicts()[1]
    assert "MT05" in worked(ScriptedMaster, [("reset", 1)]).verdicts()[1]
