import pytest
from support.eds import parse, section

from canopen_control.data_files import data_names, data_path
from canopen_control.errors import EdsError
from canopen_control.od.eds import parse_eds, read_eds
from canopen_control.od.issues import Severity
from canopen_control.od.model import DataType, ObjectCode
from canopen_control.od.xdd import xdd_text

BUNDLED = [name for name in data_names("eds") if name.endswith(".eds")]
FILE = """<?xml version="1.0" encoding="utf-8"?>
<p:ISO15745ProfileContainer xmlns:p="http://www.canopen.org/xml/1.1"
    xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance">
 <ISO15745Profile>
  <ProfileBody xsi:type="ProfileBody_Device_CANopen">
   <DeviceIdentity><vendorName>Some &amp; Co</vendorName><vendorID>0x147</vendorID><productID/></DeviceIdentity>
   <ApplicationProcess><parameterList>
    <parameter uniqueID="UID_OBJ_1000" access="read"><label lang="en">Device type</label><UDINT/>
     <defaultValue value="0x00020192"/></parameter>
    <parameter uniqueID="UID_SUB_140001" access="readWrite"><label lang="en">COB-ID</label><UDINT/>
     <defaultValue value="$NODEID+0x200"/></parameter>
    <parameter uniqueID="UID_OBJ_6060" access="readWriteOutput"><SINT/>
     <allowedValues><range><minValue value="-3"/><maxValue value="10"/></range></allowedValues></parameter>
   </parameterList></ApplicationProcess>
  </ProfileBody>
 </ISO15745Profile>
 <ISO15745Profile>
  <ProfileBody xsi:type="ProfileBody_CommunicationNetwork_CANopen">
   <ApplicationLayers>
    <identity><vendorID>1</vendorID></identity>
    <CANopenObjectList>
     <CANopenObject index="1000" name="Type of device" objectType="7" PDOmapping="no" uniqueIDRef="UID_OBJ_1000"/>
     <CANopenObject index="1001" name="Error register" objectType="7" dataType="0005" accessType="ro"
                    PDOmapping="TPDO" objFlags="0003"/>
     <CANopenObject index="1400" name="RPDO 1" objectType="9" subNumber="2">
      <CANopenSubObject subIndex="00" name="Count" objectType="7" dataType="05" accessType="const" defaultValue="1"/>
      <CANopenSubObject subIndex="01" objectType="7" uniqueIDRef="UID_SUB_140001"/>
     </CANopenObject>
     <CANopenObject index="6060" name="Mode" objectType="7" PDOmapping="RPDO" uniqueIDRef="UID_OBJ_6060"/>
     <CANopenObject index="6064" name="Position" objectType="7" dataType="0004" accessType="ro" PDOmapping="optional"
                    actualValue="77"/>
    </CANopenObjectList>
    <dummyUsage><dummy entry="Dummy0005=1"/></dummyUsage>
   </ApplicationLayers>
   <TransportLayers><PhysicalLayer><baudRate defaultValue="250 Kbps"><supportedBaudRate value="250 Kbps"/>
    <supportedBaudRate value="1000 Kbps"/></baudRate></PhysicalLayer></TransportLayers>
   <NetworkManagement>
    <CANopenGeneralFeatures granularity="8" nrOfRxPDO="1" nrOfTxPDO="2" bootUpSlave="true"
                            layerSettingServiceSlave="true"/>
    <deviceCommissioning nodeID="5" nodeName="left" actualBaudRate="250 Kbps" networkNumber="1"
                         CANopenManager="false"/>
   </NetworkManagement>
  </ProfileBody>
 </ISO15745Profile>
</p:ISO15745ProfileContainer>
"""


def read(text=FILE, name="device.xdd"):
    return parse_eds(text.encode(), name=name)


def test_objects_have_what_their_attributes_and_their_parameters_specify():
    od = read().od
    assert (od.node_id, od.bitrate, od.commissioning.node_name) == (5, 250_000, "left")
    kind = od[0x1000, 0]
    assert (kind.name, kind.data_type, kind.access, kind.default) == (
        "Type of device", DataType.UNSIGNED32, "ro", 0x20192)  # fmt: skip
    register = od[0x1001, 0]
    assert (register.data_type, register.tpdo_mappable, register.obj_flags) == (DataType.UNSIGNED8, True, 3)
    assert od.objects[0x1400].code is ObjectCode.RECORD
    cob_id = od[0x1400, 1]
    assert (cob_id.name, cob_id.default, cob_id.relative) == ("COB-ID", 0x205, True)
    mode = od[0x6060, 0]
    assert (mode.data_type, mode.access, mode.rpdo_mappable, mode.tpdo_mappable) == (
        DataType.INTEGER8, "rww", True, False)  # fmt: skip
    assert (mode.low, mode.high) == (-3, 10)
    assert (od[0x6064, 0].parameter_value, od[0x6064, 0].pdo_mappable) == (77, True)


def test_a_parameter_without_access_is_read_only():
    """`read` is the default of the schema, and programs that write by it leave it out."""
    file = read(FILE.replace(' access="read"', ""))
    assert file.od[0x1000, 0].access == "ro"
    assert "access-type" not in {issue.code for issue in file.issues}


def test_the_device_is_that_of_the_device_profile_and_of_the_network():
    device = read().od.device
    assert (device.vendor_name, device.vendor_number, device.product_number) == ("Some & Co", 0x147, None)
    assert (device.rpdo_count, device.tpdo_count, device.lss_supported) == (1, 2, True)
    assert device.bit_rates == {250_000, 1_000_000}
    assert read().od.dummy_usage == {5}


@pytest.mark.parametrize("name", BUNDLED)
def test_what_is_written_is_read_again(name):
    od = read_eds(data_path("eds", name)).od
    again = parse_eds(xdd_text(od).encode(), name="again.xdd").od
    assert again.entries == od.entries
    assert again.objects == od.objects
    assert again.device.bit_rates == od.device.bit_rates


def test_a_written_file_of_one_device_has_its_node_id_and_its_values():
    od = read().od
    again = parse_eds(xdd_text(od, configured=True).encode(), name="again.xdc").od
    assert (again.node_id, again.bitrate, again.commissioning) == (od.node_id, od.bitrate, od.commissioning)
    assert again.entries == od.entries
    assert "actualValue" not in xdd_text(od)


# public files have `ObjectType=0x07 # VAR`, types with h, and objects without a type or with a word
@pytest.mark.parametrize(
    ("keys", "attributes"),
    [
        ({"ObjectType": "0x07 # VAR"}, 'objectType="7" dataType="0007"'),
        ({"ObjectType": "07", "DataType": "0007h"}, 'objectType="7" dataType="0007"'),
        ({"ObjectType": "VAR", "DataType": "0x0004 # INTEGER32"}, 'objectType="7" dataType="0004"'),
        ({"DataType": "UNSIGNED16"}, 'objectType="7" dataType="0006"'),
        ({"PDOMapping": "0x00"}, 'PDOmapping="no"'),
        ({"PDOMapping": "1", "AccessType": "RWW"}, 'accessType="rw" PDOmapping="RPDO"'),
        ({"ObjFlags": "1 # no download"}, 'objFlags="0001"'),
    ],
)
def test_an_odd_notation_of_an_eds_becomes_a_plain_one(keys, attributes):
    texts = {"ParameterName": "Speed", "ObjectType": "0x7", "DataType": "0x0007", "AccessType": "rw"} | keys
    text = xdd_text(parse(section("2000", **texts)).od)
    (line,) = [line for line in text.splitlines() if 'index="2000"' in line]
    assert attributes in line


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        (FILE.replace("</p:ISO", "</ISO"), FILE.count("\n"), "not well-formed"),
        ("\n<robot name='r'/>", 2, "not a device description of CiA 311: the root element is <robot>"),
        ("<ISO15745ProfileContainer/>", 1, "without any <CANopenObject>"),
        (FILE.replace("<p:ISO", "<!DOCTYPE x>\n<p:ISO", 1), 2, "DOCTYPE"),
        ("<a>" * 100, 1, "more than 64 levels"),
    ],
)
def test_what_is_not_a_device_description_is_refused_with_its_line(text, line, words):
    with pytest.raises(EdsError, match=words) as error:
        read(text)
    assert error.value.line == line


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('index="6064"', 'index="60640"', "<CANopenObject> has the invalid index '60640'"),
        ('subIndex="01"', 'subIndex="x"', "<CANopenSubObject> has the invalid subIndex 'x'"),
        ('uniqueIDRef="UID_OBJ_6060"', 'uniqueIDRef="UID_OBJ_9"', "the <parameter> 'UID_OBJ_9' is missing"),
        ('index="6064"', 'index="6060"', "[6060] is repeated; the first is used"),
    ],
)
def test_problems_have_the_line_of_their_element(old, new, words):
    issues = [issue for issue in read(FILE.replace(old, new)).issues if words in issue.text]
    assert [issue.line for issue in issues] == [FILE[: FILE.index(old)].count("\n") + 1]
    assert issues[0].severity is not Severity.NOTE


def test_a_file_with_another_ending_is_read_with_a_note():
    (note,) = [issue for issue in read(name="device.eds").issues if issue.code == "xdd"]
    assert note.severity is Severity.NOTE
    assert not [issue for issue in read().issues if issue.code == "xdd"]
