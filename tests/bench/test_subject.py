"""The measured runtime: it runs as `run` does, and what it writes down is per cycle (with processes: test_cycle)."""

from canopen_control.bench.subject import options


def test_it_runs_on_drives_that_are_there_already():
    assert not options(realtime=False).drives
    assert options(realtime=False).realtime is None
    assert options(realtime=True).realtime > 0
