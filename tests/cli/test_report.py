"""The verb `report`."""

import json

import pytest
from support.flightstory import record, saved
from support.mockrobot import running

from canopen_control.bus.recordings import RecordingWriter
from canopen_control.cli.main import main
from canopen_control.host.files import state_dir


@pytest.fixture
def flight():
    """Write a flight recording of robby where the recorder would."""
    return saved(record("clireport", seconds=3, power_off_after=1.0), state_dir("robby") / "flight")


def test_without_a_file_it_is_the_newest_flight_recording(flight, capsys):
    assert main(["report"]) == 0
    output = capsys.readouterr().out
    page = flight.with_suffix(".html")
    assert "left_drive" in "\n".join(output.splitlines()[:3])
    assert f"written: {page}" in output
    assert "left_drive" in page.read_text()


def test_the_recordings_are_listed(flight, capsys):
    assert main(["report", "--list"]) == 0
    output = capsys.readouterr().out
    assert "robby: node 3 (left_drive)" in output
    assert str(flight) in output
    assert main(["report", "--list", "--json", "--name", "robby"]) == 0
    (listed,) = json.loads(capsys.readouterr().out)
    assert listed["file"] == str(flight)
    assert listed["reason"]["node"] == "left_drive"


def test_a_damaged_recording_hides_no_other(flight, capsys):
    flight.with_name("2000-01-01T00-00-00-x.zip").write_bytes(b"cut")
    assert main(["report", "--list"]) == 0
    output = capsys.readouterr()
    assert str(flight) in output.out
    assert "2000-01-01" in output.err


def test_the_facts_as_json_write_no_page(flight, capsys):
    assert main(["report", str(flight), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["fault"]["node"] == "left_drive"
    assert not flight.with_suffix(".html").exists()


@pytest.mark.rest
def test_a_recording_of_frames_has_names_by_a_robots_files(flight, tmp_path, capsys):
    from canopen_control.trace.flight_file import read_flight

    path = tmp_path / "run.log"
    with RecordingWriter(path, "can0") as writer:
        for time_ns, _, frame in read_flight(flight).frames:
            writer.write(time_ns, frame)
    assert main(["report", str(path), "--config", "robby", "-o", str(tmp_path / "x.html")]) == 0
    assert "left_drive (node 3)" in capsys.readouterr().out
    assert "Load of bus can" in (tmp_path / "x.html").read_text()


def test_a_running_robot_is_watched(tmp_path, capsys):
    with running("live"):
        assert main(["report", "--for", "0.3", "--name", "live", "-o", str(tmp_path / "x.html")]) == 0
    assert capsys.readouterr().out.startswith("live: 0.")
    assert "Joints" in (tmp_path / "x.html").read_text()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "no fault has been recorded"),
        (["--name", "nobody"], "of nobody"),
        (["gone.zip"], "gone.zip"),
        (["gone.log"], "gone.log"),
        (["gone.txt"], "gone.txt"),
        (["--for", "1"], "no robot"),
        (["x.zip", "--for", "1"], "omit FILE"),
    ],
)
def test_what_cannot_be_reported_is_a_sentence_and_exit_code_2(arguments, words, capsys):
    assert main(["report", *arguments]) == 2
    assert words in capsys.readouterr().err


@pytest.mark.parametrize(("name", "content", "words"), [("a.log", b"", "contains no frames"), ("a.blf", b"x", "")])
def test_nothing_is_not_reported_as_nothing_wrong(tmp_path, capsys, name, content, words):
    (tmp_path / name).write_bytes(content)
    assert main(["report", str(tmp_path / name)]) == 2
    output = capsys.readouterr()
    assert f"canopen-control: {tmp_path / name}" in output.err
    assert words in output.err
    assert output.out == ""
    assert not (tmp_path / "a.html").exists()
