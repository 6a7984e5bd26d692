"""A fleet of recordings: it runs, takes every TPDO of every cycle, and says when it does not."""

import pytest
from canopen_control_bench.recorded import RecordedFleet

from canopen_control.errors import CanopenError


def test_every_cycle_takes_the_tpdos_of_all_drives(tmp_path):
    fleet = RecordedFleet(tmp_path, 3)
    before = [pdo.count for node in fleet.core.nodes.values() for pdo in node.received]
    took = [fleet.cycle() for _ in range(100)]
    after = [pdo.count for node in fleet.core.nodes.values() for pdo in node.received]
    fleet.check()
    fleet.close()
    assert min(took) > 0
    assert [late - early for early, late in zip(before, after, strict=True)] == [100] * 6


def test_a_robot_that_has_stopped_is_no_figure(tmp_path):
    fleet = RecordedFleet(tmp_path, 2)
    fleet._beats = b""
    fleet._records = [b""]
    for _ in range(50):
        fleet.cycle()
    with pytest.raises(CanopenError, match="stopped running"):
        fleet.check()
    fleet.close()
