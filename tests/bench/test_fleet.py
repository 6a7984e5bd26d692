"""The robots of the bench are robots: they are read without an error, and have what is measured."""

import pytest
from canopen_control_bench.fleet import CONTROLLER, FIRST_NODE, write_fleet

from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot


@pytest.mark.parametrize(("count", "base"), [(2, True), (16, False), (126, False)])
def test_a_fleet_is_a_robot_without_a_warning_about_time(tmp_path, count, base):
    setup = read_robot(find_robot(str(write_fleet(tmp_path, count, 1000, base=base))))
    assert [node.node_id for node in setup.bus.nodes.values()] == list(range(FIRST_NODE, FIRST_NODE + count))
    assert setup.cycle_ns == 1_000_000
    assert setup.to_activate == ("joint_state_broadcaster", CONTROLLER)
    assert not [note for note in setup.notes if "0x60C2" in note]


def test_every_rpdo_is_cyclic(tmp_path):
    text = (write_fleet(tmp_path, 2, 1000) / "bus.yml").read_text()
    assert text.partition("rpdo:")[2].count("transmission: 0x01") == 2


def test_feedback_is_stale_after_the_same_time_at_every_period(tmp_path):
    for period_us, missed in ((1000, 500), (20_000, 25), (100_000, 10)):
        setup = read_robot(find_robot(str(write_fleet(tmp_path, 2, period_us))))
        assert {node.supervision.missed_syncs for node in setup.bus.nodes.values()} == {missed}


def test_drives_are_shared_out_among_buses(tmp_path):
    setup = read_robot(find_robot(str(write_fleet(tmp_path, 6, 2000, buses=2))))
    assert [len(bus.nodes) for bus in setup.buses.values()] == [3, 3]
