import io
import shutil
import subprocess

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.bus.recordings import interface_name, line_of, parse_line, read_lines
from canopen_control.frame import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, CanFrame

frames = st.one_of(
    st.builds(CanFrame, st.integers(0, 0x7FF), st.binary(max_size=8)),
    st.builds(CanFrame, st.integers(0, 0x1FFFFFFF).map(lambda i: i | EXTENDED_FLAG), st.binary(max_size=8)),
    st.builds(CanFrame, st.integers(0, 0x7FF).map(lambda i: i | REMOTE_FLAG), st.integers(0, 8).map(bytes)),
    st.builds(CanFrame, st.integers(0, 0x3FF).map(lambda i: i | ERROR_FLAG), st.binary(min_size=8, max_size=8)),
)


@given(st.integers(0, 4_000_000_000_000_000), frames)
def test_a_line_reads_back_as_it_was_written(microseconds, frame):
    line = line_of(microseconds * 1000, "can0", frame)
    assert parse_line(line.strip()) == (microseconds * 1000, frame)


@given(st.text(max_size=60))
def test_no_text_is_an_error(text):
    found = parse_line(text)
    assert found is None or isinstance(found[1], CanFrame)


@pytest.mark.parametrize(
    ("line", "frame"),
    [
        ("(1700000000.123456) vcan0 183#3706", CanFrame(0x183, b"\x37\x06")),
        ("(1700000000.123456) vcan0 183#37.06 R", CanFrame(0x183, b"\x37\x06")),
        ("(1700000000.123456) vcan0 703#R", CanFrame(REMOTE_FLAG | 0x703)),
        ("(1700000000.123456) vcan0 00000183#", CanFrame(EXTENDED_FLAG | 0x183)),
    ],
)
def test_lines_of_candump_are_read(line, frame):
    assert parse_line(line) == (1_700_000_000_123_456_000, frame)


@pytest.mark.parametrize(
    ("line", "time_ns", "frame"),
    [
        ("(1700000000.000000) can0 181#0102030405060708_9", 1_700_000_000 * 10**9, CanFrame(0x181, bytes(range(1, 9)))),
        ("(1700000000.000000) can0 181#0102030405060708_F", 1_700_000_000 * 10**9, CanFrame(0x181, bytes(range(1, 9)))),
        ("(1700000000.000000) can0 703#R8_D", 1_700_000_000 * 10**9, CanFrame(0x703 | REMOTE_FLAG, bytes(8))),
        ("(-5.250000) can0 181#01", -5_250_000_000, CanFrame(0x181, b"\1")),
        ("(-0.500000) can0 181#01", -500_000_000, CanFrame(0x181, b"\1")),
    ],
)
def test_a_raw_dlc_and_a_time_before_1970_are_read(line, time_ns, frame):
    assert parse_line(line) == (time_ns, frame)


@pytest.mark.parametrize("time_ns", [-1000, -500_000_000, -5_250_000_000, 0])
def test_a_time_before_1970_reads_back(time_ns):
    assert parse_line(line_of(time_ns, "can0", CanFrame(0x80)).strip()) == (time_ns, CanFrame(0x80))


def test_a_line_without_an_end_is_no_frame_and_costs_no_memory():
    file = io.StringIO("x" * 100_000 + "\n(0000000001.000000) can0 080#\n")
    found = list(read_lines(file))
    assert found[-1] == (10**9, CanFrame(0x80))
    assert set(found[:-1]) == {None}


def test_what_is_no_classic_frame_is_none():
    text = "(1.0) can0 123##01122\n\nhello\n(1.000000) can0 123#11\n"
    assert list(read_lines(io.StringIO(text))) == [None, None, (10**9, CanFrame(0x123, b"\x11"))]


def test_a_channel_becomes_a_name_that_other_programs_take():
    assert [interface_name(name) for name in ("can0", "local:robby", "", "pcan:PCAN_USBBUS1@500000")] == [
        "can0",
        "local_robby",
        "can0",
        "pcan_PCAN_USBBU",
    ]


@pytest.mark.process
def test_can_utils_reads_our_lines(tmp_path):
    if shutil.which("log2asc") is None:
        pytest.skip("can-utils is not installed")
    log = tmp_path / "x.log"
    log.write_text(line_of(10**18, "can0", CanFrame(0x183, b"\x37\x06")) + line_of(10**18, "can0", CanFrame(0x80)))
    out = subprocess.run(["log2asc", "-I", log, "can0"], capture_output=True, text=True, check=True).stdout
    assert "183" in out
    assert "37 06" in out
