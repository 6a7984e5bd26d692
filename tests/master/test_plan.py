"""Writes to a node before it may run, compared with the golden writes of the robby tutorial."""

import json
import textwrap
from pathlib import Path

import pytest

from canopen_control.data_files import data_path
from canopen_control.master.config import inspect_bus, read_bus
from canopen_control.od.dcf import encode_concise

DATA = Path(__file__).parents[1] / "data"
ROBBY = data_path("config", "robby") / "bus.yml"


def plan_of(folder, node, master="{node_id: 1, sync_period: 20000}"):
    path = folder / "bus.yml"
    body = textwrap.indent(textwrap.dedent(node), "    ")
    path.write_text(f"master: {master}\nnodes:\n  drive:\n    dcf: TMCM-1270.eds\n    node_id: 3\n{body}")
    return read_bus(path).plans["drive"]


def written(plan, index):
    return [(write.subindex, write.data.hex()) for write in plan.writes if write.index == index]


def test_the_tutorials_file_gives_the_peers_writes_in_the_peers_order_but_supervision_last():
    golden = json.loads((DATA / "robby_tutorial_writes.json").read_text())
    plan = read_bus(DATA / "robby_tutorial" / "bus.yml").plans["left_drive"]
    ours = [[f"0x{w.index:04X}", w.subindex, w.data.hex().upper()] for w in plan.writes if not w.reason]
    assert golden[0][0] == "0x1017"
    assert ours == [*golden[1:], golden[0]]
    assert len(ours) == 35


def test_what_is_added_reports_why():
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
        (0x1400, 2, "ff"),  # as in the EDS, but the device may have stored another value
        (0x1600, 0, "00"),
        (0x1600, 1, "10004060"),
        (0x1600, 2, "08006060"),
        (0x1600, 0, "02"),
        (0x1400, 1, "03020040"),
    ]


def test_a_live_default_pdo_that_is_not_configured_is_switched_off(tmp_path):
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


def test_a_drive_with_0x6007_is_commanded_to_fault_when_the_master_is_lost(tmp_path):
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
        (
            "rpdo: {1: {mapping: [{index: 0x6041}]}}",
            "0x6041:00 Statusword cannot be mapped into an RPDO, but into a TPDO, which the device sends",
        ),
        ("sdo: [{index: 0x6083, value: -1}]", "0x6083:00"),
    ],
)
def test_what_cannot_be_is_an_error_of_the_file(tmp_path, node, words):
    with pytest.raises(Exception, match=words):
        plan_of(tmp_path, node)


# -- supervision is written last and judged by what the node holds in the end

EDITS = DATA / "eds_edits"
SUPERVISED_DCF = DATA / "reports" / "dcf_supervision" / "drive.dcf"


def read_plan(folder, node="", dcf="generic_cia402.eds", defaults="{}"):
    path = folder / "bus.yml"
    keys = textwrap.indent(textwrap.dedent(node), "    ")
    path.write_text(
        f"master: {{node_id: 1}}\ndefaults: {defaults}\nnodes:\n  drive:\n    dcf: {dcf}\n    node_id: 3\n{keys}"
    )
    config, problems = inspect_bus(path)
    return config.plans["drive"], config.notes, [str(error) for error in problems.errors]


def final(plan, index, subindex=0, unwritten=None):
    held = {(w.index, w.subindex): int.from_bytes(w.data, "little") for w in plan.writes}
    return held.get((index, subindex), unwritten)


@pytest.mark.parametrize(
    ("period", "words"), [(1_000_000, "with this sync_period, 1000 ms"), (70_000, ""), (280_000, ""), (0, "")]
)
def test_a_cycle_in_which_the_heartbeat_is_too_late_for_the_nodes_is_reported(tmp_path, period, words):
    path = tmp_path / "bus.yml"
    path.write_text(
        f"master: {{node_id: 1, sync_period: {period}}}\n"
        "nodes: {drive: {dcf: generic_cia402.eds, node_id: 3, heartbeat_multiplier: 3}}\n"
    )
    reported = [
        str(warning) for warning in inspect_bus(path)[1].warnings if "reports the master as lost" in str(warning)
    ]
    assert [words in text for text in reported] == ([True] if words else [])


def test_supervision_is_written_last_and_a_file_does_not_switch_it_off(tmp_path):
    plan, notes, errors = read_plan(tmp_path, dcf=SUPERVISED_DCF)
    assert not errors
    assert [write.index for write in plan.writes][-3:] == [0x1016, 0x1017, 0x6007]
    assert final(plan, 0x1016, 1) == 1 << 16 | 300
    assert any("0x1016:01 = 0x0 from" in note and "replaced" in note for note in notes)


NOTHING_WATCHES = encode_concise(((0x1016, 1, bytes(4)), (0x1017, 0, bytes(2)), (0x6007, 0, bytes(2))))


@pytest.mark.parametrize(
    ("defaults", "node", "dcf", "reaction"),
    [
        ("", "", "generic_cia402.eds", 1),
        ("", "", SUPERVISED_DCF, 1),
        ("", "configuration_file: off.bin", "generic_cia402.eds", 1),
        ("{heartbeat_producer: 100, sdo: [{index: 0x6007, value: 3}]}", "", SUPERVISED_DCF, 3),
        ("{configuration_file: off.bin, heartbeat_consumer: true}", "", SUPERVISED_DCF, 1),
        (
            "{sdo: [{index: 0x1016, sub_index: 1, value: 0}, {index: 0x1017, value: 0}]}",
            "heartbeat_consumer: true\nheartbeat_producer: 100",
            "generic_cia402.eds",
            1,
        ),
        ("", "sdo: [{index: 0x6098, value: 35}, {index: 0x605E, value: 0}]", SUPERVISED_DCF, 1),
        ("", "profile: 402\nvelocity_mode: 3\nhoming_timeout_seconds: 5\nrecovery: enable", SUPERVISED_DCF, 1),
    ],
    ids=["plain", "DCF", "concise", "defaults", "defaults and file", "node against defaults", "sdo", "motion keys"],
)
def test_every_source_leaves_a_drive_that_a_dead_master_stops(tmp_path, defaults, node, dcf, reaction):
    (tmp_path / "off.bin").write_bytes(NOTHING_WATCHES)
    plan, _, errors = read_plan(tmp_path, node, dcf, defaults or "{}")
    assert (errors, plan.unsupervised) == ([], "")
    entries = [value for sub in (1, 2) if (value := final(plan, 0x1016, sub, 0))]
    assert entries == [1 << 16 | 300]
    assert (final(plan, 0x1017), final(plan, 0x6007)) == (100, reaction)


def test_a_configuration_is_stored_with_its_supervision(tmp_path):
    plan, _, errors = read_plan(tmp_path, "sdo: [{index: 0x1010, sub_index: 1, value: save}]")
    assert not errors
    assert [write.index for write in plan.writes][-2:] == [0x6007, 0x1010]


@pytest.mark.parametrize(
    ("node", "dcf", "words"),
    [
        ("sdo: [{index: 0x6007, value: 0}]", "generic_cia402.eds", "0x6007 = 0 lets the motor continue to turn"),
        ("error_behavior: {1: 0}", "TMCM-1270.eds", "0x1029:01 = 0 lets the motor continue to turn"),
        (
            "sdo: [{index: 0x1029, sub_index: 1, value: 1}]",
            "TMCM-1270.eds",
            "0x1029:01 = 1 lets the motor continue to turn",
        ),
        ("sdo: [{index: 0x1016, sub_index: 1, value: 0}]", "TMCM-1270.eds", "sets 0x1016:01 to 0x00000000"),
        ("sdo: [{index: 0x1016, sub_index: 1, value: 0x501F4}]", "TMCM-1270.eds", "does not monitor node 1"),
        ("guard_time: 100\nheartbeat_producer: 100", EDITS / "guardhb.eds", "neither a writable heartbeat consumer"),
    ],
)
def test_a_plan_that_leaves_a_drive_unsupervised_is_an_error_unless_it_is_allowed(tmp_path, node, dcf, words):
    plan, _, (error,) = read_plan(tmp_path, node, dcf)
    assert "nothing would stop this drive" in error
    assert words in error
    assert plan.unsupervised
    assert not read_plan(tmp_path, f"{node}\nallow_unsupervised: true", dcf)[2]


@pytest.mark.parametrize(
    ("node", "entries"),
    [
        ("", {1: 0x1012C}),
        ("sdo: [{index: 0x1016, sub_index: 1, value: 0x103E8}]", {1: 0x103E8}),  # bus.yml gives the time
        ("sdo: [{index: 0x1016, sub_index: 1, value: 0x503E8}]", {1: 0x503E8, 2: 0x1012C}),  # and watches another node
        ("sdo: [{index: 0x1016, sub_index: 1, value: 0}]", {1: 0, 2: 0x1012C}),
    ],
)
def test_the_master_has_one_entry_among_those_that_are_watched(tmp_path, node, entries):
    plan, _, errors = read_plan(tmp_path, node)
    assert not errors
    assert {w.subindex: int.from_bytes(w.data, "little") for w in plan.writes if w.index == 0x1016} == entries


def test_guarding_that_bus_yml_asks_for_goes_before_a_heartbeat_of_the_file(tmp_path):
    plan, notes, errors = read_plan(tmp_path, "guard_time: 100", EDITS / "guardhb.eds")
    assert not errors
    assert (plan.guard, plan.heartbeat_timeout_ns) == ((100_000_000, 3), 0)
    assert final(plan, 0x1017) == 0
    assert any("0x1017:00 = 0x64 from" in note for note in notes)


@pytest.mark.parametrize(("guarded", "words"), [(True, "set guard_time"), (False, "no node guarding (0x100C, 0x100D)")])
def test_guarding_is_advised_only_where_the_node_has_it(tmp_path, guarded, words):
    text = data_path("eds", "generic_cia402.eds").read_text().replace("[1017]", "[5017]")
    text = text if guarded else text.replace("[100C]", "[500C]").replace("[100D]", "[500D]")
    (tmp_path / "silent.eds").write_text(text)
    _, notes, _ = read_plan(tmp_path, dcf="silent.eds")
    (reported,) = [note for note in notes if "the master cannot detect the loss of this node" in note]
    assert words in reported


def test_what_a_device_beats_without_end_is_watched_instead_of_guarding(tmp_path):
    head, _, rest = (EDITS / "guardhb.eds").read_text().partition("[1017]\n")
    _, _, rest = rest.partition("\n\n")
    section = (
        "ParameterName=Heartbeat\nObjectType=0x7\nDataType=0x0006\nAccessType=const\nDefaultValue=100\nPDOMapping=0"
    )
    (tmp_path / "fixed.eds").write_text(f"{head}[1017]\n{section}\n\n{rest}")
    plan, notes, (error,) = read_plan(tmp_path, "guard_time: 100", "fixed.eds")
    assert (plan.guard, plan.heartbeat_timeout_ns) == (None, 300_000_000)
    assert "neither a writable heartbeat consumer" in error
    assert any("0x1017 is 100 ms and cannot be written" in note for note in notes)


def test_monitoring_that_bus_yml_switches_off_is_the_reason(tmp_path):
    _, _, (error,) = read_plan(tmp_path, "heartbeat_consumer: false", "generic_cia402.eds")
    assert "heartbeat_consumer is false, so that it does not monitor the master; write true, or accept that" in error
    assert "heartbeat_consumer: nothing would stop this drive" in error


def test_a_second_axis_without_0x6007_is_stopped_by_the_nmt_state(tmp_path):
    plan, _, errors = read_plan(tmp_path, dcf=DATA / "reports" / "amr_two_channels" / "two_axis.eds")
    assert not errors
    assert (final(plan, 0x6007), final(plan, 0x1029, 1)) == (1, 2)


def test_the_sync_counter_is_written_before_anything_else(tmp_path):
    path = tmp_path / "bus.yml"
    path.write_text(
        "master: {node_id: 1, sync_period: 20000, sync_overflow: 10}\nnodes:\n"
        f"  drive: {{dcf: {SUPERVISED_DCF}, node_id: 3}}\n"
    )
    plan = read_bus(path).plans["drive"]
    assert next(write.index for write in plan.writes if write.index != 0x1006) == 0x1019


@pytest.mark.parametrize(
    ("name", "index", "words"), [("nocob", 0x1803, "TPDO 4 has no valid COB-ID"), ("sync0", 0x1005, "0x1005 = 0x0 in")]
)
def test_a_cob_id_that_the_file_lacks_is_named_and_written(tmp_path, name, index, words):
    plan, notes, errors = read_plan(tmp_path, "tpdo: {1: {}}\nrpdo: {1: {}}", EDITS / f"{name}.eds")
    assert not errors
    assert any(words in note for note in notes)
    assert final(plan, index, 1 if index >= 0x1400 else 0) == (1 << 31 if index >= 0x1400 else 0x80)


def test_a_pdo_of_the_file_is_off_unless_bus_yml_lists_it(tmp_path):
    dcf = EDITS / "pdo_kept_by_the_file.dcf"
    plan, notes, errors = read_plan(tmp_path, "tpdo: {1: {}}", dcf)
    assert not errors
    assert [layout.number for layout in plan.tpdos] == [1]
    assert final(plan, 0x1802, 1) & 1 << 31
    assert any("TPDO 3 is valid from" in note and "disabled" in note for note in notes)
    assert 3 in [layout.number for layout in read_plan(tmp_path, "", dcf)[0].tpdos]


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ("tpdo: {1: {cob_id: 0x83}}", "COB-ID 0x083 of TPDO 1 of drive is already used by EMCY of drive"),
        ("tpdo: {1: {cob_id: 0x80}}", "already used by SYNC"),
        ("tpdo: {1: {cob_id: 0x701}}", "not allowed for PDOs"),
        ("sdo: [{index: 0x1800, sub_index: 1, value: 0x601}]", "TPDO 1 would have COB-ID 0x601"),
        ("tpdo: {1: {transmission: 1}}\nsdo: [{index: 0x1800, sub_index: 2, value: 255}]", "keep one of the two"),
        (
            "tpdo: {1: {cob_id: 0x190}}\nsdo: [{index: 0x1802, sub_index: 1, value: 0x190}]",
            "COB-ID 0x190 of TPDO 3 of drive is already used by TPDO 1",
        ),
    ],
)
def test_a_cob_id_that_is_none_or_has_a_user_is_an_error(tmp_path, keys, words):
    errors = read_plan(tmp_path, keys)[2]
    assert any(words in error for error in errors), errors


def test_a_pdo_that_the_sdo_list_configures_is_one_that_bus_yml_lists(tmp_path):
    mapping = "{index: 0x1A02, sub_index: 0, value: 1}, {index: 0x1A02, sub_index: 1, value: 0x606C0020}"
    listed = f"sdo: [{mapping}, {{index: 0x1802, sub_index: 1, value: 0x383}}]"
    plan, _, errors = read_plan(tmp_path, listed)
    assert not errors
    assert [(tpdo.number, tpdo.cob_id, [o.index for o in tpdo.objects]) for tpdo in plan.tpdos] == [
        (3, 0x383, [0x606C])
    ]
    order = [(w.index, w.subindex) for w in plan.writes if w.index in (0x1802, 0x1A02)]
    assert (order[0], order[-1]) == ((0x1802, 1), (0x1802, 1))


@pytest.mark.parametrize(("value", "warned"), [(0x40000080, 0), (0x40000081, 1)])
def test_a_node_that_sends_sync_by_its_sdo_list_is_left_alone(tmp_path, value, warned):
    plan, notes, errors = read_plan(tmp_path, f"sdo: [{{index: 0x1005, value: {value}}}]")
    assert not errors
    assert final(plan, 0x1005) == value
    assert sum("is not the COB-ID of the master's SYNC" in note for note in dict.fromkeys(notes)) == warned


# public files: a bus.yml for igus dryve D1 (6, 7, 15), one for EPOS4, and a DCF saved from an enabled EPOS4 (0x000F)
@pytest.mark.parametrize("values", [(6, 7, 15), (128,)])
def test_the_sdo_list_does_not_enable_a_drive(tmp_path, values):
    listed = ", ".join(f"{{index: 0x6040, value: {value}}}" for value in values)
    plan, notes, errors = read_plan(tmp_path, f"sdo: [{listed}, {{index: 0x6083, value: 5}}]")
    assert not errors
    assert written(plan, 0x6040) == []
    assert written(plan, 0x6083) == [(0, "05000000")]
    for number, value in enumerate(values):
        assert sum(f"sdo[{number}]: 0x6040 = 0x{value:X} is not written" in note for note in dict.fromkeys(notes)) == 1


@pytest.mark.parametrize(("word", "reported"), [(0x0F, 1), (0, 0)])
def test_a_file_does_not_enable_a_drive(tmp_path, word, reported):
    (tmp_path / "on.bin").write_bytes(
        encode_concise(((0x6040, 0, word.to_bytes(2, "little")), (0x6083, 0, b"\5\0\0\0")))
    )
    plan, notes, errors = read_plan(tmp_path, "configuration_file: on.bin")
    assert not errors
    assert (written(plan, 0x6040), written(plan, 0x6083)) == ([], [(0, "05000000")])
    assert sum("0x6040 = 0xF from on.bin is not written" in note for note in dict.fromkeys(notes)) == reported


def test_the_sdo_list_does_not_enable_a_second_axis(tmp_path):
    two = DATA / "reports" / "amr_two_channels" / "two_axis.eds"
    plan, notes, errors = read_plan(tmp_path, "sdo: [{index: 0x6840, value: 15}]", two)
    assert (errors, written(plan, 0x6840)) == ([], [])
    assert any("0x6840 = 0xF is not written" in note for note in notes)


def test_a_device_without_an_axis_gets_every_object_of_the_list(tmp_path):
    text = data_path("eds", "generic_cia402.eds").read_text()
    (tmp_path / "plain.eds").write_text(text.replace("[6041]", "[5041]"))
    plan, _, _ = read_plan(tmp_path, "sdo: [{index: 0x6040, value: 15}]", "plain.eds")
    assert written(plan, 0x6040) == [(0, "0f00")]


def saved_for(folder, node_id, object_name="Node-ID"):
    """Write a DCF as maxon's tool saves it: each COB-ID as a number, and the node-ID in an object of its own."""
    text = data_path("eds", "generic_cia402.eds").read_text()
    head, _, tail = text.partition("[ManufacturerObjects]\nSupportedObjects=")
    count, _, rest = tail.partition("\n")
    text = f"{head}[ManufacturerObjects]\nSupportedObjects={int(count) + 1}\n{int(count) + 1}=0x2F00\n{rest}"
    text += f"\n[2F00]\nParameterName={object_name}\nObjectType=7\nDataType=5\nAccessType=rw\nDefaultValue=1\n"
    text += f"ParameterValue={node_id}\n\n[DeviceComissioning]\nNodeID={node_id}\n"
    cob_id = "DefaultValue=$NODEID+0x200\n"
    assert cob_id in text
    number = int(str(node_id).partition(";")[0])
    (folder / "saved.dcf").write_text(text.replace(cob_id, f"{cob_id}ParameterValue=0x{0x200 + number:X}\n", 1))
    return "saved.dcf"


@pytest.mark.parametrize(
    ("saved", "keys", "name", "reported"),
    [
        (7, "", "Node-ID", ["RPDO 1 0x207", "Node-ID (0x2F00) = 7"]),
        (7, "rpdo: {1: {cob_id: auto}}", "Node ID", ["Node ID (0x2F00) = 7"]),
        (7, "rpdo: {1: {cob_id: auto}}", "Node-ID of the SDO client", []),
        ("07 ; left", "rpdo: {1: {cob_id: auto}}", "Node ID", ["Node ID (0x2F00) = 7"]),
        (3, "", "Node-ID", []),
    ],
)
def test_a_dcf_that_was_saved_for_another_node_is_reported(tmp_path, saved, keys, name, reported):
    _, notes, errors = read_plan(tmp_path, keys, saved_for(tmp_path, saved, name))
    assert not errors
    result = [note for note in dict.fromkeys(notes) if "was saved for node" in note]
    assert len(result) == bool(reported)
    for text in reported:
        assert text in result[0]
    assert not result or "saved for node 7, and node 3 gets values of that node" in result[0]


REPLACE = "replace heartbeat_producer by `guard_time: 100` and `life_time_factor: 5`, or accept that"


@pytest.mark.parametrize(
    ("keys", "dcf", "errors", "warned"),
    [
        ("", "nohb.eds", "nor node guarding; accept that", 0),
        ("heartbeat_producer: 100", "guardhb.eds", f"nor node guarding; {REPLACE}", 0),
        ("guard_time: 100\nlife_time_factor: 5", "guardhb.eds", "", 1),
        ("allow_unsupervised: true", "nohb.eds", "", 1),
        ("", "plain.eds", "the node cannot monitor the master; write false", 0),
        ("allow_unsupervised: true", "plain.eds", "", 1),
    ],
)
def test_a_missing_heartbeat_consumer_is_one_error_with_its_remedy(tmp_path, keys, dcf, errors, warned):
    text = (EDITS / "nohb.eds").read_text()
    (tmp_path / "plain.eds").write_text(text.replace("[6040]", "[5040]").replace("[6041]", "[5041]"))
    path = "plain.eds" if dcf == "plain.eds" else EDITS / dcf
    _, notes, found = read_plan(tmp_path, f"heartbeat_consumer: true\n{keys}", path)
    assert len(found) == bool(errors)
    assert errors in "".join(found)
    assert sum("the node cannot monitor the master; write false" in note for note in dict.fromkeys(notes)) == warned
