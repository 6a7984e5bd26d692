import struct

import pytest
from support.simulated import MS, Judged, setup_of

from canopen_control.frame import CanFrame, pack_records
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot
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
def test_a_pdo_that_is_cut_short_reports_nothing_as_the_robot_drops_it(view, data):
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


def test_an_emcy_of_an_error_counts_and_a_strangers_does_not(view):
    node = view.nodes[3]
    hear(view, 5, 0x083, bytes(8))
    hear(view, 6, 0x083, b"\x10\x43\x09", "drive 3")
    hear(view, 7, 0x083, b"\x10\x43\x09\0\0\0\0\0", "stranger")
    assert node.emcy_at == 0
    hear(view, 8, 0x083, b"\x10\x43\x09\0\0\0\0\0")
    assert node.emcy_at == 8


def test_a_limit_counts_from_when_it_is_shown(view):
    node = view.nodes[3]
    for now, word in ((5, 0x0637), (6, 0x0E37), (7, 0x0E37)):
        hear(view, now, 0x183, struct.pack("<Hb", word, 3))
    assert node.limited_at == 6


def test_an_answer_to_guarding_with_the_toggle_bit_of_the_one_before_counts():
    view = WireView(read_robot(find_robot("tools/campaigner/robots/guarded")).bus)
    node = view.nodes[2]
    for now, answer in enumerate((0x00, 0x05, 0x85, 0x05, 0x85), 1):
        hear(view, now, 0x702, bytes((answer,)))
    assert (node.toggled_at, node.nmt, node.booted_at) == (0, 5, 1)
    hear(view, 6, 0x702, b"\x85")
    hear(view, 7, 0x702, b"\x00")
    assert (node.toggled_at, node.booted_at) == (6, 7)


# -- disturbed nodes


class Nothing:
    def __init__(self, *_parts):
        pass

    def on_sample(self, now):
        pass


@pytest.fixture
def judged():
    created = Judged(Nothing)
    yield created
    created.close()


def test_an_unaffected_node_is_not_disturbed(judged):
    judged.drive(5.0, 5.0).do("stop").run(1.0)
    assert judged.disturbed.last(2) == judged.disturbed.last(3) == 0


@pytest.mark.parametrize("act", [{"name": "drive_fault"}, {"name": "hand_moved"}])
def test_a_fault_disturbs_its_node_as_long_as_it_is_on(judged, act):
    judged.do("fault", 3, 0.2, **act).run(1.0)
    lasted = 0.2 if act["name"] == "drive_fault" else 0.0
    assert judged.disturbed.last(3) == pytest.approx(judged.robot.now_ns - (1.0 - lasted) * 1e9, abs=25 * MS)
    assert judged.disturbed.last(2) == 0


@pytest.mark.parametrize(
    ("kind", "target", "more", "both"),
    [
        ("power", 3, {}, False),
        ("stall", 3, {}, True),
        ("stall", "master", {}, True),
        ("kill", "", {}, True),
        ("cut", 2, {}, True),
        ("lose", "", {"values": (2.0,)}, True),
        ("frame", "", {"values": (0x203.__float__(), 0.0)}, True),
    ],
)
def test_nodes_disturbed_by_each_event(judged, kind, target, more, both):
    lasts = {} if kind == "frame" else {"seconds": 0.1}
    judged.do(kind, target, **lasts, **more).run(0.05)
    assert judged.disturbed.last(3) > judged.robot.now_ns - 60 * MS
    assert (judged.disturbed.last(2) > 0) is both
