from __future__ import annotations

import os
import select

import pytest

from canopen_control.host.environment import GATE, LIFELINE, READY
from canopen_control.host.lifeline import LivenessReport, gate_fd, lifeline_fd, report_failure, report_ready


def test_a_process_without_a_lifeline_detects_this(monkeypatch, tmp_path):
    monkeypatch.delenv(LIFELINE, raising=False)
    assert lifeline_fd() is None
    for nonsense in ("", "x", "-1", "99999"):
        monkeypatch.setenv(LIFELINE, nonsense)
        assert lifeline_fd() is None
    with open(tmp_path / "file", "w") as file:  # the number is in use, by something else
        monkeypatch.setenv(LIFELINE, str(file.fileno()))
        assert lifeline_fd() is None


def test_a_lifeline_is_found_again_and_not_passed_on(monkeypatch):
    theirs, ours = os.pipe()
    os.set_inheritable(theirs, True)
    monkeypatch.setenv(LIFELINE, str(theirs))
    assert lifeline_fd() == lifeline_fd() == theirs
    assert not os.get_inheritable(theirs)
    assert not select.select([theirs], [], [], 0)[0]
    os.close(ours)
    assert select.select([theirs], [], [], 0)[0]
    os.close(theirs)


def test_reporting_to_a_client_that_has_left_does_nothing(monkeypatch):
    ours, theirs = os.pipe()
    os.close(ours)
    monkeypatch.setenv(READY, str(theirs))
    report_ready()
    report_ready()
    assert READY not in os.environ
    with pytest.raises(OSError, match="Bad file"):
        os.fstat(theirs)


@pytest.mark.parametrize(
    ("report", "line"), [(report_ready, b"ready\n"), (lambda: report_failure("the bus\nis busy"), b"the bus is busy\n")]
)
def test_a_report_is_one_line_and_the_last_word(monkeypatch, report, line):
    ours, theirs = os.pipe()
    monkeypatch.setenv(READY, str(theirs))
    report()
    assert os.read(ours, 100) == line
    assert os.read(ours, 100) == b""
    os.close(ours)


def test_a_pulse_is_received_again_and_again_and_never_waits(monkeypatch):
    ours, theirs = os.pipe()
    monkeypatch.setenv(READY, str(theirs))
    pulse = LivenessReport()
    assert READY not in os.environ
    pulse.beat()
    pulse.beat()
    assert os.read(ours, 100) == b"ready\nready\n"
    for _ in range(20_000):  # without a reader the pipe is full long before
        pulse.beat()
    os.close(ours)
    pulse.beat()
    os.close(theirs)


def test_a_gate_is_named_once_and_only_to_its_client(monkeypatch):
    monkeypatch.delenv(GATE, raising=False)
    assert gate_fd() is None
    theirs, ours = os.pipe()
    monkeypatch.setenv(GATE, str(theirs))
    assert gate_fd() == theirs
    assert gate_fd() is None
    assert not select.select([theirs], [], [], 0)[0]
    os.close(ours)
    os.close(theirs)
