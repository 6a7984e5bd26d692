"""A full disk: the file is named, and an existing file is not replaced by an incomplete one."""

from __future__ import annotations

import errno
import os
import shutil
import threading
from pathlib import Path

import pytest

from canopen_control.errors import ConfigError, DiskFull
from canopen_control.host import files
from canopen_control.host.files import LogFile, space_advice, state_dir, telling, write_whole


def test_a_file_is_replaced_as_a_whole_and_keeps_its_mode(tmp_path):
    path = tmp_path / "a"
    write_whole(path, b"one")
    path.chmod(0o640)
    link = tmp_path / "link"
    link.symlink_to(path)
    write_whole(link, b"two")
    assert (path.read_bytes(), path.stat().st_mode & 0o777, link.is_symlink()) == (b"two", 0o640, True)
    assert sorted(item.name for item in tmp_path.iterdir()) == ["a", "link"]


@pytest.mark.parametrize(("before", "kept"), [(None, "nothing was written"), (b"old", "the file is unchanged")])
def test_without_disk_space_the_old_file_stays(tmp_path, monkeypatch, before, kept):
    path = tmp_path / "a"
    if before is not None:
        path.write_bytes(before)

    def full(_self, _data):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(Path, "write_bytes", full)
        with pytest.raises(DiskFull, match=rf"{path}: No space left on device; {kept}"):
            write_whole(path, b"new")
    assert (path.read_bytes() if path.exists() else None) == before
    assert [item.name for item in tmp_path.iterdir()] == ([] if before is None else ["a"])


def test_a_device_is_written_to_and_stays_one():
    write_whole("/dev/null", b"x")
    assert not Path("/dev/null").is_file()
    with pytest.raises(DiskFull, match="/dev/full: No space left on device; a part of the data was written"):
        write_whole("/dev/full", b"x")


def test_what_is_not_a_full_disk_is_a_matter_of_the_path(tmp_path):
    with pytest.raises(ConfigError, match="a/b cannot be written: No such file or directory"):
        write_whole(tmp_path / "a" / "b", b"x")
    with pytest.raises(ConfigError, match="x cannot be written: "), telling("x", "nothing"):
        os.rmdir(tmp_path / "none")


@pytest.fixture
def log(tmp_path):
    return LogFile(tmp_path / "logs", "drive-3", limit=1000)


def start(log, *argv):
    """Open it as a child would hold it."""
    with log.opened_for(argv or ("drive", "--node-id", "3")) as file:
        return os.dup(file.fileno())


def wait_for(log):
    if log._busy is not None:
        log._busy.join(60)


def test_it_begins_with_a_line_that_reports_what_was_started(log):
    os.close(start(log, "drive", "a b", "two\nlines"))
    text = log.path.read_text()
    assert text.startswith("--- 20")
    assert text.endswith(" drive 'a b' 'two lines'\n")
    assert log.path.name == "drive-3.log"


def test_the_last_lines_are_those_of_this_run(log):
    first = start(log)
    os.write(first, b"old\n")
    os.close(first)
    second = start(log)
    assert log.last_lines(10) == []
    os.write(second, b"".join(b"line %d\n" % number for number in range(20)) + b"half")
    assert log.last_lines(3) == ["line 18", "line 19", "half"]
    os.close(second)
    assert "old" in log.path.read_text()


def test_a_file_that_is_gone_has_no_lines(log):
    os.close(start(log))
    log.path.unlink()
    assert log.last_lines(5) == []
    log.rotate_if_long()
    assert log._busy is None


def test_a_long_file_is_put_aside_at_the_next_start(log):
    file = start(log)
    os.write(file, b"x" * 2000)
    os.close(file)
    os.close(start(log))
    assert log.path.stat().st_size < 200
    assert log.path.with_name("drive-3.log.1").stat().st_size > 2000


def test_a_long_file_is_rotated_under_the_child_that_writes_it(log):
    file = start(log)
    os.write(file, b"before\n")
    log.rotate_if_long()
    assert log._busy is None
    os.write(file, b"x" * 2000 + b"\n")
    log.rotate_if_long()
    wait_for(log)
    os.write(file, b"after\n")
    os.close(file)
    text = log.path.read_bytes()
    assert text.startswith(b"--- rotated")
    assert text.endswith(b"\nafter\n")
    assert b"\0" not in text  # the child appends: no hole where the old text was
    assert b"before" in log.path.with_name("drive-3.log.1").read_bytes()
    assert log.last_lines(1) == ["after"]


def test_one_rotation_at_a_time(log, monkeypatch):
    file = start(log)
    os.write(file, b"x" * 2000)
    let_go, copies = threading.Event(), []

    def slow_copy(source, _target):
        copies.append(source)
        assert let_go.wait(60)

    monkeypatch.setattr(shutil, "copyfile", slow_copy)
    log.rotate_if_long()
    log.rotate_if_long()
    let_go.set()
    wait_for(log)
    os.close(file)
    assert len(copies) == 1


def test_a_full_disk_does_not_keep_the_file_from_being_emptied(log, monkeypatch):
    def full(_source, _target):
        raise OSError(28, "No space left on device")

    file = start(log)
    os.write(file, b"x" * 2000)
    monkeypatch.setattr(shutil, "copyfile", full)
    log.rotate()
    assert log.path.stat().st_size < 200
    os.close(file)


def test_a_folder_that_cannot_be_written_is_a_sentence(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match=r"cannot write the log .*File exists; set XDG_STATE_HOME"):
        start(LogFile(tmp_path / "file", "drive-3"))


def test_a_log_on_a_full_disk_names_the_file_system_and_no_other_folder(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os.path, "ismount", lambda path: Path(path) == tmp_path)
    monkeypatch.setattr(files, "make_private", full)
    with pytest.raises(DiskFull) as caught:
        start(LogFile(tmp_path / "state" / "robby", "drive-3"))
    log = tmp_path / "state" / "robby" / "drive-3.log"
    assert str(caught.value) == (
        f"cannot write the log {log}: No space left on device; its process was not started; "
        f"free some space on the file system of {tmp_path}"
    )


def test_only_a_full_file_system_is_named(tmp_path):
    assert space_advice(tmp_path, OSError(errno.EDQUOT, "")).startswith("; free some space on the file system of /")
    assert space_advice(tmp_path, OSError(errno.EACCES, "")) == ""


def test_logs_live_in_the_state_folder(monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", "/some/state")
    assert state_dir("robby") == Path("/some/state/canopen_control/robby")
    assert state_dir() == Path("/some/state/canopen_control")
    for useless in ("", "relative"):
        monkeypatch.setenv("XDG_STATE_HOME", useless)
        monkeypatch.setenv("HOME", "/home/me")
        assert state_dir("robby") == Path("/home/me/.local/state/canopen_control/robby")
