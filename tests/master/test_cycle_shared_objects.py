"""One controlword of several axes, in the process data of the master."""

import pytest
from support.two_motors import dictionary

from canopen_control.cia301.pdo import MappedObject
from canopen_control.cia402.motors import MotorMap
from canopen_control.master.cycle import ProcessImage, share_objects
from canopen_control.od.model import DataType

NODE = 2
U16 = DataType.UNSIGNED16


@pytest.fixture(scope="module")
def motors():
    return MotorMap(dictionary(), (1, 2))


@pytest.fixture
def image(motors):
    image = ProcessImage()
    words = (MappedObject(0x6041, 0, 16, U16), MappedObject(0x6841, 0, 16, U16))
    display = MappedObject(0x6061, 0, 8, DataType.INTEGER8)
    image.add_tpdo(NODE, 0x182, (*words, display))
    image.add_rpdo(NODE, 0x202, (MappedObject(0x6040, 0, 16, U16), MappedObject(0x6060, 0, 8, DataType.INTEGER8)))
    share_objects(image, NODE, motors)
    return image


def words(image):
    axes = image.output(NODE, 0x6040), image.output(NODE, 0x6840)
    for axis in axes:
        axis.drive()
    return axes


@pytest.mark.parametrize(
    ("left", "right", "sent"),
    [
        (0x0F, 0x0F, 0x0F),
        (0x0F, 0x06, 0x06),  # the first that is to stop stops both
        (0x0F, 0x02, 0x02),
        (0x0F, 0x00, 0x00),
        (0x07, 0x0F, 0x07),
        (0x10F, 0x0F, 0x10F),  # halt
        (0x80, 0x06, 0x80),  # a fault reset never enables
        (0x80, 0x0F, 0x80),
    ],
)
def test_the_word_of_the_device_is_that_of_both_axes(image, left, right, sent):
    first, second = words(image)
    first.set(left)
    second.set(right)
    assert image.outputs[0].values[0] == sent


@pytest.mark.parametrize(("shown", "sent"), [(0x0237, 0x00), (0x0218, 0x0F), (0x021F, 0x0F)])
def test_an_axis_in_a_fault_takes_no_power_from_the_other_one(image, shown, sent):
    image.inputs[0x182].receive(shown.to_bytes(2, "little") + b"\x37\x02\x03\0\0\0", 5, 1)
    first, second = words(image)
    second.set(0x0F)
    first.set(0)
    assert image.outputs[0].values[0] == sent


def test_an_axis_without_a_joint_is_not_waited_for(image):
    first = image.output(NODE, 0x6040)
    first.drive()
    first.set(0x0F)
    assert image.outputs[0].values[0] == 0x0F


def test_what_both_axes_have_is_one_value(image):
    assert image.output(NODE, 0x6860) is image.output(NODE, 0x6060)
    assert image.input(NODE, 0x6861) is image.input(NODE, 0x6061)
    assert image.input(NODE, 0x6841) is not image.input(NODE, 0x6041)
