from dataclasses import replace

import pytest

from canopen_control.cia402 import objects
from canopen_control.data_files import data_path
from canopen_control.od.eds import read_eds
from canopen_control.od.model import DataType, Entry
from canopen_control.service.object_rows import unit_of

OD = read_eds(data_path("eds", "TMCM-1270.eds"), 5).od


@pytest.mark.parametrize(
    ("index", "unit"),
    [
        (0x607A, "counts"),
        (0x60FF, "counts/s"),
        (0x6083, "counts/s^2"),
        (0x6077, "1/1000 of the rated torque"),
        (0x1017, "ms"),
        (0x1000, ""),
        (0x2000, ""),
        (0x6877 - 0x800 + 0x800, "1/1000 of the rated torque"),  # of the second axis
    ],
)
def test_objects_of_the_profile_have_units(index, unit):
    assert unit_of(OD, index, 0) == unit


def test_a_count_of_subindices_has_none():
    od = replace(OD, entries=dict(OD.entries))
    for subindex in (0, 1):
        od.add(Entry(objects.SOFTWARE_POSITION_LIMIT, subindex, "x", DataType.INTEGER32))
    assert [unit_of(od, objects.SOFTWARE_POSITION_LIMIT, each) for each in (0, 1)] == ["", "counts"]


def test_the_drive_tells_that_its_velocities_are_revolutions():
    od = replace(OD, entries=dict(OD.entries))
    unit = 0x00B44700  # revolutions per minute
    od.add(Entry(objects.SI_UNIT_VELOCITY, 0, "SI unit velocity", DataType.UNSIGNED32, default=unit))
    assert (unit_of(od, 0x60FF, 0), unit_of(od, 0x607A, 0)) == ("rpm", "counts")
    od.add(Entry(objects.SI_UNIT_VELOCITY, 0, "SI unit velocity", DataType.UNSIGNED32, default=unit | 0xFD << 24))
    assert unit_of(od, 0x60FF, 0) == "0.001 rpm"
