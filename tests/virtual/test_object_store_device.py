"""SDO's side of a virtual drive with two motors in one object set."""

import pytest
from support.two_motors import dictionary

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.sdo_server import SdoServerAbort
from canopen_control.virtual.device import make_device

_WIDE = "[6041]\nParameterName=Statusword\nObjectType=0x7\nDataType=0x0007"


@pytest.fixture
def device():
    node = make_device(dictionary(), 2)
    node.tick(0)
    return node


def read(device, index, subindex=0):
    return device.sdo.store.upload(index, subindex)


def write(device, index, subindex, data):
    device.sdo.store.download(index, subindex, data)


def test_each_motor_has_its_subindex(device):
    write(device, 0x60FF, 1, (100).to_bytes(4, "little"))
    write(device, 0x60FF, 2, (-200).to_bytes(4, "little", signed=True))
    assert [device.store.get(index) for index in (0x60FF, 0x68FF)] == [100, -200]
    assert int.from_bytes(read(device, 0x60FF, 2), "little", signed=True) == -200
    assert read(device, 0x60FF, 3) == bytes((100, 0, 0x38, 0xFF))
    assert read(device, 0x60FF) == b"\x03"


def test_a_value_for_both_motors_is_divided(device):
    write(device, 0x60FF, 3, bytes((5, 0, 0xFB, 0xFF)))
    assert [device.get(0x60FF, motor) for motor in (1, 2)] == [5, -5]
    assert device.sdo.store.size_of(0x60FF, 3) == 4


def test_the_statusword_has_sixteen_bits_of_each_motor(device):
    device.drives[1].fault(0x2310, 0)
    word = int.from_bytes(read(device, 0x6041), "little")
    assert (word & 0x4F, word >> 16 & 0x4F) == (0x40, 0x08)


def test_one_controlword_is_for_both_motors(device):
    write(device, 0x6040, 0, b"\x06\0")
    assert {drive.power.controlword for drive in device.drives.values()} == {0x06}


@pytest.mark.parametrize(
    ("index", "subindex", "code"),
    [(0x6840, 0, AbortCode.NO_OBJECT), (0x68FF, 0, AbortCode.NO_OBJECT), (0x60FF, 4, AbortCode.NO_SUBINDEX)],
)
def test_objects_of_a_second_axis_are_not_there(device, index, subindex, code):
    with pytest.raises(SdoServerAbort) as error:
        read(device, index, subindex)
    assert error.value.code == code


@pytest.mark.parametrize(
    ("index", "subindex", "data", "code"),
    [
        (0x6041, 0, bytes(4), AbortCode.READ_ONLY),
        (0x6064, 1, bytes(4), AbortCode.READ_ONLY),
        (0x60FF, 1, bytes(5), AbortCode.LENGTH_TOO_HIGH),
        (0x60FF, 3, bytes(2), AbortCode.LENGTH_TOO_LOW),
        (0x60FF, 0, bytes(1), AbortCode.READ_ONLY),
    ],
)
def test_what_the_device_refuses_is_refused(device, index, subindex, data, code):
    with pytest.raises(SdoServerAbort) as error:
        write(device, index, subindex, data)
    assert error.value.code == code


def test_a_statusword_for_both_motors_shows_the_fault_of_one():
    node = make_device(dictionary(lambda text: text.replace(_WIDE, _WIDE.replace("0x0007", "0x0006"))), 2)
    node.tick(0)
    node.drives[1].fault(0x2310, 0)
    assert int.from_bytes(read(node, 0x6041), "little") & 0x4F == 0x08
