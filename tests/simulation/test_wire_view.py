import struct

import pytest
from support.simulated import setup_of

from canopen_control.frame import CanFrame, pack_records
from canopen_control.simulation.wire_view import WireView

TARGET_VELOCITY, CONTROLWORD = 0x60FF, 0x6040


@pytest.fixture
def view():
    return WireView(setup_of().bus)


def hear(view, now, can_id, data=b"", label="drive 3"):
    view.hear(now, label, pack_records([CanFrame(can_id, data)]))


def test_a_statusword_is_that_of_its_node(view):
    left, right = view.nodes[3], view.nodes[2]
    hear(view, 5, 0x183, struct.pack("<Hb", 0x0637, 3))
    assert (left.enabled, left.in_fault, left.status_at, left.shown_enabled_at) == (True, False, 5, 5)
    hear(view, 6, 0x183, struct.pack("<Hb", 0x0608, 3))
    assert (left.enabled, left.in_fault, left.fault_at) == (False, True, 6)
    hear(view, 7, 0x183, struct.pack("<Hb", 0x0608, 3))
    assert left.fault_at == 6
    assert right.status_at == 0


def test_a_controlword_counts_from_when_it_begins_to_enable(view):
    node = view.nodes[3]
    for now, word in ((1, 0x06), (2, 0x0F), (3, 0x1F), (4, 0x8F)):
        hear(view, now, 0x203, struct.pack("<Hb", word, 3), "master")
    assert (node.enabled_at, node.commanded) == (2, False)
    hear(view, 5, 0x603, struct.pack("<BHBI", 0x2B, CONTROLWORD, 0, 0x0F), "master")
    assert (node.enabled_at, node.commanded) == (5, True)


def test_targets_are_signed(view):
    hear(view, 3, 0x303, struct.pack("<ii", 0, -1000), "master")
    node = view.nodes[3]
    assert (node.targets[TARGET_VELOCITY], node.target_changed_at) == (-1000, 3)


@pytest.mark.parametrize("data", [b"\x37", b"\x08\x06"])
def test_a_pdo_that_is_cut_short_tells_nothing_as_the_robot_drops_it(view, data):
    hear(view, 5, 0x183, data, "stranger")
    assert view.nodes[3].status_at == 0


def test_signs_of_life_and_boot_ups(view):
    hear(view, 5, 0x703, b"\x05")
    hear(view, 6, 0x703, b"\x00")
    hear(view, 7, 0x701, b"\x05", "master")
    hear(view, 8, 0x701, b"\x05", "stranger")
    hear(view, 9, 0x080, b"", "master")
    assert (view.nodes[3].alive_at, view.nodes[3].booted_at) == (6, 6)
    assert (view.master_at, view.sync_at) == (7, 9)
