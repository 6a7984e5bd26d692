import csv
import io

from support.tracing import frame, robby_decoder, robby_network

from canopen_control.frame import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG
from canopen_control.rpc.wire import plain
from canopen_control.trace.frame_lines import COLUMNS, LineWriter, document_of, identifier_text, write_long, write_wide

STREAM = [(0x183, "370603"), (0x703, "05"), (0x283, "FFFFFFFF40060000"), (0x603, "4018100500000000"), (0x7FF, "00")]


def frames():
    decoder = robby_decoder()
    return [decoder.decode(frame(*each), 10**18 + number * 1_500_000) for number, each in enumerate(STREAM)]


def rows(write, *how):
    out = io.StringIO()
    count = write(frames(), *how, out)
    table = list(csv.reader(io.StringIO(out.getvalue())))
    assert len(table) == count + 1
    return table


def test_every_value_and_every_frame_without_one_is_a_row():
    table = rows(write_long)
    assert table[0] == list(COLUMNS)
    assert table[1] == [
        *("1000000000.000000", "0x183", "left_drive", "pdo", "Statusword", "1591"),
        "0x0637 OPERATION ENABLED, target reached",
    ]
    assert [row[4:6] for row in table[2:]] == [
        ["Modes of operation display", "3"],
        ["heartbeat", "05"],
        ["Position actual value", "-1"],
        ["Velocity actual value", "1600"],
        ["SDO request", "4018100500000000"],
        ["", "00"],
    ]


def test_wide_is_a_row_for_each_pdo_and_a_column_for_each_signal():
    table = rows(write_wide, ["left_drive.Statusword", "left_drive.Velocity actual value", "right_drive.Statusword"])
    assert table == [
        ["time", "left_drive.Statusword", "left_drive.Velocity actual value", "right_drive.Statusword"],
        ["1000000000.000000", "1591", "", ""],
        ["1000000000.003000", "", "1600", ""],
    ]


def lines(*frames, **how):
    decoder, writer = robby_decoder(), LineWriter(robby_network(), **how)
    return [writer.line(decoder.decode(frame(*each), 10**18 + n * 1_500_000)) for n, each in enumerate(frames)]


def test_a_line_is_a_row_of_columns_with_the_seconds_since_the_first():
    assert lines((0x183, "370603"), (0x080,), (0x709, "05"), (REMOTE_FLAG | 0x183, "0000")) == [
        "    0.000000  183  37 06 03                 left_drive   TPDO1         Statusword 0x0637 OPERATION ENABLED, "
        "target reached; Modes of operation display 3 PV",
        "    0.001500  080                                        SYNC",
        "    0.003000  709  05                       node 9       heartbeat     OPERATIONAL",
        "    0.004500  183  remote, 2 bytes          left_drive   TPDO1         request for TPDO1",
    ]


def test_absolute_times_are_those_of_the_day():
    (line,) = lines((0x080,), absolute=True)
    assert line.startswith("2001-09-0")
    assert ".000000  080" in line


def test_colours_mark_only_values_that_need_attention():
    _, ordinary, fault = lines((0x183, "370603"), (0x183, "370603"), (0x083, "1186210000000000"), colour=True)
    assert "\x1b" not in ordinary
    assert fault.startswith("\x1b[31m")
    assert fault.endswith("\x1b[0m")


def test_identifiers_of_29_bits_and_error_classes_have_eight_digits():
    assert [identifier_text(item) for item in (0x80, EXTENDED_FLAG | 0x80, ERROR_FLAG | 4, REMOTE_FLAG | 0x703)] == [
        "080",
        "00000080",
        "00000004",
        "703",
    ]


def test_a_frame_is_a_document_for_scripts():
    decoder = robby_decoder()
    row = plain(document_of(decoder.decode(frame(0x183, "370603"), 1_500_000_000)))
    assert list(row) == ["time", "id", "extended", "remote", "data", "service", "subject", "node_id", "node", "text",
                          "mark", "values"]  # fmt: skip
    assert (row["time"], row["id"], row["data"], row["node"]) == (1.5, "183", "370603", "left_drive")
    assert row["values"][0] == {
        "index": 0x6041,
        "subindex": 0,
        "name": "Statusword",
        "value": 0x637,
        "text": "0x0637 OPERATION ENABLED, target reached",
    }
    assert document_of(decoder.decode(frame(0x080))).node is None
