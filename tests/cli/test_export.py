import csv
import io

from canopen_control.bus.recordings import RecordingWriter
from canopen_control.cli.main import main
from canopen_control.frame import CanFrame


def recording(tmp_path):
    path = tmp_path / "run.blf"
    with RecordingWriter(path) as writer:
        writer.write(1_763_700_000_000_000_000, CanFrame(0x080))
        writer.write(1_763_700_000_001_000_000, CanFrame(0x283, bytes.fromhex("FFFFFFFF40060000")))
    return str(path)


def test_a_robots_layout_goes_into_a_file_and_it_is_reported_what_is_in_it(tmp_path, capsys):
    path = tmp_path / "robby.dbc"
    assert main(["export", "dbc", "robby", "-o", str(path)]) == 0
    assert capsys.readouterr().out == f"{path}: 2 nodes, 8 PDOs\n"
    assert path.read_text().startswith('VERSION ""')
    assert main(["export", "dbc", "robby"]) == 0
    assert capsys.readouterr().out == path.read_text()


def test_a_recording_becomes_a_table(tmp_path, capsys):
    path = recording(tmp_path)
    assert main(["export", "csv", path, "robby"]) == 0
    table = list(csv.DictReader(io.StringIO(capsys.readouterr().out)))
    assert [(row["service"], row["signal"], row["value"]) for row in table] == [
        ("sync", "SYNC", ""),
        ("pdo", "Position actual value", "-1"),
        ("pdo", "Velocity actual value", "1600"),
    ]
    out = tmp_path / "wide.csv"
    assert main(["export", "csv", path, "robby", "--wide", "-o", str(out)]) == 0
    assert capsys.readouterr().out == f"{out}: 1 rows\n"
    (row,) = csv.DictReader(io.StringIO(out.read_text()))
    assert row["left_drive.Velocity actual value"] == "1600"
    assert row["right_drive.Velocity actual value"] == ""


def test_what_cannot_be_is_a_sentence(tmp_path, capsys):
    assert main(["export", "dbc"]) == 2
    assert "give the robot to export" in capsys.readouterr().err
    assert main(["export", "dbc", "robby", "-o", "/nowhere/x.dbc"]) == 2
    assert "/nowhere/x.dbc cannot be written: No such file or directory" in capsys.readouterr().err
    empty = tmp_path / "x.log"
    empty.write_text("")
    assert main(["export", "csv", str(empty), "robby"]) == 2
    assert "contains no frames" in capsys.readouterr().err
