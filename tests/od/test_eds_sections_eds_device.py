"""What a file says of the device as a whole."""

import pytest
from support.eds import codes, eds, parse, section

from canopen_control.od.model import Commissioning, DeviceInfo

INFO = section(
    "DeviceInfo",
    VendorName="V",
    VendorNumber="0x286",
    ProductName="P",
    ProductNumber="1270",
    RevisionNumber="0x3001A",
    OrderCode="O",
    BaudRate_125=1,
    BaudRate_500="0x1",
    BaudRate_1000=0,
    SimpleBootUpMaster=0,
    SimpleBootUpSlave=1,
    Granularity=0,
    DynamicChannelsSupported=2,
    GroupMessaging=1,
    NrOfRXPDO=4,
    NrOfTXPDO="0x3",
    LSS_Supported=1,
    CompactPDO=0,
)


def test_device_info_field_by_field():
    assert parse(INFO, eds()).od.device == DeviceInfo(
        vendor_name="V",
        vendor_number=0x286,
        product_name="P",
        product_number=1270,
        revision_number=0x3001A,
        order_code="O",
        bit_rates=frozenset((125_000, 500_000)),
        simple_boot_up_slave=True,
        granularity=0,
        dynamic_channels=2,
        group_messaging=True,
        rpdo_count=4,
        tpdo_count=3,
        lss_supported=True,
    )


def test_without_device_info_there_is_a_warning_and_nothing_is_made_up():
    file = parse(eds())
    assert file.od.device == DeviceInfo()
    assert [issue.line for issue in file.issues if issue.code == "device-info"] == [1]


def test_dummies_are_those_that_are_allowed():
    text = section("DummyUsage", Dummy0001=0, Dummy0005=1, Dummy0007="0x1", Dummy0006="")
    file = parse(text, eds())
    assert file.od.dummy_usage == {5, 7}
    assert codes(file) == ["key-number"]


def test_comments_come_in_the_order_of_their_numbers():
    assert parse(section("Comments", Lines=9, Line10="c", line2="b", Line1="a"), eds()).od.comments == ("a", "b", "c")


@pytest.mark.parametrize("title", ["DeviceComissioning", "DeviceCommissioning", "DEVICECOMISSIONING"])
def test_both_spellings_of_commissioning(title):
    text = section(
        title,
        NodeID="0x0A",
        NodeName="left",
        BaudRate=500,
        NetNumber=2,
        NetworkName="net",
        CANopenManager=1,
        LSS_SerialNumber=77,
    )
    od = parse(text, eds(DefaultValue="$NODEID+0x600")).od
    assert (od.node_id, od.bitrate) == (10, 500_000)
    assert od.commissioning == Commissioning("left", 2, "net", True, 77)
    assert od[0x2000, 0].default == 0x60A


def test_the_caller_s_node_id_goes_first():
    text = section("DeviceComissioning", NodeID=10, Baudrate="0x1F4")
    od = parse(text, eds(DefaultValue="$NODEID"), node_id=3).od
    assert (od.node_id, od.bitrate, od[0x2000, 0].default) == (3, 500_000, 3)


@pytest.mark.parametrize(
    ("keys", "node_id", "bitrate", "code"),
    [
        ({"NodeID": 0, "Baudrate": 0}, None, None, ["commissioning"]),
        ({"NodeID": 128}, None, None, ["commissioning"]),
        ({"NodeID": "x", "Baudrate": "y"}, None, None, ["key-number", "key-number"]),
        ({"NodeID": 1, "Baudrate": 250000}, 1, 250_000, ["commissioning"]),
        ({}, None, None, []),
    ],
)
def test_commissioning_that_cannot_be(keys, node_id, bitrate, code):
    file = parse(section("DeviceComissioning", **keys), eds())
    assert (file.od.node_id, file.od.bitrate) == (node_id, bitrate)
    assert codes(file) == code


@pytest.mark.parametrize(
    ("text", "code"),
    [
        (section("ManufacturerObjects", **{"SupportedObjects": 1, "1": "0x2000"}), []),
        (section("ManufacturerObjects", **{"SupportedObjects": "0x1", "1": "8192"}), []),
        (section("ManufacturerObjects", **{"SupportedObjects": 3, "1": "0x2000"}), ["list-count"]),
        (section("ManufacturerObjects", **{"1": "0x2000"}), ["list-count"]),
        (section("ManufacturerObjects", **{"SupportedObjects": 2, "1": "0x2000", "2": "0x2001"}), ["list-object"]),
        (section("ManufacturerObjects", **{"SupportedObjects": 2, "1": "0x2000", "2": "0x2000"}), ["list-object"]),
        (section("ManufacturerObjects", **{"SupportedObjects": 2, "1": "0x2000", "2": "what"}), ["list-object"]),
        (section("ManufacturerObjects", SupportedObjects=0), ["list-absent"]),
    ],
)
def test_lists_are_compared_with_the_objects(text, code):
    assert codes(parse(text, eds())) == code


def test_an_object_may_be_in_any_list():
    text = section("OptionalObjects", **{"SupportedObjects": 1, "1": "0x2000"})
    assert codes(parse(text, section("MandatoryObjects", SupportedObjects=0), eds())) == []
