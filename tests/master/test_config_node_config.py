import pytest
from support.busfile import NESTED, mistakes_of_a_node, write

from canopen_control.master.config import read_bus

MERGED = """\
    master: {node_id: 1}
    defaults:
      dcf: TMCM-1270.eds
      heartbeat_producer: 100
      rpdo: {1: {mapping: [{index: 0x6040}]}}
    nodes:
      left:
        node_id: 3
        heartbeat_producer: 50
        rpdo: {2: {mapping: [{index: 0x60FF}]}}
    """


def test_peer_merge_lets_whole_defaults_win_and_either_way_the_difference_is_told(tmp_path):
    path = write(tmp_path, MERGED)
    ours, theirs = read_bus(path), read_bus(path, peer_merge=True)
    assert ours.nodes["left"].supervision.heartbeat_producer == 50
    assert sorted(ours.nodes["left"].boot.rpdo) == [1, 2]
    assert theirs.nodes["left"].supervision.heartbeat_producer == 100
    assert sorted(theirs.nodes["left"].boot.rpdo) == [1]
    told = [note for note in ours.notes if "bus.yml:9:" in note]
    assert "the node's own heartbeat_producer counts; ros2_canopen takes 100 of `defaults` (--peer-merge)" in told[0]
    told = [note for note in theirs.notes if "bus.yml:9:" in note]
    assert "heartbeat_producer: 50, but --peer-merge takes 100 of `defaults`" in told[0]
    assert [note for note in ours.notes if "bus.yml:10:" in note]


def test_without_a_difference_nothing_is_told_of_merging(tmp_path):
    text = MERGED.replace("heartbeat_producer: 50", "heartbeat_producer: 100").replace("{2: {map", "{1: {map")
    text = text.replace("0x60FF", "0x6040")
    assert not [note for note in read_bus(write(tmp_path, text)).notes if "merge" in note]


@pytest.mark.parametrize(
    ("keys", "required"),
    [
        ("", True),
        ("mandatory: false", False),
        ("mandatory: true", True),
        ("required: false", False),
        ("boot: false", False),
        ("required: true, mandatory: true", True),
    ],
)
def test_who_is_waited_for(tmp_path, keys, required):
    text = NESTED.replace("right_drive: {node_id: 2}", "right_drive: {node_id: 2, " + keys + "}")
    assert read_bus(write(tmp_path, text)).nodes["right_drive"].required is required


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ("required: true, mandatory: false", "mean the same and differ"),
        ("boot: false, required: true", "nothing can wait for it"),
        ("effort_mode: 4, torque_mode: 10", "`torque_mode` and `effort_mode` mean the same"),
        ("gear_ratio: 2.0", "gear_ratio needs counts_per_revolution"),
        ("counts_per_revolution: 1600, gear_ratio: [1]", "motor turns, joint turns"),
        ("scale_vel_to_dev: 0.0", "finite and not 0 is wanted"),
        ("transition_timeouts_ms: {17: 100}", "no transition 17"),
    ],
)
def test_keys_that_contradict_each_other_are_told_at_their_line(tmp_path, keys, words):
    assert words in mistakes_of_a_node(tmp_path, keys)


def test_units_by_name_and_torque_mode_are_what_they_stand_for(tmp_path):
    keys = "counts_per_revolution: 1600, gear_ratio: 2, reversed: true, torque_mode: 4"
    text = NESTED.replace("right_drive: {node_id: 2}", "right_drive: {node_id: 2, " + keys + "}")
    node = read_bus(write(tmp_path, text)).nodes["right_drive"]
    assert node.units.scale_pos_to_dev == pytest.approx(-3200 / 6.283185307179586)
    assert node.units.scale_pos_from_dev * node.units.scale_pos_to_dev == pytest.approx(1.0)
    assert node.motion.effort_mode == 4


def test_scales_that_do_not_cancel_are_doubted(tmp_path):
    text = NESTED.replace("right_drive: {node_id: 2}", "right_drive: {node_id: 2, scale_pos_to_dev: 254.6}")
    notes = read_bus(write(tmp_path, text)).notes
    assert any("scale_pos_to_dev times scale_pos_from_dev is 0.2546, not 1" in note for note in notes)
