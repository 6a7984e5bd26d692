"""Jobs at a node of a robot in virtual time: the same work as on a bus, by a third carrier."""

from dataclasses import replace

import pytest
from support.simulated import setup_of

from canopen_control.cia301.nmt import NmtCommand, NmtState
from canopen_control.commissioning.jobs import BACKUP, RESTORE, JobRun, Reached, RestoreOptions
from canopen_control.commissioning.parameter_jobs import run_backup, run_restore
from canopen_control.commissioning.parameter_set import parse_backup
from canopen_control.errors import BootError, DriveError, SdoAbort, SdoTimeout, UnknownName
from canopen_control.testing.tested_robot import TestedRobot

WINDOW = (0x6067, 0)  # not in bus.yml


@pytest.fixture
def robot(private_folders):
    tested_robot = TestedRobot(setup_of(), 1)
    yield tested_robot
    tested_robot.close()


def test_objects_and_the_identity_are_read_while_time_advances(robot):
    session = robot.session("left_drive")
    before = robot.clock.now
    assert session.identity().vendor_id == 0x286
    assert session.read_value(session.dictionary[0x1017, 0]) == 100
    assert before < robot.clock.now < before + 1.0
    with pytest.raises(SdoAbort):
        session.read(0x2FFF, 7)
    with pytest.raises(UnknownName, match="no drive 'left'"):
        robot.session("left")


def test_a_node_that_falls_silent_is_reported_as_by_a_running_robot(robot):
    session = robot.session(3)
    robot.drives[3].fault("silent")
    robot.run(0.1)
    with pytest.raises((SdoTimeout, BootError), match="node 3"):
        session.read(0x1000)


def test_a_backup_is_restored_with_the_node_out_of_the_robot(robot):
    session, done = robot.session("left_drive"), JobRun(BACKUP, "backup")
    assert run_backup(session, done, Reached()).startswith("node 3 (left_drive): ")
    file = parse_backup(done.file[1], "left.dcf")
    robot.disable()
    robot.run(0.5)
    changed = replace(file, values=file.values | {WINDOW: 777})
    restored = JobRun(RESTORE, "restore")
    assert run_restore(session, restored, changed, RestoreOptions()).endswith(
        "1 written; not stored: a power cycle undoes it"
    )
    assert session.read_value(session.dictionary[WINDOW]) == 777
    assert session.nmt_state() is NmtState.OPERATIONAL  # the robot has booted it again
    assert not session.transfers.taken_out()


def test_an_enabled_drive_is_refused(robot):
    session, done = robot.session("left_drive"), JobRun(BACKUP, "backup")
    run_backup(session, done, Reached())
    with pytest.raises(DriveError, match="is enabled; nothing was written"):
        run_restore(session, JobRun(RESTORE, "x"), parse_backup(done.file[1], "left.dcf"), RestoreOptions())


def test_a_node_that_does_not_enter_a_state_is_reported(robot):
    session = robot.session("left_drive")
    robot.disable()
    robot.drives[3].fault("silent")
    with pytest.raises(DriveError, match=r"node 3 is .* after NMT start"):
        session.transfers.command(NmtCommand.START)


def test_a_pause_is_one_of_the_simulation(robot):
    before = robot.clock.now
    robot.session(3).transfers.pause(2.5)
    assert robot.clock.now == pytest.approx(before + 2.5, abs=1e-6)
