"""The concise DCF, byte by byte."""

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.eds import eds, parse

from canopen_control.od.dcf import concise_of, configured, decode_concise, encode_concise

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


def test_no_download_is_a_count_of_zero():
    assert encode_concise([]).hex() == VECTORS["empty"]
    assert decode_concise(bytes(4)) == []


DOWNLOADS = st.lists(st.tuples(st.integers(0, 0xFFFF), st.integers(0, 0xFF), st.binary(max_size=20)), max_size=10)


@given(DOWNLOADS)
def test_any_downloads_come_back(entries):
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
    with pytest.raises(ValueError, match="no address"):
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
