from dataclasses import replace

import pytest
from support.parameter_node import session_with

from canopen_control.cia301.nmt import NmtCommand, NmtState
from canopen_control.commissioning.jobs import RestoreOptions
from canopen_control.commissioning.parameter_set import read_parameters
from canopen_control.commissioning.restore import guarded_restore, protected, quiet_node, refuse_other_drive
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError, DriveError
from canopen_control.od.eds import read_eds

TMCM = read_eds(data_path("eds", "TMCM-1270.eds"), 5).od
PRE_OPERATIONAL, START = NmtCommand.ENTER_PRE_OPERATIONAL, NmtCommand.START


def restored(session, file, **options):
    notes = []
    return guarded_restore(session, file, RestoreOptions(**options), note=notes.append), notes


def backup(serial=None, **changes):
    result = read_parameters(session_with(TMCM, serial=serial), twice=False)[0]
    values = {(int(name[1:5], 16), 0): value for name, value in changes.items()}
    return replace(result, values={**result.values, **values}, where="left.dcf")


def test_a_node_is_pre_operational_meanwhile_and_as_it_was_afterwards():
    session = session_with(TMCM)
    with quiet_node(session):
        assert session.nmt_state() is NmtState.PRE_OPERATIONAL
    assert session.transfers.commands == [PRE_OPERATIONAL]
    session.transfers.command(START)
    with pytest.raises(KeyboardInterrupt), quiet_node(session):
        raise KeyboardInterrupt
    assert session.nmt_state() is NmtState.OPERATIONAL


def test_a_node_that_a_robot_controls_is_refused_unless_it_was_taken_out():
    session = session_with(TMCM, robot="robby")
    session.transfers.command(START)
    with (
        pytest.raises(DriveError, match=r"controlled by the running robot robby; .*`nmt preop 5`"),
        quiet_node(session),
    ):
        pass
    session.transfers.command(PRE_OPERATIONAL)
    session.transfers.robot_leaves_it = False  # it is booted again and again
    with pytest.raises(DriveError, match="nothing was written"), quiet_node(session):
        pass
    session.transfers.robot_leaves_it = True
    session.transfers.commands.clear()
    with quiet_node(session):
        pass
    assert session.transfers.commands == []


def test_globs_fit_addresses_and_names():
    addresses = [(0x6081, 0), (0x607D, 1), (0x2705, 0), (0x2003, 0)]

    def fitting(*globs):
        result = protected(TMCM, iter(addresses), list(globs), same_device=True)
        return {address for address, why in result.items() if why.startswith("--protect")}

    assert fitting("0x607D:01") == {(0x607D, 1)}
    assert fitting("0X20*", "PROFILE*") == {(0x2003, 0), (0x6081, 0)}
    assert fitting("software position limit") == {(0x607D, 1)}
    with pytest.raises(ConfigError, match="--protect 0x99 matches no parameter"):
        fitting("0x99")


@pytest.mark.parametrize("silent_from", [1, 2])
def test_an_interrupted_restore_reports_what_is_written(silent_from):
    session = session_with(TMCM)
    session.transfers.silent_from = silent_from
    with pytest.raises(
        DriveError, match=rf"ended while writing: .*no answer.*{silent_from} of 3 were written \(0x6081"
    ):
        restored(session, backup(s6081=9, s6083=9, s6084=9))


@pytest.mark.parametrize(("serial", "offset"), [(8, 0), (7, 55)])
def test_the_home_offset_is_written_back_into_its_own_drive(serial, offset):
    session = session_with(TMCM, serial=serial)
    report, _ = restored(session, backup(serial=7, s607C=55))
    assert report.refused == []
    assert session.transfers.device.store.values[0x607C, 0] == offset


def test_the_report_reports_what_came_of_it():
    session = session_with(TMCM)
    report, notes = restored(session, backup(s6081=9, s6083=9), protect=("0x6083",), store=True)
    assert (report.written, report.refused, notes) == (1, [], [])
    assert any(line.startswith("0x6083:00") and line.endswith("--protect 0x6083") for line in report.protected)
    assert report.words(session).endswith("parameters as in left.dcf, 1 written; stored")
    session.transfers.device.store.ceilings.inject({0x6083: 1})
    report, _ = restored(session, backup(s6083=9))
    assert report.words(session) == "node 5: 1 parameters refused; the drive is unchanged"
    assert report.refused[0].startswith("0x6083:00")


def test_the_backup_of_another_drive_is_for_its_own_place():
    other = replace(backup(serial=7), node_id=6)
    with pytest.raises(
        ConfigError, match=r"left.dcf belongs to node 6, and node 5 is another drive; nothing was written"
    ):
        refuse_other_drive(other, session_with(TMCM, serial=8))
    refuse_other_drive(other, session_with(TMCM, serial=7))
    refuse_other_drive(backup(serial=7), session_with(TMCM, serial=8))
