import csv
import io

from support.tracing import frame, robby_decoder

from canopen_control.trace.frame_lines import COLUMNS, write_long, write_wide

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
