"""What a node is told before it may run, against the golden writes of the robby tutorial."""

import json
import textwrap
from pathlib import Path

import pytest

from canopen_control.data_files import data_path
from canopen_control.master.config import read_bus

DATA = Path(__file__).parents[1] / "data"
ROBBY = data_path("config", "robby") / "bus.yml"


def plan_of(folder, node, master="{node_id: 1, sync_period: 20000}"):
    path = folder / "bus.yml"
    body = textwrap.indent(textwrap.dedent(node), "    ")
    path.write_text(f"master: {master}\nnodes:\n  drive:\n    dcf: TMCM-1270.eds\n    node_id: 3\n{body}")
    return read_bus(path).plans["drive"]


def written(plan, index):
    return [(write.subindex, write.data.hex()) for write in plan.writes if write.index == index]


def test_the_tutorials_file_gives_the_peers_writes_in_the_peers_order():
    golden = json.loads((DATA / "robby_tutorial_writes.json").read_text())
    plan = read_bus(DATA / "robby_tutorial" / "bus.yml").plans["left_drive"]
    ours = [[f"0x{w.index:04X}", w.subindex, w.data.hex().upper()] for w in plan.writes if not w.reason]
    assert ours == golden
    assert len(ours) == 35


def test_what_is_added_says_why():
    plan = read_bus(DATA / "robby_tutorial" / "bus.yml").plans["left_drive"]
    added = {(w.index, w.subindex): w.reason for w in plan.writes if w.reason}
    assert set(added) >= {(0x1016, 1), (0x1029, 1), (0x1402, 1)}
    assert all(added.values())


def test_robby_writes_deceleration_and_the_sync_period_and_disables_the_third_rpdo():
    plan = read_bus(ROBBY).plans["left_drive"]
    assert written(plan, 0x6084) == [(0, "803e0000")]
    assert written(plan, 0x60C2) == [(1, "14"), (2, "fd")]
    assert written(plan, 0x1402) == [(1, "030400c0")]
    assert written(plan, 0x1016) == [(1, "f4010100")]
    assert written(plan, 0x1029) == [(1, "02")]


def test_a_pdo_is_disabled_emptied_filled_counted_and_enabled_with_bit_30_kept(tmp_path):
    plan = plan_of(tmp_path, "rpdo: {1: {mapping: [{index: 0x6040}, {index: 0x6060}]}}")
    order = [(w.index, w.subindex, w.data.hex()) for w in plan.writes if w.index in (0x1400, 0x1600)]
    assert order == [
        (0x1400, 1, "030200c0"),
        (0x1600, 0, "00"),
        (0x1600, 1, "10004060"),
        (0x1600, 2, "08006060"),
        (0x1600, 0, "02"),
        (0x1400, 1, "03020040"),
    ]


def test_a_live_default_pdo_that_nobody_configured_is_switched_off(tmp_path):
    plan = plan_of(tmp_path, "rpdo: {1: {mapping: [{index: 0x6040}]}}")
    second = [w for w in plan.writes if w.index == 0x1401]
    assert [w.data.hex() for w in second] == ["030300c0"]
    assert second[0].reason


def test_a_node_without_pdo_keys_keeps_its_own_pdos(tmp_path):
    plan = plan_of(tmp_path, "")
    assert [layout.cob_id for layout in plan.tpdos] == [0x183, 0x283, 0x383]
    assert [layout.number for layout in plan.rpdos] == [1, 2, 3]


def test_an_enabled_pdo_without_cob_id_gets_the_predefined_one(tmp_path):
    plan = plan_of(tmp_path, "tpdo: {4: {enabled: true, transmission: 1, mapping: [{index: 0x606C}]}}")
    assert [layout.cob_id for layout in plan.tpdos] == [0x483]


def test_a_drive_with_0x6007_is_told_to_fault_when_the_master_is_lost(tmp_path):
    path = tmp_path / "bus.yml"
    path.write_text("master: {node_id: 1}\nnodes:\n  servo: {dcf: generic_cia402.eds, node_id: 5}\n")
    plan = read_bus(path).plans["servo"]
    assert written(plan, 0x6007) == [(0, "0100")]


@pytest.mark.parametrize(
    ("node", "words"),
    [
        ("rpdo: {9: {enabled: true}}", "has no RPDO 9"),
        ("tpdo: {1: {mapping: [{index: 0x1008}]}}", "cannot be mapped"),
        ("tpdo: {1: {mapping: [{index: 0x6064}, {index: 0x606C}, {index: 0x6041}]}}", "80 bits"),
        ("rpdo: {1: {mapping: [{index: 0x6041}]}}", "cannot be mapped into a RPDO"),
        ("sdo: [{index: 0x6083, value: -1}]", "0x6083:00"),
    ],
)
def test_what_cannot_be_is_an_error_of_the_file(tmp_path, node, words):
    with pytest.raises(Exception, match=words):
        plan_of(tmp_path, node)
