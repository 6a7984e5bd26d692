"""Reader and writer of XDD and XDC files (CiA 311), the XML forms of EDS and DCF.

A file is converted to the sections of the equivalent EDS, with the lines of the XML elements, so that one reader and
one set of checks suffice for both forms. An object has its type, access and values as attributes, or in the <parameter>
of the device profile that its `uniqueIDRef` names, as CANopenNode's editor writes it; attributes take precedence.
"""

from __future__ import annotations

import datetime
import re
import xml.parsers.expat
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from canopen_control.errors import EdsError
from canopen_control.od.dcf import object_sections
from canopen_control.od.eds_sections import Section, Sections, clip
from canopen_control.od.eds_values import parse_number
from canopen_control.od.model import DataType

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from canopen_control.od.issues import Report
    from canopen_control.od.model import Entry, ObjectDictionary, ObjectInfo


_CONTAINER: Final = "ISO15745ProfileContainer"
_OBJECT, _SUB_OBJECT, _PARAMETER = "CANopenObject", "CANopenSubObject", "parameter"
_ATTRIBUTES: Final = {  # attributes of an object, and the equivalent keys of an EDS
    "name": "ParameterName",
    "objectType": "ObjectType",
    "subNumber": "SubNumber",
    "dataType": "DataType",
    "accessType": "AccessType",
    "defaultValue": "DefaultValue",
    "lowLimit": "LowLimit",
    "highLimit": "HighLimit",
    "PDOmapping": "PDOMapping",
    "objFlags": "ObjFlags",
    "actualValue": "ParameterValue",
    "denotation": "Denotation",
}
_HEXADECIMAL: Final = ("dataType", "objFlags")  # attributes that are written in hexadecimal without a prefix
_NUMBERS: Final = frozenset(("objectType", "subNumber", *_HEXADECIMAL))
_SIMPLE_TYPES: Final = {  # element of a parameter: data type of CiA 301
    "BOOL": DataType.BOOLEAN,
    "SINT": DataType.INTEGER8,
    "CHAR": DataType.INTEGER8,
    "INT": DataType.INTEGER16,
    "DINT": DataType.INTEGER32,
    "LINT": DataType.INTEGER64,
    "USINT": DataType.UNSIGNED8,
    "BYTE": DataType.UNSIGNED8,
    "UINT": DataType.UNSIGNED16,
    "WORD": DataType.UNSIGNED16,
    "UDINT": DataType.UNSIGNED32,
    "DWORD": DataType.UNSIGNED32,
    "ULINT": DataType.UNSIGNED64,
    "LWORD": DataType.UNSIGNED64,
    "REAL": DataType.REAL32,
    "LREAL": DataType.REAL64,
    "STRING": DataType.VISIBLE_STRING,
    "WSTRING": DataType.UNICODE_STRING,
    "BITSTRING": DataType.OCTET_STRING,
}
_ACCESS: Final = {
    "const": "const",
    "read": "ro",
    "write": "wo",
    "readWrite": "rw",
    "readWriteInput": "rwr",
    "readWriteOutput": "rww",
}
_DIRECTIONS: Final = {"tpdo": "rwr", "rpdo": "rww"}  # access of a rw object that is mapped in one direction only
_IDENTITY: Final = {
    "vendorName": "VendorName",
    "vendorID": "VendorNumber",
    "productName": "ProductName",
    "productID": "ProductNumber",
    "orderNumber": "OrderCode",
}
_FEATURES: Final = {
    "granularity": "Granularity",
    "nrOfRxPDO": "NrOfRXPDO",
    "nrOfTxPDO": "NrOfTXPDO",
    "bootUpSlave": "SimpleBootUpSlave",
    "bootUpMaster": "SimpleBootUpMaster",
    "layerSettingServiceSlave": "LSS_Supported",
    "groupMessaging": "GroupMessaging",
    "dynamicChannels": "DynamicChannelsSupported",
}
_FLAGS: Final = ("bootUpSlave", "bootUpMaster", "layerSettingServiceSlave", "groupMessaging")
_COMMISSIONING: Final = {
    "nodeID": "NodeID",
    "nodeName": "NodeName",
    "actualBaudRate": "Baudrate",
    "networkNumber": "NetNumber",
    "networkName": "NetworkName",
    "CANopenManager": "CANopenManager",
}
_RATE: Final = re.compile(r"\s*([0-9]+)\s*k", re.IGNORECASE)
_TITLE: Final = re.compile(r"([0-9A-F]{4})(?:sub([0-9A-F]+))?")
_DECLARATION: Final = re.compile(r"\A[\s\ufeff\0]*(<\?xml[^>]*\?>)?")  # names an encoding; the text is decoded
_DEEPEST: Final = 64  # levels of elements; a device description has about ten


@dataclass(slots=True)
class _Element:
    tag: str  # tag without its namespace
    line: int
    attributes: dict[str, str]
    children: list[_Element] = field(default_factory=list)
    text: str = ""

    def descendants(self) -> Iterator[_Element]:
        """Yield all elements below this element, in the order of the file."""
        for child in self.children:
            yield child
            yield from child.descendants()

    def find(self, tag: str) -> _Element | None:
        """Return the first descendant with this tag, or None."""
        return next((descendant for descendant in self.descendants() if descendant.tag == tag), None)

    def value_of(self, tag: str) -> str | None:
        """Return the attribute `value` of the first child with this tag, or None."""
        return next((child.attributes.get("value") for child in self.children if child.tag == tag), None)


def is_xml(text: str) -> bool:
    """Whether a text starts like an XML document."""
    return text[:1000].lstrip(" \t\r\n\x00\ufeff").startswith("<")


def xdd_sections(text: str, report: Report) -> Sections:
    """Convert a device description to the sections of an EDS; raise EdsError for another kind of document."""
    root = _parse(text, report.path)
    if root.tag != _CONTAINER:
        raise EdsError(
            report.path,
            root.line,
            f"is XML, but not a device description of CiA 311: the root element is <{clip(root.tag)}>",
        )
    parameters = {
        descendant.attributes["uniqueID"]: descendant
        for descendant in root.descendants()
        if descendant.tag == _PARAMETER and "uniqueID" in descendant.attributes
    }
    sections: Sections = {}
    for section in (*_device_sections(root), *_object_sections(root, parameters, report)):
        if section.name in sections:
            report.warning(section.line, "section-repeated", f"[{section.title}] is repeated; the first is used")
        sections.setdefault(section.name, section)
    if not any(_TITLE.fullmatch(section.title) for section in sections.values()):
        text = f"is an XDD (CiA 311) without any <{_OBJECT}>; ask the vendor for the EDS"
        raise EdsError(report.path, 1, text)
    if not report.path.lower().endswith((".xdd", ".xdc", ".xpd")):
        report.note(
            root.line, "xdd", "is read as an XDD (CiA 311), although its name does not end in .xdd, .xdc or .xpd"
        )
    return sections


def _parse(text: str, path: str) -> _Element:
    """Return the root element; raise EdsError for XML that is malformed, nested too deeply, or has a DOCTYPE."""
    stack = [_Element("", 0, {})]
    parser = xml.parsers.expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        if len(stack) > _DEEPEST:
            raise EdsError(path, parser.CurrentLineNumber, f"has more than {_DEEPEST} levels of elements")
        element = _Element(tag.rpartition(":")[2], parser.CurrentLineNumber, attributes)
        stack[-1].children.append(element)
        stack.append(element)

    def end(_tag: str) -> None:
        stack.pop()

    def data(text: str) -> None:
        stack[-1].text += text

    def doctype(*_arguments: object) -> None:
        raise EdsError(path, parser.CurrentLineNumber, "has a DOCTYPE, which is not supported; remove the DOCTYPE")

    parser.buffer_text = True
    parser.StartElementHandler, parser.EndElementHandler, parser.CharacterDataHandler = start, end, data
    parser.StartDoctypeDeclHandler = doctype
    try:
        parser.Parse(_DECLARATION.sub(lambda match: "\n" * match[0].count("\n"), text), True)
    except xml.parsers.expat.ExpatError as error:
        reason = xml.parsers.expat.ErrorString(error.code)
        raise EdsError(path, error.lineno, f"is XML, like an XDD (CiA 311), but not well-formed: {reason}") from None
    return stack[0].children[0]


def _section(title: str, line: int, texts: Mapping[str, str]) -> Section:
    values = {key.lower(): text for key, text in texts.items()}
    return Section(title.lower(), title, line, values, dict(texts), lines=dict.fromkeys(values, line))


# --- The device ---


def _device_sections(root: _Element) -> Iterator[Section]:
    if info := _device_info(root):
        yield _section("DeviceInfo", root.line, info)
    dummies = [descendant.attributes.get("entry", "") for descendant in root.descendants() if descendant.tag == "dummy"]
    if dummies:
        yield _section("DummyUsage", root.line, dict(dummy.partition("=")[::2] for dummy in dummies))
    if (commissioning := root.find("deviceCommissioning")) is not None:
        texts = _renamed(commissioning.attributes, _COMMISSIONING)
        if rate := _RATE.match(texts.get("Baudrate", "")):
            texts["Baudrate"] = rate[1]
        yield _section("DeviceComissioning", commissioning.line, texts)


def _device_info(root: _Element) -> dict[str, str]:
    info: dict[str, str] = {}
    # tags of the communication profile and of the device profile, which takes precedence
    for tag in ("identity", "DeviceIdentity"):
        if (identity := root.find(tag)) is not None:
            info |= {
                _IDENTITY[child.tag]: text
                for child in identity.children
                if child.tag in _IDENTITY and (text := child.text.strip())
            }
    for tag in ("CANopenGeneralFeatures", "CANopenMasterFeatures"):
        if (features := root.find(tag)) is not None:
            info |= _renamed(features.attributes, _FEATURES)
    for descendant in root.descendants():
        if descendant.tag == "supportedBaudRate" and (rate := _RATE.match(descendant.attributes.get("value", ""))):
            info[f"BaudRate_{rate[1]}"] = "1"
    return info


def _renamed(attributes: Mapping[str, str], keys: Mapping[str, str]) -> dict[str, str]:
    """Return the attributes in `keys` with their EDS names; flags become 0 and 1."""
    flags = {"true": "1", "false": "0"}
    return {keys[name]: flags.get(value, value) for name, value in attributes.items() if name in keys}


# --- Objects ---


def _object_sections(root: _Element, parameters: Mapping[str, _Element], report: Report) -> Iterator[Section]:
    for element in root.descendants():
        if element.tag != _OBJECT:
            continue
        index = _number(element, "index", 0xFFFF, report)
        if index is None:
            continue
        yield _section(f"{index:04X}", element.line, _texts(element, parameters, report))
        for sub in element.children:
            if sub.tag == _SUB_OBJECT and (subindex := _number(sub, "subIndex", 0xFF, report)) is not None:
                yield _section(f"{index:04X}sub{subindex:X}", sub.line, _texts(sub, parameters, report))


def _number(element: _Element, attribute: str, highest: int, report: Report) -> int | None:
    """Return a hexadecimal index or subindex; if invalid, report an error and return None."""
    text = element.attributes.get(attribute, "")
    try:
        number = int(text, 16)
    except ValueError:
        number = -1
    if 0 <= number <= highest:
        return number
    report.error(element.line, "object-address", f"<{element.tag}> has the invalid {attribute} {clip(text)!r}; ignored")
    return None


def _texts(element: _Element, parameters: Mapping[str, _Element], report: Report) -> dict[str, str]:
    """Return the EDS keys and texts of an object or subindex, merged with its <parameter>."""
    reference = element.attributes.get("uniqueIDRef")
    texts = {}
    if reference is not None and (parameter := parameters.get(reference)) is not None:
        texts = _of_parameter(parameter)
    elif reference is not None and "dataType" not in element.attributes:
        report.warning(element.line, "parameter-missing", f"the <{_PARAMETER}> {clip(reference)!r} is missing")
    for name, key in _ATTRIBUTES.items():
        if (text := element.attributes.get(name, "")) and name != "PDOmapping":
            texts[key] = f"0x{text}" if name in _HEXADECIMAL and not text.startswith("0x") else text
    mapping = element.attributes.get("PDOmapping", "no").lower()
    if "DataType" in texts or mapping != "no":
        texts["PDOMapping"] = "0" if mapping == "no" else "1"
    if texts.get("AccessType") == "rw" and mapping in _DIRECTIONS:
        texts["AccessType"] = _DIRECTIONS[mapping]
    return texts


def _of_parameter(parameter: _Element) -> dict[str, str]:
    access = parameter.attributes.get("access", "read")  # the default of the schema of CiA 311
    fields: dict[str, str | None] = {"AccessType": _ACCESS.get(access)}
    label = next((child.text.strip() for child in parameter.children if child.tag == "label"), "")
    fields["ParameterName"] = label or None
    kind = next((child.tag for child in parameter.children if child.tag in _SIMPLE_TYPES), None)
    fields["DataType"] = None if kind is None else f"0x{_SIMPLE_TYPES[kind]:04X}"
    fields["DefaultValue"] = parameter.value_of("defaultValue")
    fields["ParameterValue"] = parameter.value_of("actualValue")
    limits = parameter.find("range")
    if limits is not None:
        fields |= {"LowLimit": limits.value_of("minValue"), "HighLimit": limits.value_of("maxValue")}
    return {key: text for key, text in fields.items() if text}


# --- Writing ---


def xdd_text(od: ObjectDictionary, *, configured: bool = False) -> str:
    """Return the text of an XDD or, if `configured`, of an XDC with node-ID, bit rate and parameter values."""
    device = od.device
    identity = (
        ("vendorName", device.vendor_name),
        ("vendorID", _hexadecimal(device.vendor_number)),
        ("productName", device.product_name),
        ("productID", _hexadecimal(device.product_number)),
        ("orderNumber", device.order_code),
    )
    rates = [
        f"<supportedBaudRate{_attributes({'value': f'{rate // 1000} Kbps'})}/>" for rate in sorted(device.bit_rates)
    ]
    dummies = [
        f"<dummy{_attributes({'entry': f'Dummy{index:04X}={int(index in od.dummy_usage)}'})}/>" for index in range(1, 8)
    ]
    identity_lines = [f"<{tag}>{_escaped(text)}</{tag}>" for tag, text in identity if text]
    return "\n".join(
        (
            '<?xml version="1.0" encoding="utf-8"?>',
            f'<{_CONTAINER} xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance">',
            *_profile("Device", [*_block("DeviceIdentity", identity_lines)]),
            *_profile(
                "CommunicationNetwork",
                [
                    *_block(
                        "ApplicationLayers",
                        [
                            *_block("CANopenObjectList", list(_written_objects(od, configured=configured))),
                            *_block("dummyUsage", dummies),
                        ],
                    ),
                    *_block("TransportLayers", _block("PhysicalLayer", _block("baudRate", rates))),
                    *_block("NetworkManagement", _network_lines(od, configured=configured)),
                ],
            ),
            f"</{_CONTAINER}>\n",
        )
    )


def _network_lines(od: ObjectDictionary, *, configured: bool) -> list[str]:
    """Return the lines for the device features; with `configured`, also for node-ID, bit rate and network."""
    device, commissioning = od.device, od.commissioning
    features = {
        "granularity": device.granularity,
        "nrOfRxPDO": device.rpdo_count,
        "nrOfTxPDO": device.tpdo_count,
        "bootUpSlave": device.simple_boot_up_slave,
        "layerSettingServiceSlave": device.lss_supported,
        "groupMessaging": device.group_messaging,
        "dynamicChannels": device.dynamic_channels,
    }
    network = [
        f"<CANopenGeneralFeatures{_attributes(features)}/>",
        f"<CANopenMasterFeatures{_attributes({'bootUpMaster': device.simple_boot_up_master})}/>",
    ]
    if configured:
        values = {
            "nodeID": od.node_id,
            "nodeName": commissioning.node_name,
            "actualBaudRate": None if od.bitrate is None else f"{od.bitrate // 1000} Kbps",
            "networkNumber": commissioning.network_number,
            "networkName": commissioning.network_name,
            "CANopenManager": commissioning.canopen_manager,
        }
        network.append(f"<deviceCommissioning{_attributes(values)}/>")
    return network


def _profile(kind: str, body: Iterable[str]) -> list[str]:
    reference = _block(
        "ISO15745Reference",
        [
            "<ISO15745Part>1</ISO15745Part>",
            "<ISO15745Edition>1</ISO15745Edition>",
            "<ProfileTechnology>CANopen</ProfileTechnology>",
        ],
    )
    header = [
        "<ProfileIdentification/>",
        "<ProfileRevision>1</ProfileRevision>",
        "<ProfileName/>",
        "<ProfileSource/>",
        f"<ProfileClassID>{kind}</ProfileClassID>",
        *reference,
    ]
    attributes = {
        "xsi:type": f"ProfileBody_{kind}_CANopen",
        "fileName": "",
        "fileCreator": "canopen_control",
        "fileCreationDate": datetime.datetime.now(tz=datetime.UTC).date().isoformat(),
        "fileVersion": "1",
    }
    return _block("ISO15745Profile", [*_block("ProfileHeader", header), *_block("ProfileBody", body, attributes)])


def _block(tag: str, lines: Iterable[str], attributes: Mapping[str, object] | None = None) -> list[str]:
    return [f"<{tag}{_attributes(attributes or {})}>", *(f"  {line}" for line in lines), f"</{tag}>"]


def _attributes(values: Mapping[str, object]) -> str:
    from xml.sax.saxutils import quoteattr  # imports urllib.request, and that ssl: every start reads EDS files

    texts = {name: str(value).lower() if isinstance(value, bool) else value for name, value in values.items()}
    return "".join(f" {name}={quoteattr(str(value))}" for name, value in texts.items() if value is not None)


def _escaped(text: str) -> str:
    from xml.sax.saxutils import quoteattr  # as above

    return quoteattr(text)[1:-1].replace("&quot;", '"')


def _hexadecimal(number: int | None) -> str:
    return "" if number is None else f"0x{number:08X}"


def _written_objects(od: ObjectDictionary, *, configured: bool) -> Iterator[str]:
    last: str | None = None
    for title, lines in object_sections(od):
        place = _TITLE.fullmatch(title)
        assert place is not None
        index, subindex = place.groups()
        entry = od.get(int(index, 16), int(subindex or "0", 16))
        attributes: dict[str, object] = {
            name: text
            for name, text in _attributes_of(lines, entry, od.objects[int(index, 16)]).items()
            if configured or name not in ("actualValue", "denotation")
        }
        if subindex is not None:
            yield f"  <{_SUB_OBJECT}{_attributes({'subIndex': f'{int(subindex, 16):02X}'} | attributes)}/>"
            continue
        if last is not None:
            yield last
        yield f"<{_OBJECT}{_attributes({'index': index} | attributes)}>"
        last = f"</{_OBJECT}>"
    if last is not None:
        yield last


def _attributes_of(lines: Mapping[str, str], entry: Entry | None, info: ObjectInfo) -> dict[str, str]:
    """Return the XML attributes of an object or subindex with the EDS keys `lines`.

    Numbers and words are those that were read, since an EDS may have notations that XML lacks (`0x07 # VAR`, `0007h`,
    `ObjectType=07`). Values and limits keep their text.
    """
    texts = {key.lower(): value for key, value in lines.items()}
    attributes = {name: texts[key.lower()] for name, key in _ATTRIBUTES.items() if key.lower() in texts}
    for name in _NUMBERS & attributes.keys():
        fallback = info.code if name == "objectType" else entry.data_type if entry and name == "dataType" else 0
        number = _number_of(attributes[name], fallback)
        attributes[name] = f"{number:04X}" if name in _HEXADECIMAL else str(number)
    if entry is not None and "accessType" in attributes:
        attributes["accessType"] = "rw" if entry.access in ("rwr", "rww") else entry.access
    if entry is not None and "PDOmapping" in attributes:
        direction = {"rww": "RPDO", "wo": "RPDO", "rw": "optional"}.get(entry.access, "TPDO")
        attributes["PDOmapping"] = direction if entry.pdo_mappable else "no"
    return attributes


def _number_of(text: str, fallback: int) -> int:
    try:
        return parse_number(text)[0]
    except ValueError:
        return fallback
