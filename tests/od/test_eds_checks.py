"""Whether the parts of a dictionary agree."""

import pytest
from support.eds import codes, eds, parse, section

from canopen_control.od.issues import Severity


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


def test_a_pdo_has_two_records():
    assert codes(parse(RPDO)) == ["pdo-record"]
    assert codes(parse(record("1A00"))) == ["pdo-record"]


@pytest.mark.parametrize(
    ("cob_id", "words"),
    [
        ("$NODEID+0x180", ""),
        ("0x1FE", ""),
        ("0x80000000", ""),
        (None, "0x1800:01 (Thing) has no DefaultValue"),
        ("0", "0x1800:01 (Thing) is 0x0, which is no COB-ID"),
        ("0x601", "0x1800:01 (Thing) is 0x601, which is no COB-ID"),
        ("0x40000000", "0x1800:01 (Thing) is 0x40000000, which is no COB-ID"),
    ],
)
def test_a_cob_id_that_is_unknown_or_none_is_named(cob_id, words):
    file = parse(record("1800", cob_id, 255), record("1A00", "0x60410010"), STATUSWORD)
    told = [issue.text for issue in file.issues if issue.code == "cob-id"]
    assert len(told) == bool(words)
    assert all(words in text for text in told)


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
    ("default", "code"),
    [("4", ["value-limit"]), ("5", []), ("10", []), ("11", ["value-limit"]), (None, [])],
)
def test_defaults_are_within_the_limits(default, code):
    assert codes(parse(eds(DefaultValue=default, LowLimit=5, HighLimit=10))) == code


def test_parameter_values_are_within_the_limits():
    assert codes(parse(eds(DefaultValue=5, ParameterValue=11, HighLimit=10))) == ["value-limit"]


def test_mandatory_objects_are_missed():
    file = parse(eds())
    missed = [issue.text[:6] for issue in file.issues if issue.code == "object-mandatory"]
    assert missed == ["0x1000", "0x1001", "0x1018"]


@pytest.mark.parametrize(
    ("device_type", "code"), [("0x00020192", ["profile-type"]), ("0xFFFF0192", ["profile-type"]), ("0x00020191", [])]
)
def test_types_that_differ_from_the_profile_are_kept_and_told(device_type, code):
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
def test_arrays_and_records_that_are_the_other_are_told(index, code, types, issue):
    subs = [sub(f"{index}sub{number}", 0, data_type) for number, data_type in enumerate(types, 1)]
    head = section(index, ParameterName="Record", ObjectType=code, SubNumber=3)
    file = parse(head, sub(f"{index}sub0", 2, 5, "ro"), *subs)
    found = [each.severity.value for each in file.issues if each.code == "object-code"]
    assert found == ([] if issue is None else [issue])
