"""The file of a flight recorder: written whole, read back equal, and never too many of them."""

import json
import zipfile

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.errors import ConfigError
from canopen_control.frame import ERROR_FLAG, EXTENDED_FLAG, RECORD, CanFrame, pack_records, remote_frame
from canopen_control.trace import flight_file
from canopen_control.trace.flight_file import MAX_FILES, candump_lines, is_flight_file, newest, read_flight, save
from canopen_control.trace.flight_ring import Batch

REASON = {"time": 1.0, "kind": "heartbeat_lost", "node": "left_drive", "level": "error", "text": "gone"}
META = {"robot": "robby", "reason": REASON, "written": 1_700_000_000.0, "begin": 0, "buses": {"can": "local:robby"}}
FRAMES = [
    CanFrame(0x183, bytes.fromhex("370603")),
    CanFrame(0x80),
    remote_frame(0x701, 1),
    CanFrame(0x12345678 | EXTENDED_FLAG, b"\x01"),
    CanFrame(ERROR_FLAG | 0x40, bytes(8)),
]


def write(folder, frames=FRAMES, **meta):
    batches = [Batch(5_000_000_123, 0, pack_records(frames))]
    lines = candump_lines(batches, ["can"], 1_600_000_000_000_000_000)
    return save(folder, {**META, **meta}, lines, [b'{"kind":"x"}'], [b'{"time":1}\n', b'{"time":2}\n'])


def test_what_is_written_is_read_back(tmp_path):
    path = write(tmp_path)
    assert is_flight_file(path)
    file = read_flight(path)
    assert file.meta["reason"] == REASON
    assert file.events == [{"kind": "x"}]
    assert file.states == [{"time": 1}, {"time": 2}]
    assert [frame for _, _, frame in file.frames] == FRAMES
    assert {(time, bus) for time, bus, _ in file.frames} == {(1_600_000_005_000_000_000, "can")}
    assert file.meta["unread_lines"] == 0


@given(st.lists(st.tuples(st.integers(0, 0x7FF), st.binary(max_size=8))))
def test_any_frames_come_back(tmp_path_factory, frames):
    frames = [CanFrame(*frame) for frame in frames]
    path = write(tmp_path_factory.mktemp("flight"), frames)
    assert [frame for _, _, frame in read_flight(path).frames] == frames


def test_a_length_above_8_on_the_wire_makes_no_broken_line():
    lines = list(candump_lines([Batch(0, 0, RECORD.pack(0x1, 15, bytes(8)))], ["can"], 0))
    assert lines == ["(0000000000.000000) can 001#0000000000000000\n"]


def test_the_name_says_when_and_why_and_is_never_taken_twice(tmp_path):
    first, second = write(tmp_path), write(tmp_path)
    assert first.name.endswith("-heartbeat_lost-left_drive.zip")
    assert second.name.endswith("-heartbeat_lost-left_drive-2.zip")
    odd = write(tmp_path, reason={"kind": "../x y", "node": None})
    assert odd.parent == tmp_path
    assert odd.name.endswith("-_x_y.zip")


def test_a_folder_keeps_the_newest(tmp_path):
    paths = [write(tmp_path, written=1_700_000_000.0 + number) for number in range(MAX_FILES + 5)]
    assert sorted(tmp_path.iterdir()) == paths[5:]
    assert newest(tmp_path) == paths[-1]
    assert newest(tmp_path / "nowhere") is None


def test_a_file_is_whole_or_not_there(tmp_path):
    def failing():
        yield "(1.0) can 080#\n"
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        save(tmp_path, META, failing(), [], [])
    assert list(tmp_path.iterdir()) == []


def test_the_eds_files_of_the_nodes_come_along(tmp_path):
    eds = tmp_path / "drive.eds"
    eds.write_bytes(b"[FileInfo]")
    nodes = [{"eds": str(eds)}, {"eds": str(eds)}, {"eds": str(tmp_path / "gone.eds")}, {"eds": ""}]
    layout = {"buses": {"can": {"nodes": nodes}}}
    assert read_flight(write(tmp_path / "flight", layout=layout)).eds == {"drive.eds": b"[FileInfo]"}


@pytest.mark.parametrize("content", [b"", b"no zip", None, {"format": "another"}, {"version": 99}])
def test_what_is_no_recording_is_refused_in_a_sentence(tmp_path, content):
    path = tmp_path / "x.zip"
    if isinstance(content, dict):
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("meta.json", json.dumps({"format": flight_file.FORMAT, "version": 1, **content}))
    elif content is not None:
        path.write_bytes(content)
    with pytest.raises(ConfigError, match=r"x\.zip"):
        read_flight(path)


def test_lines_that_are_no_frames_are_counted(tmp_path):
    lines = ["(1.0) can 080#\n", "nonsense\n", "(1.5) can 1FFFFFFFF#00\n", "(2.5) can 181#0102\n"]
    file = read_flight(save(tmp_path, META, iter(lines), [], []))
    assert [frame.can_id for _, _, frame in file.frames] == [0x80, 0x181]
    assert file.meta["unread_lines"] == 2
