"""The measured runtime: it runs as `run` does, and what it writes down is per cycle (with processes: test_cycle)."""

from canopen_control_bench.subject import options


def test_it_runs_on_drives_that_are_there_already():
    assert not options().drives
    assert (options().realtime, options().cpu) == (None, None)
    assert (options(3).realtime, options(3).cpu) == (40, 3)
