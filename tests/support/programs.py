"""A drive that takes programs over CANopen: the objects of CiA 302-3 on a bundled dictionary."""

from __future__ import annotations

from canopen_control.data_files import data_path
from canopen_control.od.dcf import eds_text
from canopen_control.od.eds import read_eds
from canopen_control.od.model import DataType, Entry

__all__ = ["program_od", "write_program_eds"]


def program_od():
    """Return the dictionary of a servo with one program."""
    od = read_eds(data_path("eds", "generic_cia402.eds")).od
    for index, name, data_type, access in (
        (0x1F50, "Program data", DataType.DOMAIN, "wo"),
        (0x1F51, "Program control", DataType.UNSIGNED8, "rw"),
        (0x1F56, "Program software identification", DataType.UNSIGNED32, "ro"),
        (0x1F57, "Flash status identification", DataType.UNSIGNED32, "ro"),
    ):
        od.add(Entry(index, 1, f"{name} 1", data_type, access))
        od.add(Entry(index, 0, f"{name} count", DataType.UNSIGNED8, "ro", default=1))
    return od


def write_program_eds(path):
    """Write it as an EDS, and return the path as a text."""
    path.write_text(eds_text(program_od()), encoding="utf-8")
    return str(path)
