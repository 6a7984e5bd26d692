"""The bench of one drive: its files, and a small program that is loaded, killed and loaded again."""

import pytest
from canopen_control_bench import one_drive
from canopen_control_bench.stage import stage

from canopen_control.errors import CanopenError
from canopen_control.od.eds import read_eds
from canopen_control.service.backup_choice import parameters_of


def test_the_drive_that_is_cloned_has_as_many_parameters_as_it_says(tmp_path):
    od = read_eds(one_drive._large_eds(tmp_path / "large.eds"), 3).od
    entries = parameters_of(od)
    assert len(entries) == one_drive.PARAMETERS + 50
    assert sum(entry.index in range(0x3000, 0x4000) for entry in entries) > 100


def test_what_does_not_come_in_time_is_told(monkeypatch):
    monkeypatch.setattr(one_drive, "TIMEOUT_S", 0.01)
    with pytest.raises(CanopenError, match="not within"):
        one_drive._until(lambda: False)


@pytest.mark.process
def test_a_verb_that_fails_is_told_with_its_complaint():
    with stage(), pytest.raises(CanopenError, match=r"diff a\.dcf b\.dcf: 2: canopen-control: a\.dcf: no such file"):
        one_drive._command("diff", "a.dcf", "b.dcf")


@pytest.mark.process
def test_a_program_is_loaded_killed_and_loaded_again():
    rate, spoilt = one_drive._programs(1, 1, 4096)
    assert rate.limit is None
    assert rate.ours > 0.0
    assert (spoilt.ours, spoilt.limit, spoilt.counted) == (0.0, 0.0, True)
