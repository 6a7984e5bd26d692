"""Lines to sections, whatever the editor did."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.eds import codes, eds, parse, section

from canopen_control.errors import EdsError
from canopen_control.od import eds_sections
from canopen_control.od.eds_sections import clip, decode_text, optional_number, read_number, split_sections
from canopen_control.od.issues import Report, Severity
from canopen_control.od.model import Commissioning, DataType, DeviceInfo


def only(file):
    (entry,) = file.od
    return entry


def test_everything_a_section_reports_is_in_the_entry():
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


@pytest.mark.parametrize(
    ("limits", "code"),
    [
        ({"LowLimit": "10", "HighLimit": "5"}, ["limit-order"]),
        ({"LowLimit": "x"}, ["limit-form"]),
        ({"HighLimit": "0x1FFFFFFFF"}, ["limit-form"]),
        ({"LowLimit": "", "HighLimit": ""}, []),
    ],
)
def test_limits_that_report_nothing_are_none_and_keep_their_text(limits, code):
    file = parse(eds(**limits))
    assert (only(file).low, only(file).high) == (None, None)
    assert codes(file) == code
    assert {key: only(file).texts[key] for key in limits} == limits


@pytest.mark.parametrize(
    ("data_type", "low", "high", "numbers"),
    [(2, "0x00", "0xFF", " (0 > -1 as INTEGER8)"), (4, "10", "5", "")],  # the first as in Faulhaber's EDS
)
def test_limits_in_the_wrong_order_are_reported_as_numbers(data_type, low, high, numbers):
    file = parse(eds(data_type=data_type, LowLimit=low, HighLimit=high))
    (issue,) = [issue for issue in file.issues if issue.code == "limit-order"]
    assert issue.text == f"LowLimit={low} is above HighLimit={high}{numbers}; both are ignored"


@pytest.mark.parametrize("data_type", [None, "", "0x40", "text"])
def test_an_unknown_type_is_bytes_and_the_value_stays_as_text(data_type):
    file = parse(eds(data_type=data_type, DefaultValue="5"))
    entry = only(file)
    assert (entry.data_type, entry.default, entry.texts["DefaultValue"]) == (DataType.DOMAIN, None, "5")
    (issue,) = [issue for issue in file.issues if issue.code in ("data-type", "key-number")]
    assert issue.code == "data-type"
    assert "its values are kept as text" in issue.text


@pytest.mark.parametrize("text", ["INTEGER16", "integer16 ; signed"])
def test_the_name_of_a_type_is_read_as_its_number(text):
    file = parse(eds(data_type=text, DefaultValue="-5"))
    assert (only(file).data_type, only(file).default) == (DataType.INTEGER16, -5)
    (issue,) = [issue for issue in file.issues if issue.code == "data-type"]
    assert issue.text.endswith("is a name; treated as 0x0003, its number")


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
        ("Read-Only", "ro", ["access-type"]),
        ("read only", "ro", ["access-type"]),
        ("constant", "const", ["access-type"]),
        ("ro ; as the others", "ro", []),
        ("const # as the others", "const", ["number-comment"]),
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


@pytest.mark.parametrize(
    ("text", "mappable", "code"),
    [("1", True, []), ("0x0", False, []), ("TRUE", True, ["number-word"]), ("", False, ["key-number"])],
)
def test_mappability(text, mappable, code):
    file = parse(eds(PDOMapping=text))
    assert only(file).pdo_mappable is mappable
    assert codes(file) == code


INFO = section(
    "DeviceInfo",
    VendorName="V",
    VendorNumber="0x286",
    ProductName="P",
    ProductNumber="1270",
    RevisionNumber="0x3001A",
    OrderCode="O",
    BaudRate_125=1,
    BaudRate_500="0x1",
    BaudRate_1000=0,
    SimpleBootUpMaster=0,
    SimpleBootUpSlave=1,
    Granularity=0,
    DynamicChannelsSupported=2,
    GroupMessaging=1,
    NrOfRXPDO=4,
    NrOfTXPDO="0x3",
    LSS_Supported=1,
    CompactPDO=0,
)


def test_device_info_field_by_field():
    assert parse(INFO, eds()).od.device == DeviceInfo(
        vendor_name="V",
        vendor_number=0x286,
        product_name="P",
        product_number=1270,
        revision_number=0x3001A,
        order_code="O",
        bit_rates=frozenset((125_000, 500_000)),
        simple_boot_up_slave=True,
        granularity=0,
        dynamic_channels=2,
        group_messaging=True,
        rpdo_count=4,
        tpdo_count=3,
        lss_supported=True,
    )


def test_without_device_info_there_is_a_warning_and_nothing_is_made_up():
    file = parse(eds())
    assert file.od.device == DeviceInfo()
    assert [issue.line for issue in file.issues if issue.code == "device-info"] == [1]


def test_dummies_are_those_that_are_allowed():
    text = section("DummyUsage", Dummy0001=0, Dummy0005=1, Dummy0007="0x1", Dummy0006="")
    file = parse(text, eds())
    assert file.od.dummy_usage == {5, 7}
    assert codes(file) == ["key-number"]


@pytest.mark.parametrize("title", ["DeviceComissioning", "DeviceCommissioning", "DEVICECOMISSIONING"])
def test_both_spellings_of_commissioning(title):
    text = section(
        title,
        NodeID="0x0A",
        NodeName="left",
        BaudRate=500,
        NetNumber=2,
        NetworkName="net",
        CANopenManager=1,
        LSS_SerialNumber=77,
    )
    od = parse(text, eds(DefaultValue="$NODEID+0x600")).od
    assert (od.node_id, od.bitrate) == (10, 500_000)
    assert od.commissioning == Commissioning("left", 2, "net", True, 77)
    assert od[0x2000, 0].default == 0x60A


@pytest.mark.parametrize(
    ("keys", "node_id", "bitrate", "code"),
    [
        ({"NodeID": 0, "Baudrate": 0}, None, None, ["commissioning"]),
        ({"NodeID": 128}, None, None, ["commissioning"]),
        ({"NodeID": "x", "Baudrate": "y"}, None, None, ["key-number", "key-number"]),
        ({"NodeID": 1, "Baudrate": 250000}, 1, 250_000, ["commissioning"]),
        ({}, None, None, []),
    ],
)
def test_commissioning_that_cannot_be(keys, node_id, bitrate, code):
    file = parse(section("DeviceComissioning", **keys), eds())
    assert (file.od.node_id, file.od.bitrate) == (node_id, bitrate)
    assert codes(file) == code


@pytest.mark.parametrize(
    ("text", "code"),
    [
        (section("ManufacturerObjects", **{"SupportedObjects": 1, "1": "0x2000"}), []),
        (section("ManufacturerObjects", **{"SupportedObjects": "0x1", "1": "8192"}), []),
        (section("ManufacturerObjects", **{"SupportedObjects": 3, "1": "0x2000"}), ["list-count"]),
        (section("ManufacturerObjects", **{"1": "0x2000"}), ["list-count"]),
        (section("ManufacturerObjects", **{"SupportedObjects": 2, "1": "0x2000", "2": "0x2001"}), ["list-object"]),
        (section("ManufacturerObjects", **{"SupportedObjects": 2, "1": "0x2000", "2": "0x2000"}), ["list-object"]),
        (section("ManufacturerObjects", **{"SupportedObjects": 2, "1": "0x2000", "2": "what"}), ["list-object"]),
        (section("ManufacturerObjects", SupportedObjects=0), ["list-absent"]),
    ],
)
def test_lists_are_compared_with_the_objects(text, code):
    assert codes(parse(text, eds())) == code


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


def test_every_byte_string_is_some_text():
    assert decode_text(b"[\x81\xff]") == ("[\x81ÿ]", "latin-1")
    assert decode_text(b"\xff\xfea")[1] == "utf-16"


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_line_ends_of_all_systems_count_the_same_lines(end):
    sections, issues = split(end.join(["[A]", "x=1", "", "[B]", "y=2"]))
    assert sections["b"].line_of("y") == 5
    assert issues == []


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


def test_lines_that_report_nothing_are_reported():
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
        ("$ EtherNet/IP EDS\nx\n", "ODVA"),
        ("../../common/Elmo.dcf", "symbolic link"),
        ("version https://git-lfs.github.com/spec/v1\noid x\n", "Git LFS pointer"),
        ("some\nother\ntext\n", "no sections"),
    ],
)
def test_what_is_not_an_eds_is_refused_with_what_it_is(text, reason):
    with pytest.raises(EdsError, match=reason) as caught:
        split(text)
    assert (caught.value.path, caught.value.line) == ("a.eds", 1)


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
    assert report.issues[0].text == "empty is empty; treated as 8"


def test_messages_quote_no_more_than_fits():
    assert clip("short") == "short"
    assert len(clip("x" * 1000)) == 60


@pytest.mark.parametrize(
    "body",
    ["x=1\ny=2\n\n", "x=1\n; x=3\n\ny=2", "  x =1\n\n\t y =\t2 \n", "no equals\nx=1\n\ny=2\n", "X=1\n # a\ny=2\ny=2"],
)
def test_keys_have_their_lines_for_every_way_of_reading(body):
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
    def collected(result):
        sections, issues = result
        return [
            (item.name, item.title, item.line, item.values, item.written, list(map(item.line_of, item.values)))
            for item in sections.values()
        ], issues

    at_once = collected(split(text))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(eds_sections._Splitter, "_read_plain", lambda *_: False)
        assert collected(split(text)) == at_once
