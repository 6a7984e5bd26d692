"""The jobs at parameters against virtual devices, with no bus and no robot in between."""

from contextlib import nullcontext
from dataclasses import replace

import pytest
from support.parameter_node import session_with

from canopen_control.cia301.nmt import NmtCommand
from canopen_control.commissioning.jobs import BACKUP, JobRun, Reached, RestoreOptions
from canopen_control.commissioning.parameter_jobs import run_backup, run_clone, run_diff, run_restore
from canopen_control.commissioning.parameter_set import parameters_of, parse_backup
from canopen_control.data_files import data_path
from canopen_control.errors import CanopenError, ConfigError, DriveError
from canopen_control.od.eds import read_eds

OD = read_eds(data_path("eds", "TMCM-1270.eds"), 5).od
SPEED = (0x6081, 0)


def taken_out(**how):
    session = session_with(OD, robot="robby", **how)
    session.transfers.command(NmtCommand.ENTER_PRE_OPERATIONAL)
    return session


def work():
    return JobRun(BACKUP, "working", "objects")


def file_of(session, **changes):
    done = work()
    run_backup(session, done, Reached())
    backup = parse_backup(done.file[1], "left.dcf")
    return replace(backup, values=backup.values | {(int(name[1:5], 16), 0): value for name, value in changes.items()})


def test_a_backup_is_a_file_that_can_be_read_again():
    done = work()
    backup = run_backup(session_with(OD, robot="robby"), done, Reached())
    name, data = done.file
    assert name == "node5.dcf"
    assert backup == f"node 5: {len(parse_backup(data, name).values)} parameters to node5.dcf"
    assert done.done == done.total


def test_a_file_and_a_node_are_compared():
    session, done = session_with(OD), work()
    file = file_of(session)
    assert run_diff(session, done, file).endswith("parameters, equal")
    assert done.table == []
    session.write_value(OD[SPEED], 777)
    diff = run_diff(session, done, file)
    assert diff.startswith("left.dcf and node 5: 1 of ")
    assert done.table == [("0x6081:00", "Profile velocity", "0", "777")]


def test_a_file_is_restored_and_what_stays_is_reported():
    session, done = taken_out(), work()
    restore = run_restore(session, done, file_of(session, s6081=9, s2705=7), RestoreOptions(store=True))
    assert restore.endswith("1 written; stored")
    assert session.read_value(OD[SPEED]) == 9
    assert any(line.startswith("not written: 0x2705:00") for line in done.lines)


def test_what_the_drive_refuses_is_reported_and_undone():
    session, done = taken_out(), work()
    session.transfers.device.store.ceilings.inject({0x6083: 1})
    restore = run_restore(session, done, file_of(session, s6081=9, s6083=5000), RestoreOptions())
    assert restore.endswith("1 parameters refused; the drive is unchanged")
    assert done.failed
    assert any(line.startswith("refused: 0x6083:00") for line in done.lines)
    assert session.read_value(OD[SPEED]) == 0


def test_a_node_that_the_robot_controls_and_an_enabled_axis_are_refused():
    session = session_with(OD, robot="robby")
    session.transfers.command(NmtCommand.START)
    file = file_of(session, s6081=9)
    with pytest.raises(DriveError, match="controlled by the running robot robby; nothing was written"):
        run_restore(session, work(), file, RestoreOptions())
    session.powered_axes = lambda: [0]
    with pytest.raises(DriveError, match="node 5 is enabled; nothing was written: disable it first"):
        run_restore(session, work(), file, RestoreOptions())
    assert session.transfers.written == []


def test_another_product_and_another_drive_are_refused():
    session = taken_out(serial=8)
    file = file_of(session)
    stranger = replace(file, identity=replace(file.identity, product_code=99))
    with pytest.raises(ConfigError, match="belongs to a different product than node 5"):
        run_restore(session, work(), stranger, RestoreOptions())
    other = replace(file, node_id=6, identity=replace(file.identity, serial_number=7))
    with pytest.raises(ConfigError, match=r"left\.dcf belongs to node 6, and node 5 is another drive"):
        run_restore(session, work(), other, RestoreOptions())
    assert session.transfers.written == []


def test_a_node_lost_in_the_middle_reports_what_is_written():
    session = taken_out()
    file = file_of(session, s6081=9, s6083=9, s6084=9)
    session.transfers.silent_from = 1
    with pytest.raises(DriveError, match=r"ended while writing: .*no answer.*; 1 of 3 were written \(0x6081"):
        run_restore(session, work(), file, RestoreOptions())


def test_a_page_that_asks_for_the_end_ends_it_and_it_reports_what_is_written():
    session, done = taken_out(), work()
    file = file_of(session, s6081=9, s6083=9, s6084=9)
    done.end()
    with pytest.raises(DriveError, match="a page requested the end; 1 of 3 were written"):
        run_restore(session, done, file, RestoreOptions())


def test_a_node_is_cloned_from_another():
    source = session_with(OD, 6, robot="robby", serial=7)
    source.write_value(source.dictionary[SPEED], 1234)
    session, done = taken_out(serial=8), work()
    clone = run_clone(session, done, nullcontext(source), RestoreOptions())
    assert clone.startswith("node 5: ")
    assert session.read_value(OD[SPEED]) == 1234
    assert done.doing == "writing node 5"
    assert (done.document.source, done.document.node_id, done.document.written) == ("node 6", 5, 1)


def test_a_drive_that_has_other_parameters_alone_gives_no_backup():
    session, done = session_with(OD), work()
    session.transfers.lacking = {entry.address for entry in parameters_of(OD)}
    with pytest.raises(CanopenError, match="has no readable and writable parameter; no file was written"):
        run_backup(session, done, Reached())
    assert done.file is None
