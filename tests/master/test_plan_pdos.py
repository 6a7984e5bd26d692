"""Which PDOs are live, and the writes that make them so."""

import re
import textwrap

import pytest

from canopen_control.data_files import data_path
from canopen_control.errors import BusConfigError
from canopen_control.master.config import inspect_bus, read_bus
from canopen_control.master.plan_pdos import is_pdo_record
from canopen_control.od.dcf import encode_concise, write_dcf
from canopen_control.od.eds import read_eds
from canopen_control.od.pdos import pdo_of

EDS = data_path("eds", "TMCM-1270.eds")


def planned(folder, node="", *, dcf="TMCM-1270.eds"):
    path = folder / "bus.yml"
    body = textwrap.indent(textwrap.dedent(node), "    ")
    path.write_text(
        f"master: {{node_id: 1, sync_period: 20000}}\nnodes:\n  drive:\n    dcf: {dcf}\n    node_id: 3\n{body}"
    )
    bus = read_bus(path)
    return bus.plans["drive"], bus.notes


def records(plan, *indices):
    return [(w.index, w.subindex, int.from_bytes(w.data, "little")) for w in plan.writes if w.index in indices]


def test_the_pdo_of_a_record():
    assert pdo_of(0x1400) == pdo_of(0x1600) == ("rpdo", 1)
    assert pdo_of(0x19FF) == pdo_of(0x1BFF) == ("tpdo", 512)
    assert pdo_of(0x1C00) is None
    assert not is_pdo_record(0x13FF)


def test_pdos_come_in_the_order_of_the_file(tmp_path):
    plan, _ = planned(tmp_path, "tpdo:\n  2: {transmission: 1}\n  1: {transmission: 1}\n")
    assert [layout.number for layout in plan.tpdos] == [2, 1]
    assert next(write.index for write in plan.writes if write.index in (0x1800, 0x1801)) == 0x1801


def test_a_pdo_that_the_eds_switches_off_gets_a_cob_id_and_that_is_reported(tmp_path):
    text = EDS.read_text(encoding="latin-1").replace("$NODEID+0xC0000480", "0x80000000")
    (tmp_path / "bare.eds").write_text(text, encoding="latin-1")
    plan, notes = planned(tmp_path, "tpdo: {4: {mapping: [{index: 0x606C}]}}", dcf="bare.eds")
    assert [layout.cob_id for layout in plan.tpdos] == [0x483]
    assert any("the predefined 0x483 is used" in note for note in notes)


@pytest.mark.parametrize("kind", ["rpdo", "tpdo"])
def test_bit_31_of_a_cob_id_keeps_a_pdo_off_as_in_ros2_canopen(tmp_path, kind):
    """What dcfgen reads as an invalid PDO must not become a second source of commands."""
    record, cob_id = (0x1400, 0x203) if kind == "rpdo" else (0x1800, 0x183)
    plan, _ = planned(tmp_path, f"{kind}: {{1: {{cob_id: {cob_id | 0x80000000:#x}, mapping: [{{index: 0x6040}}]}}}}")
    assert [value & 0x80000FFF for index, sub, value in records(plan, record) if sub == 1] == [cob_id | 0x80000000]
    assert 1 not in [layout.number for layout in (plan.rpdos if kind == "rpdo" else plan.tpdos)]
    assert not records(plan, record + 0x200)


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (("0x60400010", "0x5EEE0010"), "RPDO 1 is disabled, because of its mapping in odd.eds: 0x5EEE:00 is not in"),
        (("0x60400010", "0x60410010"), "RPDO 1 is disabled.*: 0x6041:00 Statusword cannot be mapped into an RPDO"),
        (
            ("0x60400010", "0x00050008"),
            "RPDO 1 is disabled.*: odd.eds does not allow the dummy entry 0x0005 in an RPDO",
        ),
    ],
)
def test_a_pdo_whose_mapping_in_the_eds_is_impossible_is_left_off_and_named(tmp_path, edit, words):
    text = EDS.read_text(encoding="latin-1").replace(*edit)
    (tmp_path / "odd.eds").write_text(text, encoding="latin-1")
    plan, notes = planned(tmp_path, "", dcf="odd.eds")
    assert any(re.search(words, note) for note in notes), notes
    assert 1 not in [layout.number for layout in plan.rpdos]
    assert [value & 0x80000000 for index, sub, value in records(plan, 0x1400) if sub == 1] == [0x80000000]
    with pytest.raises(BusConfigError, match=words.partition(": ")[2]):
        planned(tmp_path, "rpdo: {1: {enabled: true}}", dcf="odd.eds")


def test_a_pdo_of_the_eds_with_the_cob_id_of_another_is_left_off_and_named(tmp_path):
    """A receiver cannot tell two such PDOs apart; files that repeat PDO 1 to 4 above 4 have them."""
    text = EDS.read_text(encoding="latin-1").replace("$NODEID+0x40000280", "$NODEID+0x40000180")
    assert text != EDS.read_text(encoding="latin-1")
    (tmp_path / "twice.eds").write_text(text, encoding="latin-1")
    plan, notes = planned(tmp_path, "", dcf="twice.eds")
    assert 2 not in [layout.number for layout in plan.tpdos]
    words = (
        "TPDO 2 is disabled, because of its COB-ID in twice.eds, 0x183, which TPDO 1 also uses; correct the file, or"
    )
    assert any(words in note for note in notes), notes
    assert [value & 0x80000000 for index, sub, value in records(plan, 0x1801) if sub == 1] == [0x80000000]


def test_an_event_timer_of_zero_is_a_value_and_a_deadline_is_an_rpdos_timer(tmp_path):
    plan, _ = planned(tmp_path, "tpdo: {1: {event_timer: 0, inhibit_time: 0, transmission: 254}}")
    assert (0x1800, 5, 0) in records(plan, 0x1800)
    assert (0x1800, 3, 0) in records(plan, 0x1800)
    with pytest.raises(BusConfigError, match="0x1400:05"):
        planned(tmp_path, "rpdo: {1: {event_deadline: 100}}")


def test_a_mapping_of_more_objects_than_the_pdo_holds_is_refused(tmp_path):
    many = ", ".join(["{index: 0x6041}"] * 4)
    with pytest.raises(BusConfigError, match=r"the mapping has 4 objects, TPDO 1 of TMCM-1270.eds at most 3") as caught:
        planned(tmp_path, f"tpdo: {{1: {{mapping: [{many}]}}}}")
    assert "0x1A00:04" not in str(caught.value)  # one cause, one error


def test_a_dummy_fills_a_gap_only_where_the_device_allows_it(tmp_path):
    mapping = "rpdo: {1: {mapping: [{index: 0x0005}, {index: 0x6040}]}}"
    with pytest.raises(BusConfigError, match=r"TMCM-1270.eds does not allow the dummy entry 0x0005"):
        planned(tmp_path, mapping)
    text = EDS.read_text(encoding="latin-1").replace("Dummy0005=0", "Dummy0005=1")
    (tmp_path / "dummy.eds").write_text(text, encoding="latin-1")
    plan, _ = planned(tmp_path, mapping, dcf="dummy.eds")
    assert (0x1600, 1, 0x00050008) in records(plan, 0x1600)
    assert [mapped.bits for mapped in plan.rpdos[0].objects] == [8, 16]


def test_cob_id_auto_above_pdo_4_counts_on_over_the_whole_bus(tmp_path):
    text = EDS.read_text(encoding="latin-1")
    for old, new in (("1803", "1804"), ("1A03", "1A04")):
        text = text.replace(f"[{old}", f"[{new}")
    text = text.replace("=0x1803", "=0x1804").replace("=0x1A03", "=0x1A04")
    (tmp_path / "five.eds").write_text(text, encoding="latin-1")
    (tmp_path / "bus.yml").write_text(
        "master: {node_id: 1}\ndefaults: {dcf: five.eds, tpdo: {5: {cob_id: auto, mapping: [{index: 0x6041}]}}}\n"
        "nodes: {a: {node_id: 3}, b: {node_id: 4}}\n"
    )
    bus = read_bus(tmp_path / "bus.yml")
    assert [plan.tpdos[0].cob_id for plan in bus.plans.values()] == [0x680, 0x681]
    assert records(bus.plans["a"], 0x1804)[-1] == (0x1804, 1, 0x40000680)


GENERATED = [
    (0x1017, 0, b"\xe8\x03"),
    (0x1800, 1, (0xC0000183).to_bytes(4, "little")),
    (0x1800, 2, b"\x01"),
    (0x1A00, 0, b"\0"),
    (0x1A00, 1, (0x60410010).to_bytes(4, "little")),
    (0x1A00, 0, b"\x01"),
    (0x1800, 1, (0x40000183).to_bytes(4, "little")),
    (0x2000, 0, b"\x03"),
]


def test_a_generated_concise_dcf_is_planned_in_an_order_that_devices_take(tmp_path):
    (tmp_path / "drive.bin").write_bytes(encode_concise(GENERATED))
    plan, _ = planned(tmp_path, "configuration_file: drive.bin")
    assert records(plan, 0x1800, 0x1A00) == [
        (0x1800, 1, 0xC0000183),
        (0x1800, 2, 1),
        (0x1A00, 0, 0),
        (0x1A00, 1, 0x60410010),
        (0x1A00, 0, 1),
        (0x1800, 1, 0x40000183),
    ]
    assert {write.reason for write in plan.writes if write.index in (0x2000, 0x1A00)} == {"from drive.bin"}
    assert [(layout.number, layout.transmission_type) for layout in plan.tpdos] == [(1, 1)]
    assert [mapped.index for mapped in plan.tpdos[0].objects] == [0x6041]
    assert plan.heartbeat_timeout_ns == 3_000_000_000
    assert records(plan, 0x1801) == [(0x1801, 1, 0xC0000283)]


def test_what_bus_yml_specifies_of_a_pdo_goes_before_the_file(tmp_path):
    (tmp_path / "drive.bin").write_bytes(encode_concise(GENERATED))
    plan, _ = planned(tmp_path, "configuration_file: drive.bin\ntpdo: {1: {mapping: [{index: 0x6061}]}}\n")
    assert [mapped.index for mapped in plan.tpdos[0].objects] == [0x6061]
    assert all(write.reason != "from drive.bin" for write in plan.writes if write.index in (0x1800, 0x1A00))


def test_the_parameter_values_of_a_dcf_are_planned_writes(tmp_path):
    values = {(0x2000, 0): 4, (0x1800, 2): 10, (0x1A00, 0): 1, (0x1A00, 1): 0x60640020, (0x1402, 1): 0xC0000403}
    write_dcf(tmp_path / "drive.dcf", read_eds(EDS).od, 3, 1_000_000, values)
    plan, _ = planned(tmp_path, dcf="drive.dcf")
    assert records(plan, 0x2000) == [(0x2000, 0, 4)]
    assert records(plan, 0x1800, 0x1A00) == [
        (0x1800, 1, 0xC0000183),
        (0x1800, 2, 10),
        (0x1A00, 0, 0),
        (0x1A00, 1, 0x60640020),
        (0x1A00, 0, 1),
        (0x1800, 1, 0x40000183),
    ]
    first = next(layout for layout in plan.tpdos if layout.number == 1)
    assert ([mapped.index for mapped in first.objects], first.transmission_type) == ([0x6064], 10)
    assert records(plan, 0x1402) == [(0x1402, 1, 0xC0000403)]
    assert {write.reason for write in plan.writes if write.index == 0x2000} == {"from drive.dcf"}


@pytest.mark.parametrize(("key", "subindex"), [("inhibit_time", 3), ("event_timer", 5), ("event_deadline", 5)])
def test_a_setting_of_a_tpdo_that_the_device_lacks_is_named_by_its_key(tmp_path, key, subindex):
    text = data_path("eds", "generic_cia401.eds").read_text()
    for sub in (3, 5):
        text = re.sub(rf"(?ms)^\[1800sub{sub}\].*?(?=^\[)", "", text)
    (tmp_path / "two.eds").write_text(text)
    bus = tmp_path / "bus.yml"
    node = f"{{dcf: two.eds, node_id: 5, tpdo: {{1: {{enabled: true, transmission: 255, {key}: 20}}}}}}"
    bus.write_text(f"master: {{node_id: 1, sync_period: 20000}}\nnodes: {{io: {node}}}\n")
    with pytest.raises(BusConfigError, match=rf"two\.eds has no such setting of this TPDO \(0x1800:0{subindex}\); "
                                             f"remove {key}"):  # fmt: skip
        read_bus(bus)


@pytest.mark.parametrize("keys", ["", "tpdo: {1: {enabled: true}}"])
def test_a_pdo_without_a_mapping_is_a_warning_only_if_bus_yml_lists_it(tmp_path, keys):
    """The sample files of CiA 401 and 406 have valid PDOs without a mapping."""
    text = data_path("eds", "generic_cia402.eds").read_text()
    (tmp_path / "empty.eds").write_text(
        re.sub(r"(\[1[6A]0\dsub0\](?:\n[^\[\n]+)*?\nDefaultValue=)\w+", r"\g<1>0", text)
    )
    path = tmp_path / "bus.yml"
    path.write_text(f"master: {{node_id: 1}}\nnodes:\n  a:\n    node_id: 2\n    dcf: empty.eds\n    {keys}\n")
    config, problems = inspect_bus(path)
    assert any("TPDO 1 has no mapping" in note for note in config.notes)
    assert any("TPDO 1 has no mapping" in str(warning) for warning in problems.warnings) == bool(keys)
