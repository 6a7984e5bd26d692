"""Written files read back with the same content."""

import json
from pathlib import Path

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from support.eds import DEVIATIONS, MALFORMED, codes, eds, mutated, parse, section

from canopen_control.data_files import data_path
from canopen_control.errors import EdsError
from canopen_control.od.dcf import concise_of, configured, dcf_text, decode_concise, eds_text, encode_concise, write_dcf
from canopen_control.od.eds import parse_eds, read_eds
from canopen_control.od.model import Commissioning, DataType, Entry, ObjectDictionary

VECTORS = json.loads((Path(__file__).parents[1] / "data" / "concise_dcf.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", ["small", "robby_left_drive_node3"])
def test_known_files_byte_by_byte(name):
    vector = VECTORS[name]
    entries = [(int(index, 16), subindex, bytes.fromhex(data)) for index, subindex, data in vector["entries"]]
    data = encode_concise(entries)
    assert data.hex().upper() == vector["hex"]
    assert len(data) == vector["length"]
    assert decode_concise(data) == entries


def test_the_master_s_own_file():
    data = bytes.fromhex(VECTORS["robby_master_bin"]["hex"])
    entries = decode_concise(data)
    assert [(hex(index), subindex, value.hex()) for index, subindex, value in entries] == [
        ("0x1f87", 3, "1a000300"),
        ("0x1f87", 2, "1a000300"),
    ]
    assert encode_concise(entries) == data


DOWNLOADS = st.lists(st.tuples(st.integers(0, 0xFFFF), st.integers(0, 0xFF), st.binary(max_size=20)), max_size=10)


@given(DOWNLOADS)
def test_any_downloads_return(entries):
    assert decode_concise(encode_concise(entries)) == entries


@given(DOWNLOADS, st.data())
def test_a_file_cut_short_or_too_long_is_refused(entries, data):
    whole = encode_concise(entries)
    for broken in (whole[: data.draw(st.integers(0, len(whole) - 1))], whole + b"\0"):
        with pytest.raises(ValueError, match=r"concise DCF|bytes"):
            decode_concise(broken)


@given(st.binary(max_size=60))
def test_any_bytes_are_downloads_or_a_value_error(data):
    try:
        entries = decode_concise(data)
    except ValueError:
        return
    assert encode_concise(entries) == data


@pytest.mark.parametrize(("index", "subindex"), [(0x10000, 0), (-1, 0), (0, 256)])
def test_addresses_that_cannot_be_are_refused(index, subindex):
    with pytest.raises(ValueError, match="not an address"):
        encode_concise([(index, subindex, b"")])


def test_the_parameter_values_of_a_dcf_are_its_downloads():
    od = parse(
        eds("2001", data_type=6, ParameterValue="0x1234"),
        eds("2000", data_type=2, ParameterValue="-3"),
        eds("2002", access="ro", ParameterValue="1"),
        eds("2003", ObjFlags=1, ParameterValue="1"),
        eds("2004", DefaultValue="1"),
    ).od
    assert concise_of(od) == [(0x2000, 0, b"\xfd"), (0x2001, 0, b"\x34\x12")]
    assert concise_of(configured(od, {(0x2004, 0): 0}))[-1] == (0x2004, 0, bytes(4))


REPORTS = Path(__file__).parents[1] / "data" / "reports"
SHIPPED = [data_path("eds", name) for name in ("TMCM-1270.eds", "generic_cia402.eds")]
FILES = [*SHIPPED, *sorted(MALFORMED.glob("*.eds")), *sorted(DEVIATIONS.glob("*.eds"))]


def read_or_skip(path):
    try:
        return read_eds(path)
    except EdsError:
        return None


LOADED = {path.name: file for path in FILES if (file := read_or_skip(path)) is not None}


def expect_same(a, b):
    """Compare everything that a dictionary holds but the texts of what is written anew."""
    for field in ("node_id", "bitrate", "device", "dummy_usage", "commissioning", "comments", "entries", "objects"):
        assert getattr(a, field) == getattr(b, field), field


@pytest.mark.parametrize("name", LOADED)
def test_writing_twice_changes_nothing(name):
    text = eds_text(LOADED[name].od)
    assert eds_text(parse_eds(text.encode()).od) == text


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.name)
def test_the_bundled_files_are_as_the_writer_writes_them(path):
    assert eds_text(read_eds(path).od) == path.read_text(encoding="utf-8")


def test_what_was_not_understood_is_written_as_it_was():
    od = parse(eds(DefaultValue="$MY_ID+1", LowLimit="9", HighLimit="1", Unit="mm"), section("Tools", Items=1)).od
    text = eds_text(od)
    for line in ("DefaultValue=$MY_ID+1", "LowLimit=9", "HighLimit=1", "Unit=mm", "[Tools]", "Items=1"):
        assert line in text.splitlines()


def test_what_was_changed_is_written_again():
    od = parse(eds(DefaultValue="0x5", access="RW", Unit="mm")).od
    od.add(Entry(0x2000, 0, "Thing", DataType.UNSIGNED32, "ro", default=6, texts=od[0x2000, 0].texts))
    lines = eds_text(od).splitlines()
    assert "DefaultValue=0x00000006" in lines
    assert "AccessType=ro" in lines
    assert "Unit=mm" in lines
    assert "DefaultValue=0x5" not in lines


def test_compact_objects_are_written_out():
    head = section(
        "2000", ParameterName="T", ObjectType=8, DataType=7, AccessType="rw", CompactSubObj=2, DefaultValue=4
    )
    od = parse(head, section("2000Name", **{"1": "first"}), section("2000Value", **{"2": "$NODEID+9"}), node_id=3).od
    text = eds_text(od)
    assert "CompactSubObj" not in text
    assert "[2000Name]" not in text
    again = parse_eds(text.encode(), 3)
    assert again.od.entries == od.entries
    assert "compact-unused" not in codes(again)


def test_a_var_with_compact_entries_is_read_and_written_as_the_array_that_it_is():
    head = section("2000", ParameterName="T", ObjectType="0x7", DataType=7, AccessType="rw", CompactSubObj=2)
    file = parse(head)
    assert codes(file) == ["object-type"]
    lines = eds_text(file.od).splitlines()
    assert "ObjectType=0x8" in lines[lines.index("[2000]") : lines.index("[2000sub0]")]
    again = parse_eds(eds_text(file.od).encode())
    assert again.od.objects == file.od.objects
    assert codes(again) == []


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("lines=0", "Lines=0"),
        ("lines=1\nline1=a", "Lines=1\nLine1=a"),
        ("Line1=a\nLine2=b", "Lines=2\nLine1=a\nLine2=b"),
        ("LINES=7\nLine1=a\nOwn=x", "Lines=1\nLine1=a\nOwn=x"),
    ],
)
def test_comments_are_written_with_the_keys_and_the_count_of_the_standard(before, after):
    assert f"[Comments]\n{after}\n" in eds_text(parse(f"[comments]\n{before}\n", eds("2000")).od)


def test_a_type_of_the_files_own_is_written_as_its_basic_type_with_its_limits():
    own = read_eds(REPORTS / "eds_reported_quirks" / "quirks.eds").od
    entry = own[0x2000, 0]
    assert (entry.data_type, entry.default, entry.low, entry.high) == (DataType.UNSIGNED8, 5, 0, 10)
    again = parse_eds(eds_text(own).encode()).od
    assert again[0x2000, 0] == entry


def test_objects_are_listed_where_they_belong():
    od = parse(eds("1000"), eds("2000"), eds("6040")).od
    sections = parse_eds(eds_text(od).encode())
    assert "list-absent" not in codes(sections)
    assert "list-count" not in codes(sections)
    assert "[MandatoryObjects]\nSupportedObjects=1\n1=0x1000\n" in eds_text(od)
    assert "[ManufacturerObjects]\nSupportedObjects=1\n1=0x2000\n" in eds_text(od)


def test_a_dcf_has_the_node_and_its_values():
    od = read_eds(SHIPPED[0]).od
    values = {(0x6083, 0): 16000, (0x60C2, 2): -3, (0x1017, 0): 1000}
    file = parse_eds(dcf_text(od, 3, 500_000, values, node_name="left").encode())
    assert (file.od.node_id, file.od.bitrate) == (3, 500_000)
    assert file.od.commissioning == Commissioning("left", None, "", False, None)
    assert {entry.address: entry.parameter_value for entry in file.od if entry.parameter_value is not None} == values
    assert file.od[0x1400, 1].default == 0x40000203
    assert file.issues == []
    assert od[0x6083, 0].parameter_value is None


def test_unknown_values_of_the_commissioning_have_no_line():
    text = dcf_text(parse(eds()).od, 3, None)
    assert "NodeID=3" in text
    assert not any(key in text for key in ("Baudrate=", "NetNumber=", "LSS_SerialNumber="))
    again = parse_eds(text.encode()).od
    assert (again.bitrate, again.commissioning) == (None, Commissioning())


def test_a_dcf_of_a_dcf_keeps_what_it_does_not_change():
    extra = section("DeviceComissioning", NodeID=9, Baudrate=125, NodeName="old", NetNumber=4, Vendor="x")
    od = parse(extra, eds(ParameterValue=5), eds("2001", ParameterValue="$NODEID+1")).od
    assert parse_eds(eds_text(od).encode()).od.node_id == 9
    again = parse_eds(dcf_text(od, 10, 250_000, {(0x2000, 0): 6}).encode()).od
    assert (again.node_id, again.bitrate, again.commissioning.node_name) == (10, 250_000, "old")
    assert again.commissioning.network_number == 4
    assert (again[0x2000, 0].parameter_value, again[0x2001, 0].parameter_value) == (6, 11)
    assert "Vendor=x" in dcf_text(od, 10, 250_000)


def test_values_that_follow_the_node_id_serve_another_one():
    od = read_eds(SHIPPED[0]).od
    text = dcf_text(od, 3, 500_000, {(0x1800, 1): 0x40000183, (0x1801, 1): 0x283}, relative={(0x1800, 1)})
    assert "ParameterValue=$NODEID+0x40000180" in text
    other = parse_eds(text.encode(), 9).od
    assert (other[0x1800, 1].parameter_value, other[0x1801, 1].parameter_value) == (0x40000189, 0x283)


def test_values_that_do_not_fit_are_refused():
    od = parse(eds(data_type=5)).od
    with pytest.raises(ValueError, match="0x2001:00 is not in the object dictionary"):
        configured(od, {(0x2001, 0): 1})
    with pytest.raises(ValueError, match="256 is not a valid UNSIGNED8"):
        dcf_text(od, 3, 500_000, {(0x2000, 0): 256})


def test_files_are_written_in_utf_8(tmp_path):
    od = parse(eds(name="Höhe")).od
    write_dcf(tmp_path / "a.dcf", od, 5, 1_000_000, {(0x2000, 0): 1})
    written = read_eds(tmp_path / "a.dcf").od[0x2000, 0]
    assert (written.name, written.value) == ("Höhe", 1)


TEXT = st.text(st.characters(exclude_categories=["Cc", "Cs", "Zl", "Zp"]), min_size=1).map(str.strip).filter(bool)


@st.composite
def dictionaries(draw):
    od = ObjectDictionary()
    for index in draw(st.lists(st.integers(0x2000, 0x2003), min_size=1, unique=True)):
        for subindex in draw(st.lists(st.integers(0, 5), min_size=1, unique=True)):
            data_type = draw(st.sampled_from([t for t in DataType if t.is_integer]))
            whole = st.none() | st.integers(data_type.minimum, data_type.maximum)
            name = draw(TEXT)
            access = draw(st.sampled_from(("ro", "wo", "rw", "rwr", "rww", "const")))
            values = draw(st.tuples(whole, whole))
            od.add(
                Entry(
                    index, subindex, name, data_type, access, draw(st.booleans()), values[0], parameter_value=values[1]
                )
            )
    return od


@pytest.mark.rest
@given(dictionaries())
def test_any_dictionary_returns(od):
    assert parse_eds(eds_text(od).encode()).od.entries == od.entries


@pytest.mark.rest
@given(mutated(), st.none() | st.integers(1, 127))
def test_whatever_was_read_returns(data, node_id):
    try:
        od = parse_eds(data, node_id).od
    except EdsError:
        return
    assume(all(value == value for entry in od for value in (entry.default, entry.low)))  # not a number
    expect_same(od, parse_eds(eds_text(od).encode(), node_id).od)
