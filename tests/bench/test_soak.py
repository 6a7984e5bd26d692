"""The soak: a drive that breaks stops all wheels, is mended and runs again; one that does not stop is seen."""

import pytest
from canopen_control_bench import soak
from canopen_control_bench.cycle import Arena
from canopen_control_bench.soak import FAULTS, Soak
from canopen_control_bench.stage import stage

from canopen_control.errors import CanopenError
from canopen_control.virtual.fault_table import FAULTS as ALL


def test_its_faults_are_faults():
    assert set(FAULTS) <= set(ALL)


@pytest.mark.process
def test_a_drive_breaks_and_comes_back_and_one_that_is_none_does_not_stop_anything(monkeypatch):
    with stage() as played:
        arena = Arena(played, 2, 10_000, base=False)
        ours = arena.ours()
        run = Soak(arena, ours.pid)
        monkeypatch.setattr(soak, "FAULTS", ("drive_fault",))
        run._drive_for(0.5)
        run._break()
        assert (run.seen.faults, len(run.seen.recoveries_s)) == (1, 1)
        assert 0 < run.seen.stops_s[0] < soak.STOP_LIMIT_S
        monkeypatch.setattr(soak, "FAULTS", ("warning",))
        monkeypatch.setattr(soak, "_RECOVERY_S", 0.5)
        with pytest.raises(CanopenError, match="all wheels to stand after warning"):
            run._break()
        run.close()
        ours.leave()
