"""A drive that takes programs over CANopen: the bundled one with the objects of CiA 302-3."""

from __future__ import annotations

from canopen_control.data_files import data_path
from canopen_control.od.eds import read_eds

PROGRAM_EDS = "generic_cia402_program.eds"


def program_od():
    """Return the dictionary of a servo with one program."""
    return read_eds(data_path("eds", PROGRAM_EDS)).od
