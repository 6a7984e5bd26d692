"""Checks of the SDO server and its objects (CiA 301, 7.2.4 and 7.5.2), and offline checks of their EDS (CiA 306-1).

The offline checks send nothing. Most of their rules are those of `od.eds`, whose issues have codes; a check fails if
there is an issue with one of its codes.

`T` in a comment is the number of the case in CiA's conformance test tool 3.0.3.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.pdo import DUMMY_TYPES, parse_mapping_entry
from canopen_control.cia301.sdo_codec import ABORT, ANSWER_BASE, REQUEST_BASE
from canopen_control.cia402 import objects as o
from canopen_control.conformance.check import (
    CheckLevel,
    CheckList,
    CheckTouch,
    aborts,
    answer_text,
    client_abort,
    expect,
    expect_abort,
    expect_refused,
    expect_silence,
    mux,
    upload_request,
)
from canopen_control.conformance.checked_node import CheckFailed, NotApplicable
from canopen_control.conformance.nmt_checks import boot
from canopen_control.conformance.pdo_checks import first_pdo
from canopen_control.errors import SdoAbort
from canopen_control.od.codec import encode
from canopen_control.od.indices import DEVICE_TYPE
from canopen_control.od.model import DeviceInfo

if TYPE_CHECKING:
    from canopen_control.conformance.checked_node import CheckedNode
    from canopen_control.od.eds import EdsFile
    from canopen_control.od.model import Entry, ObjectDictionary


EDS_CHECKS = CheckList("306")
_add_306 = EDS_CHECKS.add
_MUST, _SHOULD, _CONFIGURE = CheckLevel.MUST, CheckLevel.SHOULD, CheckTouch.CONFIGURE
_SHOWN = 5  # issues in a result
_SHAPE = ("section-form", "section-repeated", "stray-line", "key-number", "key-repeated", "entry-repeated")
_ROWS = (
    ("E01", "file format", "the file has no syntax error", _MUST, _SHAPE),  # T 1.0
    ("E01i", "[DeviceInfo]", "[DeviceInfo] is complete", _MUST, ("device-info",)),
    ("E02", "lists of objects", "0x1000, 0x1001 and 0x1018 exist", _MUST, ("object-mandatory",)),
    (
        "E03",
        "lists of objects",
        "the lists of objects are complete",
        _MUST,
        ("list-count", "list-missing", "list-object"),
    ),
    ("E03s", "sections of objects", "each listed object has a section", _MUST, ("object-missing", "sub-missing")),
    (
        "E04",
        "sections of objects",
        "SubNumber and subindex 0 match the subindices",
        _MUST,
        ("sub-number", "sub0-missing", "sub0-count", "sub0-type"),
    ),
    (
        "E05",
        "sections of objects",
        "ObjectType, DataType and AccessType are legal",
        _MUST,
        ("object-type", "data-type", "access-type"),
    ),
    (
        "E06",
        "sections of objects",
        "values are within their type and limits",
        _MUST,
        ("value-form", "value-limit", "limit-order"),
    ),
    (
        "E06f",
        "sections of objects",
        "limits are numbers, and occur only where allowed",
        _SHOULD,
        ("limit-form", "limit-forbidden"),
    ),
    (
        "E08",
        "sections of objects",
        "each default mapping fits its PDO",
        _MUST,
        ("pdo-bits", "pdo-length", "pdo-direction", "pdo-target"),
    ),
    (
        "E08c",
        "sections of objects",
        "each PDO has both records, and the entries that it counts",
        _MUST,
        ("pdo-count", "pdo-record"),
    ),
    ("E08m", "sections of objects", "mapped objects have PDOMapping=1", _MUST, ("pdo-mappable",)),
    ("E09", "sections of objects", "COB-IDs are allowed identifiers, or off", _MUST, ("cob-id",)),
    ("E10", "[DeviceInfo]", "NrOfRXPDO and NrOfTXPDO are the numbers of records", _SHOULD, ("pdo-number",)),
    ("E12c", "sections of objects", "ObjectType is that of the standard (array or record)", _SHOULD, ("object-code",)),
    ("E13t", "sections of objects", "objects of CiA 402 have its types", _SHOULD, ("profile-type",)),
)


def _eds(node: CheckedNode) -> EdsFile:
    if node.eds is None:
        raise NotApplicable("no EDS; give one with --eds")
    return node.eds


def _without_issues(codes: tuple[str, ...], node: CheckedNode) -> None:
    issues = [issue for issue in _eds(node).issues if issue.code in codes]
    lines = "; ".join(f"line {issue.line}: {issue.text}" for issue in issues[:_SHOWN])
    more = f"; and {len(issues) - _SHOWN} more" if len(issues) > _SHOWN else ""
    expect(not issues, f"{lines}{more}", "none")


for _id, _section, _title, _level, _codes in _ROWS:
    _add_306(_id, f"306-1, {_section}", _title, _level)(partial(_without_issues, _codes))


@_add_306(
    "E07", "306-1, sections of objects", "mappable objects have a direction: ro, wo, rwr or rww", _SHOULD
)  # T 1.0
def _directions(node: CheckedNode) -> None:
    entries = [entry for entry in _eds(node).od if entry.pdo_mappable and entry.access == "rw"]
    names = ", ".join(f"0x{entry.index:04X}:{entry.subindex:02X}" for entry in entries[:_SHOWN])
    expect(not entries, f"rw: {names}", "rwr for a TPDO, rww for an RPDO")


@_add_306(
    "E11", "306-1, [DeviceInfo]", "vendor, product and revision of [DeviceInfo] are the defaults of 0x1018", _SHOULD
)
def _device_info(node: CheckedNode) -> None:
    od = _eds(node).od
    device = od.device
    numbers = (device.vendor_number, device.product_number, device.revision_number)
    for subindex, number in enumerate(numbers, 1):
        entry = od.get(0x1018, subindex)
        if number is not None and entry is not None and isinstance(entry.default, int):
            expect(number == entry.default, f"{number} and {entry.default} in 0x1018:{subindex:02X}", "equal numbers")


@_add_306("E12", "306-1, [DeviceInfo]", "[DeviceInfo] names a bit rate", _SHOULD)
def _bit_rates(node: CheckedNode) -> None:
    device = _eds(node).od.device
    if device == DeviceInfo():
        raise NotApplicable("the file has no [DeviceInfo]")
    expect(bool(device.bit_rates), "none", "BaudRate_N=1 for each bit rate")


@_add_306("E13", "306-1, sections of objects", "a drive has 0x6040, 0x6041, 0x6060, 0x6061 and 0x6502", _SHOULD)
def _drive(node: CheckedNode) -> None:
    od = _eds(node).od
    if (od.number(DEVICE_TYPE) or 0) & 0xFFFF != 402:
        raise NotApplicable("the low word of 0x1000 is not 402: no drive")
    required = (
        o.CONTROLWORD,
        o.STATUSWORD,
        o.MODES_OF_OPERATION,
        o.MODES_OF_OPERATION_DISPLAY,
        o.SUPPORTED_DRIVE_MODES,
    )
    missing = [f"0x{index:04X}" for index in required if od.get(index) is None]
    expect(not missing, f"{', '.join(missing)} missing", "all of them")


SDO_CHECKS = CheckList("301")
_add = SDO_CHECKS.add
_UPLOAD_ANSWER, _BLOCK_UPLOAD = 0x40, 0xA0
_MANDATORY = (0x1000, 0x1001, 0x1018)
_UNREAD = 2  # ObjFlags bit 1: not read in a scan (CiA 306)
_STRINGS = (0x1008, 0x1009, 0x100A)


def _od(node: CheckedNode) -> ObjectDictionary:
    if node.eds is None:
        raise NotApplicable("no EDS to compare with; give one with --eds")
    return node.eds.od


def _segmented(node: CheckedNode) -> tuple[int, int]:
    """Return index and announced length of an object with segmented upload; raise NotApplicable if none exists."""
    for index in _STRINGS:
        answer = node.ask(upload_request(index))
        if answer is not None and answer[0] & 0xE2 == 0x40:
            node.request(client_abort(index))
            return index, int.from_bytes(answer[4:], "little")
    raise NotApplicable("no object of 0x1008 to 0x100A is longer than four bytes")


def _download(index: int) -> bytes:
    """Return the SDO request that initiates a segmented download of eight bytes."""
    return bytes((0x21, *mux(index), 8, 0, 0, 0))


_NO_OBJECT, _NO_SUBINDEX, _UNKNOWN = (AbortCode.NO_OBJECT,), (AbortCode.NO_SUBINDEX,), (AbortCode.UNKNOWN_COMMAND,)
_NOT_WRITABLE = (
    AbortCode.READ_ONLY,
    AbortCode.UNSUPPORTED_ACCESS,
    AbortCode.LENGTH_MISMATCH,
    AbortCode.LENGTH_TOO_HIGH,
)


@_add("S01", "7.2.4.3.5", "0x1000 is uploaded expedited with four bytes")  # T 2.1
def _device_type(node: CheckedNode) -> None:
    answer = node.ask(upload_request(0x1000))
    actual = answer_text(answer)
    expect(answer is not None and answer[:4] == b"\x43\x00\x10\x00", actual, "43 00 10 00 and the device type")


@_add("S03", "7.2.4.3.17", "a download to 0x1000 (const) is refused")  # T 2.3
def _read_only(node: CheckedNode) -> None:
    value = node.read(0x1000)  # its own value: no change if the device accepts the download
    request = bytes((0x23, *mux(0x1000))) + value[:4].ljust(4, b"\0")
    expect_abort(node, request, AbortCode.READ_ONLY, AbortCode.UNSUPPORTED_ACCESS)


for _id, _title, _request, _aborts in (
    ("S05", "an upload of 0x1000:01, which does not exist, is refused", upload_request(0x1000, 1), _NO_SUBINDEX),
    ("S06", "an upload of 0x1004, which is reserved, is refused", upload_request(0x1004), _NO_OBJECT),
    (
        "S06w",
        "a download to 0x1004, which is reserved, is refused at its initiation",
        _download(0x1004),
        _NO_OBJECT,
    ),
    ("S03s", "a segmented download to 0x1000 is refused at its initiation", _download(0x1000), _NOT_WRITABLE),
    ("S07", "an unknown command specifier is refused", bytes((0xE0, *mux(0x1000), *bytes(4))), _UNKNOWN),
):  # T 2.5, 2.6, 2.7
    _add(_id, "7.2.4.3.17", _title)(aborts(_request, *_aborts))


@_add("S12", "7.5.2.33", "0x1200 shows the identifiers of the default SDO")  # T 2.12
def _server_parameters(node: CheckedNode) -> None:
    for subindex, base in ((1, REQUEST_BASE), (2, ANSWER_BASE)):
        value = node.number(0x1200, subindex)
        expect(value == base + node.node_id, f"0x{value:08X} in :{subindex:02X}", f"0x{base + node.node_id:X}")


@_add("S14", "7.2.4.3.6", "segments alternate their toggle bit and contain the announced length")  # T 2.16
def _segments(node: CheckedNode) -> None:
    _segmented(node)
    addresses = [(index, 0) for index in _STRINGS]
    if node.eds is not None:  # up to ten further objects of any length
        more = [entry.address for entry in node.eds.od if entry.readable and entry.data_type.bits is None]
        addresses += [address for address in more if address not in addresses][:10]
    for address in addresses:
        answer = node.ask(upload_request(*address))
        if answer is not None and answer[0] & 0xE2 == 0x40:
            _all_segments(node, int.from_bytes(answer[4:], "little"))


def _all_segments(node: CheckedNode, size: int) -> None:
    """Receive the segments of an upload, and check their toggle bits and the total length."""
    count, toggle = 0, 0
    while True:
        answer = node.ask(bytes((0x60 | toggle, *bytes(7))))
        if answer is None or answer[0] & 0xE0 or answer[0] & 0x10 != toggle:
            actual = answer_text(answer)
            raise CheckFailed(actual, f"a segment with toggle bit {toggle >> 4}")
        count += 7 - (answer[0] >> 1 & 7)
        if answer[0] & 1:
            break
        toggle ^= 0x10
    expect(count == size, f"{count} bytes", f"the {size} bytes announced")


@_add("S15", "7.2.4.3.17", "a request for the first segment with toggle bit 1 is refused")  # T 2.17
def _first_toggle(node: CheckedNode) -> None:
    index, _ = _segmented(node)
    node.ask(upload_request(index))
    expect_abort(node, bytes((0x70, *bytes(7))), AbortCode.TOGGLE_NOT_ALTERNATED)


@_add("S15r", "7.2.4.3.17", "a second segment request with the same toggle bit is refused", _SHOULD)
def _repeated_toggle(node: CheckedNode) -> None:
    index, size = _segmented(node)
    if size <= 14:
        raise NotApplicable("no upload of 0x1008 to 0x100A takes three segments")
    node.ask(upload_request(index))
    node.ask(bytes((0x60, *bytes(7))))
    expect_abort(node, bytes((0x60, *bytes(7))), AbortCode.TOGGLE_NOT_ALTERNATED)


@_add("S16", "7.2.4.3.13", "a block upload of 0x1000 works, or is refused as unknown")  # T 2.19
def _block_upload(node: CheckedNode) -> None:
    _block(node, 0x1000)
    value = node.read(0x1000, block=True)
    expect(value == node.read(0x1000), value.hex(" ").upper(), "the value of the expedited upload")


def _block(node: CheckedNode, index: int) -> None:
    """Raise NotApplicable if the server does not support block upload."""
    answer = node.ask(bytes((_BLOCK_UPLOAD | 4, *mux(index), 127, 0, 0, 0)))
    if answer is not None and answer[0] & 0xE0 == 0xC0:
        node.request(client_abort(index))
        return
    if answer is not None and answer[0] == ABORT:
        code = int.from_bytes(answer[4:], "little")
        expect(code in (AbortCode.UNKNOWN_COMMAND, 0x08000000), f"abort 0x{code:08X}", "abort 0x05040001")
        raise NotApplicable("the server has no block transfer")
    # CiA 301, 7.2.4.3.13: the server may switch to another protocol
    if answer is not None and answer[0] & 0xE0 == _UPLOAD_ANSWER:
        node.request(client_abort(index))
        raise NotApplicable("the server answers a block upload with a normal upload")
    raise CheckFailed(answer_text(answer), "an initiation of a block upload")


def _block_size_refused(node: CheckedNode, size: int) -> None:
    _block(node, 0x1000)
    request = bytes((_BLOCK_UPLOAD, *mux(0x1000), size, 0, 0, 0))
    expect_abort(node, request, AbortCode.INVALID_BLOCK_SIZE, AbortCode.UNKNOWN_COMMAND)


for _id, _size in (("S18", 128), ("S18z", 0)):  # T 2.26
    _add(_id, "7.2.4.3.13", f"a block size of {_size} is refused")(partial(_block_size_refused, size=_size))


@_add("S20", "7.5.2.33", "further SDO servers and clients have legal identifiers, or are absent", _SHOULD)  # T 2.28
def _further_servers(node: CheckedNode) -> None:
    for index in (0x1201, 0x1280):
        try:
            value = int.from_bytes(node.read(index, 1), "little")
        except SdoAbort as error:
            codes = AbortCode.NO_OBJECT, AbortCode.NO_SUBINDEX
            expect(error.code in codes, f"abort 0x{error.code:08X} for 0x{index:04X}:01", "0x06020000")
        else:
            expect(value >> 31 == 1 or value & 0x7FF > 0x80, f"0x{value:08X}", "a legal identifier or bit 31")


@_add("S23", "7.2.4.3.17", "an abort of the client ends a transfer without an answer")
def _abort_of_the_client(node: CheckedNode) -> None:
    index, _ = _segmented(node)
    node.ask(upload_request(index))
    answer = node.ask(client_abort(index))
    expect_silence(answer)
    node.read(0x1000)


@_add("S24", "7.2.4.3.5", "an initiate request during a transfer ends the transfer", _SHOULD)
def _initiation_within(node: CheckedNode) -> None:
    index, _ = _segmented(node)
    node.ask(upload_request(index))
    answer = node.ask(upload_request(0x1000))
    actual = answer_text(answer)
    expect(answer is not None and answer[0] == 0x43, actual, "the answer to the new request")


_add("S25", "7.2.4.3.17", "a request for a segment without a transfer is refused", _SHOULD)(
    aborts(bytes((0x60, *bytes(7))), AbortCode.UNKNOWN_COMMAND, AbortCode.TOGGLE_NOT_ALTERNATED)
)


@_add("S26", "7.2.4.3.2", "a request of seven bytes is ignored, and the next one is answered", _SHOULD)
def _short_request(node: CheckedNode) -> None:
    answer = node.ask(upload_request(0x1000)[:7])
    expect_silence(answer)
    node.read(0x1000)


@_add("S27", "7.2.4", "a hundred uploads in a row are answered", _SHOULD)
def _in_a_row(node: CheckedNode) -> None:
    times = []
    for _ in range(100):
        begin = node.reactor.now()
        node.read(0x1000)
        times.append(node.reactor.now() - begin)
    node.notes.append(f"99 of 100 answers within {sorted(times)[98] / 1e6:.2f} ms")


@_add("S02", "7.2.4.3.3", "the value of 0x1017 can be written back", touch=_CONFIGURE)  # T 2.2
def _write_back(node: CheckedNode) -> None:
    value = node.optional(0x1017)
    node.write(0x1017, 0, value)
    expect(node.read(0x1017) == value, node.read(0x1017).hex(" "), value.hex(" "))


@_add("S08", "7.2.4.3.17", "four bytes for 0x1017 (UNSIGNED16) are refused", touch=_CONFIGURE)  # T 2.8
def _too_long(node: CheckedNode) -> None:
    value = node.optional(0x1017)
    codes = AbortCode.LENGTH_TOO_HIGH, AbortCode.LENGTH_MISMATCH
    expect_refused(node, 0x1017, 0, value.ljust(4, b"\0"), *codes)


@_add("S09", "7.2.4.3.17", "one byte for 0x1017 (UNSIGNED16) is refused", touch=_CONFIGURE)  # T 2.9
def _too_short(node: CheckedNode) -> None:
    value = node.optional(0x1017)
    expect_refused(node, 0x1017, 0, value[:1], AbortCode.LENGTH_TOO_LOW, AbortCode.LENGTH_MISMATCH)


@_add("S13", "7.2.4.3.4", "two bytes can be written to 0x1017 in a segment", _SHOULD, _CONFIGURE)  # T 2.15
def _segment_of_two(node: CheckedNode) -> None:
    value = node.optional(0x1017)
    answer = node.ask(bytes((0x21, *mux(0x1017), 2, 0, 0, 0)))
    expect(answer is not None and answer[0] == 0x60, "no confirmation of the initiation", "60")
    answer = node.ask(bytes((0x0B, *value, 0, 0, 0, 0, 0)))
    expect(answer is not None and answer[0] == 0x20, "no confirmation of the segment", "20")
    expect(node.read(0x1017) == value, node.read(0x1017).hex(" "), value.hex(" "))


@_add("S28", "7.2.4.3.3", "an expedited download without a size is accepted or refused", _SHOULD, _CONFIGURE)
def _no_size(node: CheckedNode) -> None:
    value = node.optional(0x1017)
    answer = node.ask(bytes((0x22, *mux(0x1017), *value, 0, 0)))
    actual = answer_text(answer)
    expect(answer is not None and answer[0] in (0x60, ABORT), actual, "60 or an abort")


@_add("S31", "7.2.4.3", "the first request after the boot-up message is answered", _SHOULD, _CONFIGURE)
def _first_request(node: CheckedNode) -> None:
    boot(node)
    node.listen(0.1)
    answer = node.ask(upload_request(0x1000))
    expect(answer is not None, f"no answer within {node.timeout_s:g} s", "an answer")


@_add("S30", "7.2.4.3", "an object mapped in an RPDO can be written by SDO in OPERATIONAL", _SHOULD, _CONFIGURE)
def _mapped_object(node: CheckedNode) -> None:
    index, subindex, _ = parse_mapping_entry(first_pdo(node).entries[0])
    if index in DUMMY_TYPES:
        raise NotApplicable("the first RPDO begins with a gap")
    with node.operational():
        node.write(index, subindex, node.optional(index, subindex))


# -- objects


@_add("O00", "7.5.1", "the mandatory objects 0x1000, 0x1001 and 0x1018 exist")
def _mandatory(node: CheckedNode) -> None:
    for index in _MANDATORY:
        node.read(index)


@_add("O01", "7.4.7", "every readable object can be read, with the length of its type")  # T 4.1
def _every_object(node: CheckedNode) -> None:
    wrong = [text for entry in _od(node) if (text := _read_badly(node, entry))]
    expect(not wrong, "; ".join(wrong[:10]) + (f" and {len(wrong) - 10} more" if len(wrong) > 10 else ""), "the EDS")


def _read_badly(node: CheckedNode, entry: Entry) -> str:
    """Return how the upload of an object fails or deviates in length, or "" if it is correct or not required."""
    if not entry.readable or entry.obj_flags & _UNREAD:
        return ""
    name = f"0x{entry.index:04X}:{entry.subindex:02X}"
    try:
        data = node.read(entry.index, entry.subindex)
    except SdoAbort as error:
        # 0x1003 shows no entry before the first error (7.5.2.4); a device state may refuse others
        empty = error.code in (AbortCode.NO_DATA, AbortCode.NO_SUBINDEX) and entry.index == 0x1003
        return "" if empty or error.code == AbortCode.DEVICE_STATE else f"{name}: abort 0x{error.code:08X}"
    bits = entry.data_type.bits
    return f"{name} has {len(data)} bytes" if bits is not None and len(data) != (bits + 7) // 8 else ""


@_add("O02", "7.4.7", "constants have the values of the EDS", _SHOULD)  # T 4.2
def _constants(node: CheckedNode) -> None:
    wrong = []
    for entry in _od(node).for_node(node.node_id):
        if entry.access != "const" or entry.default is None or entry.index == 0x1018:
            continue
        if (data := node.read(entry.index, entry.subindex)) != encode(entry.default, entry.data_type):
            wrong.append(f"0x{entry.index:04X}:{entry.subindex:02X} is {data.hex(' ').upper()}")
    expect(not wrong, "; ".join(wrong[:10]), "the EDS")


@_add("O04", "7.4.7.1", "subindex 0xFF contains the structure, or does not exist", _SHOULD)  # T 4.5
def _structure(node: CheckedNode) -> None:
    try:
        data = node.read(0x1018, 0xFF)
    except SdoAbort as error:
        expect(error.code == AbortCode.NO_SUBINDEX, f"abort 0x{error.code:08X}", "0x06090011")
    else:
        expect(len(data) == 4, f"{len(data)} bytes", "4 bytes")


@_add("O07", "7.5.2.21", "the identity in 0x1018 matches the EDS")
def _identity(node: CheckedNode) -> None:
    od = _od(node)
    for subindex in (1, 2):
        entry = od.get(0x1018, subindex)
        if entry is not None and isinstance(entry.default, int):
            value = int.from_bytes(node.read(0x1018, subindex), "little")
            expect(value == entry.default, f"0x{value:X} in :{subindex:02X}", f"0x{entry.default:X} of the EDS")


@_add("O07v", "7.5.2.21", "the vendor id in 0x1018 is not 0", _SHOULD)
def _vendor(node: CheckedNode) -> None:
    vendor = int.from_bytes(node.read(0x1018, 1), "little")
    expect(vendor != 0, "vendor id 0", "the vendor id that CiA assigned")


@_add("O08", "7.5.2.8", "the strings of 0x1008 to 0x100A are printable", _SHOULD)
def _strings(node: CheckedNode) -> None:
    texts = 0
    for index in _STRINGS:
        try:
            data = node.read(index).rstrip(b"\0")
        except SdoAbort:
            continue
        texts += 1
        expect(all(0x20 <= byte < 0x7F for byte in data), f"{data!r} in 0x{index:04X}", "VISIBLE_STRING")
    if not texts:
        raise NotApplicable("none of 0x1008 to 0x100A exists")
