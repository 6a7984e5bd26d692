"""Whole files: accepted and refused content, reports, and reading time."""

import csv
import itertools
import json
import shutil
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from support.eds import DEVIATIONS, DEVICE_TYPE, MALFORMED, codes, eds, lines_executed, mutated, parse, section
from support.properties import examples

from canopen_control.data_files import data_path
from canopen_control.errors import EdsError
from canopen_control.od import eds as eds_module
from canopen_control.od.codec import default_of, encode
from canopen_control.od.dcf import concise_of, eds_text, encode_concise
from canopen_control.od.eds import parse_eds, read_eds
from canopen_control.od.issues import Severity
from canopen_control.od.model import TYPES, DataType, ObjectCode


@pytest.mark.parametrize("name", ["TMCM-1270.eds", "generic_cia402.eds"])
def test_the_bundled_drives_have_these_types(name):
    od = read_eds(data_path("eds", name)).od
    compared = [address for address in TYPES if address in od]
    assert len(compared) > 40
    assert [address for address in compared if od[address].data_type not in TYPES[address]] == []


def compact_of_compact_pdo(mask, rx, tx):
    return section("DeviceInfo", CompactPDO=mask, NrOfRXPDO=rx, NrOfTXPDO=tx)


def test_records_are_made_as_the_mask_reports():
    od = parse(compact_of_compact_pdo("0x13", 5, 1), eds()).od
    assert sorted(od.objects) == [*range(0x1400, 0x1405), *range(0x1600, 0x1605), 0x1800, 0x1A00, 0x2000]
    assert od.subindices(0x1400) == [0, 1, 2, 5]
    assert od[0x1400, 0].default == 5
    assert [od[0x1400 + k, 1].default for k in range(5)] == [0x200, 0x300, 0x400, 0x500, 0x80000000]
    assert (od[0x1800, 1].default, od[0x1800, 1].relative, od[0x1404, 1].relative) == (0x180, True, False)
    assert od.subindices(0x1A00) == list(range(65))


def test_what_the_file_describes_stays():
    own = section("1400", ParameterName="Own", ObjectType=9, SubNumber=0)
    file = parse(compact_of_compact_pdo(3, 1, 0), own, eds())
    assert file.od.objects[0x1400].name == "Own"
    assert file.od.subindices(0x1400) == []
    assert "compact-pdo" in codes(file)


def test_no_more_than_the_standard_has():
    file = parse(compact_of_compact_pdo(1, 100_000, -1), eds())
    assert len(file.od.objects) == 1 + 2 * 512
    assert codes(file).count("compact-count") == 2


def test_written_out_they_are_plain_records():
    od = parse(compact_of_compact_pdo("0x3F", 2, 2), eds()).od
    again = parse_eds(eds_text(od).encode())
    assert again.od.entries == od.entries
    assert "compact-pdo" not in codes(again)


def sub(title, default=None, data_type=7, access="rw", **more):
    return eds(title, data_type=data_type, access=access, DefaultValue=default, **more)


def record(index, *defaults, count=None, sub_number=None, access="rw"):
    """Make a record whose subindices 1 to n have these defaults."""
    number = len(defaults) + 1 if sub_number is None else sub_number
    return "\n".join(
        [
            section(index, ParameterName="Record", ObjectType=9, SubNumber=number),
            sub(f"{index}sub0", len(defaults) if count is None else count, 5, access),
            *(sub(f"{index}sub{n}", default) for n, default in enumerate(defaults, 1)),
        ]
    )


CONTROLWORD = eds("6040", data_type=6, access="rww", PDOMapping=1)
STATUSWORD = eds("6041", data_type=6, access="ro", PDOMapping=1)
BIT = eds("2001", data_type=1, access="rw", PDOMapping=1)
RPDO = record("1400", "$NODEID+0x200", 255, access="const")
TPDO = record("1800", "$NODEID+0x180", 255, access="const")


@pytest.mark.parametrize(
    ("mapping", "code"),
    [
        (record("1600", "0x60400010"), []),
        (record("1600", "0x60400010", 0, count=1), []),
        (record("1600", "0x20010001"), []),
        (record("1600", "0x20010008"), []),
        (record("1600", "0x60420010"), ["pdo-target"]),
        (record("1600", "0x60410010"), ["pdo-direction"]),
        (record("1600", "0x20000020"), ["pdo-mappable"]),
        (record("1600", "0x60400020"), ["pdo-length"]),
        (record("1600", *["0x60400010"] * 5), ["pdo-bits"]),
        (record("1600", "0x60400010", count=2), ["pdo-count"]),
        (record("1600", "0x60400010", 0, count=2), ["pdo-count"]),
        (record("1600", "0x60400010", count=255), []),
        (record("1600", "0x00050008"), []),
        (record("1600", "0x00050010"), ["pdo-length"]),
        (record("1600", "0x00060010"), ["pdo-target"]),
    ],
)
def test_every_mapped_object_of_an_rpdo_is_checked(mapping, code):
    dummies = section("DummyUsage", Dummy0005=1)
    file = parse(dummies, RPDO, mapping, eds(), BIT, CONTROLWORD, STATUSWORD)
    assert codes(file) == code


@pytest.mark.parametrize(
    ("mapping", "code"),
    [
        (record("1A00", "0x60410010"), []),
        (record("1A00", "0x60400010"), ["pdo-direction"]),
        (record("1A00", "0x00050008"), ["pdo-direction"]),
    ],
)
def test_every_mapped_object_of_a_tpdo_is_checked(mapping, code):
    file = parse(section("DummyUsage", Dummy0005=1), TPDO, mapping, CONTROLWORD, STATUSWORD)
    assert codes(file) == code


def test_what_cannot_work_is_an_error_at_the_mapping_entry():
    file = parse(RPDO, record("1600", "0x60420010"))
    (issue,) = [issue for issue in file.issues if issue.code == "pdo-target"]
    assert issue.severity is Severity.ERROR
    assert "RPDO1 maps 0x6042:00" in issue.text
    assert issue.line == file.od[0x1600, 1].line


@pytest.mark.parametrize(
    ("cob_id", "words"),
    [
        ("$NODEID+0x180", ""),
        ("0x1FE", ""),
        ("0x80000000", ""),
        (None, "0x1800:01 (Thing) has no DefaultValue"),
        ("0", "0x1800:01 (Thing) is 0x0, a restricted CAN-ID"),
        ("0x601", "0x1800:01 (Thing) is 0x601, a restricted CAN-ID"),
        ("0x40000000", "0x1800:01 (Thing) is 0x40000000, a restricted CAN-ID"),
    ],
)
def test_a_cob_id_that_is_unknown_or_none_is_named(cob_id, words):
    file = parse(record("1800", cob_id, 255), record("1A00", "0x60410010"), STATUSWORD)
    texts = [issue.text for issue in file.issues if issue.code == "cob-id"]
    assert len(texts) == bool(words)
    assert all(words in text for text in texts)


@pytest.mark.parametrize(("index", "value", "wrong"), [("1005", 0, True), ("1005", 128, False), ("1014", 0, True)])
def test_the_cob_ids_of_services_are_named_as_well(index, value, wrong):
    assert codes(parse(eds(index, data_type=7, DefaultValue=value))) == ["cob-id"] * wrong


def test_the_number_of_pdos_is_noted():
    info = section("DeviceInfo", NrOfRXPDO=2, NrOfTXPDO=5)
    file = parse(info, RPDO, record("1600"))
    assert codes(file) == ["pdo-number"]


@pytest.mark.parametrize(
    ("text", "code"),
    [
        (record("2000", 1, 2, access="ro"), []),
        (record("2000", 1, 2, count=3, access="ro"), ["sub0-count"]),
        (record("2000", 1, 2, count=0, access="rw"), []),
        (record("2000", 1, 2, sub_number=2), ["sub-number"]),
        (record("2000", 1, 2, sub_number="many"), ["sub-number"]),
        (section("2000", ParameterName="R", ObjectType=9, SubNumber=0), ["sub-missing"]),
        (section("2000", ParameterName="R", ObjectType=8, SubNumber=1) + sub("2000sub1"), ["sub0-missing"]),
        (section("2000", ParameterName="R", ObjectType=9, SubNumber=1) + sub("2000sub0", 0, 6, "ro"), ["sub0-type"]),
    ],
)
def test_the_subindices_of_an_object_are_counted(text, code):
    assert codes(parse(text)) == code


def test_the_structure_subindex_is_not_counted():
    text = section("2000", ParameterName="R", ObjectType=9, SubNumber=3)
    assert codes(parse(text, sub("2000sub0", 1, 5, "ro"), sub("2000sub1"), sub("2000subFF"))) == []


@pytest.mark.parametrize(
    ("default", "code"), [("4", ["value-limit"]), ("5", []), ("10", []), ("11", ["value-limit"]), (None, [])]
)
def test_defaults_are_within_the_limits(default, code):
    assert codes(parse(eds(DefaultValue=default, LowLimit=5, HighLimit=10))) == code


@pytest.mark.parametrize(
    ("default", "low", "node_id", "code"),
    [
        ("$NODEID+0x200", "0x201", None, []),  # as in Roboteq's EDS: the smallest node-ID is 1
        ("$NODEID+0x200", "0x202", None, ["value-limit"]),
        ("$NODEID+0x200", "0x202", 2, []),
        ("$NODEID+0x200", "$NODEID+0x200", None, []),
        ("0x200", "$NODEID+0x200", None, ["value-limit"]),
    ],
)
def test_a_default_with_the_node_id_is_compared_with_the_limits_for_the_smallest_node_id(default, low, node_id, code):
    text = eds(data_type=7, DefaultValue=default, LowLimit=low, HighLimit="0x5FF")
    assert codes(parse(text, node_id=node_id)) == code


def test_mandatory_objects_are_missed():
    file = parse(eds())
    missed = [issue.text[:6] for issue in file.issues if issue.code == "object-mandatory"]
    assert missed == ["0x1000", "0x1001", "0x1018"]


@pytest.mark.parametrize(
    ("device_type", "code"), [("0x00020192", ["profile-type"]), ("0xFFFF0192", ["profile-type"]), ("0x00020191", [])]
)
def test_types_that_differ_from_the_profile_are_kept_and_reported(device_type, code):
    file = parse(eds("1000", DefaultValue=device_type), eds("6060", data_type=5))
    assert codes(file) == code
    assert file.od[0x6060, 0].data_type.name == "UNSIGNED8"


def test_the_second_axis_is_compared_too():
    file = parse(eds("1000", DefaultValue="0xFFFF0192"), eds("6860", data_type=5), eds("7060", data_type=2))
    (issue,) = [issue for issue in file.issues if issue.code == "profile-type"]
    assert "0x6860:00" in issue.text


@pytest.mark.parametrize(
    ("index", "code", "types", "issue"),
    [
        ("2000", 8, (5, 7), "warning"),
        ("2000", 8, (7, 7), None),
        ("2000", 9, (7, 7), None),
        ("2000", 9, (5, 7), None),
        ("1018", 8, (7, 7), "note"),
        ("1018", 9, (7, 7), None),
        ("6091", 9, (7, 7), "note"),
        ("6891", 9, (7, 7), "note"),
        ("60C2", 8, (5, 2), "warning"),
        ("1600", 8, (7, 7), "note"),
    ],
)
def test_arrays_and_records_that_are_the_other_are_reported(index, code, types, issue):
    subs = [sub(f"{index}sub{number}", 0, data_type) for number, data_type in enumerate(types, 1)]
    head = section(index, ParameterName="Record", ObjectType=code, SubNumber=3)
    file = parse(head, sub(f"{index}sub0", 2, 5, "ro"), *subs)
    values = [item.severity.value for item in file.issues if item.code == "object-code"]
    assert values == ([] if issue is None else [issue])


HERE = Path(__file__).parent
SHIPPED = ("TMCM-1270.eds", "generic_cia402.eds")


def rows(folder):
    with (folder / "index.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


# --- The malformed files ---

INDEX = {row["file"]: row["wanted"] for row in rows(MALFORMED)}
GOOD = read_eds(MALFORMED / "00_good.eds", 5)

WANTED_VALUES = {
    "01_latin1_name": lambda od: od[0x6040, 0].name == "Höhe µm",
    "14_keys_lowercase": lambda od: od[0x6040, 0].name == "Controlword",
    "17_SUB_uppercase": lambda od: od[0x1018, 1].default == 1,
    "23_nodeid_bit31": lambda od: od[0x1400, 1].default == 0x80000205,
    "24_my_node_id": lambda od: od[0x1400, 1].default is None and od[0x1400, 1].texts["DefaultValue"],
    "25_default_int_suffix_LL": lambda od: od[0x1000, 0].default == 0x20192,
    "26_default_inline_comment": lambda od: od[0x1000, 0].default == 0x20192,
    "27_signed_hex_default": lambda od: od[0x607A, 0].default == -2147483647,
    "28_real32_hex_bits": lambda od: od[0x2000, 0].default == 10.0,
    "29_leading_zero_octal": lambda od: od[0x1400, 2].default == 8,
    "30_compactsubobj": lambda od: od.subindices(0x1003) == [0, 1, 2, 3, 4] and od[0x1003, 0].default == 4,
    "31_compact_value": lambda od: od[0x1016, 2].default == 0x203E8 and od[0x1016, 1].default is None,
    "32_unknown_datatype": lambda od: od[0x6040, 0].data_type is DataType.DOMAIN,
    "35_commissioning_mm": lambda od: od.bitrate == 500_000,
    "36_commissioning_hex_id": lambda od: od.bitrate == 1_000_000,
    "37_baudrate_hex": lambda od: od.bitrate == 500_000,
    "45_value_with_percent": lambda od: od[0x1001, 0].name == "Load 100% of %(x)s",
    "46_same_names": lambda od: od[0x6040, 0].name == od[0x2001, 0].name == "Controlword",
    "47_equals_in_value": lambda od: od[0x1001, 0].name == "a=b (c=d)",
    "50_module_device": lambda od: od.sections["M1SubExtends"] == {"NrOfEntries": "1", "1": "0x6000"},
}


@pytest.mark.parametrize("name", [name for name, expected in INDEX.items() if expected.startswith("load")])
def test_a_file_that_can_be_understood_loads(name):
    file = read_eds(MALFORMED / f"{name}.eds", 5)
    doubts = [issue for issue in file.issues if issue.severity is not Severity.NOTE]
    assert bool(doubts) is INDEX[name].startswith("load+warn"), [str(issue) for issue in doubts]
    assert all(issue.path.endswith(f"{name}.eds") and issue.code and issue.text for issue in file.issues)
    assert WANTED_VALUES.get(name, lambda _: True)(file.od)


#: what the defect itself takes away or changes; everything else must be as in the good file
TOUCHED = {
    "01_latin1_name": {(0x6040, 0)},
    "15_no_DataType_VAR": {(0x1001, 0)},
    "16_no_ParameterName": {(0x1001, 0)},
    "24_my_node_id": {(0x1400, 1)},
    "23_nodeid_bit31": {(0x1400, 1)},
    "29_leading_zero_octal": {(0x1400, 2)},
    "32_unknown_datatype": {(0x6040, 0)},
    "39_pdomapping_empty": {(0x6040, 0)},
    "40_mapping_missing_object": {(0x6040, 0)},
    "45_value_with_percent": {(0x1001, 0)},
    "47_equals_in_value": {(0x1001, 0)},
}


@pytest.mark.parametrize("name", [name for name, expected in INDEX.items() if expected.startswith("load")])
def test_a_defect_costs_nothing_but_itself(name):
    od = read_eds(MALFORMED / f"{name}.eds", 5).od
    for address, entry in GOOD.od.entries.items():
        if address not in TOUCHED.get(name, ()):
            assert od[address] == entry


@pytest.mark.parametrize("name", [name for name, expected in INDEX.items() if expected.startswith("reject")])
def test_what_is_not_a_canopen_eds_is_refused_with_one_clear_error(name):
    path = MALFORMED / f"{name}.eds"
    with pytest.raises(EdsError) as caught:
        read_eds(path)
    assert (caught.value.path, caught.value.line) == (str(path), 1)
    words = {"41_odva_eds": "ODVA", "42_symlink_text": "symbolic link", "43_empty": "empty", "44_xdd": "XDD"}
    assert words[name] in caught.value.reason


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("05_dup_section", 133),
        ("06_dup_key", 53),
        ("13_objecttype_hash_comment", 127),
        ("24_my_node_id", 93),
        ("34_listed_no_section", 37),
        ("39_pdomapping_empty", 131),
    ],
)
def test_an_issue_is_at_its_line(name, line):
    assert line in [issue.line for issue in read_eds(MALFORMED / f"{name}.eds", 5).issues]


# --- Deviations of real drives ---


@pytest.mark.parametrize("row", rows(DEVIATIONS), ids=lambda row: row["file"])
def test_a_drive_that_deviates_loads_with_its_own_types_and_the_deviation_is_reported(row):
    file = read_eds(DEVIATIONS / f"{row['file']}.eds", 3)
    assert sorted(issue.code for issue in file.issues) == sorted(row["issues"].split())
    for expected in row["types"].split():
        place, data_type = expected.split("=")
        index, subindex = (int(part, 16) for part in place.split(":"))
        assert file.od[index, subindex].data_type.name == data_type


def test_values_of_the_deviating_types_are_right():
    def od(name):
        return read_eds(DEVIATIONS / f"{name}.eds", 3).od

    assert od("03_target_velocity_unsigned")[0x60FF, 0].default == 0xFFFFFFFF
    assert od("04_torque_32_bits")[0x6071, 0].default == -10
    assert od("11_limits_and_capitals")[0x60FF, 0].low == -4096
    assert od("12_pdos_fixed")[0x1800, 1].default == 0x40000183
    assert od("12_pdos_fixed")[0x1600, 1].default == 0x60400010


# --- The bundled files ---


@pytest.mark.parametrize("name", SHIPPED)
def test_the_bundled_files_have_no_issue(name):
    file = read_eds(data_path("eds", name), 3)
    assert [str(issue) for issue in file.issues] == []


TMCM = json.loads((HERE.parent / "data" / "tmcm1270_objects.json").read_text(encoding="utf-8"))
FROM_THE_DEVICE_BLOCK = {(0x1008, 0): "TMCM-1270", (0x1018, 3): 0x0003001A}  # the table itself gives no default


def test_the_tmcm_1270_is_complete():
    od = read_eds(data_path("eds", "TMCM-1270.eds")).od
    assert len(od.objects) == TMCM["counts"]["indices"] == 136
    assert len(od) == TMCM["counts"]["sections_with_value"] == 243
    values = [row for row in TMCM["objects"] if row.get("sub") is not None]
    assert {(int(row["index"], 16), row["sub"]) for row in values} == set(od.entries)
    for row in values:
        entry = od[int(row["index"], 16), row["sub"]]
        default = FROM_THE_DEVICE_BLOCK.get(entry.address, row["default"])
        assert (entry.data_type.name, entry.access, entry.default) == (row["data_type"], row["access"], default)
        assert entry.relative is bool(row["default_plus_nodeid"])
        assert entry.pdo_mappable is row["pdo_mappable"]
        assert (entry.rpdo_mappable, entry.tpdo_mappable) == (row["rpdo_mappable"], row["tpdo_mappable"])
        assert entry.obj_flags == int(row["obj_flags"] or "0", 16)
    for row in TMCM["objects"]:
        if row.get("sub") is None:
            assert od.objects[int(row["index"], 16)].code.name == row["object_type"]


@pytest.mark.parametrize("name", SHIPPED)
def test_every_real_of_the_bundled_files_is_written_as_its_bits(name):
    """Lely's dcfgen refuses a whole file for one REAL with a decimal point."""
    path, reals = data_path("eds", name), (DataType.REAL32, DataType.REAL64)
    lines = path.read_text().splitlines()
    entries = [entry for entry in read_eds(path, 3).od if entry.data_type in reals]
    assert len(entries) == (2 if name == "generic_cia402.eds" else 0)
    for entry in entries:
        section = itertools.takewhile(lambda line: not line.startswith("["), lines[entry.line :])
        texts = [
            line.partition("=")[2] for line in section if line.startswith(("DefaultValue", "LowLimit", "HighLimit"))
        ]
        assert texts
        assert [text for text in texts if not text.startswith("0x")] == []
        assert entry.default in (1.5, -2.25)


# --- Structure ---


def test_a_sub_without_its_object_makes_one():
    file = parse(eds("2000sub1"))
    assert (file.od.objects[0x2000].code, file.od.objects[0x2000].name) == (ObjectCode.RECORD, "Object 2000")
    assert codes(file, "sub0-missing") == ["object-missing"]


@pytest.mark.parametrize(
    ("text", "code", "issue"),
    [
        (section("2000", ParameterName="A", DataType=7, AccessType="rw"), ObjectCode.VAR, []),
        (
            section("2000", ParameterName="A", ObjectType="0x44", DataType=7, AccessType="rw"),
            ObjectCode.VAR,
            ["object-type"],
        ),
        (section("2000", ParameterName="A") + eds("2000sub1"), ObjectCode.RECORD, ["object-type"]),
        (eds("2000") + eds("2000sub1"), ObjectCode.VAR, ["object-type"]),
        (section("0005", ParameterName="U8", ObjectType=5, DataType=5, AccessType="ro"), ObjectCode.DEFTYPE, []),
    ],
)
def test_object_types(text, code, issue):
    file = parse(text)
    (info,) = file.od.objects.values()
    assert info.code is code
    assert codes(file, "sub0-missing") == issue
    assert len(file.od) > 0


@pytest.mark.parametrize("title", ["2000sub1", "2000SUB1", "2000Sub01", "2000 sub 1"])
def test_subindices_are_hexadecimal_in_any_spelling(title):
    assert (0x2000, 1) in parse(eds(title)).od
    assert (0x2000, 0x1F) in parse(eds("2000sub1F")).od


@pytest.mark.parametrize("title", ["1018sub", "1018sub100", "1018subG", "20005", "0x2000", "0x2000sub1"])
def test_what_resembles_an_object_and_is_none_is_reported(title):
    file = parse(DEVICE_TYPE, section(title, ParameterName="x"))
    assert codes(file) == ["section-unknown"]
    assert file.od.sections[title] == {"ParameterName": "x"}


@pytest.mark.parametrize("title", ["2000ObjectLinks", "2000Denotation"])
def test_sections_about_an_object_are_kept(title):
    file = parse(eds("2000"), section(title, ObjectLinks=1, **{"1": "0x1000"}))
    assert "section-unknown" not in codes(file)
    assert title in file.od.sections


def compact(count, index="2000", **keys):
    return section(
        index, ParameterName="Things", ObjectType=8, DataType=7, AccessType="rw", CompactSubObj=count, **keys
    )


def test_compact_objects_have_names_values_and_a_default_for_the_others():
    names = section("2000Name", NrOfEntries=2, **{"2": "second", "3": "third"})
    values = section("2000VALUE", NrOfEntries=2, **{"1": "$NODEID+0x200", "3": "0x30"})
    file = parse(compact(3, DefaultValue="7", PDOMapping=1), names, values, node_id=5)
    assert codes(file) == []
    subs = [file.od[0x2000, subindex] for subindex in (1, 2, 3)]
    assert [entry.name for entry in subs] == ["Things1", "second", "third"]
    assert parse(compact(1), section("2000Name", **{"1": ""})).od[0x2000, 1].name == "Things1"
    assert [entry.default for entry in subs] == [0x205, 7, 0x30]
    assert [entry.relative for entry in subs] == [True, False, False]
    assert all(entry.pdo_mappable for entry in subs)
    assert (file.od[0x2000, 0].default, file.od[0x2000, 0].data_type) == (3, DataType.UNSIGNED8)


def concise(file):
    return [(subindex, int.from_bytes(data, "little")) for _, subindex, data in concise_of(file.od)]


def test_values_of_compact_objects_in_a_dcf_are_parameter_values():
    """[xxxxValue] overrides the ParameterValue of the object, and is written at boot (CiA 306-1, 4.6.3.4)."""
    values = section("2000Value", NrOfEntries=2, **{"2": "7", "3": "$NODEID+0x200"})
    commissioning = section("DeviceComissioning", NodeID=5)
    file = parse(compact(3, DefaultValue="1"), values, commissioning)
    assert [file.od[0x2000, subindex].default for subindex in (1, 2, 3)] == [1, 1, 1]
    assert concise(file) == [(2, 7), (3, 0x205)]
    assert file.od[0x2000, 3].parameter_relative
    for more in ([], [commissioning]):
        file = parse(compact(3, ParameterValue="9"), values, *more, node_id=5)
        assert concise(file) == [(1, 9), (2, 7), (3, 0x205)]
    again = parse_eds(eds_text(file.od).encode(), 5)
    assert again.od.entries == file.od.entries
    assert "ParameterValue" not in again.od.objects[0x2000].texts


def test_a_compact_mapping_record_counts_its_mapped_objects():
    """Subindex 0 as a constant would make the mapping of bus.yml impossible, and map objects at address 0."""
    for values, count in (({}, 0), ({"1": "0x60400010", "2": "0x60600008", "4": "0x60FF0020"}, 2)):
        text = section("1600Value", NrOfEntries=len(values), **values)
        for access in ("rw", "ro"):
            od = parse(compact(8, index="1600").replace("AccessType=rw", f"AccessType={access}"), text).od
            assert (od[0x1600, 0].default, od[0x1600, 0].access) == (count, access)
            assert od.subindices(0x1600) == list(range(9))
    assert [(entry.subindex, entry.access) for entry in parse(compact(1, index="1010")).od] == [(0, "ro"), (1, "rw")]


@pytest.mark.parametrize(
    ("text", "issue"),
    [
        (compact(255), ["compact-count"]),
        (compact(-1), ["compact-count", "sub-missing"]),
        (compact("x"), ["key-number", "sub-missing"]),
        (compact(2) + section("2000Value", **{"3": "1"}), ["compact-unused"]),
        (compact(2) + section("2000Value", **{"1": "1", "01": "2"}), ["compact-unused"]),
        (compact(2) + section("2000Value", **{"0x1": "1"}), ["compact-unused"]),
        (compact(2) + section("2000Value", **{"1": "x"}), ["value-form"]),
        (DEVICE_TYPE + section("1000Value", **{"1": "x"}), ["compact-unused"]),
    ],
)
def test_compact_objects_that_do_not_fit(text, issue):
    assert sorted(codes(parse(text))) == issue


def test_a_file_without_objects_is_not_a_canopen_eds():
    with pytest.raises(EdsError, match=r"no object sections.*first section is \[FileInfo\]"):
        parse("[FileInfo]\nFileName=x\n")
    with pytest.raises(EdsError, match="ODVA"):
        parse("[File]\nx=1\n[Device]\nVendCode=1;\n")


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (encode_concise([(0x1017, 0, b"\x64\0")]), "concise DCF"),
        (encode_concise([(0x6083, 0, bytes(4)), (0x6084, 0, b"\1\2\3\4")]), "configuration_file"),
        (b"[TOPOLOGY]\nNodes=0x1\n[Node1]\nName=a\nDCFName=a.dcf\n", "CANopen project"),
        (b"<?xml version='1.0'?>\n<!--\n[ 1 ] a list\n[]\n-->\n<ISO15745ProfileContainer/>", "XDD"),
        (b"\n  <ISO15745ProfileContainer>\n[x]\n", "XDD"),
        ("<?xml version='1.0'?>\n[x]\n".encode("utf-16"), "XDD"),
    ],
)
def test_files_of_the_neighbouring_formats_are_named_as_what_they_are(data, words):
    with pytest.raises(EdsError, match=words):
        parse_eds(data)


def test_a_file_of_absurd_size_is_refused_before_it_is_read(tmp_path):
    path = tmp_path / "huge.eds"
    with path.open("wb") as file:
        file.truncate(40_000_000_000)
    with pytest.raises(EdsError, match=r"it has 40000\.0 MB, more than the limit of 32 MB"):
        read_eds(path)
    with pytest.raises(EdsError, match="it is not a regular file"):
        read_eds("/dev/zero")


@pytest.mark.parametrize(
    ("base", "low", "high", "title", "result"),
    [
        (5, 0, 10, "A0", (DataType.UNSIGNED8, 0, 10)),
        (3, -5, 5, "00A0", (DataType.INTEGER16, -5, 5)),
        ("0x7", 1, 9, "a0", (DataType.UNSIGNED32, 1, 9)),
        (0x99, 1, 9, "A0", (DataType.DOMAIN, None, None)),
    ],
)
def test_a_type_made_of_a_basic_type_and_its_limits_is_followed(base, low, high, title, result):
    subs = [section(f"{title}sub{n}", ParameterName="x", DefaultValue=v) for n, v in enumerate((base, low, high), 1)]
    od = parse(section(title, ParameterName="T", ObjectType=6), *subs, eds("2000", data_type="0xA0", DefaultValue=3)).od
    entry = od[0x2000, 0]
    assert (entry.data_type, entry.low, entry.high) == result


def test_a_file_that_cannot_be_read_is_an_eds_error(tmp_path):
    with pytest.raises(EdsError, match="cannot be read"):
        read_eds(tmp_path / "none.eds")
    with pytest.raises(EdsError, match="cannot be read"):
        read_eds(tmp_path)
    with pytest.raises(EdsError, match="cannot be read"):
        read_eds("a\0b")


# --- Anything at all ---


@pytest.mark.rest
@settings(max_examples=examples(300), suppress_health_check=[HealthCheck.too_slow])
@given(mutated() | st.binary(max_size=200), st.none() | st.integers(1, 127))
@example(b"[1000]\nDataType=8\nDefaultValue=0x7FC00000", None)
@example(b"[1000]\n1=\n[1000Value]\n" + b"9" * 5000 + b"=1", 5)
def test_no_bytes_bring_another_error_than_eds_error(data, node_id):
    try:
        file = parse_eds(data, node_id, name="mutated.eds")
    except EdsError:
        return
    lines = data.count(b"\n") + data.count(b"\r") + 1
    for issue in file.issues:
        assert 1 <= issue.line <= lines
        assert issue.path == "mutated.eds"
        assert len(issue.text) < 500
    for entry in file.od:
        assert isinstance(encode(default_of(entry), entry.data_type), bytes)
        assert entry.index in file.od.objects


# --- What reading costs ---

SHAPES = {
    "objects": lambda n: "".join(eds(f"{0x2000 + i:04X}", DefaultValue=i, LowLimit=0, HighLimit=5) for i in range(n)),
    "subindices": lambda n: "".join(eds(f"{0x2000 + i // 250:04X}sub{i % 250 + 1:X}") for i in range(n)),
    "compact": lambda n: "".join(compact(254, f"{0x2000 + i:04X}") for i in range(n // 20)),
    "compact values": lambda n: compact(254) + section("2000Value", **{str(i): i for i in range(n)}),
    "lists": lambda n: section("OptionalObjects", **{str(i): f"0x{i:04X}" for i in range(n)}),
    "same listed": lambda n: section("OptionalObjects", **{str(i): "0x2000" for i in range(n)}),
    "same section": lambda n: eds() * n,
    "same key": lambda n: "[2000]\n" + "DefaultValue=5\n" * n,
    "stray lines": lambda n: "stray\n" * n,
    "comments": lambda n: section("Comments", **{f"Line{n - i}": "text" for i in range(n)}),
    "unknown keys": lambda n: section("2000", **{f"Key{i}": i for i in range(n)}),
    "unknown sections": lambda n: "".join(section(f"M{i}ModuleInfo", A=1) for i in range(n)),
    "mappings": lambda n: "".join(
        eds(f"{0x1600 + i // 64:04X}sub{i % 64 + 1:X}", DefaultValue="0x60400010") for i in range(n)
    ),
    "bad values": lambda n: "".join(
        eds(f"{0x2000 + i:04X}", data_type=99, access="x", DefaultValue="x") for i in range(n)
    ),
    "long line": lambda n: eds(DefaultValue=" " * n + "x" * n + " " * n + ";"),
    "blank lines": lambda n: "\r\n \r\n" * n,
}


@pytest.mark.parametrize("shape", SHAPES)
def test_ten_times_the_bytes_cost_at_most_fifteen_times_the_work(shape):
    small, large = ((DEVICE_TYPE + SHAPES[shape](n)).encode() for n in (60, 600))
    lines_executed(lambda: parse_eds(large))  # the texts that are parsed only once are known from here on
    cost = [lines_executed(lambda data=data: parse_eds(data)) for data in (small, large)]
    entries = [len(parse_eds(data).od) for data in (small, large)]
    assert len(large) <= 11 * len(small)
    assert cost[1] <= 15 * cost[0]
    assert entries[1] <= 15 * entries[0]


@pytest.fixture
def counted(monkeypatch):
    """Keep files, and count those that are parsed."""
    parsed = []
    monkeypatch.setattr(
        eds_module, "parse_eds", lambda *inputs, **named: parsed.append(inputs) or parse_eds(*inputs, **named)
    )
    eds_module.keep_files()
    yield parsed
    eds_module.forget_files()


def test_a_kept_file_is_parsed_once_and_is_for_each_node_as_if_it_were_read(counted, tmp_path):
    path = tmp_path / "drive.eds"
    shutil.copy(data_path("eds", "TMCM-1270.eds"), path)
    kept = [read_eds(path, node_id) for node_id in (3, 5, 3)]
    assert len(counted) == 1
    kept[0].od.entries.clear()
    kept[0].issues.clear()
    eds_module.forget_files()
    assert [read_eds(path, 5), read_eds(path, 3)] == kept[1:]
    assert len(counted) == 3


def test_a_kept_file_that_has_changed_is_read_again_and_a_missing_one_is_an_error(counted, tmp_path):
    path = tmp_path / "drive.eds"
    shutil.copy(data_path("eds", "TMCM-1270.eds"), path)
    product = read_eds(path).od.device.product_name
    path.write_bytes(path.read_bytes().replace(product.encode(), b"Another"))
    assert read_eds(path, 2).od.device.product_name == "Another"
    path.unlink()
    with pytest.raises(EdsError, match="cannot be read: No such file"):
        read_eds(path, 2)
