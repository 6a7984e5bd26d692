"""The family `simulate`: what is timed is a simulation as `simulate` runs it."""

import pytest
from canopen_control_bench import virtual_robots
from canopen_control_bench.runner import Options
from support.simulated import setup_of

from canopen_control.errors import CanopenError


def test_a_simulation_is_timed_and_the_same_each_time():
    first, second = (virtual_robots.simulate(setup_of(), 1.0) for _ in range(2))
    assert first.sha256 == second.sha256
    assert first.boot_s > 0
    assert first.robot_s + 0.3 == pytest.approx(1.0, abs=0.15)
    assert first.cpu_s < first.robot_s, "slower than real time"


def test_a_robot_that_does_not_boot_is_named(monkeypatch):
    monkeypatch.setattr(virtual_robots, "_BOOT_NS", 10_000_000)
    with pytest.raises(CanopenError, match="robby has not booted"):
        virtual_robots.simulate(setup_of(), 1.0)


@pytest.mark.sources
def test_the_family_has_both_robots_and_the_boot():
    figures = virtual_robots.measure(Options(quick=True, seconds=0.6))
    assert [each.name.split(",")[0] for each in figures] == ["robby at 50 Hz", "16 drives at 50 Hz", "boot of robby"]
    assert all(each.ratio is not None for each in figures[:2])
    assert [each.limit for each in figures] == [25.0, None, 30.0], "from the sources, a quarter for a quick run"
    assert not figures[-1].steady  # a time: a quick run does not judge it
