"""Sections to entries, with what harms least where the file does not say it well."""

import pytest
from support.eds import codes, eds, parse, section

from canopen_control.od.issues import Severity
from canopen_control.od.model import DataType


def only(file):
    (entry,) = file.od
    return entry


def test_everything_a_section_says_is_in_the_entry():
    file = parse(
        eds(
            data_type="0x0004",
            access="RWW",
            DefaultValue="0x10",
            LowLimit="-5",
            HighLimit="0x7F",
            PDOMapping=1,
            ObjFlags="0x3",
            ParameterValue="17",
            Unit="mm",
        )
    )
    entry = only(file)
    assert entry.address == (0x2000, 0)
    assert (entry.name, entry.data_type, entry.access) == ("Thing", DataType.INTEGER32, "rww")
    assert (entry.default, entry.parameter_value, entry.low, entry.high) == (16, 17, -5, 127)
    assert (entry.pdo_mappable, entry.obj_flags, entry.line) == (True, 3, 1)
    assert entry.texts["Unit"] == "mm"
    assert codes(file, "list-missing") == []


@pytest.mark.parametrize(("key", "relative"), [("DefaultValue", "relative"), ("ParameterValue", "parameter_relative")])
def test_values_with_the_node_id_are_marked(key, relative):
    text = eds(**{key: "$NODEID+0x200"})
    assert only(parse(text, node_id=3)).value == 0x203
    assert only(parse(text)).value == 0x200
    assert getattr(only(parse(text)), relative)


def test_limits_may_have_the_node_id_too():
    entry = only(parse(eds(LowLimit="$NODEID+0x180", HighLimit="0xFFFFFFFF"), node_id=3))
    assert (entry.low, entry.low_relative, entry.high, entry.high_relative) == (0x183, True, 0xFFFFFFFF, False)


def test_limits_of_signed_types_are_two_s_complement():
    entry = only(parse(eds(data_type=3, LowLimit="0xFF00", HighLimit="0x00FF")))
    assert (entry.low, entry.high) == (-256, 255)


def test_limits_of_reals_are_reals():
    entry = only(parse(eds(data_type=8, LowLimit="-0.5", HighLimit="0x3F800000")))
    assert (entry.low, entry.high) == (-0.5, 1.0)


@pytest.mark.parametrize(
    ("limits", "code"),
    [
        ({"LowLimit": "10", "HighLimit": "5"}, ["limit-order"]),
        ({"LowLimit": "x"}, ["limit-form"]),
        ({"HighLimit": "0x1FFFFFFFF"}, ["limit-form"]),
        ({"LowLimit": "", "HighLimit": ""}, []),
    ],
)
def test_limits_that_say_nothing_are_none_and_keep_their_text(limits, code):
    file = parse(eds(**limits))
    assert (only(file).low, only(file).high) == (None, None)
    assert codes(file) == code
    assert {key: only(file).texts[key] for key in limits} == limits


def test_limits_of_strings_are_none():
    assert only(parse(eds(data_type=9, LowLimit="0", HighLimit="5"))).high is None


@pytest.mark.parametrize("data_type", [None, "", "0x40", "text"])
def test_an_unknown_type_is_bytes_and_the_value_stays_as_text(data_type):
    file = parse(eds(data_type=data_type, DefaultValue="5"))
    entry = only(file)
    assert (entry.data_type, entry.default, entry.texts["DefaultValue"]) == (DataType.DOMAIN, None, "5")
    issue = next(issue for issue in file.issues if issue.code == "data-type")
    assert "values kept as text" in issue.text


def test_a_domain_needs_no_type():
    file = parse(section("2000", ParameterName="File", ObjectType="0x2", AccessType="rw"))
    assert only(file).data_type is DataType.DOMAIN
    assert codes(file) == []


@pytest.mark.parametrize(
    ("access", "taken", "code"),
    [
        ("Const", "const", []),
        ("r/w", "rw", ["access-type"]),
        ("readonly", "ro", ["access-type"]),
        ("?", "rw", ["access-type"]),
        (None, "rw", ["access-type"]),
    ],
)
def test_access_in_any_spelling(access, taken, code):
    file = parse(eds(access=access))
    assert only(file).access == taken
    assert codes(file) == code


def test_a_value_that_cannot_be_is_an_error_at_its_line():
    file = parse(eds(data_type=5, DefaultValue="0x1FF"))
    (issue,) = [issue for issue in file.issues if issue.code == "value-form"]
    assert (issue.line, issue.severity) == (6, Severity.ERROR)
    assert (only(file).default, only(file).texts["DefaultValue"]) == (None, "0x1FF")


def test_an_empty_default_is_none_without_a_word():
    file = parse(eds(DefaultValue=""))
    assert only(file).default is None
    assert codes(file) == []


@pytest.mark.parametrize(
    ("text", "mappable", "code"),
    [("1", True, []), ("0x0", False, []), ("TRUE", True, ["number-word"]), ("", False, ["key-number"])],
)
def test_mappability(text, mappable, code):
    file = parse(eds(PDOMapping=text))
    assert only(file).pdo_mappable is mappable
    assert codes(file) == code
