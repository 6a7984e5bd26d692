import json

import pytest

from canopen_control.bus.recordings import RecordingWriter
from canopen_control.cli.main import main
from canopen_control.frame import CanFrame

FRAMES = [
    CanFrame(0x000, b"\x01\x00"),
    CanFrame(0x080),
    CanFrame(0x183, b"\x37\x06\x03"),
    CanFrame(0x080),
    CanFrame(0x183, b"\x37\x06\x03"),
    CanFrame(0x603, bytes.fromhex("4018100500000000")),
    CanFrame(0x583, bytes.fromhex("8018100511000906")),
]


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "run.log"
    with RecordingWriter(path, "local:robby") as writer:
        for number, frame in enumerate(FRAMES):
            writer.write(1_763_700_000_000_000_000 + number * 10_000_000, frame)
    return str(path)


def test_a_recording_is_reported_by_name(log, capsys):
    assert main(["trace", "robby", "--file", log]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(FRAMES)
    assert lines[0].split() == ["0.000000", "000", "01", "00", "NMT", "START,", "all", "nodes"]
    assert lines[2].endswith("Statusword 0x0637 OPERATION ENABLED, target reached; Modes of operation display 3 PV")
    assert lines[6].endswith("0x06090011 subindex does not exist")
    assert "\x1b" not in "".join(lines)


def test_filters_and_count_choose_the_lines(log, capsys):
    def shown(*options):
        assert main(["trace", "robby", "--file", log, *options]) == 0
        return [line.split()[1] for line in capsys.readouterr().out.splitlines()]

    assert shown("--service", "sdo,nmt") == ["000", "603", "583"]
    assert shown("--node", "left_drive", "--count", "2") == ["183", "183"]
    assert shown("--changes") == ["000", "080", "183", "603", "583"]
    assert shown("--id", "183", "--id", "0x000") == ["000", "183", "183"]


def test_a_recording_of_which_no_frame_is_selected_is_exit_code_1(log, capsys):
    assert main(["trace", "robby", "--file", log, "--node", "right_drive"]) == 1
    assert capsys.readouterr() == ("", "canopen-control: none of 7 frames is selected by the options\n")


def test_json_is_one_object_for_each_frame(log, capsys):
    assert main(["trace", "robby", "--file", log, "--json"]) == 0
    objects = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [item["id"] for item in objects] == ["000", "080", "183", "080", "183", "603", "583"]
    assert objects[2]["values"][0]["value"] == 0x637
    assert objects[2]["time"] == 1_763_700_000.02
    assert objects[6]["mark"] == "error"


def test_without_names_the_predefined_connection_set_is_shown(log, capsys):
    assert main(["trace", "--file", log, "--id", "183", "--count", "1"]) == 0
    out, err = capsys.readouterr()
    assert "node 3    TPDO1         mapping unknown" in out
    assert "object names are unknown: give ROBOT, --name or --eds" in err


def test_a_file_that_breaks_off_is_shown_and_reported(tmp_path, capsys):
    path = tmp_path / "x.log"
    path.write_text("(1.000000) can0 080#\nrubbish\n")
    assert main(["trace", "robby", "--file", str(path)]) == 0
    out, err = capsys.readouterr()
    assert "SYNC" in out
    assert "1 line is not a frame of classic CAN, left out" in err
    path.write_text("")
    assert main(["trace", "robby", "--file", str(path)]) == 2
    assert "contains no frames" in capsys.readouterr().err
