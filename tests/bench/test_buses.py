"""Buses at their most: what is sent is heard by a listener of its own, and what is lost is missed."""

import pytest
from canopen_control_bench import buses
from canopen_control_bench.buses import Carried, carried, measure
from canopen_control_bench.runner import Options


@pytest.mark.process
def test_every_frame_of_two_buses_is_heard():
    found = carried(["one", "two"], 2000.0, 0.2)
    assert found.sent == found.heard == 2 * 400
    assert (found.lost, found.dropped) == (0, 0)
    assert 0 < found.hubs < found.cores


def test_what_was_lost_in_any_round_is_told(monkeypatch):
    monkeypatch.setattr(buses, "carried", lambda _names, _rate, _seconds: Carried(100, 99, 1, 0.5, 0.3))
    lost, cores, *_ = measure(Options())
    assert (lost.ours, lost.good, lost.absolutes["dropped by hubs"]) == (3, False, 3)
    assert (cores.ours, cores.good) == (0.5, True)
    assert measure(Options(quick=True)) == []
