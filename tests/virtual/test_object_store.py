from __future__ import annotations

import pytest
from support.two_motors import dictionary
from support.virtualbench import T, entry

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.sdo_server import SdoServerAbort
from canopen_control.od.model import ObjectDictionary
from canopen_control.virtual.device import make_device
from canopen_control.virtual.object_store import VirtualStore


def store():
    od = ObjectDictionary()
    for row in (
        entry(0x2000, 0, T.UNSIGNED8, 3, low=1, high=8),
        entry(0x2001, 0, T.UNSIGNED16, 7, "ro"),
        entry(0x2002, 0, T.UNSIGNED32, None, "wo"),
        entry(0x2003, 0, T.VISIBLE_STRING, "abc"),
        entry(0x2004, 1, T.INTEGER32, -5),
        entry(0x2005, 0, T.REAL32, 1.5, high=2.0),
        entry(0x2006, 0, T.DOMAIN),
        entry(0x1017, 0, T.UNSIGNED16, 0),
    ):
        od.add(row)
    return VirtualStore(od)


def abort(action, *arguments):
    with pytest.raises(SdoServerAbort) as caught:
        action(*arguments)
    return caught.value.code


def test_the_version_grows_with_a_value_that_is_another_one():
    values = store()
    before = values.version
    values.download(0x2000, 0, b"\x03")
    assert values.version == before
    values.download(0x2000, 0, b"\x04")
    values.set(0x2001, 0, 8)
    values.defaults()
    assert values.version == before + 3


def test_a_guard_judges_by_values_where_it_reports_this_and_nothing_is_capped():
    values = store()
    values.guard([0x2000], lambda _entry, value: value)
    values.guard([0x2001], lambda _entry, value: value, by_values=True)
    result = [values.guarded_by_values(index) for index in (0x2000, 0x2001, 0x2002)]
    values.ceilings.inject({0x2001: 1})
    assert (result, values.guarded_by_values(0x2001)) == ([False, True, True], False)


def test_it_starts_with_the_defaults_of_the_file():
    values = store()
    assert [values.get(0x2000), values.get(0x2003), values.get(0x2004, 1), values.get(0x2002)] == [3, "abc", -5, 0]
    assert values.upload(0x2004, 1) == b"\xfb\xff\xff\xff"


@pytest.mark.parametrize(
    ("index", "sub", "data", "code"),
    [
        (0x3000, 0, b"\0", 0x06020000),  # no object
        (0x2000, 1, b"\0", 0x06090011),  # no subindex
        (0x2001, 0, b"\0\0", 0x06010002),  # read only
        (0x2000, 0, b"\x09", 0x06090031),  # too high
        (0x2000, 0, b"\x00", 0x06090032),  # too low
        (0x2000, 0, b"\0\0", 0x06070012),  # too long
        (0x2004, 1, b"\0\0", 0x06070013),  # too short
        (0x2005, 0, b"\0\0\x40\x40", 0x06090031),  # 3.0
    ],
)
def test_a_write_against_the_rules_has_its_abort_code_and_changes_nothing(index, sub, data, code):
    values = store()
    before = dict(values.values)
    assert abort(values.download, index, sub, data) == code
    assert values.values == before


def test_reading_has_its_rules_too():
    values = store()
    assert abort(values.upload, 0x2002, 0) == 0x06010001
    assert abort(values.upload, 0x3000, 0) == 0x06020000
    assert abort(values.upload, 0x2004, 9) == 0x06090011


def test_strings_and_domains_may_have_any_length():
    values = store()
    values.download(0x2003, 0, b"a longer one")
    values.download(0x2006, 0, bytes(100))
    assert (values.get(0x2003), values.get(0x2006)) == ("a longer one", bytes(100))
    assert (values.size_of(0x2003, 0), values.size_of(0x2004, 1)) == (None, 4)
    with pytest.raises(SdoServerAbort, match="06020000"):  # refused at the initiation of the download
        values.size_of(0x3000, 0)


def test_sources_guards_and_watchers_have_their_report():
    values, received = store(), []
    values.on_read(0x2001, 0, lambda: 99)
    values.guard([0x2000], lambda entry, value: value + 1)
    values.on_write([0x2000], lambda entry, value: received.append((entry.index, value)))
    values.download(0x2000, 0, b"\x04")
    assert (values.get(0x2000), received, values.upload(0x2001, 0)) == (5, [(0x2000, 5)], b"\x63\0")

    def refuse(entry, value):
        raise SdoServerAbort(0x08000022)

    values.guard([0x2000], refuse)
    assert abort(values.download, 0x2000, 0, b"\x04") == 0x08000022
    assert values.get(0x2000) == 5


def test_hooks_on_what_is_not_there_do_nothing():
    values = store()
    values.on_read(0x3000, 0, lambda: 1)
    values.set(0x3000, 0, 1)
    values.preset(0x3000, 0, 1)
    assert not values.has(0x3000)
    assert values.number(0x3000, default=7) == 7
    assert values.number(0x2003, default=7) == 7  # a string is not a number


def test_a_reset_restores_the_power_on_values_of_its_range():
    values = store()
    values.download(0x2000, 0, b"\x05")
    values.download(0x1017, 0, b"\x64\0")
    values.defaults(0x1000, 0x1FFF)
    assert (values.get(0x2000), values.get(0x1017)) == (5, 0)
    values.defaults()
    assert values.get(0x2000) == 3


def test_what_is_kept_survives_a_reset_until_it_is_discarded():
    values = store()
    values.preset(0x2001, 0, 42)
    values.download(0x2000, 0, b"\x05")
    values.keep([(0x2000, 0)])
    values.defaults()
    assert (values.get(0x2000), values.get(0x2001)) == (5, 42)
    values.forget([(0x2000, 0), (0x2001, 0)])
    values.defaults()
    assert (values.get(0x2000), values.get(0x2001)) == (3, 42)


def test_a_ceiling_takes_less_without_a_word():
    values = store()
    values.ceilings.inject({0x2000: 4})
    values.download(0x2000, 0, b"\x07")
    assert values.get(0x2000) == 4


def test_a_source_whose_value_does_not_fit_is_a_general_error():
    values = store()
    values.on_read(0x2001, 0, lambda: 1 << 20)
    assert abort(values.upload, 0x2001, 0) == 0x08000000


# SDO's side of a virtual drive with two motors in one object set.


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
