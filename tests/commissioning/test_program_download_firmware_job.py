"""The firmware job: checks before the download, progress, and the final sentence."""

import threading

import pytest
from support.parameter_node import session_with
from support.programs import program_od

from canopen_control.cia301.nmt import NmtCommand
from canopen_control.commissioning import program_download
from canopen_control.commissioning.jobs import FIRMWARE, JobRun, ProgramOptions
from canopen_control.commissioning.program_download import DownloadStep, load_program
from canopen_control.errors import ConfigError, DriveError

NEW = b"version two " * 400


@pytest.fixture
def session():
    session = session_with(program_od(), robot="robby")
    session.transfers.command(NmtCommand.ENTER_PRE_OPERATIONAL)
    return session


@pytest.fixture
def steps(monkeypatch):
    """Return what the download does one after the other: that of a node has its own tests."""
    acts = []

    def download(_session, _image, _options, progress):
        for act in acts:
            act(progress)
        progress.step = DownloadStep.DONE

    monkeypatch.setattr(program_download, "download", download)
    return acts


def work():
    return JobRun(FIRMWARE, "loading", "bytes")


def test_the_program_before_and_after_is_reported_with_what_was_noted(session, steps):
    def run(progress):
        progress.old, progress.new = None, 0x1A2B
        progress.notes.append("started again: CRC error")

    steps.append(run)
    done = work()
    program = load_program(session, done, NEW, ProgramOptions(2))
    assert program == f"node 5: program 2 of {len(NEW)} bytes runs: unknown -> 0x00001A2B"
    assert done.lines == ["node 5: started again: CRC error"]


def test_a_download_that_ends_half_way_reports_what_may_be_gone(session, steps):
    def break_off(progress):
        progress.step = DownloadStep.SENDING
        raise DriveError("the program was not taken: CRC error; the node waits in its boot-loader")

    steps.append(break_off)
    with pytest.raises(DriveError, match=r"node 5: sending: .*CRC error.*repeat the command to start again"):
        load_program(session, work(), NEW, ProgramOptions())


def test_what_was_refused_before_anything_was_sent_is_reported_as_it_is(session, steps):
    def refuse(_progress):
        raise ConfigError("program 1 of the node cannot be loaded over CANopen")

    steps.append(refuse)
    with pytest.raises(ConfigError, match=r"^program 1 of the node cannot be loaded"):
        load_program(session, work(), NEW, ProgramOptions())


def test_a_node_that_the_robot_controls_an_enabled_one_and_a_stranger_are_refused(session, steps):
    session.transfers.robot_leaves_it = False
    with pytest.raises(DriveError, match="controlled by the running robot robby; nothing was written"):
        load_program(session, work(), NEW, ProgramOptions())
    session.powered_axes = lambda: [0]
    with pytest.raises(DriveError, match="is enabled; nothing was written"):
        load_program(session, work(), NEW, ProgramOptions())
    session.identity_differences = lambda: ["vendor 0x1 in the EDS, 0x2 found"]
    with pytest.raises(ConfigError, match="does not match its EDS"):
        load_program(session, work(), NEW, ProgramOptions())
    assert session.transfers.written == []


def test_step_and_bytes_are_followed(session, steps, monkeypatch):
    monkeypatch.setattr(program_download, "_REPORT_S", 0.001)
    session.transfers.progress = lambda: (700, None)
    done, observed, turn = work(), [], threading.Event()

    def wait_for(done_bytes):
        for _ in range(4000):
            if done.done == done_bytes and done.doing:
                break
            turn.wait(0.002)
        observed.append((done.doing, done.done, done.total))

    def send(progress):
        progress.step = DownloadStep.SENDING
        wait_for(700)

    def check(progress):
        progress.step = DownloadStep.CHECKING
        wait_for(0)

    steps += [send, check]
    load_program(session, done, NEW, ProgramOptions())
    assert observed == [("sending", 700, len(NEW)), ("waiting for the flash", 0, None)]
