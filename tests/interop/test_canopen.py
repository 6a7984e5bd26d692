"""The dictionary of the `canopen` package: the one we make, and the one it reads itself from the bundled files."""

import canopen
import pytest
from canopen import objectdictionary as theirs
from support.eds import eds, parse, section

from canopen_control.data_files import data_path
from canopen_control.interop.canopen import to_canopen
from canopen_control.od.codec import encode
from canopen_control.od.eds import read_eds
from canopen_control.od.model import DataType, ObjectCode

SHIPPED = ("TMCM-1270.eds", "generic_cia402.eds")
NODE = 3
#: canopen keeps an INTEGERn default that is written as two's complement as a large positive number, has no codec for
#: the two times, and adds the seven dummy types to every dictionary
DUMMIES = range(1, 8)


def variable(od, index, subindex):
    result = od[index]
    return result if isinstance(result, theirs.ODVariable) else result[subindex]


def facts(variable):
    return {
        "data_type": variable.data_type,
        "access_type": variable.access_type,
        "pdo_mappable": variable.pdo_mappable,
        "default": variable.default,
        "min": variable.min,
        "max": variable.max,
        "name": variable.name,
    }


@pytest.fixture(scope="module", params=SHIPPED)
def both(request):
    path = data_path("eds", request.param)
    return read_eds(path, NODE).od, canopen.import_od(str(path), NODE)


def test_an_independent_reader_finds_the_same_in_the_bundled_files(both):
    ours, independent = both
    assert set(independent) - set(DUMMIES) == set(ours.objects)
    for entry in ours:
        read = variable(independent, entry.index, entry.subindex)
        assert (read.data_type, read.access_type, read.name) == (entry.data_type, entry.access, entry.name)
        assert read.pdo_mappable == entry.pdo_mappable
        # it cannot read the bits; dcfgen can read only the bits
        default = None if entry.data_type.is_real else entry.default
        assert (read.min, read.max, read.default) == (entry.low, entry.high, default), hex(entry.index)


def test_the_independent_reader_finds_the_same_groups(both):
    ours, independent = both
    kinds = {ObjectCode.ARRAY: theirs.ODArray, ObjectCode.RECORD: theirs.ODRecord}
    for index, info in ours.objects.items():
        assert isinstance(independent[index], kinds.get(info.code, theirs.ODVariable))
        assert independent[index].name == info.name


def test_what_we_give_is_what_it_reads(both):
    ours, independent = both
    inputs = to_canopen(ours)
    assert set(inputs) == set(independent) - set(DUMMIES)
    for entry in ours:
        here, there = (variable(od, entry.index, entry.subindex) for od in (inputs, independent))
        lost = {"default": None} if entry.data_type.is_real else {}  # by its reader of the file
        assert facts(here) | lost == facts(there)
    device, other = inputs.device_information, independent.device_information
    assert device.allowed_baudrates == other.allowed_baudrates
    assert (device.vendor_number, device.product_number) == (other.vendor_number, other.product_number)
    assert (device.nr_of_RXPDO, device.nr_of_TXPDO) == (other.nr_of_RXPDO, other.nr_of_TXPDO)
    assert inputs.node_id == NODE


def test_both_encode_every_default_alike(both):
    ours, _ = both
    inputs = to_canopen(ours)
    for entry in ours:
        if entry.default is not None:
            raw = variable(inputs, entry.index, entry.subindex).encode_raw(entry.default)
            assert raw == encode(entry.default, entry.data_type)


def test_a_node_of_theirs_runs_on_our_dictionary(both):
    ours, _ = both
    node = canopen.LocalNode(NODE, to_canopen(ours))
    assert node.sdo[0x1000].raw == ours[0x1000, 0].default
    assert node.sdo[0x1400][1].raw == ours[0x1400, 1].default


def test_negative_defaults_are_right_where_its_own_reader_is_wrong():
    text = eds("607A", data_type=4, DefaultValue="0x80000001")
    assert to_canopen(parse(text).od)[0x607A].default == -2147483647


def test_values_of_a_dcf_and_times_are_given_as_it_takes_them():
    od = parse(eds(ParameterValue=7, DefaultValue=6), eds("2001", data_type=12, DefaultValue=1)).od
    inputs = to_canopen(od)
    assert (inputs[0x2000].value, inputs[0x2000].default) == (7, 6)
    assert inputs[0x2001].default == bytes((1, 0, 0, 0, 0, 0))


def test_compact_objects_are_all_there():
    text = section("1003", ParameterName="E", ObjectType=8, DataType=7, AccessType="ro", CompactSubObj=4)
    inputs = to_canopen(parse(text).od)
    assert list(inputs[0x1003].subindices) == [0, 1, 2, 3, 4]


def test_a_var_with_subindices_becomes_a_group():
    inputs = to_canopen(parse(eds("2000"), eds("2000sub1")).od)
    assert isinstance(inputs[0x2000], theirs.ODRecord)
    assert inputs[0x2000][1].data_type == DataType.UNSIGNED32


def test_comments_and_bit_rate_are_given():
    od = parse(
        section("Comments", Line1="a", Line2="b"), section("DeviceComissioning", NodeID=9, Baudrate=125), eds()
    ).od
    inputs = to_canopen(od)
    assert (inputs.comments, inputs.bitrate, inputs.node_id) == ("a\nb", 125_000, 9)
