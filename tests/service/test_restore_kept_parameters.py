import dataclasses

import pytest
from support.parameter_node import session_with

from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError
from canopen_control.host.files import state_dir
from canopen_control.od.eds import read_eds
from canopen_control.service.parameter_set import device_identity
from canopen_control.service.restore import KeptParameters

OD = read_eds(data_path("eds", "generic_cia402.eds"), 5).od
GAINS = {(0x60F9, 1): 12_345, (0x60FB, 2): 900}


def kept(od=OD, channel="can0"):
    session = session_with(od)
    return KeptParameters("gains", session, device_identity(session), channel)


def numbered(serial):
    return dataclasses.replace(
        OD, entries={**OD.entries, (0x1018, 4): dataclasses.replace(OD[0x1018, 4], parameter_value=serial)}
    )


def test_another_process_finds_what_was_kept(private_folders):
    kept().keep(OD, GAINS)
    found = kept()
    assert found.read() == GAINS
    found.forget()
    assert kept().read() == {}
    found.forget()


def test_what_the_dictionary_lacks_is_left_out(private_folders):
    kept().keep(OD, GAINS | {(0x3210, 1): 5})
    assert kept().read() == GAINS


def test_each_drive_has_its_own(private_folders):
    kept(numbered(7)).keep(OD, GAINS)
    assert kept(numbered(77)).read() == {}
    assert kept(numbered(7), "can1").read() == GAINS  # it is known wherever it is


def test_a_drive_without_serial_number_is_that_of_its_bus(private_folders):
    kept(numbered(0)).keep(OD, GAINS)
    assert kept(numbered(0)).read() == GAINS
    assert kept(numbered(0), "can1").read() == {}


def test_a_folder_that_cannot_be_written_is_told(private_folders):
    state_dir().mkdir(parents=True, exist_ok=True)
    state_dir("gains").write_text("in the way")
    with pytest.raises(ConfigError, match=r"cannot be kept in .*, so nothing was written into it"):
        kept().keep(OD, GAINS)
