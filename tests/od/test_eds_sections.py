"""Lines to sections, whatever the editor did."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.errors import EdsError
from canopen_control.od import eds_sections
from canopen_control.od.eds_sections import clip, decode_text, optional_number, read_number, split_sections
from canopen_control.od.issues import Report, Severity


def split(text):
    report = Report("a.eds")
    return split_sections(text, report), report.issues


@pytest.mark.parametrize(
    ("encoding", "name"),
    [
        ("utf-8", "utf-8-sig"),
        ("utf-8-sig", "utf-8-sig"),
        ("utf-16", "utf-16"),
        ("utf-16-le", "utf-16"),
        ("cp1252", "cp1252"),
    ],
)
def test_every_usual_encoding_is_read(encoding, name):
    text = "[1000]\nParameterName=Höhe – m²\n"
    assert decode_text(text.encode(encoding)) == (text, name)


def test_utf_16_of_the_other_byte_order_is_read():
    assert decode_text(b"\xfe\xff" + "[a]".encode("utf-16-be"))[0] == "[a]"


def test_every_byte_string_is_some_text():
    assert decode_text(b"[\x81\xff]") == ("[\x81ÿ]", "latin-1")
    assert decode_text(b"\xff\xfea")[1] == "utf-16"


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_line_ends_of_all_systems_count_the_same_lines(end):
    sections, issues = split(end.join(["[A]", "x=1", "", "[B]", "y=2"]))
    assert sections["b"].line_of("y") == 5
    assert issues == []


def test_mixed_line_ends_count_too():
    sections, _ = split("[A]\r\nx=1\r[B]\ny=2")
    assert sections["b"].line_of("y") == 4


def test_end_of_file_character_and_padding_are_blanks():
    sections, issues = split("\ufeff[A]\nx=1\n\x1a\n\0\0")
    assert sections["a"].get("x") == "1"
    assert issues == []


def test_names_have_no_case_and_keep_their_spelling():
    sections, _ = split("[ DeviceInfo ] ; comment\n VendorName = a=b ; c \n")
    assert sections["deviceinfo"].title == "DeviceInfo"
    assert sections["deviceinfo"].get("vendorname") == "a=b ; c"
    assert sections["deviceinfo"].texts() == {"VendorName": "a=b ; c"}
    assert sections["deviceinfo"].get("nothing") == ""
    assert sections["deviceinfo"].pair("nothing") is None
    assert sections["deviceinfo"].line_of("nothing") == 1


def test_the_first_of_two_sections_counts():
    sections, issues = split("[A]\nx=1\n[a]\nx=2\n")
    assert sections["a"].get("x") == "1"
    assert [(issue.line, issue.code, issue.severity) for issue in issues] == [(3, "section-repeated", Severity.WARNING)]


def test_the_first_of_two_keys_counts_and_the_lost_value_is_named():
    sections, issues = split("[A]\nx=1\nX=2\nx=1\n")
    assert sections["a"].get("x") == "1"
    assert [issue.line for issue in issues] == [3, 4]
    assert "'2', which is ignored" in issues[0].text
    assert "same value" in issues[1].text


def test_lines_that_say_nothing_are_reported():
    _, issues = split("before=1\n[A]\nno equals\n; comment\n# comment\n[B\n[C] rest\n")
    assert [(issue.line, issue.code) for issue in issues] == [
        (1, "stray-line"),
        (3, "stray-line"),
        (6, "section-form"),
        (7, "section-form"),
    ]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "is empty"),
        ("\n \n", "is empty"),
        ("<?xml version='1.0'?>\n", "XDD"),
        ("$ EtherNet/IP EDS\nx\n", "ODVA"),
        ("../../common/Elmo.dcf", "symbolic link"),
        ("version https://git-lfs.github.com/spec/v1\noid x\n", "git-lfs"),
        ("some\nother\ntext\n", "no sections"),
    ],
)
def test_what_is_no_eds_is_refused_with_what_it_is(text, reason):
    with pytest.raises(EdsError, match=reason) as caught:
        split(text)
    assert (caught.value.path, caught.value.line) == ("a.eds", 1)


def test_only_numbered_keys_are_entries_of_a_list():
    sections, _ = split("[A]\nSupportedObjects=2\n1=0x1000\n2=0x1001\n²=x\n")
    assert [pair.value for pair in sections["a"].numbered()] == ["0x1000", "0x1001"]


def test_numbers_that_cannot_be_read_are_replaced_and_reported():
    sections, _ = split("[A]\ngood=0x10\nempty=\nbad=ten\nodd=5L\n")
    report = Report("a.eds")
    section = sections["a"]
    assert read_number(section, "good", 1, report) == 16
    assert read_number(section, "missing", 1, report) == 1
    assert optional_number(section, "missing", report) is None
    assert report.issues == []
    assert read_number(section, "empty", 8, report) == 8
    assert optional_number(section, "bad", report) is None
    assert read_number(section, "odd", 1, report) == 5
    assert [(issue.line, issue.code) for issue in report.issues] == [
        (3, "key-number"),
        (4, "key-number"),
        (5, "number-suffix"),
    ]
    assert report.issues[0].text == "empty is empty; taken as 8"


def test_messages_quote_no_more_than_fits():
    assert clip("short") == "short"
    assert len(clip("x" * 1000)) == 60


@pytest.mark.parametrize(
    "body",
    [
        "x=1\ny=2\n\n",
        "x=1\n; x=3\n\ny=2",
        "  x =1\n\n\t y =\t2 \n",
        "no equals\nx=1\n\ny=2\n",
        "X=1\n # a\ny=2\ny=2",
    ],
)
def test_keys_know_their_lines_however_a_section_was_read(body):
    sections, _ = split(f"\n[A]\n{body}\n[B]\nz=3")
    lines = [line.strip().lower() for line in body.split("\n")]
    at = {key: next(n for n, line in enumerate(lines, 3) if line.startswith(key)) for key in "xy"}
    assert {key: sections["a"].line_of(key) for key in "xy"} == at
    assert sections["a"].values == {"x": "1", "y": "2"}
    assert sections["b"].line == body.count("\n") + 4
    assert sections["b"].pair("z") == ("z", "3", body.count("\n") + 5)


_PARTS = (
    "x",
    "Y",
    "y",
    "=",
    "=",
    "1",
    "0x2",
    ";",
    "#",
    "[",
    "]",
    "\n",
    "\n",
    "\r\n",
    " ",
    "\t",
    "\xa0",
    "\n[a]\n",
    "\n [b]\n",
)


@given(st.lists(st.sampled_from(_PARTS), max_size=30).map(lambda parts: f"[A]\n{''.join(parts)}"))
def test_a_section_of_plain_lines_is_what_it_is_line_by_line(text):
    def told(found):
        sections, issues = found
        return [
            (each.name, each.title, each.line, each.values, each.written, list(map(each.line_of, each.values)))
            for each in sections.values()
        ], issues

    at_once = told(split(text))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(eds_sections._Splitter, "_read_plain", lambda *_: False)
        assert told(split(text)) == at_once
