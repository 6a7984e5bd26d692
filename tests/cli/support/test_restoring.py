import argparse
from dataclasses import replace

import pytest
from support.parameter_node import session_with

from canopen_control.cia301.nmt import NmtCommand, NmtState
from canopen_control.cli.support.restoring import protected, quiet_node, restore_into
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError, DriveError, SdoTimeout
from canopen_control.od.eds import read_eds
from canopen_control.service.read_parameters import read_parameters

TMCM = read_eds(data_path("eds", "TMCM-1270.eds"), 5).od
PRE_OPERATIONAL, START = NmtCommand.ENTER_PRE_OPERATIONAL, NmtCommand.START


@pytest.fixture(autouse=True)
def _folders(private_folders):
    """Keep the journals out of the user's folder."""


def arguments(**changes):
    plain = {"protect": [], "include_protected": False, "keep": False, "store": False, "json": False}
    return argparse.Namespace(**{**plain, **changes})


def backup(serial=None, **changes):
    found = read_parameters(session_with(TMCM, serial=serial), twice=False)[0]
    values = {(int(name[1:5], 16), 0): value for name, value in changes.items()}
    return replace(found, values={**found.values, **values}, where="left.dcf")


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
        found = protected(TMCM, iter(addresses), list(globs), same_device=True)
        return {address for address, why in found.items() if why.startswith("--protect")}

    assert fitting("0x607D:01") == {(0x607D, 1)}
    assert fitting("0X20*", "PROFILE*") == {(0x2003, 0), (0x6081, 0)}
    assert fitting("software position limit") == {(0x607D, 1)}
    with pytest.raises(ConfigError, match="--protect 0x99: fits no parameter"):
        fitting("0x99")


@pytest.mark.parametrize("silent_from", [1, 2])
def test_an_interrupted_restore_says_what_is_written(silent_from):
    session = session_with(TMCM)
    session.transfers.silent_from = silent_from
    with pytest.raises(
        DriveError, match=rf"ended while writing: .*no answer.*{silent_from} of 3 were written \(0x6081"
    ):
        restore_into(session, backup(s6081=9, s6083=9, s6084=9), arguments())


def test_a_silence_before_anything_was_written_is_told_as_it_is():
    session = session_with(TMCM)
    session.transfers.silent_from = 0
    with pytest.raises(SdoTimeout, match="no answer"):
        restore_into(session, backup(), arguments())


@pytest.mark.parametrize(("serial", "offset"), [(8, 0), (7, 55)])
def test_the_home_offset_is_written_back_into_its_own_drive(serial, offset):
    session = session_with(TMCM, serial=serial)
    assert restore_into(session, backup(serial=7, s607C=55), arguments()) == 0
    assert session.transfers.device.store.values[0x607C, 0] == offset
