"""Where a drive with several motors in one object set has the objects of each axis."""

import pytest
from support.two_motors import dictionary

from canopen_control.cia301.pdo import MappedObject
from canopen_control.cia402.motors import MotorMap, ObjectPlace, motors_of, problem_of
from canopen_control.data_files import data_path
from canopen_control.od.eds import read_eds
from canopen_control.od.model import DataType, Entry

I16, I32, U8, U16, U32 = (
    DataType.INTEGER16,
    DataType.INTEGER32,
    DataType.UNSIGNED8,
    DataType.UNSIGNED16,
    DataType.UNSIGNED32,
)


@pytest.fixture
def od():
    return dictionary()


@pytest.fixture
def motors(od):
    return MotorMap(od, (1, 2))


@pytest.mark.parametrize(
    ("address", "place"),
    [
        ((0x60FF, 0), ObjectPlace(0x60FF, 1)),
        ((0x68FF, 0), ObjectPlace(0x60FF, 2)),
        ((0x6041, 0), ObjectPlace(0x6041, 0, 0, 16)),
        ((0x6841, 0), ObjectPlace(0x6041, 0, 16, 16)),
        ((0x6840, 0), ObjectPlace(0x6040, 0)),
        ((0x6860, 0), ObjectPlace(0x6060, 0)),
        ((0x688F, 2), ObjectPlace(0x608F, 2)),
    ],
)
def test_an_object_of_an_axis_has_its_place_in_the_device(motors, address, place):
    assert motors.places[address] == place
    assert address in motors.view


def test_a_part_of_an_answer_is_that_of_its_motor():
    assert ObjectPlace(0x6041, 0, 16, 16).part_of(bytes((1, 2, 3, 4))) == bytes((3, 4))
    assert ObjectPlace(0x60FF, 2).part_of(bytes(4)) == bytes(4)


def test_a_mapping_is_split_into_the_objects_of_the_axes(motors):
    mapping = (
        MappedObject(0x6041, 0, 32, U32),
        MappedObject(0x606C, 3, 32, U32),
        MappedObject(0x6064, 2, 32, I32),
        MappedObject(0x6061, 0, 8, U8),
    )
    assert motors.split(mapping) == (
        MappedObject(0x6041, 0, 16, U16),
        MappedObject(0x6841, 0, 16, U16),
        MappedObject(0x606C, 0, 16, I16),
        MappedObject(0x686C, 0, 16, I16),
        MappedObject(0x6864, 0, 32, I32),
        MappedObject(0x6061, 0, 8, U8),
    )


def test_a_device_is_known_by_its_dictionary(od):
    assert motors_of(od).subindices == (1, 2)
    assert motors_of(read_eds(data_path("eds", "generic_cia402.eds")).od) is None
    od.add(Entry(0x6840, 0, "Controlword 2", U16))
    assert motors_of(od) is None
    assert "each axis has its own objects" in problem_of(od, (1, 2))
